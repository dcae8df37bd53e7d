"""What a script talks to: the bus with the cell on it, found by every shim."""

from __future__ import annotations

import logging
import sys
import threading
from typing import Any, TypeVar

import numpy as np

from armcell.cell import LiveCell
from armcell.core import Event, InputError, JointTrajectory, StateSample
from armcell.model import RobotModel
from armcell.moveit.message_classes import MessageClasses
from armcell.ros import ActionClient, Bus, Ros1Graph, Ros1Settings
from armcell.ros.nodes import ServedCell
from armcell.ros.nodes.description import NAME

logger = logging.getLogger(__name__)
RECENT = 5  # lines of the log
CHECK = 0.1  # [s] between two looks whether it is all over
T = TypeVar("T")
_current: list[Session] = []


class Session:
    """A served cell and the state that rospy keeps per process.

    Args:
        live: a cell that is not connected yet.
        rate: [Hz] of the states and the clock.
        auto_grip: close a gripper that rests with an object between its fingers.
        ros1: join the cell and the script to a ROS 1 graph.
    """

    def __init__(
        self, live: LiveCell, rate: float = 100.0, auto_grip: bool = False, quiet: bool = False,
        ros1: Ros1Settings | None = None,
    ):  # fmt: skip
        self.bus = Bus()
        self.graph = None if ros1 is None else Ros1Graph(self.bus, ros1, self.shut_down, (NAME,))
        self.served = ServedCell(live, self.bus, rate, auto_grip=auto_grip)
        live.ctx.observers.append(_Warnings(self))
        self.messages = MessageClasses(self.bus.schema)
        self.node_name = ""
        self.interrupted = False
        self.shutting_down = threading.Event()
        self.on_shutdown: list[Any] = []
        self._hooks = threading.Lock()  # taken for good by who runs them
        self.claims_to_close = False  # a log line of the script's says that the gripper closes
        self.lines: list[str] = []
        """What the script has logged, and the hints."""
        self.clients: dict[str, ActionClient] = {}  # of actions that were used
        self.logged: dict[tuple[str, str], float] = {}  # [s] when; of what is not to be logged too often
        self._members: list[Any] = []
        self.rng = np.random.default_rng(live.ctx.seed)
        self._quiet, self._hints = quiet, set()

    @property
    def model(self) -> RobotModel:
        return self.served.live.model

    def __enter__(self) -> Session:
        if _current:
            raise InputError("a session is open already", cure="close it first")
        _current.append(self)
        try:
            if self.graph is not None:  # a master that is missing is said before the cell is started
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

    def shut_down(self, reason: str) -> None:
        """What rospy.signal_shutdown does: everybody who waits is told, and the hooks run once."""
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
        """A signal came: `is_shutdown()` is true from now on, every wait ends, no hook has run yet."""
        self.interrupted = True
        self.shutting_down.set()

    def own(self, member: T) -> T:
        """Close something of the script's when the session ends: it would go on in a thread of its own."""
        self._members.append(member)
        return member

    # --- talking ---
    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        """A message as scripts have them."""
        return self.messages[name](*values, **fields)

    def call(self, service: str, request: Any) -> Any:
        """Ask a service; the script's own copy of the answer.

        Raises:
            ServiceError: it is not there, or failed.
        """
        return self.messages.local(self.bus.call(service, request))

    def say(self, level: str, text: str) -> None:
        """A log line on standard error, in ROS's form."""
        line = f"[{level}] [{self.bus.clock.now():.3f}]: {text}"
        self.lines.append(line)
        if self.graph is not None:
            self.graph.say(level.lower(), text)
        if not self._quiet:
            print(line, file=sys.stderr, flush=True)  # noqa: T201  (what a script logs is for its user)

    def has_said(self, text: str) -> bool:
        """Whether one of the last lines has a text already."""
        return any(text in line for line in self.lines[-RECENT:])

    def hint(self, key: str, text: str) -> None:
        """Say something about the script, once."""
        if key not in self._hints:
            self._hints.add(key)
            self.say("HINT", text)

    @property
    def hints(self) -> set[str]:
        return self._hints

    def hint_at_gripper(self) -> None:
        """Say at the end of a script that its log lines closed no gripper, if nothing else has closed one."""
        grippers = self.served.node.grippers
        if self.claims_to_close and not (grippers.closes_by_itself or grippers.has_closed):
            self.hint(
                "auto-grip", "the script logs that it closes the gripper, but never closes it: publish to "
                "/gripper_command, use the gripper's group, or run with --auto-grip",
            )  # fmt: skip

    def finish(self) -> None:
        """Wait for the motions that the script has begun and not waited for."""
        goals = [goal for client in self.clients.values() for goal in client.unfinished]
        while self._goes_on() and not all(goal.wait(CHECK) for goal in goals):
            pass
        while self._goes_on() and (works := self.served.cell.works()):
            works[0].wait(CHECK)

    def _goes_on(self) -> bool:
        return self.served.is_running and not self.interrupted


class _Warnings:
    """Says what the cell reports of refused and stopped motions, unwanted contacts and lost objects."""

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
    """The open session.

    Raises:
        RuntimeError: there is none.
    """
    if not _current:
        raise RuntimeError("no cell to talk to: run the script with `armcell run SCRIPT.py --cell CELL`")
    return _current[-1]
