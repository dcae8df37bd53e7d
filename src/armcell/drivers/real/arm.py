"""Interfaces of one real arm and its gripper, and running trajectories on real arms."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, JointTrajectory
from armcell.drivers.execution_handle import CANCELLED, DONE, RUNNING, ExecutionHandle, SetpointHistory
from armcell.drivers.motion_guard import ArmSample
from armcell.drivers.real.identity import RobotIdentity
from armcell.drivers.safety import Fault
from armcell.model import Gripper

Array = NDArray[np.float64]


class RealGripper(Protocol):
    """Interface of the gripper on a real arm, for execution in mode `real`.

    Attributes:
        hint: remedy for a gripper that no longer answers.
    """

    hint: str

    def drive(self, width: float, force: float) -> None:
        """Move the gripper of a real arm toward a width [m] with limited force [N] per finger.
        Use a width of 0 to grasp an object.
        """
        ...

    def read(self) -> tuple[float, bool]:
        """Return the width [m] of the gripper on a real arm, and whether the gripper holds an object."""
        ...

    @property
    def time_since_answer(self) -> float:
        """Return the time [s] since the gripper of a real arm last answered."""
        ...

    def close(self) -> None: ...


class RealArm(ABC):
    """Interface of one real arm: its connection, state, motion and faults.

    The constructor performs no I/O. `RealDriver` calls `connect` once, `beat` every 10 ms from its own
    thread, and `close` at the end. The arm calls `on_state`, which it receives from its `RobotKind`, after
    each new state, from any thread.

    Attributes:
        name: planning group of the arm.
        joint_names: its joints, in the order of the controller.
        identity: identity of the connected robot.
        step: interval between streamed setpoints [s].
        T_link_base: pose of the controller's base frame in the model's base link.
    """

    name: str
    joint_names: tuple[str, ...]
    identity: RobotIdentity
    step: float
    T_link_base: SE3 = SE3.identity()

    # --- connection ---
    @abstractmethod
    def connect(self) -> None:
        """Connect to the robot of a real arm and prepare it for commands. The arm does not move.

        Raises:
            InputError: the connection failed; the message states the cause and the remedy.
        """

    @abstractmethod
    def connect_gripper(self, gripper: Gripper) -> RealGripper | None:
        """Connect to the gripper that the settings of a real arm specify.
        Return None if they specify no gripper.

        Raises:
            InputError: the gripper does not answer.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop a real arm if it is moving, and close all its connections.

        The method may also be called after a failed `connect`.
        """

    @abstractmethod
    def send_keep_alive(self) -> None:
        """Send a keep-alive signal to the robot controller of a real arm. Without this signal, the robot
        stops. The call must not raise or block.
        """

    def start_round_trip_measurement(self) -> Callable[[], float]:
        """Start measuring the network of a real arm.
        Return a function that returns the shortest recent round trip [s].

        The function returns NaN while nothing has been measured. `close` ends the measurement.
        """
        return lambda: float("nan")

    # --- state ---
    @property
    @abstractmethod
    def time_of_state(self) -> float:
        """Return the time of the latest state of a real arm [s, this computer's monotonic clock]."""

    @abstractmethod
    def state_at(self, when: float) -> tuple[Array, Array]:
        """Return the positions [rad] and velocities [rad/s], each (n,),
        measured on a real arm at a given time.

        The time is monotonic [s]. Values are interpolated between two states and clamped at the ends of the
        history.
        """

    @abstractmethod
    def setpoint(self) -> tuple[Array, Array]:
        """Return the commanded positions [rad] and velocities [rad/s], each (n,), that a real arm is tracking
        now.
        """

    @abstractmethod
    def sample(self) -> ArmSample:
        """Return the latest measurement of a real arm, to compare it with the simulated twin."""

    @property
    @abstractmethod
    def speed_scaling(self) -> float:
        """Return the current speed scaling of a real arm, as a fraction of full speed (0 to 1). The speed
        slider and pauses reduce the fraction.
        """

    @abstractmethod
    def set_slider(self, fraction: float) -> None:
        """Set the speed slider of a real arm, 0 to 1. The call must not raise if the connection is lost."""

    @property
    @abstractmethod
    def modes(self) -> tuple[int, int]:
        """Return the robot mode and safety mode of a real arm, as numbers of `ur_dashboard_msgs`."""

    @abstractmethod
    def external_wrench(self) -> tuple[Array, Array, Array]:
        """Return the force [N] and torque [Nm] at the tool of a real arm,
        and the point [m] to which they refer, all in the base frame.

        The base frame is the controller's.
        """

    @abstractmethod
    def zero_force(self) -> None:
        """Zero the force measurement of a real arm. Call this only while nothing touches the hand."""

    # --- faults ---
    @abstractmethod
    def fault(self) -> Fault | None:
        """Return the current fault of a real arm, or None. Several threads call this often."""

    @abstractmethod
    def halt(self) -> None:
        """Stop a real arm, discard all goals and hold the measured pose. The call must not raise or block."""

    @abstractmethod
    def check_resume(self) -> None:
        """Check, before a real arm resumes, that the robot is still the same one and is allowed to move.

        Raises:
            InputError: the check failed; the message states the remedy.
        """

    @abstractmethod
    def restart(self) -> None:
        """Restart a stopped real arm: reconnect, clear the stop and accept commands. The arm does not move.

        Raises:
            InputError: the arm stays stopped; the message states the remedy.
        """

    # --- motion ---
    @abstractmethod
    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        """Start a trajectory that a real arm's controller executes on its own, and return a handle for it.

        A robot without such a function streams the setpoints in a thread of its own: see `StreamedExecution`.
        """

    @abstractmethod
    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        """Stream a setpoint to a real arm. The setpoint includes the time at which the arm should pass it.

        Setpoints with equal times keep several arms synchronized.

        Args:
            q: joint positions (n,) [rad].
            v: joint velocities (n,) [rad/s].
            at: time to reach `q` [s, this computer's monotonic clock].
        """

    @abstractmethod
    def cancel(self) -> None:
        """End the motion of a real arm and hold its position. The arm stays ready for new motions."""


class StreamedExecution:
    """Handle of a motion that is streamed to several real arms on one clock. If one arm slows down or stops,
    all arms do.
    """

    def __init__(
        self, arms: Sequence[RealArm], trajectory: JointTrajectory, lead: float,
        fault: Callable[[], Fault | None],
    ):  # fmt: skip
        self._lead = lead  # [s] from sending a point until its due time
        self._arms, self._trajectory, self._fault = arms, trajectory, fault
        self._clock, self._state = 0.0, RUNNING
        self.sent_for = SetpointHistory()
        self.sent_at: list[float] = []  # send times of the points [s, monotonic]
        self._cancel = threading.Event()
        threading.Thread(target=self._stream, name="arm stream", daemon=True).start()

    def _stream(self) -> None:
        period = max(arm.step for arm in self._arms)
        duration, first = self._trajectory.duration, float(self._trajectory.times[0])
        due = time.monotonic()
        names = self._trajectory.joint_names
        columns = [[names.index(n) for n in arm.joint_names] for arm in self._arms]
        while self._fault() is None and not self._cancel.is_set():
            scaling = min(arm.speed_scaling for arm in self._arms)
            q, v, _ = self._trajectory.sample(first + self._clock)
            self.sent_at.append(time.monotonic())
            self.sent_for.record(due + self._lead, self._clock)
            for arm, own in zip(self._arms, columns):
                arm.servo(q[own], v[own] * scaling, due + self._lead)
            if self._clock >= duration:
                self._state = DONE
                return
            late = time.monotonic() - due > self._lead  # then shift the schedule: the arms must not jump
            due = time.monotonic() if late else due + period
            time.sleep(max(due - time.monotonic(), 0.0))
            self._clock = min(self._clock + period * scaling, duration)
        self._state = CANCELLED
        for arm in self._arms:
            arm.cancel()

    def trajectory_time(self) -> float:
        return self.sent_for.at(time.monotonic())[0]

    def state(self) -> str:
        return self._state

    def paused(self) -> bool:
        return any(arm.speed_scaling <= 0.0 for arm in self._arms)

    def cancel(self) -> None:
        self._cancel.set()


class CallerStreamedExecution:
    """Handle of a motion of a real arm that the caller commands point by point.

    Args:
        due: returns the time [s, monotonic] at which the next point is due.
    """

    def __init__(self, due: Callable[[], float]):
        self._due, self._state = due, RUNNING
        self.sent_for = SetpointHistory()
        self.watched: ExecutionHandle = (
            self  # the handle that compares the motion with its twin, if there is one
        )

    def record_setpoint(self, clock: float, off: Array) -> None:
        self.sent_for.record(self._due(), clock, off)

    def check(self) -> None:
        self.watched.trajectory_time()

    def end(self, how: str) -> None:
        self._state = how
        self.watched.state()

    def trajectory_time(self) -> float:
        return self.sent_for.at(time.monotonic())[0]

    def state(self) -> str:
        return self._state

    def paused(self) -> bool:
        return False

    def cancel(self) -> None:
        pass  # the caller stops the motion
