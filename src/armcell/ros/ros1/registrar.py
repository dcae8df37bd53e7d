"""Keeps the master told of what a node publishes, subscribes to and serves; a new master, too."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from armcell.ros.ros1.rpc import ERROR, RpcError, ask

logger = logging.getLogger(__name__)
CHECK_PERIOD = 1.0  # [s] between two looks whether the master still knows us
OVERTAKEN = 10  # times to ask again; then the news stands
GOODBYE = 1.0  # [s] for each word with the master while closing


class Kind(Enum):
    PUBLISHER = "Publisher"
    SUBSCRIBER = "Subscriber"
    SERVICE = "Service"


class Entry(NamedTuple):
    kind: Kind
    name: str


class Registrar:
    """Runs from `start` to `close`.

    Args:
        caller: the node's name.
        uri: gives the address of its XML-RPC server, which is known once it has started.
        on_publishers: told the publishers of a topic that was subscribed to.
        on_replaced: told when another node has taken the name.
    """

    def __init__(
        self, master: str, caller: str, uri: Callable[[], str], timeout: float,
        on_publishers: Callable[[str, list[str]], None], on_replaced: Callable[[str], None],
    ):  # fmt: skip
        self.master, self._caller, self._uri, self._timeout = master, caller, uri, timeout
        self._on_publishers, self._on_replaced = on_publishers, on_replaced
        self._changed = threading.Condition()
        self._wanted: dict[Entry, str] = {}  # to type, or a service's address
        self._done: dict[Entry, str] = {}
        self._refused: set[Entry] = set()
        self._telling = threading.Lock()
        self._asking, self._overtaken = "", False  # a topic, and whether news of it came in the meantime
        self._stop = False
        self.on_return: Callable[[], None] = lambda: None  # called when a new master knows nothing of us
        self.reachable = True
        self.losses = 0  # times that the master was gone
        self._thread = threading.Thread(target=self._run, name=f"registrar {caller}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def want(self, kind: Kind, name: str, what: str) -> None:
        with self._changed:
            self._wanted[Entry(kind, name)] = what
            self._refused.discard(Entry(kind, name))
            self._changed.notify_all()

    def drop(self, kind: Kind, name: str) -> None:
        with self._changed:
            self._wanted.pop(Entry(kind, name), None)
            self._changed.notify_all()

    def publishers_are(self, topic: str, uris: list[str]) -> None:
        """The master's news."""
        with self._telling:
            if topic == self._asking:
                self._overtaken = True
            self._on_publishers(topic, uris)

    def wait(self, timeout: float | None = None) -> bool:
        """Whether the master knows everything, after waiting for that."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._differences() or self._stop, timeout)

    def close(self) -> None:
        """Tell the master that the node goes."""
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

    # --- in its thread ---
    def _differences(self) -> list[tuple[Entry, str | None]]:
        """What to register (with its type or address) and to unregister (None)."""
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
                # Before news, too: a master that came back unnoticed would know the news alone and so
                # seem to know us.
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
        """Register, until no news of the master has overtaken its answer: which is newer, nobody can say."""
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
        return ask(self.master, f"{verb}{entry.kind.value}", *arguments, timeout=timeout)

    def _check(self) -> None:
        """Ask the master who we are; one that has been started anew does not know."""
        try:
            known = ask(self.master, "lookupNode", self._caller, self._caller, timeout=self._timeout)
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
