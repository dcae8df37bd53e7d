"""How text becomes the program that runs on an emulated robot."""

from __future__ import annotations

from armcell.control.ur_controller.builtins import motion_functions, value_functions
from armcell.control.ur_controller.network import Network
from armcell.control.ur_controller.robot import Robot
from armcell.control.ur_controller.sockets import socket_functions
from armcell.control.ur_controller.urscript import Machine, ScriptError


def run_script(robot: Robot, network: Network, text: str, name: str = "") -> bool:
    """End what runs and start this URScript; a text that is none goes to the log, as on a pendant.

    Args:
        name: of the program, instead of its own.
    """
    robot.end_program()
    waiting, instant = socket_functions(robot, network)
    try:
        machine = Machine(text, motion_functions(robot) | waiting, value_functions(robot) | instant)
    except (ScriptError, SyntaxError, RecursionError) as error:
        robot.popup(f"script error: {error}")
        return False
    machine.name = name or machine.name
    robot.run(machine)
    return robot.machine is machine
