"""Conversion of a `PlanningScene` to a compiled MuJoCo model with index tables for joints and bodies.

`build` creates the MuJoCo model directly from the robot's kinematic tree. `PhysicsSettings` holds the
parameters that the scene does not have. Each link and object becomes a body of the same name, so contacts
have names.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, InputError
from armcell.model import Gripper, RobotModel, SuctionGripper
from armcell.model.composition import finger_parts
from armcell.model.mjcf.spec import UNSAVED, log_mujoco_warnings
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.cups import CupIndex, add_cups, index_cups
from armcell.sim.decals import Decal, add_decals
from armcell.sim.objects import GeomAdder, add_object, belt_name, slide_name, turn_name, weld_name
from armcell.sim.robot import (
    add_arm_actuators,
    add_excludes,
    add_gripper,
    add_robot,
    finger_weights,
    servo_force,
    tendon_name,
)
from armcell.sim.settings import PhysicsSettings

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
RENDER_CAMERA = "render"
MANY_GEOMS = 100
ARENA = 128 * 2**20  # [bytes] for contacts of more geoms; the default (about 20 MB) can be too small for them


@dataclass(frozen=True, eq=False)
class GripperIndex:
    """Indices and limits of the position servo that drives one gripper in a MuJoCo model built from a scene.

    The length of the servo's tendon is the driven joint's position, averaged over the fingers. A suction
    gripper has no servo; its `CupIndex`es hold the indices of its vacuum.
    """

    gripper: Gripper
    ctrl: int
    joints: tuple[tuple[int, float], ...]  # (index in qpos, weight); the tendon length is the weighted sum
    lower: float  # [m] of the driven joint
    upper: float
    max_speed: float  # [m/s] of the driven joint
    max_force: float  # [N] per finger
    finger_owners: NDArray[np.int64]  # (fingers,) index of each finger's or cup's link among the owners
    hand: NDArray[np.bool_]  # (owners,) True where the owner is a link of the hand
    tcp_body: int

    def length(self, qpos: Array) -> float:
        """Return the length [m] of the tendon that drives a gripper
        in a MuJoCo model, given the state `qpos`.

        MuJoCo's own tendon length is one step old after a step.
        """
        return sum(weight * float(qpos[i]) for i, weight in self.joints)


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A MuJoCo model that was built and compiled from a scene, with tables that map names to its indices.

    `owners` lists the links, then the objects.
    """

    scene: PlanningScene
    spec: mujoco.MjSpec
    mj: mujoco.MjModel
    owners: tuple[str, ...]
    owner_index: dict[str, int]
    link_count: int
    geom_owner: Ints  # (ngeom,) index in owners, -1 for none
    body: dict[str, int]  # by link or object name
    joint_qpos: dict[str, int]  # movable joints, mimic included
    joint_dof: dict[str, int]
    qpos: Ints  # (dof,) actuated joints in the model's order
    dofs: Ints  # (dof,)
    pos_ctrl: Ints  # (dof,) control index of the position (or torque) input, -1 for a gripper's joint
    vel_ctrl: Ints  # (dof,) control index of the velocity input, -1 for joints without one
    grippers: dict[str, GripperIndex]
    object_qpos: dict[str, int]  # movable objects: start of x, y, z, qw, qx, qy, qz
    belts: tuple[tuple[int, int, float], ...]  # index in qpos, in qvel, speed [m/s]
    threaded: dict[str, tuple[int, int]]  # screwed-in objects: qpos index of the slide and of the rotation
    object_dof: dict[str, int]
    objects: dict[str, CollisionObject]  # including attached objects, at their initial poses
    welds: dict[tuple[str, str], int]  # equality constraint id by (object, gripper)
    cups: tuple[CupIndex, ...]

    @property
    def moving(self) -> tuple[str, ...]:
        """Return the objects whose poses can change in a built MuJoCo model: free objects and screwed-in
        objects.
        """
        return (*self.object_qpos, *self.threaded)


