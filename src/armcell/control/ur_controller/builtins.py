"""URScript's own functions, as the emulated controller has them."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from armcell.control.ur_controller.motion import MoveJ, MoveL, ServoJ, SpeedJ, SpeedL, StopJ, StopL
from armcell.control.ur_controller.robot import Robot
from armcell.control.ur_controller.urscript.machine import ProgramError
from armcell.control.ur_controller.urscript.values import Pose, Vec, copied, shown
from armcell.control.ur_wire.kinematics import forward, inverse, matrix_of, pose_of

Wait = Generator[None, None, Any]
Functions = dict[str, Callable[..., Any]]


def motion_functions(robot: Robot) -> Functions:
    """Those that take time: generators that yield once a control step."""
    s = robot.setpoint

    def _joints(target: Any) -> Any:
        if not isinstance(target, Pose):
            return target
        q = inverse(robot.dh, matrix_of(target), s.q, s.tcp, iterations=100)
        if q is None:
            raise ProgramError("the pose has no inverse kinematics solution")
        return q

    def _until_done(motion: Any) -> Wait:
        robot.start(motion)
        while robot.motion is motion and not motion.done:
            yield
        yield

    def movej(q: Any, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Wait:
        yield from _until_done(MoveJ(s, _joints(q), a, v, t))

    def movel(pose: Any, a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Wait:
        goal = matrix_of(pose) if isinstance(pose, Pose) else forward(robot.dh, pose, s.tcp)
        yield from _until_done(MoveL(s, goal, a, v, t))

    def _for(seconds: float) -> Wait:
        """Program time passes, which the speed slider slows; what one call overran, the next lacks."""
        now, due = robot.program_time, robot.motion_due
        begin = due if now - robot.period < due <= now else now
        robot.motion_due = end = begin + max(seconds, robot.period)
        while True:
            yield
            if robot.program_time > end - 1e-6:
                return
            robot.keep()

    def servoj(
        q: Any, a: float = 0.0, v: float = 0.0, t: float = 0.002, lookahead_time: float = 0.1,
        gain: float = 300.0,
    ) -> Wait:  # fmt: skip
        robot.start(ServoJ(s, q, lookahead_time, gain))
        yield from _for(t)

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

    return {f.__name__: f for f in (movej, movel, servoj, speedj, speedl, stopj, stopl, sync, sleep)}


def value_functions(robot: Robot) -> Functions:
    """Those that answer at once."""
    s = robot.setpoint

    def actual_q() -> Vec:
        return Vec(float(x) for x in robot.plant.read()[0])

    def target_q() -> Vec:
        return Vec(float(x) for x in s.q)

    def get_inverse_kin(pose: Any, qnear: Any = None, *_: Any, **__: Any) -> Vec:
        near = s.q if qnear is None else qnear
        q = inverse(robot.dh, matrix_of(pose), near, s.tcp, iterations=100)
        if q is None:
            raise ProgramError("get_inverse_kin: no solution")
        return Vec(float(x) for x in q)

    def has_inverse(pose: Any, qnear: Any = None, *_: Any, **__: Any) -> bool:
        near = s.q if qnear is None else qnear
        return inverse(robot.dh, matrix_of(pose), near, s.tcp, iterations=100) is not None

    def get_forward_kin(q: Any = None, tcp: Any = None) -> Pose:
        joints, tool = actual_q() if q is None else q, s.tcp if tcp is None else tcp
        return Pose(float(x) for x in pose_of(forward(robot.dh, joints, tool)))

    def pose_of_matrix(T: Any) -> Pose:
        return Pose(float(x) for x in pose_of(T))

    def set_payload(mass: float, cog: Any = None, *_: Any) -> None:
        robot.payload = float(mass)
        robot.payload_cog = list(cog) if cog is not None else [0.0, 0.0, 0.0]

    def set_tcp(pose: Any) -> None:
        s.tcp = [float(x) for x in pose]

    def write_int(register: int, value: int) -> None:
        robot.output_int[int(register)] = int(value)

    def write_double(register: int, value: float) -> None:
        robot.output_double[int(register)] = float(value)

    def write_bool(register: int, value: bool) -> None:
        bit = 1 << int(register)
        robot.output_bits = (robot.output_bits & ~bit) | (bit if value else 0)

    def textmsg(*parts: Any) -> None:
        robot.messages.append("".join(shown(p) for p in parts))

    def popup(text: Any, *_: Any, **__: Any) -> None:
        robot.popup(shown(text))

    def rtde_set_watchdog(variable: str, min_frequency: float, action: str = "pause") -> None:
        robot.set_watchdog(int(variable.rsplit("_", 1)[1]), float(min_frequency))

    def protective_stop() -> None:
        robot.protective_stop("asked for by the program")

    def within_limits(target: Any) -> bool:
        if isinstance(target, Pose):
            return has_inverse(target)
        return bool(np.abs(np.asarray(target)).max() <= 2 * math.pi)

    values: Functions = {
        "get_steptime": lambda: robot.period,
        "get_actual_joint_positions": actual_q,
        "get_joint_positions": actual_q,
        "get_target_joint_positions": target_q,
        "get_actual_joint_positions_history": lambda steps=0: actual_q(),
        "get_actual_joint_speeds": lambda: Vec(float(x) for x in robot.plant.read()[1]),
        "get_target_joint_speeds": lambda: Vec(float(x) for x in s.v),
        "get_actual_tcp_pose": lambda: Pose(float(x) for x in robot.tcp_pose(robot.plant.read()[0])),
        "get_target_tcp_pose": lambda: Pose(float(x) for x in robot.tcp_pose(s.q)),
        "get_target_tcp_speed": lambda: Pose(float(x) for x in robot.tcp_speed(s.q, s.v)),
        "get_actual_tool_flange_pose": lambda: pose_of_matrix(forward(robot.dh, actual_q(), [0.0] * 6)),
        "get_tcp_offset": lambda: Pose(s.tcp),
        "get_inverse_kin": get_inverse_kin,
        "get_inverse_kin_has_solution": has_inverse,
        "get_forward_kin": get_forward_kin,
        "is_within_safety_limits": within_limits,
        "is_steady": lambda: not np.any(s.v),
        "pose_trans": lambda a, b: pose_of_matrix(matrix_of(a) @ matrix_of(b)),
        "pose_inv": lambda a: pose_of_matrix(np.linalg.inv(matrix_of(a))),
        "pose_add": _pose_add,
        "pose_sub": _pose_sub,
        "set_payload": set_payload,
        "set_target_payload": set_payload,
        "get_target_payload": lambda: robot.payload,
        "get_target_payload_cog": lambda: Vec(robot.payload_cog),
        "set_tcp": set_tcp,
        "set_gravity": lambda vector: None,
        "set_standard_digital_out": lambda n, on: robot.set_digital_out(int(n), bool(on)),
        "set_configurable_digital_out": lambda n, on: robot.set_digital_out(int(n) + 8, bool(on)),
        "set_tool_digital_out": lambda n, on: robot.set_digital_out(int(n) + 16, bool(on)),
        "get_standard_digital_in": lambda n: bool(robot.digital_in >> int(n) & 1),
        "get_tool_digital_in": lambda n: bool(robot.digital_in >> (int(n) + 16) & 1),
        "set_tool_voltage": lambda volts: setattr(robot, "tool_voltage", int(volts)),
        "read_input_integer_register": lambda i: int(robot.inputs.get(f"input_int_register_{int(i)}", 0)),
        "read_input_float_register": lambda i: float(
            robot.inputs.get(f"input_double_register_{int(i)}", 0.0)
        ),
        "write_output_integer_register": write_int,
        "write_output_float_register": write_double,
        "write_output_boolean_register": write_bool,
        "textmsg": textmsg,
        "popup": popup,
        "rtde_set_watchdog": rtde_set_watchdog,
        "protective_stop": protective_stop,
        "zero_ftsensor": robot.zero_force,
        "get_tcp_force": lambda: Vec(float(x) for x in robot.tcp_force()),
        # Settings of force control; force_mode itself is not emulated.
        "force_mode_set_gain_scaling": lambda scaling: None,
        "force_mode_set_damping": lambda damping: None,
        "powerdown": robot.power_off,
    }
    return values | _plain_functions()


def _pose_add(a: Any, b: Any) -> Pose:
    T = matrix_of([*a[:3], *b[3:]])
    T[:3, :3] = matrix_of(a)[:3, :3] @ T[:3, :3]
    T[:3, 3] += np.asarray(b[:3])
    return Pose(float(x) for x in pose_of(T))


def _pose_sub(a: Any, b: Any) -> Pose:
    """a - b: the translations' difference, and the rotation that takes b to a."""
    T = np.eye(4)
    T[:3, :3] = matrix_of(a)[:3, :3] @ matrix_of(b)[:3, :3].T
    T[:3, 3] = np.subtract(a[:3], b[:3])
    return Pose(float(x) for x in pose_of(T))


def _norm(value: Any) -> float:
    return math.sqrt(sum(x * x for x in value)) if isinstance(value, list) else abs(value)


def _plain_functions() -> Functions:
    one_argument = (math.sin, math.cos, math.tan, math.asin, math.acos, math.atan, math.sqrt, math.log)
    found: Functions = {f.__name__: f for f in one_argument}
    found |= {
        "atan2": math.atan2,
        "pow": math.pow,
        "norm": _norm,
        "floor": math.floor,
        "ceil": math.ceil,
        "round": round,
        "d2r": math.radians,
        "r2d": math.degrees,
        "size": len,
        "length": len,
        "get_list_length": len,
        "to_num": float,
        "to_str": shown,
        "str_cat": lambda a, b: shown(a) + shown(b),
        "str_len": len,
        "make_list": lambda n, value, capacity=0: Vec(copied(value) for _ in range(min(int(n), 10_000))),
        "binary_list_to_integer": lambda bits: sum(int(b) << i for i, b in enumerate(bits)),
        "integer_to_binary_list": lambda n: Vec(bool(int(n) >> i & 1) for i in range(32)),
    }
    return found
