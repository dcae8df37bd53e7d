"""Text ports of the emulated UR controller: dashboard (29999), and Robotiq's gripper URCap (63352).

Commands that begin with `armcell` are extensions: they emulate hands, buttons and cables of a real robot.

Commands are lines such as `SET POS 255 FOR 100 GTO 1` and `GET POS`. POS 0 is open, 255 closed; OBJ is 0
during motion, 2 if an object stopped the closing motion, 3 at the target. Source: the 2F gripper's manual
and public clients of this port.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from armcell.drivers.ur.wire.models import JOINTS
from armcell.drivers.ur.wire.modes import RuntimeState
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.plant import WORDS, set_fault
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.script_server import NAME, ExternalControl

DASHBOARD_PORT = 29999

GREETING = "Connected: Universal Robots Dashboard Server"

MAX_LINE = 4096

LOCAL_REFUSAL = "Command is not allowed due to safety reasons: the robot is in local control"

HELP = f"""\
armcell protective stop | safeguard stop | safeguard reset | emergency stop | emergency release
armcell local | remote
armcell move joint <0-5> <rad>
armcell push <fx> <fy> <fz>
armcell speed <0..1>
armcell fault drop <s> | freeze <s> | delay <s> | garbage <messages> | none
armcell pose <object>
armcell reset
{WORDS}
armcell messages"""


class DashboardServer:
    def __init__(
        self, robot: Robot, network: Network, host: str, external: ExternalControl, port: int = DASHBOARD_PORT
    ):
        self._robot, self._network, self._external = robot, network, external
        greet = f"{GREETING}\n".encode()
        self.port = network.listen(host, port, lambda link: link.send(greet), self._data, "dashboard")
        r = robot
        self._queries: dict[str, Callable[[], str]] = {
            "running": lambda: f"Program running: {str(r.runtime is RuntimeState.PLAYING).lower()}",
            "robotmode": lambda: f"Robotmode: {r.mode.name}",
            "safetymode": lambda: f"Safetymode: {r.safety.name}",
            "safetystatus": lambda: f"Safetystatus: {r.safety.name}",
            "programstate": self._program_state,
            "polyscopeversion": lambda: "URSoftware {}.{}.{}.{} (Nov 22 2026)".format(*r.model.version),
            "version": lambda: "{}.{}.{}.{}".format(*r.model.version),
            "get serial number": lambda: r.serial,
            "get robot model": lambda: r.model.dashboard_name,
            "get operational mode": lambda: "AUTOMATIC" if r.remote else "MANUAL",
            "get loaded program": lambda: (
                f"Loaded program: /programs/{NAME}" if external.loaded else "No program loaded"
            ),
            "isprogramsaved": lambda: "true unnamed",
        }  # fmt: skip
        self._acts: dict[str, Callable[[], str]] = {
            "play": lambda: "Starting program" if r.play() or external.play() else "Failed to execute: play",
            "stop": self._stop,
            "pause": lambda: "Pausing program" if r.pause() else "Failed to execute: pause",
            "power on": lambda: (r.power_on(), "Powering on")[1],
            "power off": lambda: (r.power_off(), "Powering off")[1],
            "brake release": lambda: (r.release_brakes(), "Brake releasing")[1],
            "unlock protective stop": lambda: (r.unlock(), "Protective stop releasing")[1],
            "restart safety": lambda: (r.power_off(), r.emergency_stop(False), "Restarting safety")[2],
            "close popup": lambda: "closing popup",
            "close safety popup": lambda: "closing safety popup",
        }

    def _data(self, link: TcpConnection) -> None:
        while b"\n" in link.received:
            line, _, rest = bytes(link.received).partition(b"\n")
            link.received[:] = rest
            text = line.decode("utf-8", "replace").strip()
            answer = self._answer(text)
            link.send(f"{answer}\n".encode())
            if text == "quit":
                link.close()
                return
        if len(link.received) > MAX_LINE:
            link.close()

    def _answer(self, text: str) -> str:
        command = text.lower()
        if command.startswith("armcell"):
            try:
                return self._own(command.split()[1:])
            except (ValueError, IndexError):
                return HELP.replace("\n", "; ")
        if command in self._queries:
            return self._queries[command]()
        if command == "is in remote control" and self._robot.model.e_series:
            return str(self._robot.remote).lower()
        if command in ("quit", "shutdown"):
            return "Disconnected" if command == "quit" else "Shutting down"
        if command.startswith(("popup ", "addtolog ")):
            return "showing popup" if command.startswith("popup") else "Added log message"
        if command in self._acts or command.startswith(("load ", "set operational mode ")):
            if not self._robot.accepts_remote_commands:
                return LOCAL_REFUSAL
            if command in self._acts:
                return self._acts[command]()
            name = text.split(maxsplit=1)[1]
            if not command.startswith("load "):
                return "Failed"
            return (
                "Loading program: " if self._external.load(name) else "Error while loading program: "
            ) + name
        return f"could not understand: '{text}'"

    def _program_state(self) -> str:
        state = {RuntimeState.PLAYING: "PLAYING", RuntimeState.RESUMING: "PLAYING",
                 RuntimeState.STOPPED: "STOPPED"}.get(self._robot.runtime, "PAUSED")  # fmt: skip
        return f"{state} {self._robot.program_name or (NAME if self._external.loaded else 'unnamed')}"

    def _stop(self) -> str:
        self._external.stop()
        self._robot.end_program()
        return "Stopped"

    def _own(self, words: list[str]) -> str:
        r, faults = self._robot, self._network.faults
        match words:
            case ["protective", "stop"]:
                r.protective_stop("by command")
            case ["safeguard", "stop" | "reset"]:
                r.safeguard_stop(words[1] == "stop")
            case ["emergency", "stop" | "release"]:
                r.emergency_stop(words[1] == "stop")
            case ["local" | "remote"]:
                r.remote = words[0] == "remote"
            case ["move", "joint", joint, angle]:
                q = np.array(r.plant.read()[0])
                q[int(joint)] += float(angle)
                r.displace(q)
                return f"moved {JOINTS[int(joint)]}"
            case ["push", *force]:
                r.hand = np.array([float(x) for x in force]).reshape(3)
            case ["speed", fraction]:
                r.slider = float(np.clip(float(fraction), 0.0, 1.0))
            case ["fault", "drop", seconds]:
                self._network.drop(float(seconds))
            case ["fault", "freeze", seconds]:
                faults.frozen_until = time.monotonic() + float(seconds)
            case ["fault", "delay", seconds]:
                faults.delay = float(seconds)
            case ["fault", "garbage", count]:
                faults.garbage = int(count) + 1  # plus 1, because the answer to this command counts
            case ["fault", "payload" | "offset" | "block" | "arm", *_]:
                r.plant = set_fault(r.plant, words[1:])
            case ["fault", "none"]:
                faults.delay, faults.garbage = 0.0, 0
            case ["reset"]:
                r.plant.reset()
                return "the arms and their world are back at their start"
            case ["pose", name]:
                return " ".join(f"{x:.6f}" for x in r.plant.object_pose(name))
            case ["messages"]:
                return " | ".join(r.messages[-20:])
            case _:
                raise ValueError
        return "done"


GRIPPER_PORT = 63352

MAX_GRIPPER_LINE = 1024


class GripperServer:
    def __init__(self, robot: Robot, network: Network, host: str, port: int = GRIPPER_PORT):
        self._robot = robot
        self._values = {"ACT": 0, "GTO": 0, "POS": 0, "SPE": 255, "FOR": 0, "ATR": 0, "ARD": 0}
        network.listen(host, port, lambda link: None, self._data, "gripper")

    def _data(self, link: TcpConnection) -> None:
        while b"\n" in link.received:
            line, _, rest = bytes(link.received).partition(b"\n")
            link.received[:] = rest
            link.send(f"{self._answer(line.decode('ascii', 'replace').split())}\n".encode())
        if len(link.received) > MAX_GRIPPER_LINE:
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
