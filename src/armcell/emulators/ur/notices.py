"""Events of an emulated controller that it logs and sends on the primary interface."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.drivers.ur.wire.modes import SafetyMode


@dataclass(frozen=True)
class TextMessage:
    """Notice from the emulated UR controller: a URScript program has sent a text message with `textmsg`."""

    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class ProgramState:
    """Notice from the emulated UR controller: a URScript program has started or ended."""

    started: bool
    name: str

    def __str__(self) -> str:
        return f"program {self.name!r} {'started' if self.started else 'ended'}"


@dataclass(frozen=True)
class ScriptFault:
    """Notice from the emulated UR controller: a URScript program did not compile, or an error ended it.

    Attributes:
        line, column: position in the script's text, from 1.
        code: text that a real controller sends, such as `compile_error_name_not_found:foo:`.
    """

    text: str
    line: int
    column: int
    code: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Popup:
    """Notice from the emulated UR controller: the teach pendant shows a popup message."""

    text: str
    title: str = "Popup"
    warning: bool = False
    error: bool = False

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class SafetyChange:
    """Notice from the emulated UR controller: the safety mode has changed."""

    mode: SafetyMode

    def __str__(self) -> str:
        return f"safety mode {self.mode.name}"


Notice = TextMessage | ProgramState | ScriptFault | Popup | SafetyChange
