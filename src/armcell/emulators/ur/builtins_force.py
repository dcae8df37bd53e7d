"""URScript functions of the emulated controller: force mode, freedrive, contact, torques."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from armcell.drivers.ur.wire.dynamics import ArmDynamics, tool_jacobian
from armcell.drivers.ur.wire.kinematics import matrix_of
from armcell.emulators.ur.compliance import force_mode, freedrive
from armcell.emulators.ur.motion import TorqueMotion
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.urscript.machine import ProgramError
from armcell.emulators.ur.urscript.values import Pose, Vec

CONTACT, TOUCH = 3.0, 0.5  # [N] force that detects a contact; force at which the contact began
DETECTION = 0.1  # [s] after `tool_contact` in which contacts of the hand are allowed
FRICTION = 1.0  # [Nm s/rad] viscous friction of a joint that remains after compensation


def force_functions(robot: Robot) -> dict[str, Callable[..., Any]]:
    s = robot.setpoint
    gain = [1.0]

    def start_force_mode(frame: Any, selection: Any, wrench: Any, kind: int, limits: Any) -> None:
        axes, wanted, most = (_six(name, v) for name, v in _named(selection, wrench, limits))
        if int(kind) not in (1, 2, 3):
            raise ProgramError(f"force_mode: type {int(kind)} (1, 2 or 3)")
        compliance = force_mode(s, list(frame), axes != 0.0, wanted, int(kind), most, gain[0])
        before = robot.compliance
        if before is not None and not before.freedrive:
            compliance.keep_speed(before)
        robot.start_compliance(compliance)

    def freedrive_mode(freeAxes: Any = None, feature: Any = None) -> None:
        axes = np.ones(6, bool) if freeAxes is None else _six("freeAxes", freeAxes) != 0.0
        if isinstance(feature, str):
            frame = None if feature == "tool" else np.eye(4)
        else:
            frame = np.eye(4) if feature is None else matrix_of(feature)
        robot.start_compliance(freedrive(axes, frame))

    def end() -> None:
        robot.start_compliance(None)

    def set_gain(scaling: float) -> None:
        if not 0.0 <= scaling <= 2.0:
            raise ProgramError(f"force_mode_set_gain_scaling: {scaling} (0 to 2)")
        gain[0] = float(scaling)

    def external_sensor(enable: bool, *_: Any, **__: Any) -> None:
        robot.external_ft = bool(enable)

    def tool_contact(direction: Any = None) -> int:
        robot.detecting = robot.time + DETECTION
        return contact_steps(robot, np.zeros(3) if direction is None else np.asarray(direction[:3]))

    def joint_torques() -> Vec:
        J = tool_jacobian(robot.dh, robot.plant.read()[0], s.tcp)
        return Vec(float(x) for x in J.T @ robot.external_wrench())

    def dynamics() -> ArmDynamics:
        return ArmDynamics(robot.model, robot.dh, robot.payload, robot.payload_cog)

    def mass_matrix(q: Any = None, *_: Any) -> Vec:
        joints = robot.plant.read()[0] if q is None else q
        return Vec(Vec(float(x) for x in row) for row in dynamics().mass_matrix(joints))

    def velocity_torques(q: Any = None, qd: Any = None) -> Vec:
        now = robot.plant.read()
        joints, speeds = now[0] if q is None else q, now[1] if qd is None else qd
        return Vec(float(x) for x in dynamics().velocity_torques(joints, speeds))

    return {
        "force_mode": start_force_mode,
        "end_force_mode": end,
        "force_mode_set_gain_scaling": set_gain,
        "force_mode_set_damping": lambda damping: None,
        "freedrive_mode": freedrive_mode,
        "end_freedrive_mode": end,
        "get_freedrive_status": lambda: 0,
        "teach_mode": freedrive_mode,
        "end_teach_mode": end,
        "tool_contact": tool_contact,
        "zero_ftsensor": robot.zero_force,
        "get_tcp_force": lambda: Pose(float(x) for x in robot.tcp_force()),
        "force": lambda: float(np.linalg.norm(robot.tcp_force()[:3])),
        "enable_external_ft_sensor": external_sensor,
        "ft_rtde_input_enable": external_sensor,
        "get_joint_torques": joint_torques,
        "get_mass_matrix": mass_matrix,
        "get_coriolis_and_centrifugal_torques": velocity_torques,
    }


def _named(selection: Any, wrench: Any, limits: Any) -> list[tuple[str, Any]]:
    return [("selection vector", selection), ("wrench", wrench), ("limits", limits)]


def _six(name: str, values: Any) -> Any:
    array = np.array([float(x) for x in values])
    if array.shape != (6,) or not np.isfinite(array).all():
        raise ProgramError(f"the {name} needs six finite numbers")
    return array


def contact_steps(robot: Robot, direction: Any) -> int:
    """Built-in URScript force function that returns the number of
    control steps since a contact of the tool began, or 0.

    Args:
        direction: tool motion direction (3,), base frame; a zero vector detects forces from every direction.
    """
    length = float(np.linalg.norm(direction))

    def against(force: Any) -> float:
        return float(-force @ direction) / length if length > 1e-9 else float(np.linalg.norm(force))

    if against(robot.force()) < CONTACT:
        return 0
    steps = 1
    for _, force in reversed(robot.history):
        if against(force) < TOUCH:
            break
        steps += 1
    return steps


def torque_functions(robot: Robot) -> dict[str, Callable[..., Any]]:
    s = robot.setpoint

    def direct_torque(
        torque: Any, friction_comp: bool = True, viscous_scale: Any = None, coulomb_scale: Any = None
    ) -> Generator[None, None, None]:
        dynamics = ArmDynamics(robot.model, robot.dh, robot.payload, robot.payload_cog)
        external = tool_jacobian(robot.dh, s.q, s.tcp).T @ robot.external_wrench()
        robot.start(TorqueMotion(s, torque, dynamics, external, FRICTION))
        yield

    return {"direct_torque": direct_torque}
