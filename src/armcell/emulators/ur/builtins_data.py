"""URScript functions of the emulated controller without motion: math, registers, inputs, outputs, sockets.

A program opens the TCP connections from the robot.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from armcell.core import SE3, SO3
from armcell.drivers.ur.wire.kinematics import matrix_of, pose_of
from armcell.drivers.ur.wire.rtde import REGISTERS
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.urscript.interpreter import Pose, ProgramError, Vec, copy_value, format_value


def math_functions() -> dict[str, Callable[..., Any]]:
    return _numbers() | _lists_and_text() | _poses()


def _numbers() -> dict[str, Callable[..., Any]]:
    one_argument = (math.sin, math.cos, math.tan, math.asin, math.acos, math.atan, math.sqrt)
    table: dict[str, Callable[..., Any]] = {f.__name__: f for f in one_argument}
    return table | {
        "atan2": math.atan2,
        "pow": math.pow,
        "log": lambda base, value: math.log(value, base),
        "norm": _norm,
        "floor": math.floor,
        "ceil": math.ceil,
        "round": round,
        "d2r": math.radians,
        "r2d": math.degrees,
        "random": random.random,
    }


def _norm(value: Any) -> float:
    return math.sqrt(sum(x * x for x in value)) if isinstance(value, list) else abs(value)


def _lists_and_text() -> dict[str, Callable[..., Any]]:
    return {
        "size": len,
        "length": len,
        "get_list_length": len,
        "make_list": lambda n, value, capacity=0: Vec(copy_value(value) for _ in range(min(int(n), 10_000))),
        "to_num": _number,
        "to_str": format_value,
        "str_cat": lambda a, b: format_value(a) + format_value(b),
        "str_len": len,
        "str_at": lambda text, index: text[int(index)],
        "str_empty": lambda text: not text,
        "str_find": lambda text, part, start=0: text.find(part, int(start)),
        "str_sub": _part,
        "binary_list_to_integer": lambda bits: sum(int(b) << i for i, b in enumerate(bits)),
        "integer_to_binary_list": lambda n: Vec(bool(int(n) >> i & 1) for i in range(32)),
    }


def _number(text: str) -> float:
    return int(text) if str(text).strip().lstrip("+-").isdigit() else float(text)


def _part(text: str, index: int, count: int = -1) -> str:
    return text[int(index) :] if count < 0 else text[int(index) : int(index) + int(count)]


def _poses() -> dict[str, Callable[..., Any]]:
    def of(T: Any) -> Pose:
        return Pose(float(x) for x in pose_of(T))

    def interpolate(a: Any, b: Any, fraction: float) -> Pose:
        start, end = SE3.from_matrix(matrix_of(a)), SE3.from_matrix(matrix_of(b))
        return of(start.interpolate(end, float(fraction)).matrix)

    def point_distance(a: Any, b: Any) -> float:
        return float(np.linalg.norm(np.subtract(a[:3], b[:3])))

    return {
        "pose_trans": lambda a, b: of(matrix_of(a) @ matrix_of(b)),
        "pose_inv": lambda a: of(np.linalg.inv(matrix_of(a))),
        "pose_add": lambda a, b: of(_sum(a, b)),
        "pose_sub": lambda a, b: of(_difference(a, b)),
        "pose_dist": lambda a, b: float(np.linalg.norm(pose_of(_difference(a, b)))),
        "point_dist": point_distance,
        "interpolate_pose": interpolate,
        "rpy2rotvec": lambda rpy, *more: Vec(float(x) for x in _from_rpy(rpy, *more).log()),
        "rotvec2rpy": lambda rotvec, *more: Vec(_rpy(SO3.exp(_three(rotvec, *more)).matrix)),
        "wrench_trans": _wrench_trans,
    }


def _sum(a: Any, b: Any) -> Any:
    """Return the sum of poses a and b, as `pose_add` among URScript's built-in data functions defines it.

    Translations are added, and a's rotation is multiplied by b's.
    """
    T = matrix_of([*a[:3], *b[3:]])
    T[:3, :3] = matrix_of(a)[:3, :3] @ T[:3, :3]
    T[:3, 3] += np.asarray(b[:3])
    return T


def _difference(a: Any, b: Any) -> Any:
    """Return the difference of poses a and b, as `pose_sub` among URScript's built-in data functions defines
    it.

    Translations are subtracted, and the rotation leads from b to a.
    """
    T = np.eye(4)
    T[:3, :3] = matrix_of(a)[:3, :3] @ matrix_of(b)[:3, :3].T
    T[:3, 3] = np.subtract(a[:3], b[:3])
    return T


def _three(first: Any, *more: float) -> list[float]:
    return [float(x) for x in (first if isinstance(first, list) else (first, *more))]


def _from_rpy(first: Any, *more: float) -> SO3:
    roll, pitch, yaw = _three(first, *more)
    return SO3.exp((0, 0, yaw)) @ SO3.exp((0, pitch, 0)) @ SO3.exp((roll, 0, 0))


def _rpy(R: Any) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation about the fixed axes x, y and z, for URScript's built-in
    data functions.
    """
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if abs(math.cos(pitch)) < 1e-9:
        return math.atan2(math.copysign(1.0, pitch) * R[0, 1], R[1, 1]), pitch, 0.0
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _wrench_trans(T_from_to: Any, w_from: Any) -> Vec:
    """Implement `wrench_trans`, one of URScript's built-in data functions: transform a wrench (force, torque)
    to the axes and origin of another frame.
    """
    T = matrix_of(T_from_to)
    force, torque = np.asarray(w_from[:3]), np.asarray(w_from[3:])
    moved = torque + np.cross(-T[:3, 3], force)
    return Vec(float(x) for x in np.concatenate((T[:3, :3].T @ force, T[:3, :3].T @ moved)))


