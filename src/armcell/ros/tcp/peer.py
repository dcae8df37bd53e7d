"""The ROS-TCP protocol between the bus and one connected program; both sides of the wire speak it alike.

Topics go either way (`offer`: bus to peer; `take`: peer to bus), services too (`serve_remote`: the peer
implements it; `__request` from the peer: the bus answers). Whatever arrives wrong is answered with an
`__error`, logged once, and changes nothing else.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from armcell.core import ArmcellError, InputError
from armcell.ros.bus import Attachment, Bus, Publisher, Service, ServiceError
from armcell.ros.codec import Codec
from armcell.ros.complaints import Complaints
from armcell.ros.names import resolve
from armcell.ros.tcp.frames import CommandError, Frame, command, head, parameters
from armcell.ros.tcp.link import Link

logger = logging.getLogger(__name__)
WORKERS = 4  # service calls of one peer at a time
MAX_CALLS = 64  # waiting and running
MAX_REGISTRATIONS = 4096
SHOWN = 200  # characters of a peer's text in a log

Params = dict[str, Any]


class Peer:
    """One connected program. Made with a link that is started afterwards.

    Args:
        address: how logs call it.
        terminate: end names and JSON in NUL, as Unity in ROS 2 mode does and its endpoint expects.
    """

    def __init__(self, bus: Bus, codec: Codec, address: str, service_timeout: float, terminate: bool = False):
        self.bus, self.codec, self.address = bus, codec, address
        self.terminate = terminate
        self.link: Link  # whoever makes a peer sets it, before anything runs
        self.offered: dict[str, Attachment] = {}  # by the peer's own spelling of the name
        self.taken: dict[str, Publisher] = {}
        self.remote: dict[str, Service] = {}
        self.service_types: dict[str, str] = {}  # bus services the peer said it will call
        self.received: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.complaints = Complaints()
        self._service_timeout = service_timeout
        self._pending: tuple[bool, int] | None = None  # (is a request, srv_id): the next frame's meaning
        self._numbers = itertools.count(1001)
        self._waiting: dict[int, _Answer] = {}
        self._lock = threading.Lock()
        self._workers: ThreadPoolExecutor | None = None
        self._calls = 0
        self._closed = False
        self.commands: dict[str, Callable[[Params], None]] = {
            "__request": lambda p: self._expect(True, p),
            "__response": lambda p: self._expect(False, p),
        }

    # --- sending ---
    def command(self, name: str, **params: Any) -> None:
        self.link.put(command(name, params, self.terminate))

    def complain(self, kind: str, text: str) -> None:
        """Tell the peer and log it, once per kind; count the rest."""
        if self.complaints.is_new(kind):
            logger.warning("%s: %s", self.address, text[: 2 * SHOWN])
            self.tell_error(text)

    def on_fault(self, reason: str) -> None:
        """The peer's bytes make no frames any more."""
        self.complain("frame", f"closed: {reason}")

    def tell_error(self, text: str) -> None:
        """How the peer hears of an error."""
        self.command("__error", text=text)

    # --- topics ---
    def offer(self, topic: str, type_name: str) -> None:
        """Send a bus topic to the peer, from now on. Asking twice is asking once.

        Raises:
            InputError: the topic carries another type.
        """
        have = self.offered.get(topic)
        if have is not None and have.type == type_name and not have.closed:
            return
        self._check_room()
        self.codec.prepare(type_name)
        self.withdraw(topic)

        def put(message: Any) -> None:
            try:
                body = self.encode(topic, message)
            except InputError as error:
                self.complain(f"encode {topic}", f"{topic}: {error}")
                return
            self.sent[topic] += 1
            self.link.put_message(topic, head(topic, len(body), self.terminate), body)

        self.offered[topic] = self.bus.attach(topic, type_name, put)
        self._undo_if_closed()

    def encode(self, topic: str, message: Any) -> memoryview:
        """A message's bytes; a server encodes once for all its clients."""
        return self.codec.encode(message)

    def withdraw(self, topic: str) -> None:
        if attachment := self.offered.pop(topic, None):
            attachment.close()
            self.link.outbox.forget(topic)

    def take(self, topic: str, type_name: str, latch: bool) -> None:
        """Publish on the bus what the peer sends under this name. A latched message outlives asking twice.

        Raises:
            InputError: the topic carries another type.
        """
        have = self.taken.get(topic)
        if have is not None and have.type == type_name and have.latch == latch:
            return
        self._check_room()
        self.codec.prepare(type_name)
        self.drop(topic)
        self.taken[topic] = self.bus.advertise(topic, type_name, latch)
        self._undo_if_closed()

    def drop(self, topic: str) -> None:
        if publisher := self.taken.pop(topic, None):
            publisher.close()

    def _check_room(self) -> None:
        if len(self.offered) + len(self.taken) + len(self.service_types) >= MAX_REGISTRATIONS:
            raise InputError(f"more than {MAX_REGISTRATIONS} registrations on one connection")

    # --- services the peer implements ---
    def serve_remote(self, name: str, type_name: str) -> None:
        """Put a service of the peer's on the bus.

        Raises:
            InputError: somebody serves it already.
        """
        _, response_type = self.bus.schema.service(type_name)

        def handler(request: Any) -> Any:
            body = self.codec.encode(request)
            number, answer = next(self._numbers), _Answer()
            with self._lock:
                self._waiting[number] = answer
            try:
                self.link.put(
                    command("__request", {"srv_id": number}, self.terminate),
                    head(name, len(body), self.terminate),
                    body,
                )
                if self._closed:
                    answer.give(None)  # registered after `close` had told everybody
                data = answer.wait(self._service_timeout)
            finally:
                with self._lock:
                    self._waiting.pop(number, None)
            if data is None:
                gone = "went away" if self._closed else f"gave no answer in {self._service_timeout:g} s"
                raise ServiceError(f"{self.address}, who serves it, {gone}")
            return self.codec.decode(response_type._type, data)

        self.stop_serving(name)
        self.remote[name] = self.bus.serve(name, type_name, handler)
        self._undo_if_closed()

    def stop_serving(self, name: str) -> None:
        if service := self.remote.pop(name, None):
            service.close()

    # --- receiving ---
    def on_frame(self, frame: Frame) -> None:
        """From the link's reading thread."""
        if self._pending is not None:
            (is_request, number), self._pending = self._pending, None
            if not frame.is_command:
                (self._on_request if is_request else self._on_response)(number, frame)
                return
            self.complain("no body", f"a command came where the body of service call {number} was due")
        if frame.is_command:
            self._on_command(frame)
        else:
            self._on_message(frame)

    def _on_command(self, frame: Frame) -> None:
        run = self.commands.get(frame.destination)
        if run is None:
            known = ", ".join(sorted(self.commands))
            self.complain(
                f"command {frame.destination}", f"unknown command {frame.destination[:80]!r}; known: {known}"
            )
            return
        try:
            run(parameters(frame.body))
        except ArmcellError as error:
            self.complain(f"{frame.destination} {error}", f"{frame.destination}: {error}")

    def _on_message(self, frame: Frame) -> None:
        topic = frame.destination
        publisher = self.taken.get(topic)
        if publisher is None:
            if self.link.is_over:  # what was on its way when the connection ended
                return
            known = ", ".join(sorted(self.taken)[:20]) or "none"
            self.complain(
                f"topic {topic}", f"{topic[:80]!r} is not registered for publishing; registered: {known}"
            )
            return
        try:
            publisher.publish(self.codec.decode(publisher.type, frame.body))
        except ArmcellError as error:
            self.complain(f"bytes {topic}", f"{topic}: {error}")
        else:
            self.received[topic] += 1

    def _expect(self, is_request: bool, params: Params) -> None:
        self._pending = is_request, need(params, "srv_id", int)

    def _on_response(self, number: int, frame: Frame) -> None:
        with self._lock:
            answer = self._waiting.get(number)
        if answer is None:
            self.complain(
                "late answer", f"an answer to service call {number}, which nobody waits for (any more)"
            )
        else:
            answer.give(frame.body)

    def _on_request(self, number: int, frame: Frame) -> None:
        """Answered from a thread of its own: a slow service holds nothing up."""
        with self._lock:
            full = self._calls >= MAX_CALLS
            if not full:
                self._calls += 1
                if self._workers is None:
                    self._workers = ThreadPoolExecutor(WORKERS, f"services {self.address}")
                workers = self._workers
        if full:
            self._refuse(number, frame.destination, f"more than {MAX_CALLS} service calls wait for an answer")
            return
        with contextlib.suppress(RuntimeError):  # shut down: the connection has just ended
            workers.submit(self._answer, number, frame)

    def _answer(self, number: int, frame: Frame) -> None:
        name = frame.destination
        try:
            type_name = self._service_type(name)
            if type_name is None:
                known = ", ".join(self.bus.services()) or "none"
                raise ServiceError(f"unknown service {name[:80]!r}; known: {known}")
            request = self.codec.decode(f"{type_name}Request", frame.body)
            body = self.codec.encode(self.bus.call(name, request))
            self._respond(number, name, body)
        except ArmcellError as error:
            self._refuse(number, name, str(error))
        finally:
            with self._lock:
                self._calls -= 1

    def _refuse(self, number: int, name: str, reason: str) -> None:
        """A failed call is answered too, all fields at their defaults: who asked does not wait for ever."""
        self.complain(f"service {name} {reason[:80]}", f"service {name[:80]}: {reason}")
        type_name = self._service_type(name)
        body: Any = b""
        if type_name is not None:
            body = self.codec.encode(self.bus.schema.new(f"{type_name}Response"))
        self._respond(number, name, body)

    def _service_type(self, name: str) -> str | None:
        """What the peer registered it as, else what the bus serves under this name."""
        with contextlib.suppress(InputError):
            return self.service_types.get(name) or self.bus.services().get(resolve(name))
        return None

    def _respond(self, number: int, name: str, body: Any) -> None:
        self.link.put(
            command("__response", {"srv_id": number}, self.terminate),
            head(name, len(body), self.terminate),
            body,
        )

    # --- the end ---
    def close(self) -> None:
        """Take everything of this peer's off the bus. Called once the link is over; twice is fine."""
        self._closed = True
        for topic in list(self.offered):
            self.withdraw(topic)
        for topic in list(self.taken):
            self.drop(topic)
        for name in list(self.remote):
            self.stop_serving(name)
        with self._lock:
            waiting = list(self._waiting.values())
        for answer in waiting:
            answer.give(None)
        if self._workers is not None:
            self._workers.shutdown(wait=False, cancel_futures=True)

    def _undo_if_closed(self) -> None:
        """A registration that was under way when the link ended must not stay on the bus."""
        if self._closed:
            self.close()


class _Answer:
    """One answer, waited for once."""

    def __init__(self) -> None:
        self._there = threading.Event()
        self._data: bytes | None = None

    def give(self, data: bytes | None) -> None:
        self._data = data
        self._there.set()

    def wait(self, timeout: float) -> bytes | None:
        self._there.wait(timeout)
        return self._data


def need(params: Params, name: str, kind: type) -> Any:
    """A command's parameter; other keys than those asked for are ignored.

    Raises:
        CommandError: missing or of another kind.
    """
    value = params.get(name)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise CommandError(f"needs {name!r} as {kind.__name__}, has {str(value)[:80]!r}")
    return value
