"""Linear task scripts: `checked` turns a failed outcome into an exception with its reason."""

from __future__ import annotations

from typing import TypeVar

from armcell.core import ArmcellError, Outcome

Some = TypeVar("Some", bound=Outcome)


class TaskFailed(ArmcellError):
    """Failed step of a task script; `outcome` has the code, message and evidence."""

    def __init__(self, outcome: Outcome):
        super().__init__(outcome.message or outcome.code.name)
        self.outcome = outcome


def checked(outcome: Some) -> Some:
    """Return the outcome if it is a success.

    Raises:
        TaskFailed: the outcome is a failure.
    """
    if not outcome.ok:
        raise TaskFailed(outcome)
    return outcome
