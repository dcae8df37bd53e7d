"""URScript functions of the emulated UR controller: motion, state, force mode, freedrive, contact, torque."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from armcell.drivers.ur.wire.kinematics import (
    ArmDynamics,
    forward,
    inverse,
    jacobian_rate,
    matrix_of,
    pose_of,
    tool_jacobian,
)
from armcell.emulators.ur.builtins_data import io_functions, math_functions
from armcell.emulators.ur.compliance import force_mode, freedrive
from armcell.emulators.ur.motion import (
    BlendedMotion,
    MoveC,
    MoveJ,
    MoveL,
    ServoJ,
    Setpoint,
    SpeedJ,
    SpeedL,
    StopJ,
    StopL,
    TorqueMotion,
    TrackL,
)
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.urscript.interpreter import Pose, ProgramError, Vec, format_value

CONTACT, TOUCH = 3.0, 0.5  # [N] force that detects a contact; force at which the contact began
DETECTION = 0.1  # [s] after `tool_contact` in which contacts of the hand are allowed
FRICTION = 1.0  # [Nm s/rad] viscous friction of a joint that remains after compensation
Wait = Generator[None, None, Any]
Functions = dict[str, Callable[..., Any]]
FULL_ACCELERATION = 5.0  # [rad/s^2] of optimovej with a = 1


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
    """Implement URScript's built-in function `tool_contact`: return the number of control steps since the
    tool made contact, or 0 without contact.

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


