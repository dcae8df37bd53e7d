"""Text port of the emulated Franka arm for operator actions and injected faults.

Operator actions are those at the robot and in Desk. A real robot has no such port. One command per line; each
gets one line as its answer.
"""

from __future__ import annotations

import time
from typing import Protocol

from armcell.core import UnknownNameError
from armcell.emulators.franka.command_server import CommandServer
from armcell.emulators.franka.hand import Hand
from armcell.emulators.franka.motion_generators import Reflex
from armcell.emulators.franka.robot import Robot
from armcell.emulators.network import Network, TcpConnection

PORT = 1340
MAX_LINE = 1024
HELP = (
    "user stop on|off | brakes lock|unlock | fci on|off | guiding on|off | reflex | displace <7 rad> | "
    "push <x> <y> <z> [N] | hand homed|unhomed|absent|present | reset | state | pose <object> | "
    "fault drop <s> | fault freeze <s> | fault delay <s> | fault loss <share> | fault garbage <messages> | "
    "fault payload <kg> | fault offset <joint> <rad> | fault block <joint> | fault none"
)


class _Resettable(Protocol):
    def reset(self) -> None: ...


class OperatorServer:
    def __init__(
        self, robot: Robot, hand: Hand, commands: CommandServer, whole: _Resettable, network: Network,
        host: str, port: int = PORT,
    ):  # fmt: skip
        self._robot, self._hand, self._commands, self._whole = robot, hand, commands, whole
        self._network = network
        network.listen(host, port, lambda link: None, self._data, "operator")

    def _data(self, link: TcpConnection) -> None:
        while b"\n" in link.received:
            line, _, rest = bytes(link.received).partition(b"\n")
            link.received[:] = rest
            link.send(f"{self.answer(line.decode('ascii', 'replace'))}\n".encode())
        if len(link.received) > MAX_LINE:
            link.close()

    def answer(self, line: str) -> str:
        """Execute one command of the emulated Franka arm's operator, and return a line with the answer."""
        words = line.split()
        try:
            done = self._fault(words[1:]) if words[:1] == ["fault"] else self._act(words)
        except (ValueError, IndexError, UnknownNameError):
            done = None
        return f"unknown or incomplete command {line.strip()!r}; known: {HELP}" if done is None else done

    def _act(self, words: list[str]) -> str | None:
        robot, hand = self._robot, self._hand
        match words:
            case ["user", "stop", "on" | "off" as how]:
                robot.user_stop(how == "on")
            case ["brakes", "lock" | "unlock" as how]:
                robot.brakes(how == "lock")
            case ["fci", "on" | "off" as how]:
                self._commands.set_active(how == "on")
            case ["guiding", "on" | "off" as how]:
                robot.guide(how == "on")
            case ["reflex"]:
                robot.abort(Reflex("joint_reflex", "injected"))
            case ["displace", *angles] if len(angles) == 7:
                robot.displace([float(a) for a in angles])
            case ["push", x, y, z]:
                robot.plant.push[:] = float(x), float(y), float(z)
            case ["hand", "homed" | "unhomed" as how]:
                hand.homed = how == "homed"
            case ["hand", "present" | "absent" as how]:
                hand.present = how == "present"
            case ["reset"]:
                self._whole.reset()
            case ["pose", name]:
                return " ".join(f"{x:.6f}" for x in robot.plant.world.object_pose(name).translation)
            case ["state"]:
                q = " ".join(f"{x:.6f}" for x in robot.q)
                return f"{robot.mode.name} {','.join(sorted(robot.errors)) or '-'} {q}"
            case ["help"]:
                return HELP
            case _:
                return None
        return "done"

    def _fault(self, words: list[str]) -> str | None:
        faults, plant = self._network.faults, self._robot.plant
        match words:
            case ["drop", seconds]:
                self._network.drop(float(seconds))
            case ["freeze", seconds]:
                faults.frozen_until = time.monotonic() + float(seconds)
            case ["delay", seconds]:
                faults.delay = float(seconds)
            case ["loss", share]:
                self._commands.udp.loss = float(share)
            case ["garbage", count]:
                faults.garbage = int(count) + 1  # plus 1, because the answer to this command counts
            case ["payload", mass]:
                plant.attach_payload(float(mass))
            case ["offset", joint, angle]:
                plant.set_encoder_offset(int(joint), float(angle))
            case ["block", joint]:
                plant.block_joint(int(joint))
            case ["none"]:
                faults.delay, faults.garbage, self._commands.udp.loss = 0.0, 0, 0.0
            case _:
                return None
        return "done"
