"""Scene objects in a MuJoCo model (fixed, free, on a conveyor belt, screwed into others) and their poses."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.collision.object_decomposition import object_pieces
from armcell.core import SE3
from armcell.scene import CollisionObject, ScrewThread, solid_inertia
from armcell.sim.settings import PhysicsSettings
from armcell.sim.shapes import OBJECT_GROUP, GeomAdder, full_inertia

_BELT_MASS = 1e5  # [kg] so heavy that the objects on a belt do not slow it down
Array = NDArray[np.float64]
Poses = tuple[Array, Array]
"""Positions (body, 3) [m] and quaternions (body, 4), wxyz, of all bodies in parent frames."""


def add_object(
    spec: mujoco.MjSpec, adder: GeomAdder, item: CollisionObject, attached: bool, settings: PhysicsSettings,
    into: Any = None, T_world_into: SE3 | None = None,
) -> Any:  # fmt: skip
    T = item.T_world_object if T_world_into is None else T_world_into.inverse() @ item.T_world_object
    values: dict[str, Any] = {
        "rgba": item.color,
        "group": OBJECT_GROUP,
        "density": 0.0,
        "friction": friction_coefficients(item),
    }
    free = item.movable or attached
    if free and item.thread is None:
        body = add_free_body(spec.worldbody, item, T)
    else:
        body = (into or spec.worldbody).add_body(name=item.name, pos=T.translation, quat=T.quat_wxyz)
    if free:
        if item.thread is not None:
            _add_thread(spec, body, item.name, item.thread)
            _set_inertia(body, item)
        values |= {
            "priority": 1,
            "condim": settings.object_condim,
            "solref": settings.object_solref,
            "solimp": settings.object_solimp,
        }
    elif item.belt is not None:
        _add_belt(body, item.name, item.belt)
    for i, (shape, T_object_shape) in enumerate(item.shapes):
        adder.add_solid(body, shape, T_object_shape, f"{item.name}:{i}", object_pieces, **values)
    return body


def add_free_body(parent: Any, item: CollisionObject, T_parent_object: SE3) -> Any:
    """Add a body for a scene object to a MuJoCo spec. The body has a free joint and inertia but no geoms."""
    body = parent.add_body(name=item.name, pos=T_parent_object.translation, quat=T_parent_object.quat_wxyz)
    body.add_freejoint(name=f"{item.name}:free")
    _set_inertia(body, item)
    return body


def _set_inertia(body: Any, item: CollisionObject) -> None:
    center, inertia = solid_inertia(item.shapes, item.mass_kg)
    body.explicitinertial = True
    body.mass, body.ipos, body.fullinertia = item.mass_kg, center, full_inertia(inertia)


def friction_coefficients(item: CollisionObject) -> list[float]:
    """Return the friction coefficients of a scene object as MuJoCo needs them: sliding, torsional and
    rolling.
    """
    return [item.material.friction, item.material.torsional_friction, item.material.rolling_friction]


def _add_belt(body: Any, name: str, velocity: tuple[float, float, float]) -> None:
    """Add a slide joint to the MuJoCo body of a conveyor belt, along the belt's direction of motion.

    Before every step, the world resets the joint's position to zero and its velocity to the belt speed. The
    belt therefore does not move, but the objects in contact with it see a moving surface.
    """
    speed = float(np.linalg.norm(velocity))
    body.add_joint(name=belt_name(name), type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.asarray(velocity) / speed)
    body.explicitinertial = True
    body.mass, body.inertia = _BELT_MASS, [_BELT_MASS] * 3
    body.gravcomp = 1.0


def _add_thread(spec: mujoco.MjSpec, body: Any, name: str, thread: ScrewThread) -> None:
    """Add a slide joint and a hinge joint to MuJoCo for a screwed-in object.
    The pitch of the thread couples the two joints.
    """
    per_radian = thread.pitch / (2 * np.pi)
    turns, axis = thread.travel / per_radian, [0.0, 0.0, 1.0]
    # In MuJoCo, a coupling of light joints is soft, so both joints get additional armature.
    for kind, joint, low, loss, armature in (
        (mujoco.mjtJoint.mjJNT_SLIDE, slide_name(name), -thread.travel, 0.0, 1.0),
        (mujoco.mjtJoint.mjJNT_HINGE, turn_name(name), -turns, thread.torque, 0.02),
    ):
        body.add_joint(
            name=joint, type=kind, axis=axis, limited=True, range=[low, -low * 0.1], frictionloss=loss,
            armature=armature, damping=[1e-3, 0.0, 0.0],
        )  # fmt: skip
    spec.add_equality(
        name=f"{name}:thread", type=mujoco.mjtEq.mjEQ_JOINT, name1=slide_name(name), name2=turn_name(name),
        data=[0.0, per_radian] + [0.0] * 10, solref=[0.004, 1.0], solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
    )  # fmt: skip


def belt_name(name: str) -> str:
    return f"{name}:belt"


def slide_name(name: str) -> str:
    return f"{name}:slide"


def turn_name(name: str) -> str:
    return f"{name}:turn"


def weld_name(item: str, gripper: str) -> str:
    return f"{item}:{gripper}:weld"


def write_free(data: mujoco.MjData, start: int, T_world_object: SE3) -> None:
    """Write the pose of a free object into MuJoCo's qpos.
    The entries of the object's joint begin at index `start`.
    """
    data.qpos[start : start + 3] = T_world_object.translation
    data.qpos[start + 3 : start + 7] = T_world_object.quat_wxyz


class FixedBodyPoses:
    """Poses of the fixed bodies in a compiled MuJoCo model. They can be changed until the next reset."""

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._first = self.get_state()

    def put(self, body: int, T_world_body: SE3) -> None:
        self._model.body_pos[body] = T_world_body.translation
        self._model.body_quat[body] = T_world_body.quat_wxyz

    def has_moved(self, body: int) -> bool:
        """Return whether the current pose of a fixed body differs
        from its pose in the compiled MuJoCo model.
        """
        position, quaternion = self._first
        moved = (self._model.body_pos[body] != position[body]).any()
        return bool(moved or (self._model.body_quat[body] != quaternion[body]).any())

    def reset(self) -> None:
        self.set_state(self._first)

    def get_state(self) -> Poses:
        return self._model.body_pos.copy(), self._model.body_quat.copy()

    def set_state(self, poses: Poses) -> None:
        self._model.body_pos[:], self._model.body_quat[:] = poses
