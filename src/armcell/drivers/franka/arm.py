"""One real Franka arm: its state, motions, limits and faults."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, JointTrajectory
from armcell.drivers.execution_handle import RUNNING, ExecutionHandle
from armcell.drivers.franka.hand import FrankaHand
from armcell.drivers.franka.identity import HINTS, FrankaIdentity, check_position, identify
from armcell.drivers.franka.setpoint_stream import TICK
from armcell.drivers.franka.settings import FrankaArmSettings, FrankaLimits, limits_of
from armcell.drivers.franka.wire.commands import REQUESTS, Command, RecoveryStatus
from armcell.drivers.franka.wire.state import GeneratorMode, RobotMode, RobotState
from armcell.drivers.franka.worker_connection import WorkerConnection
from armcell.drivers.motion_guard import ArmSample
from armcell.drivers.real import RealArm, RealGripper, RealSettings
from armcell.drivers.safety import Fault
from armcell.model import Gripper

Array = NDArray[np.float64]

MARGIN = 0.95  # fraction of Franka's velocity and acceleration limits that a motion may use
HALTED_WITHIN = 2.0  # [s] in which a stopped arm comes to rest
RUNNING_MODE, NORMAL, PROTECTIVE_STOP, EMERGENCY_STOP = 7, 1, 3, 7
IDLE_MODE, DISCONNECTED = 5, 0
_MODES = {
    RobotMode.OTHER: (IDLE_MODE, NORMAL),
    RobotMode.REFLEX: (RUNNING_MODE, PROTECTIVE_STOP),
    RobotMode.AUTOMATIC_ERROR_RECOVERY: (RUNNING_MODE, PROTECTIVE_STOP),
    RobotMode.USER_STOPPED: (RUNNING_MODE, EMERGENCY_STOP),
}
"""Robot mode and safety mode in the numbers of `ur_dashboard_msgs`; other modes are running and normal."""


def time_stretch(trajectory: JointTrajectory, limits: FrankaLimits) -> float:
    """Return the factor (at least 1) by which a trajectory must be
    slowed to respect the limits of a real Franka arm.

    Raises:
        InputError: a position is outside the joint limits.
    """
    times = np.arange(trajectory.times[0], trajectory.times[-1] + 0.5 * TICK, TICK)
    q, v, a = trajectory.samples(times)
    beyond = np.maximum(limits.lower - q, q - limits.upper)
    if beyond.max() > 0.0:
        k, i = np.unravel_index(int(beyond.argmax()), beyond.shape)
        raise InputError(
            f"the motion takes joint {i + 1} to {q[k, i]:.4f} rad, {limits.model}'s limits are "
            f"{limits.lower[i]:.4f} to {limits.upper[i]:.4f}",
            hint="set these limits in the robot model, so that planning keeps them",
        )
    low, high = (np.array(rows) for rows in zip(*(limits.velocity_range(x) for x in q), strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.where(v > 0, v / high, np.where(v < 0, v / low, 0.0))
    fast = float(np.nan_to_num(speed, posinf=np.inf).max(initial=0.0)) / MARGIN
    hard = float((np.abs(a) / limits.acceleration).max(initial=0.0)) / MARGIN
    if not np.isfinite(fast):
        raise InputError(
            "the motion moves at a joint limit, where Franka allows no speed",
            hint="leave a margin to the joint limits",
        )
    return max(1.0, fast, float(np.sqrt(hard)))


class FrankaArm(RealArm):
    """Real Franka arm, which a separate worker process moves at 1 kHz."""

    identity: FrankaIdentity

    def __init__(
        self, name: str, joint_names: Sequence[str], settings: FrankaArmSettings, limits: RealSettings,
        identity: FrankaIdentity, on_state: Callable[[], None],
    ):  # fmt: skip
        self.name, self.joint_names = name, tuple(joint_names)
        self.settings, self.identity, self._supervision = settings, identity, limits
        self.limits = limits_of(settings.model)
        self.step = 0.004  # [s]
        self._link = WorkerConnection(
            name, settings.host, limits.watchdog, settings.backend, self.limits, on_state
        )
        self.armed = False
        self._slider, self._streamed, self._halted = 1.0, 0.0, 0.0
        self._number = 0
        self._no_force = np.zeros(6)

    # --- connection ---
    def connect(self) -> None:
        self._link.start()
        self._configure()
        self.armed = True

    def _configure(self) -> None:
        """Configure a real Franka arm: its collision thresholds, stiffness and load.

        Raises InputError if the robot rejects one of them.
        """
        own = self.settings
        torque, force = [own.collision_torque] * 7, [own.collision_force] * 6
        self._set(Command.SET_COLLISION_BEHAVIOR, torque * 4 + force * 4, "collision thresholds")
        if own.joint_stiffness is not None:
            self._set(Command.SET_JOINT_IMPEDANCE, own.joint_stiffness, "joint stiffness")
        if own.payload is not None:
            inertia = (0.4 * own.payload * own.payload_radius**2 * np.eye(3)).ravel()
            self._set(Command.SET_LOAD, (own.payload, *own.payload_cog, *inertia), "load")
        self._link.set_speed_scaling(self._slider)

    def _set(self, command: Command, values: Sequence[float], what: str) -> None:
        status = self._link.ask(command, REQUESTS[command].pack(*values))
        if status != 0:
            raise InputError(
                f"arm {self.name!r}: the robot rejects the {what}", element=f"real/arms/{self.name}",
                hint="see Franka's limits for this parameter",
            )  # fmt: skip

    def connect_gripper(self, gripper: Gripper) -> RealGripper | None:
        own = self.settings
        return None if own.gripper is None else FrankaHand(own.host, own.gripper, gripper)

    def close(self) -> None:
        self.armed = False
        self._link.close()

    def send_keep_alive(self) -> None:
        self._link.beat()

    # --- state ---
    @property
    def state(self) -> RobotState:
        history = self._link.history
        if not history:
            raise InputError(
                f"arm {self.name!r}: {self.settings.host} has sent no state",
                hint="connect the cell first: with cell.connect('real') as live: ...",
            )
        return history[-1][1]

    @property
    def time_of_state(self) -> float:
        return self._link.history[-1][0]

    def state_at(self, when: float) -> tuple[Array, Array]:
        history = list(self._link.history)
        after_time, after = history[-1]
        for measured, state in reversed(history):
            if measured <= when:
                span = after_time - measured
                share = min((when - measured) / span, 1.0) if span > 0 else 0.0
                q0, v0 = state["q"], state["dq"]
                return q0 + share * (after["q"] - q0), v0 + share * (after["dq"] - v0)
            after_time, after = measured, state
        return after["q"], after["dq"]

    def setpoint(self) -> tuple[Array, Array]:
        return self.state["q_d"], self.state["dq_d"]

    def sample(self) -> ArmSample:
        state = self.state
        number, clock = self._link.progress
        return ArmSample(
            state["q"], state["dq"], state["tau_J"], clock if number == self._number else 0.0, self._slider
        )

    @property
    def speed_scaling(self) -> float:
        return self._slider

    def set_slider(self, fraction: float) -> None:
        self._slider = float(np.clip(fraction, 0.0, 1.0))
        self._link.set_speed_scaling(self._slider)

    @property
    def modes(self) -> tuple[int, int]:
        if self._link.error is not None:
            return DISCONNECTED, NORMAL
        return _MODES.get(RobotMode(self.state.mode), (RUNNING_MODE, NORMAL))

    @property
    def success_rate(self) -> float:
        """Return the fraction of the last 100 commands that the real Franka arm received in time.

        The value is 0 without a motion.
        """
        return self.state.success_rate

    def external_wrench(self) -> tuple[Array, Array, Array]:
        state = self.state
        felt = -state["O_F_ext_hat_K"] - self._no_force  # Franka reports forces on the environment
        return felt[:3], felt[3:], state["O_T_EE"].reshape(4, 4).T[:3, 3]

    def zero_force(self) -> None:
        recent = [state["O_F_ext_hat_K"] for _, state in list(self._link.history)[-50:]]
        self._no_force = -np.mean(recent, axis=0)

    # --- faults ---
    @property
    def moving(self) -> bool:
        """Return whether the real Franka arm executes a motion or receives setpoints."""
        streaming = time.monotonic() - self._streamed < 0.2
        return streaming or (self._number > 0 and self._link.result(self._number) == RUNNING)

    def fault(self) -> Fault | None:
        link, limits = self._link, self._supervision
        if link.error is not None:
            text = f"the link to {self.settings.host} is lost: {link.error}"
            return Fault(self.name, "link lost", text, "check the cable and Desk, then call resume()")
        state, mode = self.state, RobotMode(self.state.mode)
        if mode not in (RobotMode.IDLE, RobotMode.MOVE):
            return self._mode_fault(mode, state)
        if self.armed and link.state_age > (limits.max_state_age if self.moving else limits.max_silence):
            text = f"its state is {link.state_age * 1000:.0f} ms old"
            return Fault(self.name, "stale state", text, "check the network")
        error = float(np.abs(state["q_d"] - state["q"]).max())
        if self.armed and error > limits.max_tracking_error:
            return Fault(self.name, "tracking error", f"{error:.3f} rad from its target", "is it blocked?")
        return None

    def _mode_fault(self, mode: RobotMode, state: RobotState) -> Fault:
        cause, hint = HINTS[mode]
        if mode is RobotMode.REFLEX:
            names = ", ".join(state.errors or state.last_errors) or "unknown error"
            lost = "communication_constraints_violation" in names
            more = f"; {REALTIME}" if lost else ""
            return Fault(self.name, "protective stop", f"{names}{more}", "free the arm, then call resume()")
        kind = {RobotMode.USER_STOPPED: "emergency stop"}.get(mode, "not running")
        return Fault(self.name, kind, cause, hint)

    def halt(self) -> None:
        self.armed = False
        self._streamed, self._halted = 0.0, time.monotonic()
        self._link.cancel()

    def check_resume(self) -> None:
        self._link.close_hung()
        if self._link.error is not None:
            found = identify(self.settings.host)
            if (found.model, found.calibration) != (self.identity.model, self.identity.calibration):
                raise InputError(
                    f"arm {self.name!r}: another robot than before answers at {self.settings.host}",
                    hint="check cables and addresses, then start armcell again",
                )
            mode, q = RobotMode(found.state.mode), found.state["q"]
        else:
            mode, q = RobotMode(self.state.mode), self.state["q"]
        if mode not in (RobotMode.IDLE, RobotMode.MOVE, RobotMode.REFLEX):
            cause, hint = HINTS[mode]
            raise InputError(f"arm {self.name!r}: {cause}", hint=hint)
        check_position(self.name, self.settings.model, q)

    def restart(self) -> None:
        if self._link.error is not None:
            self._link.start()
        self._wait_for_rest()
        if self.state.mode == RobotMode.REFLEX:
            status = RecoveryStatus(self._link.ask(Command.AUTOMATIC_ERROR_RECOVERY))
            if status is not RecoveryStatus.SUCCESS:
                raise InputError(
                    f"arm {self.name!r}: the robot rejects the recovery: {status.name.lower()}",
                    hint="clear the error in Desk",
                )
            self._wait_until(lambda: self.state.mode == RobotMode.IDLE, "idle after the recovery")
        self._configure()
        self.armed = True

    def _wait_for_rest(self) -> None:
        def rests() -> bool:
            state = self.state
            return state.generator == GeneratorMode.IDLE and float(np.abs(state["dq_d"]).max()) < 1e-3

        self._wait_until(rests, "at rest")

    def _wait_until(self, holds: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + HALTED_WITHIN
        while not holds():
            if time.monotonic() > end or self._link.error is not None:
                raise InputError(f"arm {self.name!r} is not {what}", hint="look at Desk")
            time.sleep(0.005)

    # --- motion ---
    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        return FrankaExecution(self, trajectory.reindexed(self.joint_names))

    def play(self, trajectory: JointTrajectory) -> tuple[int, float]:
        """Play a trajectory on the real Franka arm, more slowly if Franka's limits require it.

        Returns its number and the slowing factor.

        Raises:
            InputError: the trajectory leaves the joint limits.
        """
        slower = time_stretch(trajectory, self.limits)
        steps = max(int(np.ceil(trajectory.duration * slower / TICK)), 1)
        times = trajectory.times[0] + np.arange(steps + 1) * (TICK / slower)
        self._number = self._link.play(trajectory.samples(times)[0])
        return self._number, slower

    def clock(self, number: int) -> float:
        """Return the progress [s] of the Franka arm along a motion that its worker process executes. The
        progress is 0 before the motion starts.
        """
        current, clock = self._link.progress
        return clock if current == number else 0.0

    def result(self, number: int) -> str:
        return self._link.result(number)

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        self._streamed = time.monotonic()
        self._link.servo(np.asarray(q, dtype=float), np.asarray(v, dtype=float), at)

    def cancel(self) -> None:
        self._streamed = 0.0
        self._link.cancel()


REALTIME = "the robot missed 20 commands in a row: free this computer, or use chrt -f 10 armcell ..."


class FrankaExecution:
    """Handle to monitor and cancel a trajectory on a real Franka arm. The arm's worker process plays the
    trajectory, and the speed slider slows it down.
    """

    def __init__(self, arm: FrankaArm, trajectory: JointTrajectory):
        self._arm, self._duration = arm, trajectory.duration
        self._number, self._slower = arm.play(trajectory)

    def trajectory_time(self) -> float:
        if self.state() == "done":
            return self._duration
        return min(self._arm.clock(self._number) / self._slower, self._duration)

    def state(self) -> str:
        return self._arm.result(self._number)

    def paused(self) -> bool:
        return self._arm.speed_scaling <= 0.0

    def cancel(self) -> None:
        self._arm.cancel()
