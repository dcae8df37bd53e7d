"""RTDE port (30004) of the emulated UR controller, and the values of its output variables."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.drivers.ur.wire import rtde
from armcell.drivers.ur.wire.kinematics import cross, forward, frames_of, jacobian
from armcell.drivers.ur.wire.modes import SAFETY_BITS, RobotMode
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.robot import Robot

Array = NDArray[np.float64]
Getter = Callable[[], Any]

ZERO = {"BOOL": False, "VECTOR3D": (0.0,) * 3, "VECTOR6D": (0.0,) * 6, "VECTOR6INT32": (0,) * 6}
TORQUE_PER_AMPERE = 10.0  # [Nm/A] approximate torque at the gear's output
JOINT_RUNNING, JOINT_IDLE = 253, 255
TOOL_RUNNING, TOOL_IDLE = 253, 255
WORD = 0xFFFFFFFF
MAX_DEVIATION = 0.1  # [rad] between target and measured position: deviation ratio 1
log = logging.getLogger(__name__)
MAX_INPUT_RECIPES = 255
NEVER = 2**31  # control steps between two packets of a client that asks for nearly no packets


def outputs_of(robot: Robot) -> dict[str, Getter]:
    """Return the RTDE output variables of the server: for each variable, a function that reads its value from
    the emulated UR controller.

    Variables that are not emulated read zero.
    """
    table: dict[str, Getter] = {
        name: lambda value=ZERO.get(kind, 0): value for name, kind in rtde.OUTPUTS.items()
    }
    for name in rtde.OUTPUTS.keys() & rtde.INPUTS.keys():  # inputs that clients can read back
        table[name] = lambda name=name, zero=ZERO.get(rtde.INPUTS[name], 0): robot.inputs.get(name, zero)
    return table | _registers(robot) | _motion(robot) | _tool(robot) | _state(robot)


def _registers(r: Robot) -> dict[str, Getter]:
    table: dict[str, Getter] = {
        "output_bit_registers0_to_31": lambda: r.output_bits & WORD,
        "output_bit_registers32_to_63": lambda: r.output_bits >> 32 & WORD,
        **{f"output_bit_register_{i}": lambda i=i: bool(r.output_bits >> i & 1) for i in range(64, 128)},
    }
    for i in range(48):
        table[f"output_int_register_{i}"] = lambda i=i: r.output_int[i]
        table[f"output_double_register_{i}"] = lambda i=i: r.output_double[i]
    return table


def _motion(r: Robot) -> dict[str, Getter]:
    s = r.setpoint

    def efforts() -> Array:
        return r.plant.read()[2]

    def actual() -> tuple[Array, Array]:
        return r.plant.read()[:2]

    def deviation() -> float:
        return float(np.abs(np.subtract(s.q, actual()[0])).max() / MAX_DEVIATION)

    return {
        "target_q": lambda: s.q,
        "target_qd": lambda: s.v,
        "target_qdd": lambda: r.target_qdd,
        "target_moment": efforts,
        "actual_q": lambda: actual()[0],
        "actual_qd": lambda: actual()[1],
        "actual_current": lambda: efforts() / TORQUE_PER_AMPERE,
        "target_current": lambda: efforts() / TORQUE_PER_AMPERE,
        "joint_control_output": lambda: efforts() / TORQUE_PER_AMPERE,
        "actual_current_as_torque": efforts,
        "actual_TCP_pose": lambda: r.tcp_pose(actual()[0]),
        "target_TCP_pose": lambda: r.tcp_pose(s.q),
        "actual_TCP_speed": lambda: r.tcp_speed(*actual()),
        "target_TCP_speed": lambda: r.tcp_speed(s.q, s.v),
        "actual_TCP_acceleration": lambda: _tcp_acceleration(r, *actual(), r.actual_qdd),
        "target_TCP_acceleration": lambda: _tcp_acceleration(r, s.q, s.v, r.target_qdd),
        "actual_TCP_force": r.tcp_force,
        "wrench_calc_from_currents": r.tcp_force,
        "ft_raw_wrench": lambda: _raw_wrench(r),
        "tcp_force_scalar": lambda: float(np.linalg.norm(r.tcp_force()[:3])),
        "tcp_offset": lambda: s.tcp,
        "elbow_position": lambda: frames_of(r.dh, actual()[0])[2][:3, 3],
        "elbow_velocity": lambda: _elbow_velocity(r, *actual()),
        "joint_position_deviation_ratio": deviation,
        "joint_mode": lambda: (JOINT_RUNNING if r.mode is RobotMode.RUNNING else JOINT_IDLE,) * 6,
        "joint_temperatures": lambda: (25.0,) * 6,
        "actual_joint_voltage": lambda: (48.0,) * 6,
    }


def _tcp_acceleration(r: Robot, q: Array, v: Array, a: Array) -> Array:
    """Return the acceleration (6,) [m/s^2, rad/s^2] of the emulated UR arm's tool for an RTDE output of the
    server, by finite differences.
    """
    dt = r.period
    return (r.tcp_speed(q, v) - r.tcp_speed(q - v * dt, v - a * dt)) / dt


def _elbow_velocity(r: Robot, q: Array, v: Array) -> Array:
    elbow = frames_of(r.dh, q)[2][:3, 3]
    return (jacobian(r.dh, q, elbow)[:3, :2] @ v[:2]).ravel()


def _raw_wrench(r: Robot) -> Array:
    """Return the wrench (6,) [N, Nm] on the emulated UR arm's flange for an RTDE output of the server. It
    includes the weight of the payload.
    """
    if not r.model.e_series:
        return np.zeros(6)
    R = forward(r.dh, r.plant.read()[0], [0.0] * 6)[:3, :3]
    wrench = r.tcp_force()
    weight = -r.payload * np.asarray(r.gravity)
    torque = wrench[3:] + cross(R @ np.asarray(r.payload_cog), weight)
    return np.concatenate([R.T @ (wrench[:3] + weight), R.T @ torque])


def _tool(r: Robot) -> dict[str, Getter]:
    return {
        "actual_tool_accelerometer": lambda: (0.0, 0.0, 9.81),
        "tool_mode": lambda: TOOL_RUNNING if r.mode >= RobotMode.IDLE else TOOL_IDLE,
        "tool_analog_input_types": lambda: 0b11,
        "tool_analog_input0": lambda: 10.0 * r.plant.gripper()[0],  # [V]
        "tool_output_voltage": lambda: r.tool_voltage,
        "tool_temperature": lambda: 25.0,
        "payload": lambda: r.payload,
        "payload_cog": lambda: r.payload_cog,
        "payload_inertia": lambda: r.payload_inertia,
        "target_gravity": lambda: r.gravity,
    }


def _state(r: Robot) -> dict[str, Getter]:
    return {
        "timestamp": lambda: r.time,
        "control_step": lambda: round(r.time / r.period),
        "robot_mode": lambda: int(r.mode),
        "safety_mode": lambda: int(r.safety),
        "safety_status": lambda: int(r.safety),
        "runtime_state": lambda: int(r.runtime),
        "robot_status_bits": r.status_bits,
        "safety_status_bits": lambda: SAFETY_BITS[r.safety],
        "speed_scaling": lambda: r.scaling,
        "target_speed_fraction": lambda: r.slider,
        "script_control_line": r.control_line,
        "actual_digital_input_bits": lambda: r.digital_in,
        "actual_digital_output_bits": lambda: r.digital_out,
        "actual_configurable_digital_input_bits": lambda: r.digital_in >> 8 & 0xFF,
        "actual_configurable_digital_output_bits": lambda: r.digital_out >> 8 & 0xFF,
        "analog_io_types": lambda: 0b11 | r.analog_volts << 2,
        "standard_analog_output0": lambda: r.analog_output(0),
        "standard_analog_output1": lambda: r.analog_output(1),
        "actual_main_voltage": lambda: 48.0,
        "actual_robot_voltage": lambda: 48.0,
    }


class _Client:
    def __init__(self) -> None:
        self.protocol = 1  # until the client asks for another version
        self.outputs: rtde.Recipe | None = None
        self.getters: list[Getter] = []
        self.every = 1
        self.inputs: dict[int, rtde.Recipe] = {}
        self.started = False
        self.count = 0


class RtdeServer:
    """Server of all RTDE clients of one emulated UR controller."""

    def __init__(self, robot: Robot, network: Network, host: str, port: int = rtde.PORT):
        self._robot, self._table = robot, outputs_of(robot)
        self._clients: dict[TcpConnection, _Client] = {}
        self.port = network.listen(host, port, self._begin, self._data, "RTDE")

    @property
    def clients(self) -> int:
        """Return the number of clients that are connected to the RTDE server of the emulated UR
        controller.
        """
        return sum(link.open for link in self._clients)

    def _begin(self, link: TcpConnection) -> None:
        self._clients[link] = _Client()

    def _data(self, link: TcpConnection) -> None:
        client = self._clients.get(link)
        if client is None:
            return
        try:
            for kind, payload in rtde.frames(link.received):
                self._handle(link, client, kind, payload)
        except (rtde.RtdeError, struct.error) as error:
            log.info("RTDE client cut off: %s", error)
            link.close()  # a real controller also closes the link after invalid data

    def _handle(self, link: TcpConnection, client: _Client, kind: int, payload: bytes) -> None:
        r = self._robot
        if kind == rtde.DATA:
            recipe = client.inputs.get(payload[0]) if payload else None
            if recipe is None or len(payload) != 1 + recipe.size or not r.accepts_remote_commands:
                return  # ur_rtde 1.6.5's getForwardKinematics(q, tcp) uses the ID of another recipe
            values = recipe.unpack(payload[1:])
            if all(np.all(np.isfinite(v)) for v in values.values()):
                r.set_inputs(values)
            return
        if kind == rtde.MESSAGE:
            r.popup(f"RTDE client: {rtde.message_text(payload)}")  # RTDE has no answer to a client's message
            return
        if kind == rtde.VERSION:
            (version,) = struct.unpack(">H", payload)
            client.protocol = version if version in (1, 2) else client.protocol
            answer = b"\x01" if version in (1, 2) else b"\x00"
        elif kind == rtde.CONTROLLER_VERSION:
            answer = struct.pack(">4I", *r.model.version)
        elif kind == rtde.SETUP_OUTPUTS:
            answer = self._setup_outputs(client, payload)
        elif kind == rtde.SETUP_INPUTS:
            answer = self._setup_inputs(client, payload)
        elif kind == rtde.START:
            client.started = client.outputs is not None
            answer = bytes([client.started or bool(client.inputs)])
        elif kind == rtde.PAUSE:
            client.started, answer = False, b"\x01"
        else:
            raise rtde.RtdeError(f"type {kind}")
        link.send(rtde.frame(kind, answer))

    def _setup_outputs(self, client: _Client, payload: bytes) -> bytes:
        """Set up the recipe of output variables that a client requests from the RTDE server of the emulated
        UR controller.

        Protocol version 1 has neither a frequency nor a recipe ID.
        """
        highest = self._robot.model.frequency
        if client.protocol == 1:
            frequency, names, number = highest, rtde.split_names(payload), b""
        else:
            frequency, names = struct.unpack_from(">d", payload)[0], rtde.split_names(payload[8:])
            number = b"\x01"
        known = [rtde.OUTPUTS.get(n, "NOT_FOUND") for n in names]
        if "NOT_FOUND" not in known and np.isfinite(frequency) and frequency > 0:
            client.outputs = rtde.Recipe(names, known)
            client.every = int(min(max(highest / frequency, 1), NEVER))
            client.getters = [self._table[n] for n in names]
        return number + ",".join(known).encode()

    def _setup_inputs(self, client: _Client, payload: bytes) -> bytes:
        names = rtde.split_names(payload)
        kinds = [rtde.INPUTS.get(n, "NOT_FOUND") for n in names]
        others = [c for other, c in self._clients.items() if c is not client and other.open]
        used = {n for c in others for recipe in c.inputs.values() for n in recipe.names}
        kinds = ["IN_USE" if n in used else k for n, k in zip(names, kinds)]
        good = not {"NOT_FOUND", "IN_USE"} & set(kinds) and len(client.inputs) < MAX_INPUT_RECIPES
        number = len(client.inputs) + 1 if good else 0
        if good:
            client.inputs[number] = rtde.Recipe(names, kinds)
        return bytes([number]) + ",".join(kinds).encode()

    def send_outputs(self) -> None:
        """Send RTDE output variables of the emulated UR controller to each client at the client's chosen
        frequency. Call this method once per control step.
        """
        for link, client in list(self._clients.items()):
            if not link.open:
                del self._clients[link]
            elif client.started and client.outputs is not None:
                client.count += 1
                if client.count >= client.every:
                    client.count = 0
                    data = client.outputs.pack(get() for get in client.getters)
                    number = b"" if client.protocol == 1 else b"\x01"
                    link.send(rtde.frame(rtde.DATA, number + data))
