"""The attribute `params` of a macro: `name`, `name:=default`, `name:=^`, `name:=^|default`, `*block`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from armcell.model.xacro.budget import XacroError

MAX_PARAMETERS = 10_000  # characters
# Every alternative is one character or one quoted text, so that no text takes long to match.
_WITH_DEFAULT = re.compile(
    r"\s*(?P<name>[^\s:=]+)\s*:?=\s*(?P<forward>\^\|?)?"
    r"(?P<default>\$\{.*?\}(?=\s|$)|\$\(.*?\)(?=\s|$)|(?:'[^']*'|\"[^\"]*\"|[^\s'\"])*)(?=\s|$)"
)
_NAME = re.compile(r"\s*(?P<name>\S+)")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a macro.

    Attributes:
        default: text to evaluate in the caller's scope; None: the parameter must be given.
        forwarded: takes the caller's property of the same name if there is one.
    """

    name: str
    default: str | None = None
    forwarded: bool = False

    @property
    def is_block(self) -> bool:
        return self.name.startswith("*")


def parameters_of(text: str) -> tuple[Parameter, ...]:
    """Return the parameters that a macro declares.

    Raises:
        XacroError: the text is too long.
    """
    if len(text) > MAX_PARAMETERS:
        raise XacroError(f"params has more than {MAX_PARAMETERS:,} characters")
    found, at = [], 0
    while text[at:].strip():
        given = _WITH_DEFAULT.match(text, at)
        token = given or _NAME.match(text, at)
        assert token is not None  # there is a character that is not white
        at = token.end()
        if given is None:
            found.append(Parameter(token["name"]))
        else:
            found.append(Parameter(given["name"], given["default"] or None, given["forward"] is not None))
    return tuple(found)
