"""The primary, secondary and realtime ports (30001 to 30003): URScript in, the robot's state out."""

from __future__ import annotations

import struct
from functools import partial

from armcell.control.ur_controller.network import Link, Network
from armcell.control.ur_controller.programs import run_script
from armcell.control.ur_controller.robot import Robot
from armcell.control.ur_controller.urscript.parser import MAX_SCRIPT, depth_after
from armcell.control.ur_wire import primary
from armcell.control.ur_wire.modes import RuntimeState, SafetyMode

PRIMARY, SECONDARY, REALTIME = 30001, 30002, 30003
STATE_PERIOD = 0.1  # [s] of primary and secondary


class ScriptServer:
    def __init__(self, robot: Robot, network: Network, host: str, ports: tuple[int, int, int]):
        self._robot, self._network = robot, network
        self._text: dict[Link, tuple[list[str], int]] = {}
        self._watching: dict[Link, bool] = {}  # realtime or not
        self._next = 0.0
        for name, port in zip(("primary", "secondary", "real-time"), ports, strict=True):
            begin = partial(self._begin, realtime=name == "real-time")
            network.listen(host, port, begin, self._data, f"script, {name}")

    def _begin(self, link: Link, realtime: bool) -> None:
        self._watching[link] = realtime
        if not realtime:
            v = self._robot.model.version
            link.send(primary.version_message(self._now_us(), "URControl", v[:3], v[3]))

    def _data(self, link: Link) -> None:
        lines, depth = self._text.get(link, ([], 0))
        while b"\n" in link.received:
            raw, _, rest = bytes(link.received).partition(b"\n")
            link.received[:] = rest
            line = raw.decode("utf-8", "replace").rstrip("\r")
            lines.append(line)
            depth = depth_after(line, depth)
            if depth == 0:
                text, lines = "\n".join(lines), []
                if text.strip():
                    self._run(text)
        self._text[link] = (lines, depth)
        if len(link.received) + sum(map(len, lines)) > MAX_SCRIPT:
            link.close()

    def _run(self, text: str) -> None:
        robot = self._robot
        if not robot.remote_or_cb3:
            robot.popup("script refused: the robot is in local control")
            return
        run_script(robot, self._network, text)

    def _now_us(self) -> int:
        return int(self._robot.time * 1e6)

    def send_state(self) -> None:
        """To be called once a control step."""
        r = self._robot
        due = r.time >= self._next
        if due:
            self._next = r.time + STATE_PERIOD
        for link, realtime in list(self._watching.items()):
            if not link.open:
                del self._watching[link]
                self._text.pop(link, None)
            elif due:
                link.send(self._realtime() if realtime else self._state())

    def _state(self) -> bytes:
        r, limit = self._robot, self._robot.model.max_position
        mode = primary.mode_package(
            self._now_us(), r.mode >= 4, r.safety in (6, 7), r.safety is SafetyMode.PROTECTIVE_STOP,
            r.runtime is RuntimeState.PLAYING, r.runtime is RuntimeState.PAUSED,
            max(int(r.mode), 0), r.slider, r.scaling,
        )  # fmt: skip
        kind = primary.ROBOT_TYPES[r.model.name.removesuffix("e")]
        configuration = primary.configuration_package(
            [(-limit, limit)] * 6, r.model.velocity, [r.model.acceleration] * 6, r.dh, kind
        )
        return primary.robot_state([mode, r.dh.pack(), configuration])

    def _realtime(self) -> bytes:
        """The layout of the realtime port: int32 size, then doubles (139 in all), time first."""
        r, s = self._robot, self._robot.setpoint
        q, v, _ = r.plant.read()
        values = [0.0] * 139
        values[0] = r.time
        for start, six in ((1, s.q), (7, s.v), (31, q), (37, v), (55, r.tcp_pose(q))):
            values[start : start + 6] = [float(x) for x in six]
        values[94], values[117] = float(r.mode), r.scaling
        return struct.pack(">i139d", 4 + 8 * 139, *values)
