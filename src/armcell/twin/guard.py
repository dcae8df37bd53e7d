"""The twin guard: refuses motions that collide in simulation and stops deviating arms.

An arm that deviates from its simulated twin is first slowed, then stopped.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, InputError, JointState, JointTrajectory, Outcome
from armcell.drivers.execution_handle import ExecutionHandle, SetpointHistory
from armcell.drivers.motion_guard import GuardedArm
from armcell.drivers.safety import Fault
from armcell.twin.dry_run import DryRun, TwinSimulation
from armcell.twin.residual_thresholds import (
    LASTING,
    SMOOTHED,
    ArmResidualThresholds,
    ResidualThresholds,
    TwinSample,
)

Array = NDArray[np.float64]

SLOW_AFTER, STOP_AFTER = LASTING, 12
"""Consecutive samples outside a band after which the guard slows the arms, and after which it stops them."""
UNWATCHED = "motions are rehearsed, but not compared with the twin while they run: it has no bands yet"
FAR = 3.0  # residual, in bands, at which the guard stops the arms instead of slowing them
SLOW = 0.25  # speed fraction of slowed arms
LATE = 0.02  # [s] largest clock error of a streamed motion
STEADY = 0.002  # largest change of the speed scaling between two samples of constant speed


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Recorded motion of an arm, and the dry run of the same motion in the simulated twin, from which the
    twin guard learns its thresholds.
    """

    arm: str
    twin: DryRun
    columns: tuple[int, ...]
    seen: list[TwinSample]


class TwinGuard:
    """Guard that compares the moving arms of a driver with their simulated twin.

    Args:
        simulation: simulation in which motions are dry-run.
        bands: residual thresholds; None: motions are dry-run but not compared while they run.
        learning: True to keep the samples in `motions`, to learn thresholds from them.
        note: called with (arm name, kind, text) for each action of the guard; the run's record shows the
            text.
    """

    def __init__(
        self, simulation: TwinSimulation, bands: ResidualThresholds | None = None, learning: bool = False,
        note: Callable[[str, str, str], None] = lambda arm, kind, text: None,
    ):  # fmt: skip
        self.simulation, self.bands, self.learning, self.note = simulation, bands, learning, note
        self.trips: Mapping[str, Callable[[], float]] = {}  # shortest recent round trip [s], by arm
        self.motions: list[RecordedMotion] = []
        self._twin: DryRun | None = None
        self._rehearsed: JointTrajectory | None = None
        self._said = learning  # whether the UNWATCHED note was issued

    @property
    def compares(self) -> bool:
        return self.bands is not None

    def check_calibration(self, found: Mapping[str, str]) -> None:
        """Check that the twin guard's thresholds were learned with the calibration of the connected robots.

        Args:
            found: arm name to the checksum of its calibration.
        Raises:
            InputError: the thresholds were learned on another robot or before a new calibration.
        """
        for arm, now in found.items():
            then = None if self.bands is None else self.bands.identity.get(f"calibration.{arm}")
            if then not in (None, now):
                raise InputError(
                    f"{arm}: the twin's bands were learned on calibration {then}, this robot has {now}",
                    hint="learn them again, which begins with a slow loop: armcell twin CELL",
                )

    def dry_run(
        self,
        trajectory: JointTrajectory,
        state: JointState,
        poses: Mapping[str, SE3],
        held: Mapping[str, str],
    ) -> Outcome | None:
        """Let the twin guard dry-run a trajectory in the simulated twin before the real arm executes it.
        Return the reason not to execute it, or None.

        Args:
            state: measured joint state at the start.
            poses: T_world_object of the movable objects.
            held: held objects and their grippers.
        """
        self._rehearsed = trajectory
        self._twin = self.simulation.play(trajectory, state, poses, held)
        outcome = self._twin.outcome
        if outcome.ok:
            return None
        self.note("all", "twin refused", outcome.message)
        return Outcome(
            outcome.code, f"the twin refuses it: {outcome.message}", {**outcome.evidence, "twin": True}
        )

    def monitor(
        self, following: ExecutionHandle, trajectory: JointTrajectory, arms: Iterable[GuardedArm],
        trip: Callable[[Fault], None], sent_for: SetpointHistory | None = None, forced: bool = False,
    ) -> ExecutionHandle:  # fmt: skip
        """Wrap the handle of a running motion, so that the twin guard compares the
        real arms with their simulated twin whenever the executor reads the handle.

        Args:
            following: handle of the running motion.
            arms: arms that execute the motion.
            trip: called with the fault that stops the arms.
            sent_for: setpoint history of a streamed motion; None: the robot plays the trajectory and reports
                its own clock.
            forced: True if measured forces modify the motion, so that currents and speeds are not compared.
        """
        twin = self._twin
        if twin is None or trajectory is not self._rehearsed:
            return following
        if self.bands is None and not self._said:
            self._said = True
            self.note("all", "twin", UNWATCHED)
        return MonitoredExecution(self, following, twin, list(arms), trip, sent_for, forced)


