"""Wrong values in all places of the public API: only errors of the project, no crash, no long wait."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from tests.misuse.calls import findings

SHARDS = 2
CALLS = 15_000


@pytest.mark.slow
def test_no_wrong_value_gets_past_the_checks():
    """NaN, infinity, huge and empty values, wrong shapes and types, one wrong argument a call.

    A value of another Python type may raise Python's own error for it (`calls.WRONG_TYPE`), but not from
    compiled code. A crash names the callable; no call may take longer than `calls.LONGEST`.
    """
    with ThreadPoolExecutor(SHARDS) as threads:
        lines = [
            line
            for found in threads.map(lambda k: list(findings(k, SHARDS)), range(SHARDS))
            for line in found
        ]
    faults = [line for line in lines if "fault" in line]
    assert not faults, "\n".join(map(str, faults))
    assert sum(line.get("calls", 0) for line in lines) >= CALLS
