"""Parser for the `params` attribute of a xacro macro.

The supported forms are `name`, `name:=default`, `name:=^`, `name:=^|default` and `*block`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from armcell.model.xacro.budget import XacroError

MAX_PARAMETERS = 10_000  # characters
# Every alternative is one character or one quoted text, so matching never backtracks for long.
_WITH_DEFAULT = re.compile(
    r"\s*(?P<name>[^\s:=]+)\s*:?=\s*(?P<forward>\^\|?)?"
    r"(?P<default>\$\{.*?\}(?=\s|$)|\$\(.*?\)(?=\s|$)|(?:'[^']*'|\"[^\"]*\"|[^\s'\"])*)(?=\s|$)"
)
_NAME = re.compile(r"\s*(?P<name>\S+)")


@dataclass(frozen=True)
class Parameter:
    """Parameter in `params` of a xacro macro, with its default value.

    Attributes:
        name: name of the parameter; a block parameter's name starts with `*`.
        default: text that is evaluated in the caller's scope. None: the caller must pass the parameter.
        forwarded: whether the parameter takes the caller's property of the same name, if it exists.
    """

    name: str
    default: str | None = None
    forwarded: bool = False

    @property
    def is_block(self) -> bool:
        return self.name.startswith("*")


def parameters_of(text: str) -> tuple[Parameter, ...]:
    """Parse the parameters that the attribute `params` of a xacro macro declares.

    Raises:
        XacroError: the text is too long.
    """
    if len(text) > MAX_PARAMETERS:
        raise XacroError(f"params has more than {MAX_PARAMETERS:,} characters")
    found, at = [], 0
    while text[at:].strip():
        given = _WITH_DEFAULT.match(text, at)
        token = given or _NAME.match(text, at)
        assert token is not None  # the loop condition guarantees a character that is not white space
        at = token.end()
        if given is None:
            found.append(Parameter(token["name"]))
        else:
            found.append(Parameter(given["name"], given["default"] or None, given["forward"] is not None))
    return tuple(found)
