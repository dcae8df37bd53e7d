"""Emulated gripper URCap socket (port 63352) with Robotiq's text protocol.

Commands are lines such as `SET POS 255 FOR 100 GTO 1` and `GET POS`. POS 0 is open, 255 closed; OBJ is 0
during motion, 2 if an object stopped the closing motion, 3 at the target. Source: the 2F gripper's manual
and public clients of this port.
"""

from __future__ import annotations

from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.robot import Robot

PORT = 63352
MAX_LINE = 1024


class GripperServer:
    def __init__(self, robot: Robot, network: Network, host: str, port: int = PORT):
        self._robot = robot
        self._values = {"ACT": 0, "GTO": 0, "POS": 0, "SPE": 255, "FOR": 0, "ATR": 0, "ARD": 0}
        network.listen(host, port, lambda link: None, self._data, "gripper")

    def _data(self, link: TcpConnection) -> None:
        while b"\n" in link.received:
            line, _, rest = bytes(link.received).partition(b"\n")
            link.received[:] = rest
            link.send(f"{self._answer(line.decode('ascii', 'replace').split())}\n".encode())
        if len(link.received) > MAX_LINE:
            link.close()

    def _answer(self, words: list[str]) -> str:
        if len(words) >= 3 and words[0] == "SET" and len(words) % 2 == 1:
            try:
                new = {k: int(v) for k, v in zip(words[1::2], words[2::2], strict=True)}
            except ValueError:
                return "?"
            if not set(new) <= set(self._values) or not all(0 <= v <= 255 for v in new.values()):
                return "?"
            self._values.update(new)
            if self._values["ACT"] and self._values["GTO"]:
                self._robot.plant.drive_gripper(1.0 - self._values["POS"] / 255, self._values["FOR"] / 255)
            return "ack"
        if len(words) == 2 and words[0] == "GET":
            opening, holds = self._robot.plant.gripper()
            position = round(255 * (1.0 - opening))
            if words[1] == "POS":
                return f"POS {position}"
            if words[1] == "OBJ":
                arrived = abs(position - self._values["POS"]) <= 2
                return f"OBJ {2 if holds else 3 if arrived else 0}"
            if words[1] == "STA":
                return f"STA {3 if self._values['ACT'] else 0}"
            if words[1] in self._values:
                return f"{words[1]} {self._values[words[1]]}"
        return "?"