def indexed(
    scene: PlanningScene,
    settings: PhysicsSettings,
    spec: mujoco.MjSpec,
    mj: mujoco.MjModel,
    objects: dict[str, CollisionObject],
) -> BuiltModel:
    model = scene.model
    owners = (*model.links, *objects)
    owner_index = {name: i for i, name in enumerate(owners)}
    body = {name: mj.body(name).id for name in owners}
    owner_of_body = np.full(mj.nbody, -1)
    for name, i in body.items():
        owner_of_body[i] = owner_index[name]
    for name, finger in finger_parts(model).items():
        owner_of_body[body[name]] = owner_index[finger]
    cups = index_cups(mj, model, owner_index)
    for cup in cups:
        owner_of_body[cup.body] = cup.owner
    joints = {name: mj.joint(name) for name in model.movable_joint_names}
    joint_qpos = {name: int(j.qposadr[0]) for name, j in joints.items()}
    joint_dof = {name: int(j.dofadr[0]) for name, j in joints.items()}
    driven = {name for g in model.grippers.values() for name in g.joint_names}
    # each pid actuator has two controls, so an actuator's id differs from its control index
    first = {n: int(mj.actuator_ctrladr[mj.actuator(n).id]) for n in model.joint_names if n not in driven}
    free = {
        n: mj.joint(f"{n}:free")
        for n, o in objects.items()
        if o.thread is None and (o.movable or n in scene.attached)
    }
    return BuiltModel(
        scene=scene,
        spec=spec,
        mj=mj,
        owners=owners,
        owner_index=owner_index,
        link_count=len(model.links),
        geom_owner=owner_of_body[mj.geom_bodyid],
        body=body,
        joint_qpos=joint_qpos,
        joint_dof=joint_dof,
        qpos=_ints(joint_qpos[n] for n in model.joint_names),
        dofs=_ints(joint_dof[n] for n in model.joint_names),
        pos_ctrl=_ints(first.get(n, -1) for n in model.joint_names),
        vel_ctrl=_ints(
            first[n] + 1 if n in first and settings.arm_control == "pid" else -1 for n in model.joint_names
        ),
        grippers={
            g.name: _gripper_index(mj, model, g, settings, owner_index) for g in model.grippers.values()
        },
        object_qpos={n: int(j.qposadr[0]) for n, j in free.items()},
        belts=tuple(
            (int(j.qposadr[0]), int(j.dofadr[0]), float(np.linalg.norm(o.belt)))
            for n, o in objects.items()
            if o.belt is not None and (j := mj.joint(belt_name(n))) is not None
        ),
        threaded={
            n: (int(mj.joint(slide_name(n)).qposadr[0]), int(mj.joint(turn_name(n)).qposadr[0]))
            for n, o in objects.items()
            if o.thread is not None
        },
        object_dof={n: int(j.dofadr[0]) for n, j in free.items()},
        objects=objects,
        welds={(n, g): mj.equality(weld_name(n, g)).id for n in free for g in model.grippers},
        cups=cups,
    )


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), dtype=np.int64)


def _gripper_index(
    mj: mujoco.MjModel, model: RobotModel, gripper: Gripper, settings: PhysicsSettings, owners: dict[str, int]
) -> GripperIndex:
    common = {
        "gripper": gripper,
        "finger_owners": np.array([owners[n] for n in gripper.contact_links], np.int64),
        "hand": np.array([name in gripper.hand_links for name in owners]),
        "tcp_body": mj.body(gripper.tcp_link).id,
    }
    if not gripper.joint_name:
        force = gripper.max_force
        return GripperIndex(
            ctrl=-1, joints=(), lower=0.0, upper=0.0, max_speed=0.0, max_force=force, **common
        )
    limits = model.joints[gripper.joint_name].limits
    actuator = mj.actuator(tendon_name(gripper.name)).id
    return GripperIndex(
        ctrl=int(mj.actuator_ctrladr[actuator]),
        joints=tuple((int(mj.joint(n).qposadr[0]), w) for n, w in finger_weights(model, gripper.joint_name)),
        lower=limits.lower,
        upper=limits.upper,
        max_speed=min(limits.velocity, settings.finger_speed / gripper.finger_travel_per_joint),
        max_force=servo_force(gripper, settings) / abs(gripper.width_per_joint),
        **common,
    )


def scene_objects(scene: PlanningScene) -> dict[str, CollisionObject]:
    """Return the objects of a planning scene by name, at their current poses, to build a MuJoCo model.

    Attached objects are included, because they are free bodies in physics.
    """
    return {**scene.objects, **{name: scene.object(name) for name in scene.attached}}


def same_build(a: PlanningScene, b: PlanningScene) -> bool:
    """Return whether `build` would create the same MuJoCo model from two planning scenes.

    Joint positions and poses of free bodies may differ.
    """
    if a.model is not b.model or dict(a.allowed) != dict(b.allowed) or set(a.attached) != set(b.attached):
        return False
    olds, news = scene_objects(a), scene_objects(b)
    if list(olds) != list(news):
        return False
    for name, new in news.items():
        old = olds[name]
        free = new.movable or name in b.attached
        if old.shapes is not new.shapes or (old.mass, old.material, old.movable, old.color, old.belt) != (
            new.mass, new.material, new.movable, new.color, new.belt
        ):  # fmt: skip
            return False
        if new.thread is not None:
            into = new.thread.into
            was = olds[into].T_world_object.inverse() @ old.T_world_object
            if new.thread != old.thread or not was.isclose(
                news[into].T_world_object.inverse() @ new.T_world_object
            ):
                return False
        if not free and not old.T_world_object.isclose(new.T_world_object, 0.0, 0.0):
            return False
    return True


