"""Grippers: the servo that closes them, what they hold, and the welds of the modes that are not friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3
from armcell.sim.built import BuiltModel, GripperIndex
from armcell.sim.settings import PhysicsSettings
from armcell.sim.stepping import (
    BLOCKED_LEAD,
    CONTROL,
    LAW_SIZE,
    LEAD,
    PUSH_STEP,
    SET_POINT,
    STEP,
    TARGET,
    add_finger_forces,
    drive_fingers,
)

Array = NDArray[np.float64]

_CHECK_EVERY = 5  # steps between two looks of the weld modes
_SETTLING = 0.2  # [s] both fingers press before "weld" fixes the object or "hybrid" measures its slip
_WIDTH_TOLERANCE = 1e-4  # [m]


@dataclass(frozen=True)
class GripperState:
    """`held` is the object that both fingers touch, or None. Force [N] along the closing axis, per finger."""

    width: float  # [m]
    force_per_finger: float
    held: str | None


@dataclass(frozen=True)
class WeldEvent:
    """An object was fixed to a gripper by a weld, which is not friction: always to be reported."""

    time: float  # [s]
    object: str
    gripper: str
    mode: str  # "weld" or "hybrid"
    reason: str
    released_at: float | None = None  # [s]


class GripperDrive:
    """Drives one gripper's servo: to a width, at a bounded finger speed, with a bounded force per finger.

    The servo's set point runs ahead of the fingers by no more than what gives the wanted force, so blocked
    fingers press with exactly that force and free ones move at `max_speed`.
    """

    def __init__(self, index: GripperIndex, settings: PhysicsSettings, law: Array):
        """The law (7,) is what `stepping.drive_fingers` works with, kept up to date here."""
        self.index, self._law = index, law
        self._kp = settings.gripper_kp
        self._ratio = abs(index.gripper.width_per_joint)
        dt = settings.timestep
        lag = (settings.gripper_kv + 2 * settings.joint_damping) * index.max_speed / settings.gripper_kp
        law[CONTROL] = index.ctrl
        law[BLOCKED_LEAD] = 3 * lag + 0.001  # [m] more than free fingers ever lag behind
        law[STEP] = index.max_speed * dt
        law[PUSH_STEP] = max(law[STEP], settings.grip_force_rate * self._ratio / settings.gripper_kp * dt)
        law[LEAD] = self._force_lead(index.max_force)

    def _force_lead(self, force: float) -> float:
        return min(force, self.index.max_force) * self._ratio / self._kp

    def hold(self, data: mujoco.MjData, joint_position: float) -> None:
        """Stay at a joint position, at full force."""
        self._law[[SET_POINT, TARGET]] = joint_position
        data.ctrl[self.index.ctrl] = joint_position
        self._law[LEAD] = self._force_lead(self.index.max_force)

    def command(self, width: float, force_per_finger: float) -> None:
        """Drive to a width [m]. The closed end means: press with that force [N] on what is between."""
        gripper = self.index.gripper
        lead = self._force_lead(force_per_finger)
        ends = self.index.lower, self.index.upper
        closed = min(ends, key=gripper.width)
        target = float(np.clip(gripper.joint_position(width), *ends))
        if gripper.width(target) <= gripper.width(closed) + _WIDTH_TOLERANCE:
            target = closed - np.sign(gripper.width_per_joint) * lead
        self._law[TARGET], self._law[LEAD] = target, lead

    def closing(self, data: mujoco.MjData) -> bool:
        """Whether the fingers are told to be closer together than they are."""
        width = self.index.gripper.width
        return width(self._law.item(TARGET)) < width(self.index.length(data.qpos)) - _WIDTH_TOLERANCE

    def get_state(self) -> Array:
        return self._law.copy()

    def set_state(self, state: Array) -> None:
        self._law[:] = state


class Fingers:
    """The servos of every gripper.

    Attributes:
        law: (g, 7) a row per gripper, for `stepping.drive_fingers`.
        joints, weights: (g, k) index in qpos and share in the servo's length.
    """

    def __init__(self, built: BuiltModel, settings: PhysicsSettings):
        grippers = built.grippers
        most = max((len(index.joints) for index in grippers.values()), default=0)
        self.law = np.zeros((len(grippers), LAW_SIZE))
        self.joints, self.weights = np.zeros((len(grippers), most), np.int64), np.zeros((len(grippers), most))
        self.drives: dict[str, GripperDrive] = {}
        for row, (name, index) in enumerate(grippers.items()):
            self.drives[name] = GripperDrive(index, settings, self.law[row])
            for k, (joint, weight) in enumerate(index.joints):
                self.joints[row, k], self.weights[row, k] = joint, weight

    def update(self, data: mujoco.MjData) -> None:
        """Set the servos' inputs for the next step."""
        drive_fingers(self.law, self.joints, self.weights, data.qpos, data.ctrl)


def finger_forces(built: BuiltModel, data: mujoco.MjData, index: GripperIndex) -> dict[int, list[float]]:
    """Force [N] along the closing axis (the tcp's y) on each finger, by the owner index that it touches."""
    if data.ncon == 0:
        return {}
    contact, y_axis = data.contact, data.xmat[index.tcp_body][1::3]
    fingers = np.array(index.finger_owners, np.int64)
    forces = np.zeros((len(built.owners), len(fingers)))
    add_finger_forces(
        built.mj._address,
        data._address,
        contact.geom,
        contact.frame,
        built.geom_owner,
        fingers,
        y_axis,
        forces,
    )
    return {other: [*map(abs, row)] for other, row in enumerate(forces.tolist()) if any(row)}


