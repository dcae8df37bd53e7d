"""The controller's RTDE port (30004)."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from armcell.control.ur_controller.network import Link, Network
from armcell.control.ur_controller.robot import Robot
from armcell.control.ur_wire import rtde
from armcell.control.ur_wire.modes import SAFETY_BITS

log = logging.getLogger(__name__)

Getter = Callable[[], Any]
MAX_INPUT_RECIPES = 255
ZERO = {"BOOL": False, "VECTOR3D": (0.0,) * 3, "VECTOR6D": (0.0,) * 6, "VECTOR6INT32": (0,) * 6}


def outputs_of(robot: Robot) -> dict[str, Getter]:
    """How each output variable is read; one without a source here is zero."""
    r, s = robot, robot.setpoint
    table: dict[str, Getter] = {}
    for name, kind in rtde.OUTPUTS.items():
        table[name] = lambda value=ZERO.get(kind, 0): value
    for i in range(48):
        table[f"output_int_register_{i}"] = lambda i=i: r.output_int[i]
        table[f"output_double_register_{i}"] = lambda i=i: r.output_double[i]
        for kind in ("int", "double"):
            table[f"input_{kind}_register_{i}"] = lambda name=f"input_{kind}_register_{i}": r.inputs.get(
                name, 0
            )
    efforts = lambda: r.plant.read()[2]  # noqa: E731
    table |= {
        "timestamp": lambda: r.time,
        "target_q": lambda: s.q,
        "target_qd": lambda: s.v,
        "target_moment": efforts,
        "actual_q": lambda: r.plant.read()[0],
        "actual_qd": lambda: r.plant.read()[1],
        "actual_current": lambda: efforts() / 10.0,  # a motor gives about 10 Nm per ampere behind its gear
        "target_current": lambda: efforts() / 10.0,
        "actual_current_as_torque": efforts,
        "actual_TCP_pose": lambda: r.tcp_pose(r.plant.read()[0]),
        "target_TCP_pose": lambda: r.tcp_pose(s.q),
        "actual_TCP_speed": lambda: r.tcp_speed(*r.plant.read()[:2]),
        "target_TCP_speed": lambda: r.tcp_speed(s.q, s.v),
        "actual_TCP_force": r.tcp_force,
        "tcp_force_scalar": lambda: float(np.linalg.norm(r.tcp_force()[:3])),
        "tcp_offset": lambda: s.tcp,
        "joint_temperatures": lambda: (25.0,) * 6,
        "actual_joint_voltage": lambda: (48.0,) * 6,
        "joint_mode": lambda: (253 if r.mode.value == 7 else 239,) * 6,
        "robot_mode": lambda: int(r.mode),
        "safety_mode": lambda: int(r.safety),
        "safety_status": lambda: int(r.safety),
        "runtime_state": lambda: int(r.runtime),
        "robot_status_bits": r.status_bits,
        "safety_status_bits": lambda: SAFETY_BITS[r.safety],
        "speed_scaling": lambda: r.scaling,
        "target_speed_fraction": lambda: r.slider,
        "payload": lambda: r.payload,
        "payload_cog": lambda: r.payload_cog,
        "actual_digital_input_bits": lambda: r.digital_in,
        "actual_digital_output_bits": lambda: r.digital_out,
        "standard_analog_output0": lambda: r.analog_out[0],
        "standard_analog_output1": lambda: r.analog_out[1],
        "tool_analog_input0": lambda: 10.0 * r.plant.gripper()[0],  # [V]
        "tool_output_voltage": lambda: r.tool_voltage,
        "output_bit_registers0_to_31": lambda: r.output_bits & 0xFFFFFFFF,
        "output_bit_registers32_to_63": lambda: r.output_bits >> 32,
        "actual_main_voltage": lambda: 48.0,
        "actual_robot_voltage": lambda: 48.0,
        "actual_tool_accelerometer": lambda: (0.0, 0.0, 9.81),
    }
    return table


class _Client:
    def __init__(self) -> None:
        self.outputs: rtde.Recipe | None = None
        self.getters: list[Getter] = []
        self.every = 1
        self.inputs: dict[int, rtde.Recipe] = {}
        self.started = False
        self.count = 0


class RtdeServer:
    """All RTDE clients of one controller."""

    def __init__(self, robot: Robot, network: Network, host: str, port: int = rtde.PORT):
        self._robot, self._table = robot, outputs_of(robot)
        self._clients: dict[Link, _Client] = {}
        self.port = network.listen(host, port, self._begin, self._data, "RTDE")

    def _begin(self, link: Link) -> None:
        self._clients[link] = _Client()

    def _data(self, link: Link) -> None:
        client = self._clients.get(link)
        if client is None:
            return
        try:
            for kind, payload in rtde.frames(link.received):
                self._handle(link, client, kind, payload)
        except (rtde.RtdeError, struct.error) as error:
            log.info("RTDE client cut off: %s", error)
            link.close()  # as a controller does with what is not RTDE

    def _handle(self, link: Link, client: _Client, kind: int, payload: bytes) -> None:
        r = self._robot
        if kind == rtde.DATA:
            recipe = client.inputs.get(payload[0]) if payload else None
            if recipe is None or len(payload) != 1 + recipe.size or not r.remote_or_cb3:
                return  # ur_rtde 1.6.5's getForwardKinematics(q, tcp) sends under another recipe's number
            values = recipe.unpack(payload[1:])
            if all(np.all(np.isfinite(v)) for v in values.values()):
                r.set_inputs(values)
            return
        if kind == rtde.VERSION:
            answer = b"\x01" if struct.unpack(">H", payload)[0] in (1, 2) else b"\x00"
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
        frequency, names = struct.unpack_from(">d", payload)[0], rtde.split_names(payload[8:])
        known = [rtde.OUTPUTS.get(n, "NOT_FOUND") for n in names]
        if "NOT_FOUND" not in known and np.isfinite(frequency) and frequency > 0:
            client.outputs = rtde.Recipe(names, known)
            client.every = max(round(self._robot.model.frequency / frequency), 1)
            client.getters = [self._table[n] for n in names]
        return b"\x01" + ",".join(known).encode()

    def _setup_inputs(self, client: _Client, payload: bytes) -> bytes:
        names = rtde.split_names(payload)
        kinds = [rtde.INPUTS.get(n, "NOT_FOUND") for n in names]
        used = {
            n for c in self._clients.values() if c is not client for x in c.inputs.values() for n in x.names
        }
        kinds = ["IN_USE" if n in used else k for n, k in zip(names, kinds)]
        good = not {"NOT_FOUND", "IN_USE"} & set(kinds) and len(client.inputs) < MAX_INPUT_RECIPES
        number = len(client.inputs) + 1 if good else 0
        if good:
            client.inputs[number] = rtde.Recipe(names, kinds)
        return bytes([number]) + ",".join(kinds).encode()

    def send_outputs(self) -> None:
        """To be called once a control step."""
        for link, client in list(self._clients.items()):
            if not link.open:
                del self._clients[link]
            elif client.started and client.outputs is not None:
                client.count += 1
                if client.count >= client.every:
                    client.count = 0
                    data = client.outputs.pack(get() for get in client.getters)
                    link.send(rtde.frame(rtde.DATA, b"\x01" + data))
