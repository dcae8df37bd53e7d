"""Session of a running ROS script: the bus and the cell that all ROS shims use."""

from __future__ import annotations

import logging
import sys
import threading
from typing import Any, TypeVar

import numpy as np

from armcell.cell import Cell, LiveCell
from armcell.core import Event, InputError, JointTrajectory, StateSample
from armcell.model import RobotModel
from armcell.moveit.message_classes import MessageClasses
from armcell.moveit.ros_time import NO_SESSION, session_clocks
from armcell.ros import ActionClient, Bus, NameMap, Ros1Graph, Ros1Settings
from armcell.ros.nodes import ServedCell, ServedPlanner
from armcell.ros.robot_description import NAME

logger = logging.getLogger(__name__)
RECENT = 5  # log lines that `has_logged` searches
SILENT = 5.0  # [s, wall clock] without joint states after which the user gets a hint
CHECK = 0.1  # [s] between two checks for the end of the session
T = TypeVar("T")
_current: list[Session] = []


class Session:
    """Session of a running ROS script.
    It contains the cell that is served to the script and the state that rospy has in each process.

    Args:
        cell: a live cell that is not connected yet, or a cell whose simulator or robot is another program on
            the bus, which the script then moves through topics and actions.
        rate: rate [Hz] of the published states and clock.
        auto_grip: close a gripper that rests with an object between its fingers.
        quiet: do not print log lines.
        ros1: join the cell and the script to a ROS 1 graph.
        bus: the bus, if transports are connected to it already.
        names: maps the ROS names of the cell and the script to names on the bus.
    """

    def __init__(
        self, cell: LiveCell | Cell, rate: float = 100.0, auto_grip: bool = False, quiet: bool = False,
        ros1: Ros1Settings | None = None, bus: Bus | None = None, names: NameMap | None = None,
    ):  # fmt: skip
        if bus is None:
            bus = Bus()
        self.bus = bus.with_remapping(names)
        self.graph: Ros1Graph | None = None
        if ros1 is not None:
            self.graph = Ros1Graph(bus, ros1, self.shut_down, (self.bus.full_name(NAME),))
        self.served: ServedCell
        if isinstance(cell, LiveCell):
            self.served, seed = ServedCell(cell, self.bus, rate, auto_grip=auto_grip), cell.ctx.seed
            cell.ctx.observers.append(_Warnings(self))
        else:
            self.served, seed = ServedPlanner(cell, self.bus), 0
        self.messages = MessageClasses(self.bus.schema)
        self.node_name = ""
        self.interrupted = False
        self.shutting_down = threading.Event()
        self.on_shutdown: list[Any] = []
        self._hooks = threading.Lock()  # acquired once and never released, so that the hooks run once
        self.claims_to_close = False  # whether the script has logged that it closes the gripper
        self.lines: list[str] = []
        """Log lines of the script, and armcell's hints."""
        self.clients: dict[str, ActionClient] = {}  # by action name, created on first use
        self.logged: dict[tuple[str, str], float] = {}  # (level, text) of throttled log lines -> time [s]
        self._members: list[Any] = []
        self.rng = np.random.default_rng(seed)
        self._quiet, self._hints = quiet, set()

    @property
    def model(self) -> RobotModel:
        return self.served.cell.model

    def __enter__(self) -> Session:
        if _current:
            raise InputError("a session is open already", hint="close it first")
        _current.append(self)
        session_clocks.append(self.bus.clock)
        try:
            if self.graph is not None:  # report a missing master before the cell starts
                self.graph.reserve()
            self.served.start()
            if self.graph is not None:
                self.graph.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        self.shut_down("closed")
        for member in (*self.clients.values(), *self._members):
            member.close()
        if self.graph is not None:
            self.graph.close()
        self.served.close()
        _current.remove(self)
        session_clocks.remove(self.bus.clock)

    def shut_down(self, reason: str) -> None:
        """Shut down the session of a ROS script, like rospy.signal_shutdown.
        All waiting calls end, and the shutdown hooks run once.
        """
        self.interrupted |= reason == "interrupted"
        self.shutting_down.set()
        if not self._hooks.acquire(blocking=False):
            return
        logger.info("shutdown: %s", reason)
        for hook in self.on_shutdown:
            try:
                hook()
            except Exception:
                logger.exception("a shutdown hook failed")

    def interrupt(self) -> None:
        """Interrupt the session of a ROS script after a signal. Every waiting call ends, and `is_shutdown()`
        returns True. The shutdown hooks run later.
        """
        self.interrupted = True
        self.shutting_down.set()

    def close_on_shutdown(self, member: T) -> T:
        """Register an object that a ROS script has created, such as a subscriber,
        so that it is closed together with the session.
        """
        self._members.append(member)
        return member

    # --- messages, services and logs ---
    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        """Create a message for a ROS script, in the session of the script,
        from its type `pkg/Name` and the values of its fields.

        Args:
            name: message type `pkg/Name`.
            values, fields: values of the message's fields.
        """
        return self.messages[name](*values, **fields)

    def call(self, service: str, request: Any) -> Any:
        """Call a ROS service from the session of a script and return a copy of the response.
        The script may modify the copy.

        Raises:
            ServiceError: the service does not exist, or failed.
        """
        return self.messages.local(self.bus.call(service, request))

    def say(self, level: str, text: str) -> None:
        """Write a log line in the session of a ROS script to standard error, in the format of ROS."""
        line = f"[{level}] [{self.bus.clock.now():.3f}]: {text}"
        self.lines.append(line)
        if self.graph is not None:
            self.graph.say(level.lower(), text)
        if not self._quiet:
            print(line, file=sys.stderr, flush=True)  # noqa: T201  (a script's log is output for its user)

    def has_logged(self, text: str) -> bool:
        """Return whether a text occurs in the most recent log lines of a ROS script."""
        return any(text in line for line in self.lines[-RECENT:])

    def hint(self, key: str, text: str) -> None:
        """Let the session of a ROS script log a hint for the author of the script. Hints with the same key
        are logged only once.
        """
        if key not in self._hints:
            self._hints.add(key)
            self.say("HINT", text)

    @property
    def hints(self) -> set[str]:
        return self._hints

    def hint_at_gripper(self) -> None:
        """Let the session of a ROS script log a hint if the script's log says that the gripper closes,
        although the script has never commanded the gripper.
        """
        if self.claims_to_close and not self.served.has_closed_gripper:
            self.hint(
                "auto-grip", "the script logs that it closes the gripper, but never closes it: publish to "
                "/gripper_command, use the gripper's group, or run with --auto-grip",
            )  # fmt: skip

    def hint_at_missing_joint_states(self) -> None:
        """Log a hint in the session of a ROS script if the external simulator or robot has stopped sending
        joint states. The hint appears only once.
        """
        if isinstance(self.served, ServedPlanner) and self.served.driver.time_since_joint_states > SILENT:
            self.hint(
                "silent", f"no /joint_states for {SILENT:g} s: the simulator or robot has ended or lost its "
                "connection, its clock stands still, and the script waits; Ctrl-C ends it",
            )  # fmt: skip

    def wait_for_motions(self) -> None:
        """Wait at the end of the session for motions of the ROS script that are still running."""
        goals = [goal for client in self.clients.values() for goal in client.unfinished_goals]
        while self._goes_on() and not all(goal.wait(CHECK) for goal in goals):
            pass
        while self._goes_on() and (works := self.served.cell.motions()):
            works[0].wait(CHECK)

    def _goes_on(self) -> bool:
        return self.served.is_running and not self.interrupted


class _Warnings:
    """Observer of the cell that logs warnings for a ROS script: protective stops, contacts and lost objects.

    The events include motions that the cell refused.
    """

    KINDS = ("stop", "contact", "lost")

    def __init__(self, session: Session):
        self._session = session

    def on_event(self, event: Event) -> None:
        if event.kind in self.KINDS:
            self._session.say("WARN", event.text)

    def on_state(self, sample: StateSample) -> None:
        pass

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass


def current_session() -> Session:
    """Return the open session of the ROS script that is running.

    Raises:
        RuntimeError: no session is open.
    """
    if not _current:
        raise RuntimeError(NO_SESSION)
    return _current[-1]
