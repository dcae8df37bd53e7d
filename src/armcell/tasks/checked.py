"""Scripts that read top to bottom: an outcome that failed ends them, with its reason."""

from __future__ import annotations

from typing import TypeVar

from armcell.core import ArmcellError, Outcome

Some = TypeVar("Some", bound=Outcome)


class TaskFailed(ArmcellError):
    """A step failed; `outcome` has code, message and evidence."""

    def __init__(self, outcome: Outcome):
        super().__init__(outcome.message or outcome.code.name)
        self.outcome = outcome


def checked(outcome: Some) -> Some:
    """The outcome, if it succeeded.

    Raises:
        TaskFailed: it did not.
    """
    if not outcome.ok:
        raise TaskFailed(outcome)
    return outcome