class MonitoredExecution:
    """Execution handle with which the twin guard monitors a running motion: it compares each real arm with
    its simulated twin, and slows or stops the arms if one deviates.

    All calls are forwarded to the handle of the running motion.
    """

    def __init__(
        self, guard: TwinGuard, following: ExecutionHandle, twin: DryRun, arms: list[GuardedArm],
        trip: Callable[[Fault], None], sent_for: SetpointHistory | None, forced: bool,
    ):  # fmt: skip
        self._guard, self._following, self._twin, self._arms, self._trip = guard, following, twin, arms, trip
        self._sent_for, self._forced = sent_for, forced
        names = twin.joint_names
        self._columns = {arm.name: tuple(names.index(n) for n in arm.joint_names) for arm in arms}
        self._kept = {arm.name: RecordedMotion(arm.name, twin, self._columns[arm.name], []) for arm in arms}
        if guard.learning:
            guard.motions.extend(self._kept.values())
        self._outside = dict.fromkeys(self._columns, 0)
        self._doubt: dict[str, tuple[str, str]] = dict.fromkeys(
            self._columns, ("", "")
        )  # kind and text of the last sample outside a band
        self._worst: dict[str, tuple[float, str]] = dict.fromkeys(self._columns, (0.0, ""))
        self._load = dict.fromkeys(self._columns, 0.0)  # [kg] largest estimate
        self._currents = {name: deque[np.ndarray](maxlen=SMOOTHED) for name in self._columns}
        self._scaling: dict[str, float] = {}  # at the last sample
        self._before: dict[str, float] = {}  # slider values before slowing
        self._stopped = self._told = False

    def trajectory_time(self) -> float | None:
        t = self._following.trajectory_time()
        if t is not None and t > 0.0 and self._following.state() == "running":
            for arm in self._arms:
                self._look(arm, t)
        return t

    def state(self) -> str | Outcome:
        found = self._following.state()
        if found != "running" and not self._told:
            self._told = True
            self._end(str(found))
        return found

    def paused(self) -> bool:
        return self._following.paused()

    def cancel(self) -> None:
        self._following.cancel()

    # --- comparison with the twin ---
    def _look(self, arm: GuardedArm, t: float) -> None:
        sample, scaling = arm.sample(), arm.speed_scaling
        q, v, current = sample.positions, sample.velocities, sample.efforts
        if self._sent_for is None:  # the robot plays the trajectory: its measurement contains its clock
            clock = sample.clock
        else:
            clock, off = self._sent_for.at(arm.time_of_state)
            q = q if off is None else q - off[list(self._columns[arm.name])]
        if scaling <= 0.0 or clock <= 0.0 or (self._sent_for is None and abs(clock - t) > 0.2):
            return
        trip = self._guard.trips.get(arm.name, lambda: math.nan)()
        steady = abs(scaling - self._scaling.get(arm.name, 1.0)) < STEADY and not self._forced
        self._scaling[arm.name] = scaling
        seen = TwinSample(
            clock, scaling, q, v, current, trip, steady, 0.0 if self._sent_for is None else LATE
        )
        bands = self._guard.bands
        if bands is None:
            self._kept[arm.name].seen.append(seen)
        elif arm.name in bands.arms:
            self._judge(arm, seen, bands.arms[arm.name])

    def _judge(self, arm: GuardedArm, seen: TwinSample, bands: ArmResidualThresholds) -> None:
        found = bands.residuals(seen, self._twin, self._columns[arm.name], self._currents[arm.name])
        kind, ratio, text = self._worst_of(found, arm, bands)
        self._worst[arm.name] = max(self._worst[arm.name], (ratio, text))
        doubted, before = self._doubt[arm.name]
        if ratio > 1.0:
            self._doubt[arm.name] = kind, text
        elif doubted in ("", *found):
            self._outside[arm.name], self._doubt[arm.name] = 0, ("", "")
            return
        else:  # a kind that is not observable while the speed changes is not cleared
            kind, text = doubted, before
        self._outside[arm.name] += 1
        count = self._outside[arm.name]
        if count >= SLOW_AFTER and not self._before and not self._stopped:
            self._slow(arm, text, seen.clock)
        if not self._stopped and (count >= STOP_AFTER or (count >= SLOW_AFTER and ratio > FAR)):
            self._stopped = True
            hints = {
                "load": "tell its payload, or what it holds; or is something pressing on it?",
                "current": "an undeclared payload? a touch?",
                "timing": "look at the network",
            }
            hint = hints.get(kind, "is it blocked, displaced, badly calibrated?")
            self._trip(Fault(arm.name, "twin deviation", f"{text} at {seen.clock:.2f} s", hint))
            self._as_before()  # safe: the arms stay stopped until the operator clears the fault

    def _worst_of(
        self, found: Mapping[str, Array], arm: GuardedArm, bands: ArmResidualThresholds
    ) -> tuple[str, float, str]:
        """Return the kind of the largest residual that the twin guard found, its size relative to its
        threshold, and a description.

        The description also names a load that explains the currents, whatever kind is largest, because an
        arm may also yield under an unknown load.
        """
        kind = max(found, key=lambda each: float(np.abs(found[each]).max()))
        ratios = np.abs(found[kind])
        ratio, said = float(ratios.max()), []
        if kind != "load":
            joint = "the network" if kind == "timing" else arm.joint_names[int(np.argmax(ratios))]
            said.append(f"{joint}: {kind} is {ratio:.1f} times its band from the twin's")
        load = float(found.get("load", np.zeros(1))[0])
        if abs(load) * bands.load > abs(self._load[arm.name]):
            self._load[arm.name] = load * bands.load
        if abs(load) > 1.0 or kind == "load":
            more = "more" if load > 0.0 else "less"
            text = f"the arm seems to carry {abs(load) * bands.load:.1f} kg {more} than its model says"
            said.append(f"{text}, {abs(load):.1f} times that band")
        return ("load" if abs(load) > 1.0 else kind), ratio, "; ".join(said)

    def _slow(self, cause: GuardedArm, text: str, clock: float) -> None:
        for arm in self._arms:
            now = arm.sample().speed_fraction
            self._before[arm.name] = now
            arm.set_slider(min(SLOW, now))
        self._guard.note(cause.name, "twin slowed", f"{text} at {clock:.2f} s: slowed to {SLOW:.0%}")

    def _as_before(self) -> None:
        """Set the speed sliders of all arms back to the values that they had before the twin guard slowed the
        arms.
        """
        for arm in self._arms:
            if arm.name in self._before:
                arm.set_slider(self._before.pop(arm.name))

    def _end(self, how: str) -> None:
        self._as_before()
        for arm in self._arms:
            ratio, text = self._worst[arm.name]
            if self._guard.bands is not None and text:
                load = f", load {self._load[arm.name]:+.1f} kg" if self._load[arm.name] else ""
                self._guard.note(arm.name, "twin", f"{how}: at most {ratio:.2f} of a band ({text}){load}")
