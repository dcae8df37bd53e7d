"""URScript interpreter: parses scripts, compiles them to Python generators and steps them."""

from armcell.emulators.ur.urscript.interpreter import Machine, ProgramError
from armcell.emulators.ur.urscript.parser import ScriptError, parse

__all__ = ["Machine", "ProgramError", "ScriptError", "parse"]