CONFIGURABLE, TOOL = 8, 16  # first bit of the configurable pins, and of the tool's pins

TOOL_VOLTAGES = (0, 12, 24)  # [V]

Wait = Generator[None, None, Any]


def io_functions(robot: Robot) -> dict[str, Callable[..., Any]]:
    return _digital(robot) | _analog(robot) | _registers(robot)


class DigitalOutputs(list):
    """Legacy list `digital_out[n]` among URScript's built-in data for inputs and outputs. Assigning an item
    sets the digital output.
    """

    def __init__(self, robot: Robot):
        super().__init__([False] * 18)
        self._robot = robot

    def __setitem__(self, index: Any, value: Any) -> None:
        self._robot.set_digital_out(_bit(index, 18), bool(value))

    def __getitem__(self, index: Any) -> bool:
        return bool(self._robot.digital_out >> _bit(index, 18) & 1)


def _bit(index: Any, count: int, first: int = 0) -> int:
    return _index(index, count, "pin") + first


def _register(index: Any, count: int = REGISTERS) -> int:
    return _index(index, count, "register")


def _index(index: Any, count: int, what: str) -> int:
    if not 0 <= int(index) < count:
        raise ProgramError(f"there is no {what} {int(index)} (0 to {count - 1})")
    return int(index)


def _digital(r: Robot) -> dict[str, Callable[..., Any]]:
    def setter(count: int, first: int = 0) -> Callable[..., None]:
        return lambda n, on: r.set_digital_out(_bit(n, count, first), bool(on))

    def output(count: int, first: int = 0) -> Callable[..., bool]:
        return lambda n: bool(r.digital_out >> _bit(n, count, first) & 1)

    def entry(count: int, first: int = 0) -> Callable[..., bool]:
        return lambda n: bool(r.digital_in >> _bit(n, count, first) & 1)

    table: dict[str, Callable[..., Any]] = {
        "set_digital_out": setter(18),  # the legacy names number all pins consecutively
        "get_digital_out": output(18),
        "get_digital_in": entry(18),
    }
    for name, count, first in (("standard", 8, 0), ("configurable", 8, CONFIGURABLE), ("tool", 2, TOOL)):
        table[f"set_{name}_digital_out"] = setter(count, first)
        table[f"get_{name}_digital_out"] = output(count, first)
        table[f"get_{name}_digital_in"] = entry(count, first)
        table[f"set_{name}_digital_input_action"] = lambda n, action: None
    return table


