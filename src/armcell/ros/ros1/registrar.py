"""Registrations of a ROS 1 node at the master, renewed after a restart of the master."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from armcell.ros.ros1.xmlrpc import ERROR, RpcError, call_method

logger = logging.getLogger(__name__)
CHECK_PERIOD = 1.0  # [s] between two checks that the master still knows this node
OVERTAKEN = 10  # attempts to register without a concurrent publisherUpdate; then the update counts
GOODBYE = 1.0  # [s] for each call to the master while closing


class Kind(Enum):
    PUBLISHER = "Publisher"
    SUBSCRIBER = "Subscriber"
    SERVICE = "Service"


class Entry(NamedTuple):
    kind: Kind
    name: str


class Registrar:
    """Thread that registers the topics and services of a ROS 1 node at the master.

    Args:
        caller: the node's name.
        uri: returns the address of the node's XML-RPC server, which is known once the server has started.
        on_publishers: called with a subscribed topic and the addresses of its publishers.
        on_replaced: called with a reason when another node has taken the name.
    """

    def __init__(
        self, master: str, caller: str, uri: Callable[[], str], timeout: float,
        on_publishers: Callable[[str, list[str]], None], on_replaced: Callable[[str], None],
    ):  # fmt: skip
        self.master, self._caller, self._uri, self._timeout = master, caller, uri, timeout
        self._on_publishers, self._on_replaced = on_publishers, on_replaced
        self._changed = threading.Condition()
        self._wanted: dict[Entry, str] = {}  # entry -> message type, or address of a service
        self._done: dict[Entry, str] = {}
        self._refused: set[Entry] = set()
        self._telling = threading.Lock()
        # Topic being registered, and whether a publisherUpdate for it arrived in the meantime.
        self._asking, self._overtaken = "", False
        self._stop = False
        # Called when the master has restarted and no longer knows this node.
        self.on_return: Callable[[], None] = lambda: None
        self.reachable = True
        self.losses = 0  # number of times that the master became unreachable
        self._thread = threading.Thread(target=self._run, name=f"registrar {caller}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def register(self, kind: Kind, name: str, what: str) -> None:
        with self._changed:
            self._wanted[Entry(kind, name)] = what
            self._refused.discard(Entry(kind, name))
            self._changed.notify_all()

    def unregister(self, kind: Kind, name: str) -> None:
        with self._changed:
            self._wanted.pop(Entry(kind, name), None)
            self._changed.notify_all()

    def update_publishers(self, topic: str, uris: list[str]) -> None:
        """Pass on the list of a topic's current publishers. The ROS 1 master sends it (publisherUpdate) after
        publishers have been registered or unregistered.
        """
        with self._telling:
            if topic == self._asking:
                self._overtaken = True
            self._on_publishers(topic, uris)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the registrar has registered all topics and services of its ROS 1 node at the master.
        Return False on timeout.

        Args:
            timeout: limit [s]; None waits without limit.
        """
        with self._changed:
            return self._changed.wait_for(lambda: not self._differences() or self._stop, timeout)

    def close(self) -> None:
        """Unregister the topics and services of a ROS 1 node at the master and end the thread of the
        registrar.
        """
        with self._changed:
            self._stop = True
            self._changed.notify_all()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(2 * self._timeout)
        if not self.reachable:
            return
        with contextlib.suppress(RpcError):
            for entry, what in list(self._done.items()):
                self._tell("unregister", entry, what, GOODBYE)

    # --- in the registrar's thread ---
    def _differences(self) -> list[tuple[Entry, str | None]]:
        """Return the topics and services whose registration at the ROS 1 master must change: those to
        register, and those to unregister.

        Returns:
            Pairs of an entry and its type or address; None instead of the type means to unregister.
        """
        found: list[tuple[Entry, str | None]] = [(e, None) for e in self._done if e not in self._wanted]
        for entry, what in self._wanted.items():
            if self._done.get(entry) != what and entry not in self._refused:
                found.append((entry, what))
        return found

    def _run(self) -> None:
        while True:
            with self._changed:
                changed = self._changed.wait_for(lambda: self._differences() or self._stop, CHECK_PERIOD)
                if self._stop:
                    return
            try:
                # Also check before new registrations: a master that restarted unnoticed would learn only
                # the new entry, and would then seem to know this node.
                if self._done or not (changed and self.reachable):
                    self._check()
                with self._changed:
                    todo = self._differences()
                for entry, what in todo:
                    if self._stop:
                        return
                    self._carry_out(entry, what)
            except RpcError as error:
                self._lost(error)

    def _carry_out(self, entry: Entry, what: str | None) -> None:
        if what is None:
            self._tell("unregister", entry, self._done[entry], self._timeout)
            with self._changed:
                self._done.pop(entry, None)
                self._changed.notify_all()
            return
        try:
            if entry.kind is Kind.SUBSCRIBER:
                self._subscribe(entry, what)
            else:
                self._tell("register", entry, what, self._timeout)
        except RpcError as error:
            if error.code is None:
                raise
            logger.error("the master refuses %s %s: %s", entry.kind.value.lower(), entry.name, error)
            with self._changed:
                self._refused.add(entry)
                self._changed.notify_all()
            return
        with self._changed:
            self._done[entry] = what
            self._changed.notify_all()

    def _subscribe(self, entry: Entry, what: str) -> None:
        """Register a subscriber at the ROS 1 master and pass on the publishers that the master returns.

        If a publisherUpdate arrives during the call, the order of the answer and the update is unknown. The
        method then repeats the call, up to `OVERTAKEN` times; after that, the update counts.
        """
        for _ in range(OVERTAKEN):
            with self._telling:
                self._asking, self._overtaken = entry.name, False
            answer = self._tell("register", entry, what, self._timeout)
            with self._telling:
                if not self._overtaken:
                    if isinstance(answer, list):
                        self._on_publishers(entry.name, [str(uri) for uri in answer])
                    return

    def _tell(self, verb: str, entry: Entry, what: str, timeout: float) -> object:
        arguments = [self._caller, entry.name]
        if verb == "register":
            arguments += [what, self._uri()]
        else:
            arguments.append(what if entry.kind is Kind.SERVICE else self._uri())
        return call_method(self.master, f"{verb}{entry.kind.value}", *arguments, timeout=timeout)

    def _check(self) -> None:
        """Check at the ROS 1 master whether the node is still registered. A master that was restarted has
        lost all registrations.
        """
        try:
            known = call_method(self.master, "lookupNode", self._caller, self._caller, timeout=self._timeout)
        except RpcError as error:
            if error.code != ERROR:
                raise
            known = None
        if not self.reachable:
            self.reachable = True
            logger.warning("the master at %s is back", self.master)
        if known is None and self._done:
            with self._changed:
                self._done.clear()
            self.on_return()
        elif known not in (None, self._uri()):
            self._on_replaced(f"another node has the name {self._caller} now")

    def _lost(self, error: RpcError) -> None:
        if self.reachable:
            self.losses += 1
            self.reachable = False
            logger.warning("the master is gone: %s; trying on", error)
        with self._changed:
            self._changed.wait_for(lambda: self._stop, CHECK_PERIOD)
