"""From a `PlanningScene` to a MuJoCo model and the table of what is where in it.

The model is made from the robot's tree directly. What physics adds to the scene's data is in
`PhysicsSettings`. Links and objects keep their names as bodies, so a contact can be told by name.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.collision.convex import convex_pieces
from armcell.collision.decompose import object_pieces
from armcell.core import SE3, InputError
from armcell.model import Gripper, Joint, Link, RobotModel
from armcell.model.assets import DEFAULT_COLOR
from armcell.scene import WORLD, CollisionObject, PlanningScene, Thread, solid_inertia
from armcell.sim.decals import Decal, add_decals
from armcell.sim.settings import PhysicsSettings
from armcell.sim.shapes import GeomAdder
from armcell.sim.visuals import visual_parts

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

OBJECT_GROUP, VISUAL_GROUP, COLLISION_GROUP = 0, 2, 3
"""MuJoCo's geom groups; viewers draw 0 to 2."""
RENDER_CAMERA = "render"
_TINY_MASS, _TINY_INERTIA = 1e-4, 1e-7
_BELT_MASS = 1e5  # [kg] what lies on a belt does not slow it down


@dataclass(frozen=True)
class GripperIndex:
    """One gripper's servo. The servo's length is the driven joint's position (mean over the fingers)."""

    gripper: Gripper
    ctrl: int
    joints: tuple[tuple[int, float], ...]  # (index in qpos, weight): the servo's length is their weighted sum
    lower: float  # [m] of the driven joint
    upper: float
    max_speed: float  # [m/s] of the driven joint
    max_force: float  # [N] per finger
    finger_owners: tuple[int, ...]
    tcp_body: int

    def length(self, qpos: Array) -> float:
        """Of the servo at a state. (MuJoCo's own is one step old after a step.)"""
        return sum(weight * float(qpos[i]) for i, weight in self.joints)


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A compiled model with indices by name. `owners` are links, then objects."""

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
    vel_ctrl: Ints  # (dof,) of the velocity input, -1 where there is none
    grippers: dict[str, GripperIndex]
    object_qpos: dict[str, int]  # movable objects: start of x, y, z, qw, qx, qy, qz
    belts: tuple[tuple[int, int, float], ...]  # index in qpos, in qvel, speed [m/s]
    threaded: dict[str, tuple[int, int]]  # objects screwed into others: slide and turn
    object_dof: dict[str, int]
    objects: dict[str, CollisionObject]  # attached ones included, at their initial poses
    welds: dict[tuple[str, str], int]  # equality by (object, gripper)

    @property
    def moving(self) -> tuple[str, ...]:
        """Objects whose pose changes."""
        return (*self.object_qpos, *self.threaded)


def scene_objects(scene: PlanningScene) -> dict[str, CollisionObject]:
    """Every object of a scene at its present pose. Attached ones are free bodies in physics."""
    return {**scene.objects, **{name: scene.object(name) for name in scene.attached}}


def build(
    scene: PlanningScene,
    settings: PhysicsSettings | None = None,
    visuals: bool = False,
    decals: Iterable[Decal] = (),
) -> BuiltModel:
    """Compile a scene.

    Args:
        visuals: add the links' visual meshes (no contacts, no mass) for drawing. The physics is the same
            without them and compiles faster.
        decals: pictures to be drawn, for models with visuals.
    Raises:
        InputError: MuJoCo refuses the model.
    """
    settings = settings or PhysicsSettings()
    spec = mujoco.MjSpec()
    _set_options(spec, settings)
    adder = GeomAdder(spec)
    bodies = _add_robot(spec, adder, scene.model, settings, visuals)
    objects = scene_objects(scene)
    for item in objects.values():
        into = bodies[item.thread.into] if item.thread is not None else None
        T_into = objects[item.thread.into].T_world_object if item.thread is not None else None
        bodies[item.name] = _add_object(
            spec, adder, item, item.name in scene.attached, settings, into, T_into
        )
    add_decals(spec, bodies, decals)
    _add_excludes(spec, scene)
    _add_arm_actuators(spec, scene.model, settings)
    for gripper in scene.model.grippers.values():
        _add_gripper(spec, scene.model, gripper, settings)
    for name, item in objects.items():
        if item.thread is None and (item.movable or name in scene.attached):
            for gripper in scene.model.grippers.values():
                spec.add_equality(
                    name=_weld_name(name, gripper.name),
                    type=mujoco.mjtEq.mjEQ_WELD,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    name1=gripper.tcp_link,
                    name2=name,
                    active=False,
                    solref=settings.weld_solref,
                )
    _add_look(spec)
    try:
        mj = spec.compile()
    except ValueError as error:
        raise InputError(f"physics cannot be built for {scene.model.name!r}: {error}") from None
    return _index(scene, settings, spec, mj, objects)


# --- options and look ---
def _set_options(spec: mujoco.MjSpec, settings: PhysicsSettings) -> None:
    option = spec.option
    option.timestep = settings.timestep
    option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{settings.integrator.upper()}")
    option.cone = getattr(mujoco.mjtCone, f"mjCONE_{settings.cone.upper()}")
    option.impratio = settings.impratio
    option.iterations = settings.iterations
    option.noslip_iterations = settings.noslip_iterations
    option.gravity = settings.gravity
    # MuJoCo 4.0.0's sparse Newton solver has a known defect, and "auto" turns to it at 60 degrees of freedom
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    if settings.sleep:
        option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
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


# --- robot ---
def _add_robot(
    spec: mujoco.MjSpec, adder: GeomAdder, model: RobotModel, settings: PhysicsSettings, visuals: bool
) -> dict[str, Any]:
    # several robots composed have a root of their own, which is MuJoCo's: the world
    root = spec.worldbody if model.root_link == WORLD else spec.worldbody.add_body(name=model.root_link)
    bodies = {model.root_link: root}
    for joint in model.joints.values():
        T = joint.T_parent_joint
        body = bodies[joint.parent].add_body(name=joint.child, pos=T.translation, quat=T.quat_wxyz)
        bodies[joint.child] = body
        if joint.movable:
            _add_joint(body, joint, settings)
    massless = _massless_carriers(model)
    for name, body in bodies.items():
        link = model.links[name]
        if name != WORLD:
            body.gravcomp = settings.gravity_compensation  # real arms compensate their own weight
            _set_inertia(body, link, name in massless)
        _add_link_geoms(adder, body, link, visuals)
    for joint in model.joints.values():
        if joint.mimic is not None:
            spec.add_equality(
                name=f"{joint.name}:mimic",
                type=mujoco.mjtEq.mjEQ_JOINT,
                name1=joint.name,
                name2=joint.mimic.joint,
                data=[joint.mimic.offset, joint.mimic.multiplier] + [0.0] * 10,
                solref=settings.object_solref,
                solimp=settings.object_solimp,
            )
    return bodies


def _add_joint(body: Any, joint: Joint, settings: PhysicsSettings) -> None:
    types = mujoco.mjtJoint
    limited = bool(np.isfinite(joint.limits.lower) and np.isfinite(joint.limits.upper))
    body.add_joint(
        name=joint.name,
        type=types.mjJNT_SLIDE if joint.type == "prismatic" else types.mjJNT_HINGE,
        axis=joint.axis,
        limited=limited,
        range=[joint.limits.lower, joint.limits.upper] if limited else [0.0, 0.0],
        armature=settings.armature,
        damping=[max(settings.joint_damping, joint.damping), 0.0, 0.0],  # linear, then higher powers of speed
        frictionloss=joint.friction,
        # the engine's soft stops would let a closing finger sink millimetres into its limit
        solref_limit=settings.object_solref,
        solimp_limit=settings.object_solimp,
    )


def _massless_carriers(model: RobotModel) -> set[str]:
    """Links moved by a joint which, with all that is fixed to them, weigh nothing (MuJoCo forbids that)."""
    found = set()
    for group in model.rigid_groups:
        heavy = any((i := model.links[n].inertial) is not None and i.mass > 0 for n in group)
        if not heavy and model.root_link not in group:
            found |= {n for n in group if model.parent_joint[n].movable}
    return found


def _set_inertia(body: Any, link: Link, carrier: bool) -> None:
    body.explicitinertial = True
    inertial = link.inertial
    if inertial is None or inertial.mass <= 0:
        if carrier:
            body.mass, body.inertia = _TINY_MASS, [_TINY_INERTIA] * 3
        else:
            body.mass, body.inertia = 0.0, [0.0] * 3
        return
    R = inertial.T_link_com.rotation.matrix
    inertia = R @ inertial.inertia @ R.T
    if np.linalg.eigvalsh(inertia)[0] <= 0:  # some URDFs give a mass and no inertia
        inertia = inertia + np.eye(3) * _TINY_INERTIA
    body.mass = inertial.mass
    body.ipos = inertial.T_link_com.translation
    body.fullinertia = _full(inertia)


def _full(inertia: Array) -> list[float]:
    return [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]


def _add_link_geoms(adder: GeomAdder, body: Any, link: Link, visuals: bool) -> None:
    color = next((v.color for v in link.visuals if v.color is not None), DEFAULT_COLOR)
    group = COLLISION_GROUP if link.visuals else OBJECT_GROUP
    for i, solid in enumerate(link.collisions):
        adder.add_solid(
            body, solid.shape, solid.T_link_shape, f"{link.name}:{i}", group=group, rgba=color, density=0.0
        )
    if not visuals:
        return
    looks = {"contype": 0, "conaffinity": 0, "group": VISUAL_GROUP, "density": 0.0}
    for i, visual in enumerate(link.visuals):
        name = f"{link.name}:visual{i}"
        if visual.shape is not None:
            rgba = visual.color or DEFAULT_COLOR
            adder.add_solid(body, visual.shape, visual.T_link_visual, name, rgba=rgba, **looks)
        for k, (mesh, rgba) in enumerate(visual_parts(visual)):
            adder.add_mesh(body, mesh, visual.T_link_visual, f"{name}.{k}", rgba=rgba, **looks)


def _add_excludes(spec: mujoco.MjSpec, scene: PlanningScene) -> None:
    """Link pairs that may touch: the model's, the scene's, and always links joined by one joint.

    Neighbours' hulls overlap at their joint, so there a contact would mean nothing.
    """
    model = scene.model
    group_of = {name: i for i, group in enumerate(model.rigid_groups) for name in group}
    joined = {frozenset((group_of[j.parent], group_of[j.child])) for j in model.joints.values() if j.movable}
    solid = [name for name, link in model.links.items() if link.collisions]
    for a, b in combinations(solid, 2):
        groups = frozenset((group_of[a], group_of[b]))
        if len(groups) == 1 or groups in joined or scene.is_allowed(a, b):
            spec.add_exclude(name=f"{a}|{b}", bodyname1=a, bodyname2=b)


def _add_arm_actuators(spec: mujoco.MjSpec, model: RobotModel, settings: PhysicsSettings) -> None:
    driven = {g.joint_name for g in model.grippers.values()}
    for name in model.joint_names:
        if name in driven:
            continue
        joint = model.joints[name]
        slide = joint.type == "prismatic"
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        # A weak joint with a strong joint's gains would saturate at every small error and chatter.
        weak = min(1.0, joint.limits.effort / settings.full_gain_effort)
        kp = weak * (settings.slide_kp if slide else settings.arm_kp)
        kv = weak * (settings.slide_kv if slide else settings.arm_kv)
        if settings.arm_control == "pid":
            actuator.set_to_pid(kp=kp, kv=kv)
        elif settings.arm_control == "position":
            actuator.set_to_position(kp=kp, kv=kv)
        else:
            actuator.set_to_motor()
        if np.isfinite(joint.limits.effort) and joint.limits.effort > 0:
            actuator.forcelimited = True
            actuator.forcerange = [-joint.limits.effort, joint.limits.effort]


def _add_gripper(spec: mujoco.MjSpec, model: RobotModel, gripper: Gripper, settings: PhysicsSettings) -> None:
    tendon = spec.add_tendon(name=_tendon_name(gripper.name))
    for joint, weight in _finger_weights(model, gripper.joint_name):
        tendon.wrap_joint(joint, weight)
    actuator = spec.add_actuator(
        name=_tendon_name(gripper.name), target=tendon.name, trntype=mujoco.mjtTrn.mjTRN_TENDON
    )
    actuator.set_to_position(kp=settings.gripper_kp, kv=settings.gripper_kv)
    limit = _servo_force(gripper, settings)
    actuator.forcelimited = True
    actuator.forcerange = [-limit, limit]


def _finger_weights(model: RobotModel, driven: str) -> list[tuple[str, float]]:
    """The driven joint and those that mimic it, weighted so that their sum is the mean finger position."""
    found = [(driven, 1.0)]
    for joint in model.joints.values():
        if joint.mimic is not None and joint.mimic.joint == driven and joint.mimic.multiplier != 0:
            found.append((joint.name, joint.mimic.multiplier))
    return [(name, 1.0 / (len(found) * multiplier)) for name, multiplier in found]


def _servo_force(gripper: Gripper, settings: PhysicsSettings) -> float:
    """Largest force of the servo [N]: a servo force f gives each finger f / |width_per_joint|."""
    return min(settings.gripper_force, gripper.max_force * abs(gripper.width_per_joint))


# --- objects ---
def _add_object(
    spec: mujoco.MjSpec, adder: GeomAdder, item: CollisionObject, attached: bool, settings: PhysicsSettings,
    into: Any = None, T_world_into: SE3 | None = None,
) -> Any:  # fmt: skip
    T = item.T_world_object if T_world_into is None else T_world_into.inv() @ item.T_world_object
    body = (into or spec.worldbody).add_body(name=item.name, pos=T.translation, quat=T.quat_wxyz)
    material = item.material
    values: dict[str, Any] = {
        "rgba": item.color,
        "group": OBJECT_GROUP,
        "density": 0.0,
        "friction": [material.friction, material.torsional_friction, material.rolling_friction],
    }
    free = item.movable or attached
    if free:
        if item.thread is None:
            body.add_freejoint(name=f"{item.name}:free")
        else:
            _add_thread(spec, body, item.name, item.thread)
        centre, inertia = solid_inertia(item.shapes, item.mass_kg)
        body.explicitinertial = True
        body.mass, body.ipos, body.fullinertia = item.mass_kg, centre, _full(inertia)
        values |= {
            "priority": 1,
            "condim": settings.object_condim,
            "solref": settings.object_solref,
            "solimp": settings.object_solimp,
        }
    elif item.belt is not None:
        _add_belt(body, item.name, item.belt)
    for i, (shape, T_object_shape) in enumerate(item.shapes):
        split = object_pieces if free else convex_pieces
        adder.add_solid(body, shape, T_object_shape, f"{item.name}:{i}", split, **values)
    return body


def _add_belt(body: Any, name: str, velocity: tuple[float, float, float]) -> None:
    """A joint along the belt's way. Before every step it is put back and given the belt's speed, so that the
    body stays where it is and what touches it feels a surface that moves."""
    speed = float(np.linalg.norm(velocity))
    body.add_joint(name=_belt_name(name), type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.asarray(velocity) / speed)
    body.explicitinertial = True
    body.mass, body.inertia = _BELT_MASS, [_BELT_MASS] * 3
    body.gravcomp = 1.0


def _add_thread(spec: mujoco.MjSpec, body: Any, name: str, thread: Thread) -> None:
    """A turn and a slide about the body's z axis, coupled by the pitch."""
    per_radian = thread.pitch / (2 * np.pi)
    turns, axis = thread.travel / per_radian, [0.0, 0.0, 1.0]
    # The engine makes a coupling as soft as both joints are light, so both get some inertia of their own.
    for kind, joint, low, loss, armature in (
        (mujoco.mjtJoint.mjJNT_SLIDE, _slide_name(name), -thread.travel, 0.0, 1.0),
        (mujoco.mjtJoint.mjJNT_HINGE, _turn_name(name), -turns, thread.torque, 0.02),
    ):
        body.add_joint(
            name=joint, type=kind, axis=axis, limited=True, range=[low, -low * 0.1], frictionloss=loss,
            armature=armature, damping=[1e-3, 0.0, 0.0],
        )  # fmt: skip
    spec.add_equality(
        name=f"{name}:thread", type=mujoco.mjtEq.mjEQ_JOINT, name1=_slide_name(name), name2=_turn_name(name),
        data=[0.0, per_radian] + [0.0] * 10, solref=[0.004, 1.0], solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
    )  # fmt: skip


