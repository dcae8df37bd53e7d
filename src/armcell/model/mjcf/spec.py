"""MuJoCo specs of robots, normalized so that every link of the robot model has a body.

This file and `reader.py` are the only ones below `sim` that import MuJoCo: its compiler is the only complete
reader of its own format (defaults, angle units, frames, replicated bodies, inertia from geoms).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from armcell.core import InputError

logger = logging.getLogger(__name__)

WORLD = "world"
_ENDLESS = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)
_FREE, _BALL = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL
_POSITIONS = {_FREE: 7, _BALL: 4}


UNSAVED = "Attaching a spec with an empty prefix may prevent the model from being saved"
"""Part of a MuJoCo warning about models saved as XML, which does not concern armcell."""


def log_mujoco_warnings() -> None:
    """Log MuJoCo's warnings about a robot's spec, instead of printing them and writing them to
    MUJOCO_LOG.TXT.
    """
    mujoco.set_mju_user_warning(_log_warning)


def _log_warning(message: str) -> None:
    if UNSAVED not in message:
        logger.warning("MuJoCo: %s", message)


@dataclass(frozen=True, eq=False)
class RobotSpec:
    """Normalized MuJoCo spec of a robot, with its compiled model and the elements that normalization removed.

    All bodies and joints have names. Every link of the robot model has a body: each named site, and each
    joint frame that is not its body's frame, gets an empty body that moves with the body.

    Attributes:
        compiled: the mjModel without the empty bodies.
        frames: name of the link at each joint's frame, by joint name; the body's own name for its last joint
            if that joint's anchor is the body's origin.
        sites: name of the link of each named site, by site name.
        keys: joint positions [rad or m] of each named keyframe, by joint name.
        objects: names of the bodies that are objects, not parts of the robot.
    """

    spec: Any
    compiled: Any
    frames: dict[str, str]
    sites: dict[str, str]
    keys: dict[str, dict[str, float]]
    objects: tuple[str, ...]


def robot_spec(text: str) -> RobotSpec:
    """Return the normalized MuJoCo spec of a robot from its MJCF text. It has one body for each link.

    Lights, cameras, sensors, keyframes, the floor and other fixed geoms of the world, and free objects are
    removed. A free base becomes a fixed base.

    Raises:
        ValueError: MuJoCo cannot parse or compile the text.
        InputError: the model has a ball joint, or no body.
    """
    log_mujoco_warnings()
    spec = mujoco.MjSpec.from_string(text)
    keys = _keyframes(spec)
    objects = _remove_objects(spec)
    for kind in ("keys", "sensors", "lights", "cameras", "skins", "flexes", "hfields", "tuples"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for geom in list(spec.worldbody.geoms):
        spec.delete(geom)
    for geom in list(spec.geoms):
        if int(geom.type) in _ENDLESS:
            spec.delete(geom)
    if not list(spec.worldbody.bodies):
        raise InputError("has no <body>", hint="is this a robot, or only a scene?")
    _add_names(spec)
    spec.compiler.discardvisual = spec.compiler.fusestatic = False
    model = spec.compile()
    taken = {body.name for body in spec.bodies}
    frames = _add_joint_frames(spec, model, taken)
    return RobotSpec(spec, model, frames, _add_sites(spec, model, taken), keys, objects)


def _tree(body: Any) -> list[Any]:
    """Return a body in the MuJoCo spec of a robot and all bodies below it, depth first."""
    return [body, *(inner for child in body.bodies for inner in _tree(child))]


def _keyframes(spec: Any) -> dict[str, dict[str, float]]:
    """Return the positions of hinge and slide joints in each named keyframe of a robot's MuJoCo spec, by
    joint name.
    """
    at, addresses = 0, {}
    for body in _tree(spec.worldbody):
        for joint in body.joints:
            if joint.type not in _POSITIONS and joint.name:
                addresses[joint.name] = at
            at += _POSITIONS.get(joint.type, 1)
    found = {}
    for key in spec.keys:
        qpos = np.asarray(key.qpos, dtype=float)
        if key.name and len(qpos) == at and np.isfinite(qpos).all():
            found[key.name] = {name: float(qpos[i]) for name, i in addresses.items()}
    return found


def _remove_objects(spec: Any) -> tuple[str, ...]:
    """Delete mocap bodies and free objects from a robot's MuJoCo spec.
    If the robot's base is free, fix it.
    """
    found = []
    for body in list(spec.worldbody.bodies):
        joints = [joint for inner in _tree(body) for joint in inner.joints]
        free = [joint for joint in joints if joint.type == _FREE]
        if body.mocap or (free and len(free) == len(joints)):
            found.append(body.name)
            spec.delete(body)
            continue
        for joint in free:
            logger.info("%s: the free joint of the base is left out: the base is fixed", spec.modelname)
            spec.delete(joint)
    return tuple(found)


def _add_names(spec: Any) -> None:
    taken = {body.name for body in spec.bodies}
    for body in spec.bodies:
        if not body.name:
            parent = body.parent.name
            body.name = _unused(f"{parent}_child" if parent != WORLD else "base", taken)
    joints = {joint.name for joint in spec.joints}
    for joint in spec.joints:
        if joint.type == _BALL:
            raise InputError(
                f"joint {joint.name or joint.parent.name!r} is a ball joint; armcell's joints have one "
                "degree of freedom",
                hint="replace it by three hinges",
            )
        if not joint.name:
            joint.name = _unused(f"{joint.parent.name}_joint", joints)


def _unused(name: str, taken: set[str]) -> str:
    number, found = 2, name
    while found in taken:
        found, number = f"{name}{number}", number + 1
    taken.add(found)
    return found


def joints_of(model: Any, body: int) -> range:
    """Return the joint ids of a body in a robot's MuJoCo spec, in the order in which the joints act."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body])) if first >= 0 else range(0)