def build(
    scene: PlanningScene,
    settings: PhysicsSettings | None = None,
    visuals: bool = False,
    decals: Iterable[Decal] = (),
) -> BuiltModel:
    """Build a compiled MuJoCo model from a planning scene.

    Args:
        visuals: also add the links' visual meshes, without contacts or mass, for rendering. A model without
            visual meshes has the same physics and compiles faster.
        decals: images to attach to links, objects or the world; only for models with `visuals`.
    Raises:
        InputError: MuJoCo rejects the model.
    """
    settings = settings or PhysicsSettings()
    log_mujoco_warnings()
    spec = mujoco.MjSpec()
    set_options(spec, settings)
    adder = GeomAdder(spec)
    bodies = add_robot(spec, adder, scene.model, settings, visuals)
    objects = scene_objects(scene)
    for item in objects.values():
        into = bodies[item.thread.into] if item.thread is not None else None
        T_into = objects[item.thread.into].T_world_object if item.thread is not None else None
        bodies[item.name] = add_object(spec, adder, item, item.name in scene.attached, settings, into, T_into)
    add_decals(spec, bodies, decals)
    add_excludes(spec, scene)
    add_arm_actuators(spec, scene.model, settings)
    for gripper in scene.model.grippers.values():
        if isinstance(gripper, SuctionGripper):
            add_cups(spec, bodies, scene.model, gripper)
        else:
            add_gripper(spec, scene.model, gripper, settings)
    for name, item in objects.items():
        if item.thread is None and (item.movable or name in scene.attached):
            for gripper in scene.model.grippers.values():
                spec.add_equality(
                    name=weld_name(name, gripper.name),
                    type=mujoco.mjtEq.mjEQ_WELD,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    name1=gripper.tcp_link,
                    name2=name,
                    active=False,
                    solref=settings.weld_solref,
                )
    _add_look(spec)
    if len(spec.geoms) > MANY_GEOMS:
        spec.memory = ARENA
    try:
        mj = compiled(spec)
    except ValueError as error:
        raise InputError(f"physics cannot be built for {scene.model.name!r}: {error}") from None
    return indexed(scene, settings, spec, mj, objects)


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a MuJoCo spec, without MuJoCo's warning about models that are saved as XML."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", UNSAVED)
        return spec.compile()


# --- options and look ---
def set_options(spec: mujoco.MjSpec, settings: PhysicsSettings) -> None:
    option = spec.option
    option.timestep = settings.timestep
    option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{settings.integrator.upper()}")
    option.cone = getattr(mujoco.mjtCone, f"mjCONE_{settings.cone.upper()}")
    option.impratio = settings.impratio
    option.iterations = settings.iterations
    option.noslip_iterations = settings.noslip_iterations
    option.gravity = settings.gravity
    # MuJoCo 4.0.0's sparse Newton solver has a known defect; "auto" selects it from 60 degrees of freedom on
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    if settings.sleep:
        option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    else:  # only sleeping needs islands; with few bodies, finding islands costs more time than it saves
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    spec.compiler.balanceinertia = True
    spec.compiler.fusestatic = False
    spec.compiler.degree = False
    spec.compiler.autolimits = False


def _add_look(spec: mujoco.MjSpec) -> None:
    visual = spec.visual
    visual.headlight.ambient = [0.35, 0.35, 0.35]
    visual.headlight.diffuse = [0.45, 0.45, 0.45]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    visual.map.znear = 0.005
    spec.stat.extent = 2.0
    sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    gradient = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(
        name="sky", type=sky, builtin=gradient, rgb1=[0.75, 0.83, 0.92], rgb2=[0.95, 0.97, 1.0],
        width=64, height=384,
    )  # fmt: skip
    spec.worldbody.add_light(
        name="key", pos=[1.0, -1.5, 3.0], dir=[-0.3, 0.45, -0.85], diffuse=[0.5, 0.5, 0.5],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False,
    )  # fmt: skip
    spec.worldbody.add_camera(name=RENDER_CAMERA)


def relative_pose(data: mujoco.MjData, body_a: int, body_b: int) -> SE3:
    """Return the pose T_a_b between two bodies of a MuJoCo model, such as a gripper and its held object,
    after the last physics step.

    Both poses come from the same instant.
    """
    return body_pose(data, body_a).inverse() @ body_pose(data, body_b)


def body_pose(data: mujoco.MjData, body: int) -> SE3:
    """Return the pose T_world_body of a body in a MuJoCo model, such as a gripper's tcp, after the last
    physics step.
    """
    return SE3(SO3(data.xmat[body].reshape(3, 3).copy()), data.xpos[body].copy())
