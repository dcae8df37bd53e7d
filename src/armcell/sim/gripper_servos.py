"""Gripper servos, and detection of held objects."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.model import SuctionGripper
from armcell.sim.mujoco_model import BuiltModel, GripperIndex
from armcell.sim.robot import servo_gains
from armcell.sim.settings import PhysicsSettings
from armcell.sim.step_kernel import (
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
    grip_between,
)
from armcell.sim.suction import LEVEL, SETTLED, Suction

Array = NDArray[np.float64]
_WIDTH_TOLERANCE = 1e-4  # [m]


@dataclass(frozen=True)
class GripperState:
    """State of a simulated gripper: its width [m], its finger force [N] and the object that it holds.

    `force_per_finger` [N] acts along the closing axis. `held` is the object that both fingers touch, or None.
    """

    width: float  # [m]
    force_per_finger: float  # [N] mean per cup for a suction gripper
    held: str | None
    sealed: tuple[int, int] | None = None  # cups that hold the object, and all cups; None for jaws
    vacuum: float | None = None  # [kPa] below ambient, highest of the cups; None for jaws


class GripperDrive:
    """Position servo of one simulated gripper, with a limited finger speed and a limited force per finger.

    The set point leads the fingers by at most the distance that yields the commanded force. Blocked fingers
    therefore press with exactly this force, and free fingers move at `max_speed`.
    """

    def __init__(self, index: GripperIndex, settings: PhysicsSettings, law: Array):
        """Write the gripper servo's constants into `law` (7,), which `step_kernel.drive_fingers` reads."""
        self.index, self._law = index, law
        self._kp, kv = servo_gains(index.gripper, settings)
        scale = index.gripper.finger_travel_per_joint
        self._ratio = abs(index.gripper.width_per_joint)
        dt = settings.timestep
        lag = (kv + 2 * settings.joint_damping * scale**2) * index.max_speed / self._kp
        law[CONTROL] = index.ctrl
        law[BLOCKED_LEAD] = 3 * lag + 0.001 / scale  # larger than the lag of free fingers
        law[STEP] = index.max_speed * dt
        law[PUSH_STEP] = max(law[STEP], settings.grip_force_rate * self._ratio / self._kp * dt)
        law[LEAD] = self._force_lead(index.max_force)

    def _force_lead(self, force: float) -> float:
        return min(force, self.index.max_force) * self._ratio / self._kp

    def hold(self, data: mujoco.MjData, joint_position: float) -> None:
        """Hold the driven joint of a simulated gripper at a position [m] with the gripper's full force."""
        self._law[[SET_POINT, TARGET]] = joint_position
        data.ctrl[self.index.ctrl] = joint_position
        self._law[LEAD] = self._force_lead(self.index.max_force)

    def command(self, width: float, force_per_finger: float) -> None:
        """Command the servo of a simulated gripper to a width [m] with limited force per finger.

        At the closed end, the fingers press on the object between them with `force_per_finger` [N].
        """
        gripper = self.index.gripper
        lead = self._force_lead(force_per_finger)
        ends = self.index.lower, self.index.upper
        closed = min(ends, key=gripper.width)
        target = float(np.clip(gripper.joint_position(width), *ends))
        if gripper.width(target) <= gripper.width(closed) + _WIDTH_TOLERANCE:
            target = closed - np.sign(gripper.width_per_joint) * lead
        self._law[TARGET], self._law[LEAD] = target, lead

    def closing(self, data: mujoco.MjData) -> bool:
        """Return whether a simulated gripper is commanded to close:
        its target width is smaller than its current width.
        """
        width = self.index.gripper.width
        return width(self._law.item(TARGET)) < width(self.index.length(data.qpos)) - _WIDTH_TOLERANCE

    def get_state(self) -> Array:
        return self._law.copy()

    def set_state(self, state: Array) -> None:
        self._law[:] = state


class Fingers:
    """Servos of the fingers of all simulated grippers, with the arrays that the compiled stepper uses.

    Attributes:
        law: (g, 7) one row per gripper for `step_kernel.drive_fingers`.
        joints: (g, k) indices of the finger joints in qpos.
        weights: (g, k) weights of the finger joints in the tendon length.
    """

    def __init__(self, built: BuiltModel, settings: PhysicsSettings):
        grippers = {name: index for name, index in built.grippers.items() if index.joints}
        most = max((len(index.joints) for index in grippers.values()), default=0)
        self.law = np.zeros((len(grippers), LAW_SIZE))
        self.joints, self.weights = np.zeros((len(grippers), most), np.int64), np.zeros((len(grippers), most))
        self.drives: dict[str, GripperDrive] = {}
        for row, (name, index) in enumerate(grippers.items()):
            self.drives[name] = GripperDrive(index, settings, self.law[row])
            for k, (joint, weight) in enumerate(index.joints):
                self.joints[row, k], self.weights[row, k] = joint, weight

    def update(self, data: mujoco.MjData) -> None:
        """Write the setpoints of all simulated gripper servos to `data.ctrl` for the next physics step."""
        drive_fingers(self.law, self.joints, self.weights, data.qpos, data.ctrl)


def finger_forces(built: BuiltModel, data: mujoco.MjData, index: GripperIndex) -> dict[int, list[float]]:
    """Return the force [N] with which each finger of a simulated gripper presses on other bodies, along the
    closing axis of the gripper.

    The closing axis is the tcp's y axis.

    Returns:
        Forces (fingers,) by the owner index of the body that the fingers touch.
    """
    if data.ncon == 0:
        return {}
    contact, fingers, y_axis = data.contact, index.finger_owners, data.xmat[index.tcp_body][1::3]
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


def gripper_state(built: BuiltModel, data: mujoco.MjData, suction: Suction, name: str) -> GripperState:
    index = built.grippers[name]
    if not index.joints:
        return _suction_state(built, suction, name)
    total, held = 0.0, -1
    if data.ncon:
        contact, fingers, y_axis = data.contact, index.finger_owners, data.xmat[index.tcp_body][1::3]
        total, held = grip_between(
            built.mj._address, data._address, contact.geom, contact.frame, built.geom_owner, fingers, y_axis,
            len(built.owners), built.link_count,
        )  # fmt: skip
    position = data.qpos.item(built.joint_qpos[index.gripper.joint_name])
    return GripperState(
        width=index.gripper.width(position),
        force_per_finger=total / len(index.finger_owners),
        held=built.owners[held] if held >= 0 else None,
    )


def _suction_state(built: BuiltModel, suction: Suction, name: str) -> GripperState:
    """Return the `GripperState` of a suction gripper in the simulation. The object on which the most suction
    cups seal counts as held.
    """
    cups, gripper = suction.rows(name), built.grippers[name].gripper
    assert isinstance(gripper, SuctionGripper)
    firm = [k for k in cups if suction.sealed[k] >= 0 and suction.law[k, LEVEL] >= SETTLED]
    owners = [int(suction.sealed[k]) for k in firm]
    held = max(sorted(set(owners)), key=owners.count, default=-1)
    return GripperState(
        width=0.0 if suction.is_on(name) else gripper.max_width,
        force_per_finger=sum(suction.pull(k) for k in cups) / len(cups),
        held=built.owners[held] if held >= 0 else None,
        sealed=(owners.count(held), len(cups)),
        vacuum=gripper.vacuum * max((float(suction.law[k, LEVEL]) for k in cups), default=0.0),
    )
