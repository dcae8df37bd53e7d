"""URScript interpreter: parses scripts, compiles them to Python generators, and steps them."""

from armcell.control.ur_controller.urscript.machine import Machine, ProgramError
from armcell.control.ur_controller.urscript.parser import ScriptError, parse

__all__ = ["Machine", "ProgramError", "ScriptError", "parse"]
