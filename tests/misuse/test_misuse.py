"""Wrong values in all places of the public API: only errors of the project, no crash, no long wait."""

import pytest
from tests.misuse.calls import findings

CALLS = 15_000


@pytest.mark.slow
def test_no_wrong_value_gets_past_the_checks():
    """NaN, infinity, huge and empty values, wrong shapes and types, one wrong argument a call.

    A value of another Python type may raise Python's own error for it (`calls.WRONG_TYPE`), but not from
    compiled code. A crash names the callable; no call may take longer than `calls.LONGEST`.
    """
    lines = list(findings(0, 1))
    faults = [line for line in lines if "fault" in line]
    assert not faults, "\n".join(map(str, faults))
    assert sum(line.get("calls", 0) for line in lines) >= CALLS