def _analog(r: Robot) -> dict[str, Callable[..., Any]]:
    def set_output(n: Any, ratio: float) -> None:
        r.analog_out[_bit(n, 2)] = min(max(float(ratio), 0.0), 1.0)

    def get_output(n: Any) -> float:
        return r.analog_out[_bit(n, 2)]

    def tool_input(n: Any) -> float:
        return 10.0 * r.plant.gripper()[0] if _bit(n, 2) == 0 else 0.0

    def standard_input(n: Any) -> float:
        _bit(n, 2)
        return 0.0

    def set_tool_voltage(volts: Any) -> None:
        if int(volts) not in TOOL_VOLTAGES:
            raise ProgramError(f"the tool voltage must be 0, 12 or 24 V, not {volts}")
        r.tool_voltage = int(volts)

    def set_domain(n: Any, domain: int) -> None:
        r.set_analog_domain(_bit(n, 2), bool(domain))

    return {
        "set_standard_analog_out": set_output,
        "set_analog_out": set_output,
        "get_standard_analog_out": get_output,
        "get_analog_out": get_output,
        "get_standard_analog_in": standard_input,
        "get_tool_analog_in": tool_input,
        "get_analog_in": lambda n: standard_input(n) if int(n) < 2 else tool_input(int(n) - 2),
        "set_analog_outputdomain": set_domain,
        "set_standard_analog_input_domain": lambda n, domain: None,
        "set_tool_analog_input_domain": lambda n, domain: None,
        "set_analog_inputrange": lambda n, reach: None,
        "set_tool_voltage": set_tool_voltage,
        "set_tool_output_mode": lambda mode: None,
        "set_tool_digital_output_mode": lambda n, mode: None,
        "get_tool_current": lambda: 0.0,
        "get_tool_accelerometer_reading": lambda: [0.0, 0.0, 9.81],
    }


def _registers(r: Robot) -> dict[str, Callable[..., Any]]:
    def write_int(register: int, value: int) -> None:
        if not -(2**31) <= int(value) < 2**31:
            raise ProgramError(f"{int(value)} does not fit into a register of 32 bits")
        r.output_int[_register(register)] = int(value)

    def write_double(register: int, value: float) -> None:
        r.output_double[_register(register)] = float(value)

    def write_bool(register: int, value: bool) -> None:
        bit = 1 << _register(register, 128)
        r.output_bits = (r.output_bits & ~bit) | (bit if value else 0)

    def read_bool(register: int) -> bool:
        bit = _register(register, 128)
        if bit >= 64:
            return bool(r.inputs.get(f"input_bit_register_{bit}", False))
        word = "input_bit_registers0_to_31" if bit < 32 else "input_bit_registers32_to_63"
        return bool(int(r.inputs.get(word, 0)) >> bit % 32 & 1)

    return {
        "read_input_boolean_register": read_bool,
        "read_input_integer_register": lambda i: int(r.inputs.get(f"input_int_register_{_register(i)}", 0)),
        "read_input_float_register": lambda i: float(
            r.inputs.get(f"input_double_register_{_register(i)}", 0.0)
        ),
        "read_output_boolean_register": lambda i: bool(r.output_bits >> _register(i, 128) & 1),
        "read_output_integer_register": lambda i: r.output_int[_register(i)],
        "read_output_float_register": lambda i: r.output_double[_register(i)],
        "write_output_boolean_register": write_bool,
        "write_output_integer_register": write_int,
        "write_output_float_register": write_double,
    }


