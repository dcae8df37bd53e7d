"""Setpoint sources for the executor: streaming, playback by the robot, coupled arms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from armcell.core import ErrorCode, JointTrajectory, Outcome, Playback
from armcell.drivers import Capability, Driver, ExecutionHandle
from armcell.drivers.motion_guard import ExecutionMonitor
from armcell.execution.settings import ExecutionSettings

Array = NDArray[np.float64]
Correction = Callable[[float, Array, Array], tuple[Array, Array]]

PLAYED_AT_ONCE = 0.05  # [s] of trajectory that a driver plays per call, so also between two checks for a stop
LAG = 0.06  # [s] largest lag of the measured state behind the clock of a trajectory that the robot plays
CANCEL_TIME = 2.0  # [s] time limit for a canceled robot to come to rest
AT_REST = 0.005  # [rad/s] speed below which a canceled robot rests
CATCH_UP = 4  # driver periods of a real robot that one setpoint can catch up
SCALING_RATE = 2.0  # [1/s] limit on the speed scaling's rate: a pause brakes within half a second


class SetpointSource(ABC):
    """Base class of the setpoint sources. An instance sends the setpoints of one motion to a driver.

    The executor calls `start` once, then for each driver period `send`, `tracking_error` and `ended`.

    Attributes:
        blends: True if the source can add the remaining motion of an arm that is not at rest.
        columns: (n,) indices of the trajectory's joints in the driver's joint state.
        clock: time on the trajectory [s] of the latest setpoint.
        goal: (n,) position [rad or m] at which the arm must come to rest.
        complete: True once the last setpoint is sent; the arm then has the settling time to come to rest.
        over: True if the robot itself has ended the motion, so that it needs no stop.
    """

    blends = False

    def __init__(self, driver: Driver, trajectory: JointTrajectory, settings: ExecutionSettings):
        self.driver, self.trajectory, self.settings = driver, trajectory, settings
        self.names, self.duration = trajectory.joint_names, trajectory.duration
        self.columns = np.array(driver.joint_state().columns(self.names), dtype=int)
        self.clock, self.goal = 0.0, cast(Array, trajectory.positions[-1])
        self.complete = self.over = False
        self._completed_at: float | None = None  # [s]

    def start(self, blend: JointTrajectory | None) -> Outcome | None:
        """Start sending the setpoints of a motion. Return a result if the motion ends at once, else None.

        Args:
            blend: offset to add to the setpoints, for a source that `blends`; None for an arm at rest.
        """
        return None

    @abstractmethod
    def send(self) -> bool:
        """Send the next setpoint of a motion. Return False if the driver has already advanced its clock."""

    @abstractmethod
    def tracking_error(self) -> tuple[float, int] | None:
        """Return the largest deviation [rad or m] of a joint from its setpoint, and the index of the joint.
        Return None when only the goal tolerance applies, such as after the last setpoint.
        """

    def ended(self) -> Outcome | None:
        """Return the outcome if the setpoint source reports that the motion has ended, for example because
        the robot aborted it. Return None while the motion may continue.
        """
        return None

    def settling_time(self) -> float:
        """Return the time [s] that has passed since the last setpoint of the motion was sent."""
        if self._completed_at is None:
            self._completed_at = self.driver.now
        return self.driver.now - self._completed_at

    def cancel(self) -> None:
        """Cancel the setpoints of a motion: the robot discards those that it has already received."""
        return None

    def halted(self) -> bool:
        """Return whether the arm has come to rest after its setpoints were canceled.
        The executor waits until it has.
        """
        return True

    def end(self, outcome: Outcome) -> None:
        """Finish the monitoring that the setpoint source has started for a motion. `outcome` is the result of
        the motion.
        """
        return None


class StreamedSetpoints(SetpointSource):
    """Setpoint source that streams one setpoint to the robot in each period of the driver's clock.

    Args:
        plays: True if the driver plays parts of the trajectory itself, which advances its clock; False to
            command every period.
    """

    blends = True

    def __init__(
        self,
        driver: Driver,
        trajectory: JointTrajectory,
        settings: ExecutionSettings,
        plays: bool = False,
    ):
        super().__init__(driver, trajectory, settings)
        self._plays, self._playback = plays, Playback(trajectory)
        self._began, self._blend = driver.now, None
        self._sent: Array | None = None  # last setpoint (n,) on the trajectory
        self._played = 0.0, 0  # result of the last `play`

    def start(self, blend: JointTrajectory | None) -> Outcome | None:
        self._began, self._blend = self.driver.now, blend
        if blend is not None:
            self._plays = False
        self._look_at_clock()
        if self.complete:  # a trajectory of one point
            self._hold_goal()
        return None

    def send(self) -> bool:
        driver, t = self.driver, self.driver.now - self._began
        self._sent = None
        if self.complete:
            self._hold_goal()
            return True
        if self._plays:
            self.clock, tolerance = min(t + PLAYED_AT_ONCE, self.duration), self.settings.path_tolerance
            self._played = driver.play(self.names, self._playback, self._began, self.clock, tolerance)
            return False
        self.clock = min(t + driver.period, self.duration)
        q, v = self._playback.at(self.clock)
        if self._blend is not None:
            offset, offset_speed, _ = self._blend.sample(t + driver.period)
            q, v = q + offset, v + offset_speed
        driver.command(self.names, q, v)
        self._sent = q
        return True

    def tracking_error(self) -> tuple[float, int] | None:
        settling = self.complete
        self._look_at_clock()
        if settling:
            return None
        if self._sent is None:
            return self._played
        return largest(np.abs(self.driver.joint_state().positions[self.columns] - self._sent))

    def settling_time(self) -> float:
        return self.driver.now - self._began - self.duration

    def _look_at_clock(self) -> None:
        self.complete = not self.driver.now - self._began < self.duration - 1e-9

    def _hold_goal(self) -> None:
        self.driver.command(self.names, self.goal, np.zeros(len(self.names)))


class RobotPlayback(SetpointSource):
    """Setpoint source for robots that receive a whole trajectory and play it back on their own clock.

    The executor monitors the robot's progress.
    """

    def __init__(self, driver: Driver, trajectory: JointTrajectory, settings: ExecutionSettings):
        super().__init__(driver, trajectory, settings)
        self._first = float(trajectory.times[0])
        self._handle: ExecutionHandle | None = None
        self._furthest = 0.0  # [s] on the trajectory
        self._advanced_at = driver.now  # [s] of the last progress

    def start(self, blend: JointTrajectory | None) -> Outcome | None:
        if self.duration <= 0.0:  # the arm is at the goal: the start check has passed
            return Outcome(ErrorCode.SUCCESS)
        return None

    def send(self) -> bool:
        if self._handle is None:
            self._advanced_at = self.driver.now
            self._handle = self.driver.follow(self.trajectory)
        return True

    def tracking_error(self) -> tuple[float, int] | None:
        handle = self._playing()
        t = handle.trajectory_time()
        if t is None:
            self.clock = min(self.driver.now - self._advanced_at, self.duration)
            return None
        self.clock = t
        if t > self._furthest or handle.paused():
            self._furthest, self._advanced_at = max(t, self._furthest), self.driver.now
        q = self.driver.joint_state().positions[self.columns]
        lags = (0.0, LAG / 2, LAG)
        planned = [self.trajectory.sample(self._first + max(t - lag, 0.0))[0] for lag in lags]
        return largest(np.min(np.abs(q - np.array(planned)), axis=0))

    def ended(self) -> Outcome | None:
        state = self._playing().state()
        if isinstance(state, Outcome):
            self.over = True
            return state
        self.complete = state == "done"
        stalled = self.driver.now - self._advanced_at > self.settings.stall_time
        if state == "running" and stalled and self._playing().trajectory_time() is not None:
            text = (
                f"no progress for {self.settings.stall_time:g} s at {self.clock:.2f} of {self.duration:.2f} s"
            )
            return Outcome(ErrorCode.TIMED_OUT, text)
        if state not in ("running", "done"):
            return Outcome(ErrorCode.CONTROL_FAILED, f"the robot ended the trajectory: {state}")
        return None

    def cancel(self) -> None:
        if self._handle is not None and self._handle.state() == "running":
            self._handle.cancel()

    def halted(self) -> bool:
        if self._handle is None:
            return True
        state = self._handle.state()
        self.over = isinstance(state, Outcome)
        return self.over or (state != "running" and max_speed(self.driver, self.columns) < AT_REST)

    def _playing(self) -> ExecutionHandle:
        if self._handle is None:
            raise RuntimeError("the robot has no trajectory yet")
        return self._handle


class CoupledSetpoints(SetpointSource):
    """Setpoint source for several coupled arms on a common clock.
    The speed of the clock follows the slowest arm.

    Args:
        correct: maps the trajectory time [s] and the setpoints q, v, each (n,), to the setpoints to send.
        watch: called after every setpoint; a failure that it returns stops all arms.
        scalings: returns each arm's allowed speed fraction, 0..1; the smallest one slows the common clock.
            By default, the speed fraction that the driver reports for sliders and pauses, if it reports one.
    """

    def __init__(
        self,
        driver: Driver,
        trajectory: JointTrajectory,
        settings: ExecutionSettings,
        correct: Correction | None = None,
        watch: Callable[[], Outcome | None] | None = None,
        scalings: Callable[[], tuple[float, ...]] | None = None,
    ):
        super().__init__(driver, trajectory, settings)
        self._correct, self._watch, self._scalings = correct, watch, scalings
        self._has_clock = Capability.ROBOT_CLOCK in driver.capabilities
        self._playback = Playback(trajectory)
        self._scale, self._tick = 1.0, 0.0
        self._recent = _RecentSetpoints(driver.latency if self._has_clock else 0.0)
        self._monitor: ExecutionMonitor | None = None  # compares the arms with the dry run

    def start(self, blend: JointTrajectory | None) -> Outcome | None:
        if Capability.DRY_RUN in self.driver.capabilities:
            self._monitor = self.driver.monitor_execution(self.trajectory, self._correct is not None)
        if self._has_clock:
            self._tick = self.driver.next_command_time
        return None

    def send(self) -> bool:
        scale = self._advance_clock()
        planned, v = self._playback.at(self.clock)
        q, v = planned, v * scale
        if self._correct is not None:
            q, v = self._correct(self.clock, q, v)
        self.driver.command(self.names, q, v)
        if self._monitor is not None:
            self._monitor.record_setpoint(self.clock, q - planned)
        self.goal = q
        return True

    def tracking_error(self) -> tuple[float, int] | None:
        if self._monitor is not None:
            self._monitor.check()
        self.complete = not self.clock < self.duration
        q = self.driver.joint_state().positions[self.columns]
        return largest(np.abs(q - self._recent.nearest(q, self.goal, self.driver.now)))

    def ended(self) -> Outcome | None:
        return None if self._watch is None else self._watch()

    def end(self, outcome: Outcome) -> None:
        if self._monitor is not None:
            self._monitor.end("done" if outcome.ok else outcome.message)

    def _advance_clock(self) -> float:
        """Advance the common clock of coupled arms by one setpoint period. Return the factor by which the
        clock is slowed at present.
        """
        period = self.driver.period
        scale = min(
            max(self._allowed_speed(), self._scale - SCALING_RATE * period),
            self._scale + SCALING_RATE * period,
        )
        passed = period
        if self._has_clock:  # real time passes on its own: a late program must not cause a jump
            tick = self.driver.next_command_time
            passed, self._tick = min(tick - self._tick, CATCH_UP * period), tick
        self.clock, self._scale = min(self.clock + scale * passed, self.duration), scale
        return scale

    def _allowed_speed(self) -> float:
        """Return the speed fraction (0 to 1) at which the setpoints of coupled arms may advance. Speed
        sliders, pauses and the caller limit it.
        """
        if self._scalings is not None:
            fraction = min(self._scalings())
        elif self._has_clock:
            fraction = self.driver.speed_fraction
        else:
            return 1.0
        return min(max(float(fraction), 0.0), 1.0)


class _RecentSetpoints:
    """Setpoints sent in the last `latency` seconds.
    They are kept because a real robot lags behind the newest setpoint.
    """

    def __init__(self, latency: float):
        self._latency = latency
        self._kept: deque[tuple[float, Array]] = deque()

    def nearest(self, measured: Array, q: Array, now: float) -> Array:
        """Return the setpoint (n,) from the recent ones that is nearest to the measured position.

        Args:
            measured: measured joint positions (n,) [rad or m].
            q: newest setpoint (n,), added to the history first.
            now: driver time [s].
        """
        self._kept.append((now, q))
        while self._kept[0][0] < now - self._latency:
            self._kept.popleft()
        if len(self._kept) == 1:
            return q
        return min((q for _, q in self._kept), key=lambda q: float(np.abs(measured - q).max()))


def largest(errors: Array) -> tuple[float, int]:
    """Return the largest of several setpoint errors (n,) and its index, or (0, 0) if there are no joints."""
    if len(errors) == 0:
        return 0.0, 0
    i = int(errors.argmax())
    return errors.item(i), i


def max_speed(driver: Driver, columns: NDArray[np.int64]) -> float:
    """Return the largest measured speed [rad/s or m/s] of the joints that receive setpoints, or 0 if the
    robot measures no speed.
    """
    v = driver.joint_state().velocities
    return 0.0 if v is None else float(np.max(np.abs(v[columns]), initial=0.0))
