"""Robot state messages of the emulated UR primary, secondary and real-time ports."""

from __future__ import annotations

import struct

import numpy as np

from armcell.drivers.ur.wire import primary
from armcell.drivers.ur.wire.modes import RuntimeState, SafetyMode
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.rtde_outputs import outputs_of

REALTIME_DOUBLES = (((3, 15), 152), ((3, 14), 142), ((3, 10), 139), ((3, 5), 138), ((3, 2), 132))
"""Number of doubles in the real-time message, by the first CB3 software version that sends it."""
_REALTIME = (
    (0, "timestamp"), (1, "target_q"), (7, "target_qd"), (13, "target_qdd"), (19, "target_current"),
    (25, "target_moment"), (31, "actual_q"), (37, "actual_qd"), (43, "actual_current"),
    (49, "joint_control_output"), (55, "actual_TCP_pose"), (61, "actual_TCP_speed"),
    (67, "actual_TCP_force"), (73, "target_TCP_pose"), (79, "target_TCP_speed"),
    (85, "actual_digital_input_bits"), (86, "joint_temperatures"), (92, "actual_execution_time"),
    (94, "robot_mode"), (95, "joint_mode"), (101, "safety_mode"), (108, "actual_tool_accelerometer"),
    (117, "speed_scaling"), (118, "actual_momentum"), (121, "actual_main_voltage"),
    (122, "actual_robot_voltage"), (123, "actual_robot_current"), (124, "actual_joint_voltage"),
    (130, "actual_digital_output_bits"), (131, "runtime_state"), (132, "elbow_position"),
    (135, "elbow_velocity"), (138, "safety_status"), (142, "payload"), (143, "payload_cog"),
    (146, "payload_inertia"),
)  # fmt: skip
"""Index of each value's first double. Source: Universal Robots, "Realtime Client Interface" (3.15, 5.10)."""


class StateEncoder:
    """Encoder of an emulated UR robot's state messages for its clients."""

    def __init__(self, robot: Robot):
        self._robot, self._read = robot, outputs_of(robot)
        self._doubles = next(n for since, n in REALTIME_DOUBLES if robot.model.cb3_version >= since)

    @property
    def now_us(self) -> int:
        return int(self._robot.time * 1e6)

    def realtime(self) -> bytes:
        values = np.zeros(max(n for _, n in REALTIME_DOUBLES), dtype=">f8")
        for first, name in _REALTIME:
            value = self._read[name]()
            place = first if np.isscalar(value) else slice(first, first + len(value))
            values[place] = value
        return struct.pack(">i", 4 + 8 * self._doubles) + values[: self._doubles].tobytes()

    def primary(self) -> bytes:
        """Return the state message for the primary clients of the emulated UR robot,
        with every package that its model sends.
        """
        r = self._robot
        rows = zip(
            *(self._six(name) for name in ("actual_q", "target_q", "actual_qd", "actual_current")),
            *(self._six(name) for name in ("actual_joint_voltage", "joint_temperatures")),
            (int(x) for x in self._read["joint_mode"]()),
            strict=True,
        )
        tool_mode = int(self._read["tool_mode"]())
        domains = (r.analog_volts & 1, r.analog_volts >> 1 & 1)
        packages = [
            self._mode(),
            primary.joint_package(rows),
            primary.tool_package((self._read["tool_analog_input0"](), 0.0), r.tool_voltage, 25.0, tool_mode),
            primary.masterboard_package(
                r.digital_in, r.digital_out, domains, (r.analog_output(0), r.analog_output(1)),
                int(r.safety), r.safety is SafetyMode.REDUCED,
            ),
            primary.cartesian_package(self._six("actual_TCP_pose"), r.setpoint.tcp),
            r.dh.pack(),
            self._configuration(),
            primary.force_mode_package(r.external_wrench().tolist(), 1.0),
            primary.additional_package(r.compliance is not None and r.compliance.freedrive),
            *primary.internal_packages(),
        ]  # fmt: skip
        if r.model.e_series:
            packages += primary.tool_extras(0)
        return primary.robot_state(packages)

    def _six(self, name: str) -> list[float]:
        return [float(x) for x in self._read[name]()]

    def _mode(self) -> bytes:
        r = self._robot
        return primary.mode_package(
            self.now_us, r.mode >= 4, r.safety in (6, 7), r.safety is SafetyMode.PROTECTIVE_STOP,
            r.runtime is RuntimeState.PLAYING, r.runtime is RuntimeState.PAUSED,
            max(int(r.mode), 0), r.slider, r.scaling, r.model.cb3_version,
        )  # fmt: skip

    def _configuration(self) -> bytes:
        r, limit = self._robot, self._robot.model.max_position
        kind = primary.ROBOT_TYPES[r.model.name.removesuffix("e")]
        return primary.configuration_package(
            [(-limit, limit)] * 6, r.model.velocity, [r.model.acceleration] * 6, r.dh, kind
        )