def socket_functions(
    robot: Robot, network: Network
) -> tuple[dict[str, Callable[..., Wait]], dict[str, Callable[..., Any]], Callable[[], None]]:
    """Return URScript's built-in functions that exchange data over sockets, for one program of the emulated
    UR robot.

    Returns:
        Functions that take time (generators), functions that return immediately, and a function that closes
        all sockets of the program.
    """
    links: dict[str, TcpConnection] = {}

    def close_all() -> None:
        for link in links.values():
            link.close()

    def alive(name: str) -> TcpConnection | None:
        link = links.get(name)
        return link if link is not None and link.open else None

    def socket_open(address: str, port: int, name: str = "socket_0") -> Wait:
        yield
        old = links.pop(name, None)
        if old is not None:
            old.close()
        link = network.connect(address, int(port))
        if link is None:
            return False
        links[name] = link
        return True

    def _receive(name: str, count: int, timeout: float) -> Wait:
        """Receive `count` bytes of data from a URScript socket, or return None after a timeout [s]. A timeout
        of 0 means no limit.
        """
        end = robot.time + timeout
        while True:
            link = links.get(name)
            if link is None:
                yield  # a loop that reads a closed socket must not block the controller
                return None
            if len(link.received) >= count:
                data = bytes(link.received[:count])
                del link.received[:count]
                return data
            closed = not link.open
            if not closed and timeout > 0 and robot.time > end - 0.5 * robot.period:
                return None
            yield
            if closed:
                return None

    def socket_read_binary_integer(number: int, name: str = "socket_0", timeout: float = 2.0) -> Wait:
        data = yield from _receive(name, 4 * int(number), timeout)
        if data is None:
            return Vec([0] + [0] * int(number))
        return Vec((int(number), *struct.unpack(f">{int(number)}i", data)))

    def socket_read_byte_list(number: int, name: str = "socket_0", timeout: float = 2.0) -> Wait:
        data = yield from _receive(name, int(number), timeout)
        return Vec([0] + [0] * int(number)) if data is None else Vec((int(number), *data))

    def socket_read_line(name: str = "socket_0", timeout: float = 2.0) -> Wait:
        end = robot.time + timeout
        while True:
            link = links.get(name)
            if link is None or b"\n" in link.received or not link.open:
                break
            if timeout > 0 and robot.time > end - 0.5 * robot.period:
                return ""
            yield
        if link is None or b"\n" not in link.received:
            yield
            return ""
        line, _, rest = bytes(link.received).partition(b"\n")
        link.received[:] = rest
        return line.decode("ascii", "replace").rstrip("\r")

    def _send(name: str, data: bytes) -> bool:
        link = alive(name)
        if link is not None:
            link.send(data)
        return link is not None

    def socket_close(name: str = "socket_0") -> None:
        link = links.pop(name, None)
        if link is not None:
            link.close()

    def socket_read_string(
        name: str = "socket_0", prefix: str = "", suffix: str = "", interpret_escape: bool = False,
        timeout: float = 2.0,
    ) -> Wait:  # fmt: skip
        """Built-in URScript function that reads text data from a socket, optionally only the text between a
        prefix and a suffix.
        """
        begin, stop, end = str(prefix).encode(), str(suffix).encode(), robot.time + timeout
        while True:
            link = links.get(name)
            found = _between(link.received, begin, stop) if link is not None else None
            if link is not None and found is not None:
                return found.decode("utf-8", "replace")
            if timeout > 0 and robot.time > end - 0.5 * robot.period:
                return ""
            yield
            if link is None or not link.open:
                return ""

    def socket_read_ascii_float(number: int, name: str = "socket_0", timeout: float = 2.0) -> Wait:
        """Built-in URScript function that reads number data from a socket as text, such as `(1.5, 2, 3)`. It
        returns their count and their values.
        """
        text = yield from socket_read_string(name, "(", ")", False, timeout)
        try:
            values = [float(part) for part in text.split(",")] if text else []
        except ValueError:
            values = []
        return Vec((len(values), *values)) if len(values) == int(number) else Vec([0] + [0] * int(number))

    def socket_set_var(variable: str, value: int, name: str = "socket_0") -> None:
        _send(name, f"SET {variable} {int(value)}\n".encode())

    def socket_get_var(variable: str, name: str = "socket_0") -> Wait:
        _send(name, f"GET {variable}\n".encode())
        line = yield from socket_read_line(name)
        return int(line.rsplit(" ", 1)[-1]) if line.rsplit(" ", 1)[-1].lstrip("-").isdigit() else 0

    waiting = (
        socket_open, socket_read_binary_integer, socket_read_byte_list, socket_read_line, socket_read_string,
        socket_read_ascii_float, socket_get_var,
    )  # fmt: skip
    instant: dict[str, Callable[..., Any]] = {
        "socket_close": socket_close,
        "socket_set_var": socket_set_var,
        "socket_send_int": lambda value, name="socket_0": _send(name, struct.pack(">i", int(value))),
        "socket_send_byte": lambda value, name="socket_0": _send(name, bytes([int(value) & 255])),
        "socket_send_string": lambda text, name="socket_0": _send(name, str(text).encode()),
        "socket_send_line": lambda text, name="socket_0": _send(name, f"{text}\n".encode()),
    }
    return {f.__name__: f for f in waiting}, instant, close_all


def _between(received: bytearray, begin: bytes, stop: bytes) -> bytes | None:
    """Remove the data between two marks from the buffer of a URScript socket and return it, or return None if
    the data is incomplete.

    Without marks, all received data is returned.
    """
    first = received.find(begin)
    last = received.find(stop, first + len(begin)) if stop else len(received)
    if not received or first < 0 or last < 0:
        return None
    text = bytes(received[first + len(begin) : last])
    del received[: last + len(stop)]
    return text
