"""URScript: read, compiled to Python generators, and run a control step at a time."""

from armcell.control.ur_controller.urscript.machine import Machine, ProgramError
from armcell.control.ur_controller.urscript.parser import ScriptError, parse

__all__ = ["Machine", "ProgramError", "ScriptError", "parse"]
