"""Conversion of a `PlanningScene` to a MuJoCo model.

`build` creates the MuJoCo model directly from the robot's kinematic tree. `PhysicsSettings` holds the
parameters that the scene does not have. Each link and object becomes a body of the same name, so contacts
have names.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import mujoco

from armcell.core import InputError
from armcell.model import SuctionGripper
from armcell.model.mjcf.spec import UNSAVED, log_mujoco_warnings
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.built_model import BuiltModel, indexed
from armcell.sim.cups import add_cups
from armcell.sim.decals import Decal, add_decals
from armcell.sim.objects import add_object, weld_name
from armcell.sim.robot import add_arm_actuators, add_excludes, add_gripper, add_robot
from armcell.sim.settings import PhysicsSettings
from armcell.sim.shapes import GeomAdder

RENDER_CAMERA = "render"


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
            add_cups(spec, bodies, gripper)
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
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", UNSAVED)
            mj = spec.compile()
    except ValueError as error:
        raise InputError(f"physics cannot be built for {scene.model.name!r}: {error}") from None
    return indexed(scene, settings, spec, mj, objects)


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