def _belt_name(name: str) -> str:
    return f"{name}:belt"


def _slide_name(name: str) -> str:
    return f"{name}:slide"


def _turn_name(name: str) -> str:
    return f"{name}:turn"


# --- the table ---
def _tendon_name(gripper: str) -> str:
    return f"{gripper}:grip"


def _weld_name(item: str, gripper: str) -> str:
    return f"{item}:{gripper}:weld"


def _index(
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
    joints = {name: mj.joint(name) for name in model.movable_joint_names}
    joint_qpos = {name: int(j.qposadr[0]) for name, j in joints.items()}
    joint_dof = {name: int(j.dofadr[0]) for name, j in joints.items()}
    driven = {g.joint_name for g in model.grippers.values()}
    # pid actuators have two controls each, so the actuator's number is not the control's
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
            if o.belt is not None and (j := mj.joint(_belt_name(n))) is not None
        ),
        threaded={
            n: (int(mj.joint(_slide_name(n)).qposadr[0]), int(mj.joint(_turn_name(n)).qposadr[0]))
            for n, o in objects.items()
            if o.thread is not None
        },
        object_dof={n: int(j.dofadr[0]) for n, j in free.items()},
        objects=objects,
        welds={(n, g): mj.equality(_weld_name(n, g)).id for n in free for g in model.grippers},
    )


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), dtype=np.int64)


def _gripper_index(
    mj: mujoco.MjModel, model: RobotModel, gripper: Gripper, settings: PhysicsSettings, owners: dict[str, int]
) -> GripperIndex:
    limits = model.joints[gripper.joint_name].limits
    actuator = mj.actuator(_tendon_name(gripper.name)).id
    return GripperIndex(
        gripper=gripper,
        ctrl=int(mj.actuator_ctrladr[actuator]),
        joints=tuple((int(mj.joint(n).qposadr[0]), w) for n, w in _finger_weights(model, gripper.joint_name)),
        lower=limits.lower,
        upper=limits.upper,
        max_speed=min(limits.velocity, settings.finger_speed),
        max_force=_servo_force(gripper, settings) / abs(gripper.width_per_joint),
        finger_owners=tuple(owners[n] for n in gripper.finger_links),
        tcp_body=mj.body(gripper.tcp_link).id,
    )