def _add_joint_frames(spec: Any, model: Any, taken: set[str]) -> dict[str, str]:
    """Add an empty body to a robot's MuJoCo spec for each MJCF joint that needs a separate link.

    MuJoCo's bodies may have several joints, and joints with an anchor off the body's origin; a link of a
    robot model has one joint at its origin.
    """
    frames = {}
    for body in range(1, model.nbody):
        joints = joints_of(model, body)
        for i in joints:
            name, anchor = model.joint(i).name, model.jnt_pos[i]
            frames[name] = model.body(body).name
            if i != joints[-1] or anchor.any():
                frames[name] = _unused(f"{name}_link", taken)
                spec.body(model.body(body).name).add_body(name=frames[name], pos=anchor)
    return frames


def _add_sites(spec: Any, model: Any, taken: set[str]) -> dict[str, str]:
    """Add an empty body to a robot's MuJoCo spec at each named site. Tool frames in MJCF are sites."""
    found = {}
    for i in range(model.nsite):
        name, body = model.site(i).name, int(model.site_bodyid[i])
        if name and body > 0:
            found[name] = name if name not in taken else _unused(f"{name}_site", taken)
            taken.add(found[name])
            pose = {"pos": model.site_pos[i], "quat": model.site_quat[i]}
            spec.body(model.body(body).name).add_body(name=found[name], **pose)
    return found


def _state_pose(geom: Any, model: Any, i: int) -> None:
    """Set the pose and the size of a geom in a robot's MuJoCo spec explicitly, to the values in the compiled
    model.

    The file may state them by another orientation, two end points or a <frame>.
    """
    geom.pos, geom.quat, geom.size = model.geom_pos[i], model.geom_quat[i], model.geom_size[i]
    geom.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    geom.fromto = [np.nan] * 6
    if geom.frame is not None:
        geom.set_frame(geom.parent.add_frame())


@lru_cache(maxsize=16)
def physics_spec(text: str) -> Any:
    """Return the normalized MuJoCo spec of a robot, ready to be attached to the model of a simulated world.

    Geoms that collide with nothing are removed, because armcell adds its own visuals; inertias and the poses
    of boxes are those of the compiled model. Inertias may come from geoms. Actuators are removed, because
    armcell's servos take over their gains and force limits. Callers attach a copy of the spec.
    """
    found = robot_spec(text)
    spec, model = found.spec, found.compiled
    for body in range(1, model.nbody):
        item = spec.body(model.body(body).name)
        item.explicitinertial = True
        item.mass, item.inertia = model.body_mass[body], model.body_inertia[body]
        item.ipos, item.iquat = model.body_ipos[body], model.body_iquat[body]
        item.fullinertia = [np.nan, *[0.0] * 5]  # undefined: principal axes are given
        item.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    solid = {int(i) for pair in (model.pair_geom1, model.pair_geom2) for i in pair}
    for i, geom in enumerate(list(spec.geoms)):
        if not (model.geom_contype[i] or model.geom_conaffinity[i] or i in solid):
            spec.delete(geom)
            continue
        if not (model.geom_contype[i] | model.geom_conaffinity[i]) & 1:
            geom.conaffinity = int(model.geom_conaffinity[i]) | 1  # otherwise objects would pass through it
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX and not geom.meshname:
            _state_pose(geom, model, i)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    return spec
