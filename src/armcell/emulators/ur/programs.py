"""Execution of programs and commands that clients send to an emulated UR robot as text."""

from __future__ import annotations

from collections.abc import Callable

from armcell.emulators.network import Network
from armcell.emulators.ur.builtins import motion_functions, value_functions
from armcell.emulators.ur.builtins_io import DigitalOutputs
from armcell.emulators.ur.builtins_socket import socket_functions
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.urscript import Machine, ScriptError


def run_command(robot: Robot, text: str) -> bool:
    """Execute a client's text command to the emulated UR robot that is not URScript, such as `stop program`.

    Returns:
        False if the text is not a command.
    """
    commands: dict[str, Callable[[], object]] = {
        "stop program": robot.end_program,
        "pause program": robot.pause,
        "resume program": robot.play,
        "power on": robot.power_on,
        "power off": robot.power_off,
        "set robotmode run": robot.release_brakes,
        "set robotmode powerdown": robot.power_off,
        "set unlock protective stop": robot.unlock,
        "set sim": lambda: None,
        "set real": lambda: None,
    }
    command = commands.get(" ".join(text.split()))
    if command is None:
        return False
    command()
    return True


def run_script(robot: Robot, network: Network, text: str, name: str = "") -> bool:
    """Compile a URScript program from a client, and start it on the
    emulated UR robot in place of the running program.

    A secondary program runs beside the running program. If the text does not compile, the robot reports the
    error as a pendant does, and the running program ends as well.

    Args:
        name: program name that overrides the name in the text.
    Returns:
        Whether the program started.
    """
    waiting, instant, close_sockets = socket_functions(robot, network)
    try:
        machine = Machine(text, motion_functions(robot) | waiting, value_functions(robot) | instant)
    except (ScriptError, SyntaxError, RecursionError) as error:
        robot.end_program()
        robot.report_program_error(error if isinstance(error, ScriptError) else ScriptError(str(error)))
        return False
    if machine.secondary:
        robot.run_secondary(machine)
        close_sockets()
        return True
    machine.variables["digital_out"] = DigitalOutputs(robot)
    machine.name = name or machine.name
    robot.run(machine)
    robot.on_program_end(close_sockets)
    return robot.machine is machine
