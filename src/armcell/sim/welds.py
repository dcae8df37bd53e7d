"""Weld-based grip modes: MuJoCo's weld constraints fix held objects to simulated grippers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from armcell.core import SE3
from armcell.sim.gripper_servos import GripperDrive, finger_forces
from armcell.sim.mujoco_model import BuiltModel, GripperIndex, relative_pose
from armcell.sim.settings import PhysicsSettings

_CHECK_EVERY = 5  # steps between two checks of the weld modes
_SETTLING = 0.2  # [s] time both fingers press before "weld" fixes the object or "hybrid" measures its slip


@dataclass(frozen=True)
class WeldEvent:
    """Record of a weld: the moment when the simulation fixed an object to a gripper.

    A weld replaces friction, so every report must list it.
    """

    time: float  # [s]
    object: str
    gripper: str
    mode: str  # "weld" or "hybrid"
    reason: str
    released_at: float | None = None  # [s]


@dataclass(frozen=True)
class _Grip:
    """State of one gripper that can weld objects: the held object,
    the reference pose for measuring slip, and the active weld.
    """

    item: str | None = None
    since: float = 0.0  # [s] simulation time since which both fingers press the object
    T_tcp_item: SE3 | None = None  # reference pose from which "hybrid" measures the slip
    event: int | None = None  # index of the active weld


class Welder:
    """Welder that fixes held objects to simulated grippers by MuJoCo's weld constraints, in the grip modes
    "weld" and "hybrid".

    `events` records every weld and its release.
    """

    def __init__(self, built: BuiltModel, settings: PhysicsSettings, drives: Mapping[str, GripperDrive]):
        self._built = built
        self._settings = settings
        self._drives = drives
        self._grips = {name: _Grip() for name in built.grippers}
        self._steps = 0
        self.events: list[WeldEvent] = []

    def update(self, data: mujoco.MjData) -> None:
        """Weld held objects to their grippers after a physics step if the grip mode is "weld" or "hybrid"."""
        self._steps += 1
        if self._steps % _CHECK_EVERY:
            return
        for name, grip in self._grips.items():
            if name in self._drives and grip.event is None and self._drives[name].closing(data):
                self._grips[name] = self._look(data, name, grip)

    def fix(self, data: mujoco.MjData, gripper: str, item: str, reason: str) -> None:
        """Weld an object to a simulated gripper at its current relative pose. This works in any grip mode."""
        self._grips[gripper] = self._weld(data, gripper, _Grip(item, float(data.time)), reason)

    def release(self, data: mujoco.MjData, gripper: str) -> None:
        """Remove MuJoCo's weld constraint between a gripper and its object when the gripper opens."""
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
                # a monitored object may lose finger contact because it slips: keep measuring its slip
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
        meters, radians = grip.T_tcp_item.distance_to(self._pose(data, self._built.grippers[name], grip))
        if meters <= self._settings.hybrid_slip and radians <= self._settings.hybrid_turn:
            return grip
        return self._weld(
            data, name, grip, f"slipped {meters * 1000:.2f} mm and {np.rad2deg(radians):.2f} deg"
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
        built.mj.eq_data[weld, 11] = 0.0  # use the pose above, not the pose of the model's reference state
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