def motion_functions(robot: Robot) -> Functions:
    """Return the built-in URScript functions that take time.
    They are generators that yield once per control step.
    """
    s = robot.setpoint

    def _joints(target: Any) -> Any:
        if not isinstance(target, Pose):
            return target
        q = inverse(robot.dh, matrix_of(target), s.q, s.tcp, iterations=100)
        if q is None:
            raise ProgramError("the pose has no inverse kinematics solution")
        return q

    def _pose(target: Any) -> Any:
        return matrix_of(target) if isinstance(target, Pose) else forward(robot.dh, target, s.tcp)

    def _until_done(motion: Any, goal: Any = None) -> Wait:
        robot.start(motion)
        if goal is not None:
            robot.waypoint = pose_of(goal)
        while robot.motion is motion and not (motion.done or getattr(motion, "near", False)):
            yield
            robot.mark_motion_in_use()
        yield

    def _along(make: Callable[[Setpoint], MoveJ | MoveL], goal: Any, radius: float) -> Wait:
        """Run a built-in URScript motion function that moves an emulated UR arm to a pose (4, 4). If the
        previous motion is near its goal, blend the two motions.

        Blend radii [m] are limited to half the path length, so that two blends do not overlap.
        """
        running = robot.motion
        if isinstance(running, (MoveJ, MoveL, BlendedMotion)) and running.near and not s.compliant:
            motion = BlendedMotion(s, running, make)
        else:
            motion = make(s)
        target = goal[:3, 3]

        def left() -> float:
            return float(np.linalg.norm(target - forward(robot.dh, s.q, s.tcp)[:3, 3]))

        radius = min(radius, 0.5 * left())
        for _ in _until_done(motion, goal):
            yield
            motion.near = radius > 0 and left() <= radius

    def movej(q: Any, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Wait:
        joints = _joints(q)
        yield from _along(lambda at: MoveJ(at, joints, a, v, t), forward(robot.dh, joints, s.tcp), r)

    def movel(pose: Any, a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Wait:
        goal = _pose(pose)
        yield from _along(lambda at: MoveL(at, goal, a, v, t), goal, r)

    def movep(pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Wait:
        yield from _until_done(TrackL(s, _pose(pose), a, v, r), _pose(pose))

    def movec(
        pose_via: Any, pose_to: Any, a: float = 1.2, v: float = 0.25, r: float = 0.0, mode: int = 0
    ) -> Wait:
        via, goal, fixed = _pose(pose_via), _pose(pose_to), int(mode) == 1
        yield from _along(lambda at: MoveC(at, via, goal, a, v, fixed), goal, r)

    def optimovej(q: Any, a: float = 0.3, v: float = 0.3, t: float = 0.0, r: float = 0.0) -> Wait:
        """Built-in URScript function optimovej, which moves to joint
        positions. `a` and `v` are fractions (0..1) of the limits.
        """
        yield from movej(q, max(a, 0.01) * FULL_ACCELERATION, max(v, 0.01) * float(s.v_max.min()), t, r)

    def optimovel(pose: Any, a: float = 0.3, v: float = 0.3, t: float = 0.0, r: float = 0.0) -> Wait:
        yield from movel(pose, max(a, 0.01) * FULL_TOOL_ACCELERATION, max(v, 0.01) * FULL_TOOL_SPEED, t, r)

    def _for(seconds: float) -> Wait:
        """Built-in URScript function that waits for a duration [s] of program time,
        which the speed slider slows down.

        If a wait takes too long, the next wait is shortened.
        """
        now, due = robot.program_time, robot.motion_due
        begin = due if now - robot.period < due <= now else now
        robot.motion_due = end = begin + max(seconds, robot.period)
        while True:
            yield
            if robot.program_time > end - 1e-6:
                return
            robot.mark_motion_in_use()

    def servoj(
        q: Any, a: float = 0.0, v: float = 0.0, t: float = 0.002, lookahead_time: float = 0.1,
        gain: float = 300.0,
    ) -> Wait:  # fmt: skip
        robot.start(ServoJ(s, q, lookahead_time, gain))
        yield from _for(t)

    def servoc(pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Wait:
        yield from _until_done(TrackL(s, _pose(pose), a, v, r), _pose(pose))

    def speedj(qd: Any, a: float = 1.4, t: float = 0.0) -> Wait:
        robot.start(SpeedJ(s, qd, a))
        yield from _for(t)

    def speedl(xd: Any, a: float = 1.2, t: float = 0.0, aRot: float = 0.0) -> Wait:
        robot.start(SpeedL(s, xd, a))
        yield from _for(t)

    def stopj(a: float = 2.0) -> Wait:
        yield from _until_done(StopJ(a))

    def stopl(a: float = 2.0, aRot: float = 0.0) -> Wait:
        yield from _until_done(StopL(a, s))

    def sync() -> Wait:
        yield

    def sleep(seconds: float) -> Wait:
        end = robot.time + seconds
        while robot.time < end - 0.5 * robot.period:
            yield

    functions = (
        movej, movel, movep, movec, optimovej, optimovel, servoj, servoc, speedj, speedl, stopj, stopl,
        sync, sleep,
    )  # fmt: skip
    return {f.__name__: f for f in functions} | torque_functions(robot)


FULL_TOOL_ACCELERATION, FULL_TOOL_SPEED = 5.0, 1.5  # [m/s^2], [m/s] of optimovel with a = v = 1


def value_functions(robot: Robot) -> Functions:
    """Return the built-in URScript functions that return a value immediately, by name."""
    return _state_functions(robot) | io_functions(robot) | force_functions(robot) | math_functions()


def _state_functions(robot: Robot) -> Functions:
    s = robot.setpoint

    def actual_q() -> Vec:
        return Vec(float(x) for x in robot.plant.read()[0])

    def actual_v() -> Vec:
        return Vec(float(x) for x in robot.plant.read()[1])

    def target_q() -> Vec:
        return Vec(float(x) for x in s.q)

    def history(steps: int = 0) -> Vec:
        """Built-in URScript function that returns the joint positions
        from a given number of control steps ago.
        """
        back = int(steps)
        if not robot.history or back < 1:
            return actual_q()
        return Vec(float(x) for x in robot.history[-min(back, len(robot.history))][0])

    def get_inverse_kin(pose: Any, qnear: Any = None, *_: Any, **more: Any) -> Vec:
        near, tcp = s.q if qnear is None else qnear, more.get("tcp", s.tcp)
        q = inverse(robot.dh, matrix_of(pose), near, tcp, iterations=100)
        if q is None:
            raise ProgramError("get_inverse_kin: no solution")
        return Vec(float(x) for x in q)

    def has_inverse(pose: Any, qnear: Any = None, *_: Any, **more: Any) -> bool:
        near, tcp = s.q if qnear is None else qnear, more.get("tcp", s.tcp)
        return inverse(robot.dh, matrix_of(pose), near, tcp, iterations=100) is not None

    def pose_of_matrix(T: Any) -> Pose:
        return Pose(float(x) for x in pose_of(T))

    def get_forward_kin(q: Any = None, tcp: Any = None) -> Pose:
        joints, tool = actual_q() if q is None else q, s.tcp if tcp is None else tcp
        return pose_of_matrix(forward(robot.dh, joints, tool))

    def set_payload(mass: float, cog: Any = None, inertia: Any = None, *_: Any) -> None:
        robot.payload = float(mass)
        robot.payload_cog = list(cog) if cog is not None else [0.0, 0.0, 0.0]
        robot.payload_inertia = list(inertia) if inertia is not None else [0.0] * 6

    def set_tcp(pose: Any, *_: Any) -> None:
        s.tcp = [float(x) for x in pose]

    def popup(
        text: Any, title: str = "Popup", warning: bool = False, error: bool = False, blocking: bool = False
    ) -> None:
        robot.popup(format_value(text), title=str(title), warning=bool(warning), error=bool(error))

    def rtde_set_watchdog(variable: str, min_frequency: float, action: str = "pause") -> None:
        robot.set_watchdog(int(variable.rsplit("_", 1)[1]), float(min_frequency))

    def within_limits(target: Any) -> bool:
        if isinstance(target, Pose):
            return has_inverse(target)
        return bool(np.abs(np.asarray(target)).max() <= 2 * math.pi)

    def target_waypoint() -> Pose:
        return Pose(robot.waypoint if robot.waypoint is not None else robot.tcp_pose(s.q))

    def get_jacobian(q: Any = None, tcp: Any = None) -> Vec:
        joints, tool = actual_q() if q is None else q, s.tcp if tcp is None else tcp
        return rows(tool_jacobian(robot.dh, joints, tool))

    def get_jacobian_time_derivative(q: Any = None, qd: Any = None, tcp: Any = None) -> Vec:
        joints, speeds = actual_q() if q is None else q, actual_v() if qd is None else qd
        return rows(jacobian_rate(robot.dh, joints, speeds, s.tcp if tcp is None else tcp))

    return {
        "get_steptime": lambda: robot.period,
        "get_actual_joint_positions": actual_q,
        "get_joint_positions": actual_q,
        "get_target_joint_positions": target_q,
        "get_actual_joint_positions_history": history,
        "get_actual_joint_speeds": actual_v,
        "get_joint_speeds": actual_v,
        "get_target_joint_speeds": lambda: Vec(float(x) for x in s.v),
        "get_target_joint_accelerations": lambda: Vec(float(x) for x in robot.target_qdd),
        "get_actual_tcp_pose": lambda: Pose(float(x) for x in robot.tcp_pose(robot.plant.read()[0])),
        "get_target_tcp_pose": lambda: Pose(float(x) for x in robot.tcp_pose(s.q)),
        "get_actual_tcp_speed": lambda: Pose(float(x) for x in robot.tcp_speed(*robot.plant.read()[:2])),
        "get_target_tcp_speed": lambda: Pose(float(x) for x in robot.tcp_speed(s.q, s.v)),
        "get_actual_tool_flange_pose": lambda: pose_of_matrix(forward(robot.dh, actual_q(), [0.0] * 6)),
        "get_target_waypoint": target_waypoint,
        "get_tcp_offset": lambda: Pose(s.tcp),
        "get_inverse_kin": get_inverse_kin,
        "get_inverse_kin_has_solution": has_inverse,
        "get_forward_kin": get_forward_kin,
        "get_jacobian": get_jacobian,
        "get_jacobian_time_derivative": get_jacobian_time_derivative,
        "is_within_safety_limits": within_limits,
        "is_steady": lambda: not np.any(s.v),
        "set_payload": set_payload,
        "set_target_payload": set_payload,
        "set_payload_mass": lambda mass: setattr(robot, "payload", float(mass)),
        "set_payload_cog": lambda cog: setattr(robot, "payload_cog", [float(x) for x in cog]),
        "get_target_payload": lambda: robot.payload,
        "get_target_payload_cog": lambda: Vec(robot.payload_cog),
        "get_target_payload_inertia": lambda: Vec(robot.payload_inertia),
        "set_tcp": set_tcp,
        "set_gravity": lambda vector: setattr(robot, "gravity", [float(x) for x in vector]),
        "get_gravity": lambda: Vec(robot.gravity),
        "get_joint_temp": lambda joint: 25.0,
        "get_controller_temp": lambda: 25.0,
        "textmsg": lambda *parts: robot.textmsg("".join(format_value(p) for p in parts)),
        "popup": popup,
        "rtde_set_watchdog": rtde_set_watchdog,
        "protective_stop": lambda: robot.protective_stop("called by the program"),
        "powerdown": robot.power_off,
    }


def rows(matrix: Any) -> Vec:
    """Return a matrix as built-in URScript functions represent it: as a list of rows."""
    return Vec(Vec(float(x) for x in row) for row in matrix)
