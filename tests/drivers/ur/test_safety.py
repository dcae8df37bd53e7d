"""Stops at random instants while two emulated arms move: judged by what the emulator itself wrote down."""

import time

import numpy as np
import pytest
from benchmarks.ur_stops import STOPS, spoilt
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts
from tests.drivers.ur.rig import MOVE, swing, two_arms
from tests.execution.ungated import execute

from armcell.core import InputError
from armcell.drivers.safety import Fault, Supervisor
from armcell.emulators.ur.controller import TRACE

# Here a plain sleep of 2 ms takes up to 75 ms now and then: the default age of 50 ms would stop the arms by
# itself. In the tests it is 150 ms, and a start that the machine spoils all the same is made again.
LIMITS = {"max_state_age": 0.15, "watchdog": 0.15}
TO_REST = 0.3  # [s]
MAX_STEP = 0.02  # [rad] per control period


def read_trace(path):
    """By arm: monotonic time (n,), the robot's own time (n,), actual positions (n, 6)."""
    data = path.read_bytes()
    lines = np.array(list(TRACE.iter_unpack(data[: len(data) // TRACE.size * TRACE.size])))
    return {
        arm: (lines[lines[:, 0] == arm, 1], lines[lines[:, 0] == arm, 2], lines[lines[:, 0] == arm, 3:9])
        for arm in (0, 1)
    }


def moving(driver, plans, seconds: float) -> None:
    """Have all plans under way, for so long."""
    for _ in range(5):
        running = [driver.follow(plan) for plan in plans]
        time.sleep(seconds)
        if all(r.state() == "running" for r in running):
            return
        assert spoilt(driver), [r.state() for r in running]
        plans = [
            swing(driver, plan.joint_names, plan.positions[-1] - plan.positions[0], 3.0) for plan in plans
        ]
    raise AssertionError("the machine is too busy for this test")


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("together", [False, True], ids=["forwarded", "streamed"])
def test_both_arms_rest_after_any_stop(tmp_path, together):
    rng = np.random.default_rng(7)
    hosts, trace = free_hosts(2), tmp_path / "trace"
    with emulator("--trace", str(trace), hosts=hosts), two_arms(hosts, **LIMITS) as driver:
        left, right = driver.arms.values()
        moments = []
        for stop, undo in STOPS.items():
            if together:
                joints = [*left.joint_names, *right.joint_names]
                plans = [swing(driver, joints, [*MOVE, *-MOVE], 3.0)]
            else:
                plans = [swing(driver, arm.joint_names, MOVE, 3.0) for arm in (left, right)]
            moving(driver, plans, float(rng.uniform(0.4, 2.0)))
            victim = hosts[int(rng.integers(2))]
            dashboard(victim, f"armcell {stop}")
            at = time.monotonic()
            time.sleep(1.5)
            assert driver.fault() is not None, stop
            with pytest.raises(InputError, match="no motion after a stop"):
                driver.follow(plans[0])
            moments.append((stop, at, time.monotonic()))
            if undo:
                dashboard(victim, *undo)
                time.sleep(0.8)
            driver.resume()
            assert driver.fault() is None
            for _ in range(4):
                result = execute(driver, swing(driver, left.joint_names, -0.3 * MOVE, 1.0))
                if result.ok or not spoilt(driver):
                    break
            assert result.ok, f"after {stop}: {result.message}"
        kinds = [e.kind for e in driver.safety_events]
    assert kinds.count("peer stopped") == kinds.count("resumed") >= len(STOPS)
    assert {"protective stop", "safeguard stop", "emergency stop"} <= set(kinds)
    assert {"link lost", "program ended"} & set(kinds)  # a broken link is seen by whichever is read first
    assert "stale state" in kinds
    for arm, (wall, t, q) in read_trace(trace).items():
        assert np.abs(np.diff(q, axis=0)).max() <= MAX_STEP, f"arm {arm} jumped"
        for stop, at, until in moments:
            still = q[(t > np.interp(at, wall, t) + TO_REST) & (wall < until)]
            assert len(still) > 50 and np.ptp(still, axis=0).max() < 1e-3, f"arm {arm} moved after {stop}"


class Part:
    """An arm that says what it is told to."""

    def __init__(self, name):
        self.name, self.wrong, self.halted = name, "", 0

    def fault(self):
        return Fault(self.name, self.wrong, self.wrong, "mend it") if self.wrong else None

    def halt(self):
        self.halted += 1


def test_one_fault_stops_all_and_only_clear_ends_it():
    left, right = Part("left"), Part("right")
    supervisor = Supervisor({"left": left, "right": right})
    assert supervisor.check() is None
    right.wrong = "tracking error"
    for _ in range(3):
        assert supervisor.check().arm == "right"
    assert (left.halted, right.halted) == (1, 1)
    with pytest.raises(
        InputError, match=r"cannot resume: right: tracking error \(mend it; then call resume\(\) again\)"
    ):
        supervisor.clear()
    right.wrong = ""
    assert supervisor.check() is not None  # gone, and still stopped
    supervisor.clear()
    assert supervisor.check() is None
    assert [e.kind for e in supervisor.events] == ["tracking error", "peer stopped", "resumed"]
    assert all(e.wall > 1.7e9 for e in supervisor.events)