def gripper_state(built: BuiltModel, data: mujoco.MjData, name: str) -> GripperState:
    index = built.grippers[name]
    forces = finger_forces(built, data, index)
    held = [
        (min(row), owner) for owner, row in forces.items() if min(row) > 0.0 and owner >= built.link_count
    ]
    position = data.qpos.item(built.joint_qpos[index.gripper.joint_name])
    return GripperState(
        width=index.gripper.width(position),
        force_per_finger=sum(map(sum, forces.values())) / len(index.finger_owners),
        held=built.owners[max(held)[1]] if held else None,
    )


def relative_pose(data: mujoco.MjData, body_a: int, body_b: int) -> SE3:
    """T_a_b from the kinematics of the last step (both from the same instant)."""
    return body_pose(data, body_a).inv() @ body_pose(data, body_b)


def body_pose(data: mujoco.MjData, body: int) -> SE3:
    """T_world_body."""
    return SE3(SO3(data.xmat[body].reshape(3, 3).copy()), data.xpos[body].copy())


@dataclass(frozen=True)
class _Grip:
    """What a weld mode knows of one gripper."""

    item: str | None = None
    since: float = 0.0  # [s] both fingers press it
    T_tcp_item: SE3 | None = None  # "hybrid" measures slip from here
    event: int | None = None  # index of the active weld


class Welder:
    """The grip modes "weld" and "hybrid". Each weld and its release is an event."""

    def __init__(self, built: BuiltModel, settings: PhysicsSettings, drives: Mapping[str, GripperDrive]):
        self._built = built
        self._settings = settings
        self._drives = drives
        self._grips = {name: _Grip() for name in built.grippers}
        self._steps = 0
        self.events: list[WeldEvent] = []

    def update(self, data: mujoco.MjData) -> None:
        """After a step: weld what is held, if the mode says so."""
        self._steps += 1
        if self._steps % _CHECK_EVERY:
            return
        for name, grip in self._grips.items():
            if grip.event is None and self._drives[name].closing(data):
                self._grips[name] = self._look(data, name, grip)

    def fix(self, data: mujoco.MjData, gripper: str, item: str, reason: str) -> None:
        """Weld an object to a hand as it is now, whatever the mode is."""
        self._grips[gripper] = self._weld(data, gripper, _Grip(item, float(data.time)), reason)

    def release(self, data: mujoco.MjData, gripper: str) -> None:
        """The gripper opens: undo its weld."""
        grip = self._grips[gripper]
        if grip.event is not None:
            event = self.events[grip.event]
            data.eq_active[self._built.welds[event.object, gripper]] = 0
            self.events[grip.event] = replace(event, released_at=float(data.time))
        self._grips[gripper] = _Grip()

    def _look(self, data: mujoco.MjData, name: str, grip: _Grip) -> _Grip:
        built, settings, now = self._built, self._settings, float(data.time)
        index = built.grippers[name]
        pressed = {
            built.owners[owner]: min(row)
            for owner, row in finger_forces(built, data, index).items()
            if min(row) >= settings.weld_force and built.owners[owner] in built.object_qpos
        }
        if grip.item not in pressed:
            if not pressed:
                # a grip that was being watched may lose contact because it slips: keep watching it
                return self._slipped(data, name, grip) if grip.T_tcp_item is not None else _Grip()
            grip = _Grip(max(sorted(pressed), key=pressed.__getitem__), now)
        if now - grip.since < _SETTLING:
            return grip
        if settings.grip_mode == "weld":
            force = pressed[grip.item or ""]
            return self._weld(data, name, grip, f"both fingers press with {force:.1f} N or more")
        if grip.T_tcp_item is None:
            return replace(grip, T_tcp_item=self._pose(data, index, grip))
        return self._slipped(data, name, grip)

    def _slipped(self, data: mujoco.MjData, name: str, grip: _Grip) -> _Grip:
        assert grip.T_tcp_item is not None
        metres, radians = grip.T_tcp_item.distance_to(self._pose(data, self._built.grippers[name], grip))
        if metres <= self._settings.hybrid_slip and radians <= self._settings.hybrid_turn:
            return grip
        return self._weld(
            data, name, grip, f"slipped {metres * 1000:.2f} mm and {np.rad2deg(radians):.2f} deg"
        )

    def _pose(self, data: mujoco.MjData, index: GripperIndex, grip: _Grip) -> SE3:
        return relative_pose(data, index.tcp_body, self._built.body[grip.item or ""])

    def _weld(self, data: mujoco.MjData, name: str, grip: _Grip, reason: str) -> _Grip:
        built, settings = self._built, self._settings
        assert grip.item is not None
        T = self._pose(data, built.grippers[name], grip)
        weld = built.welds[grip.item, name]
        built.mj.eq_data[weld, :3] = 0.0  # anchor: the object's origin
        built.mj.eq_data[weld, 3:6] = T.translation
        built.mj.eq_data[weld, 6:10] = T.quat_wxyz
        built.mj.eq_data[weld, 10] = 1.0  # torque scale
        built.mj.eq_data[weld, 11] = 0.0  # the pose is given, not that of the model's reference state
        built.mj.eq_solref[weld] = (
            settings.weld_solref if settings.grip_mode == "weld" else settings.hybrid_solref
        )
        data.eq_active[weld] = 1
        self.events.append(WeldEvent(float(data.time), grip.item, name, settings.grip_mode, reason))
        return replace(grip, event=len(self.events) - 1)

    def get_state(self) -> tuple:
        return dict(self._grips), self._steps, tuple(self.events)

    def set_state(self, state: tuple) -> None:
        grips, self._steps, events = state
        self._grips, self.events = dict(grips), list(events)
