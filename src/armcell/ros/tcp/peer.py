"""ROS-TCP protocol between the bus and one connected program, common to server and client.

Topics go in either direction (`offer`: bus to peer; `take`: peer to bus), and so do services (`serve_remote`:
the peer implements the service; `__request` from the peer: the bus answers). The peer gets an `__error` for
each invalid message, which is logged once per kind and has no other effect.
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
from armcell.ros.faults import FaultCounter
from armcell.ros.names import resolve
from armcell.ros.tcp.connection import RosTcpConnection
from armcell.ros.tcp.framing import CommandError, Frame, command, frame_header, parameters

logger = logging.getLogger(__name__)
WORKERS = 4  # service calls of one peer that run in parallel
MAX_CALLS = 64  # service calls of one peer that wait or run
MAX_REGISTRATIONS = 4096
SHOWN = 200  # [characters] half the longest text of a peer in a log

Params = dict[str, Any]


class Peer:
    """Program at the other end of a ROS-TCP connection, seen from this end. After creating a `Peer`, set its
    attribute `link` (the connection), and only then start the link.

    Args:
        address: name of the peer in logs.
        service_timeout: limit [s] for the peer's answers to service requests.
        terminate: end names and JSON in NUL, like Unity in ROS 2 mode, because its endpoint expects NUL.
    """

    def __init__(self, bus: Bus, codec: Codec, address: str, service_timeout: float, terminate: bool = False):
        self.bus, self.codec, self.address = bus, codec, address
        self.terminate = terminate
        self.link: RosTcpConnection  # the creator of the peer sets it before anything runs
        self.offered: dict[str, Attachment] = {}  # by topic name as the peer spells it
        self.taken: dict[str, Publisher] = {}
        self.remote: dict[str, Service] = {}
        self.service_types: dict[str, str] = {}  # bus services that the peer registered to call
        self.received: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.complaints = FaultCounter()
        self._service_timeout = service_timeout
        self._pending: tuple[bool, int] | None = None  # (is a request, srv_id) of the next frame
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
        """Count an error of the ROS-TCP peer. The first error of each kind is also logged and sent to the
        peer.
        """
        if self.complaints.count(kind):
            logger.warning("%s: %s", self.address, text[: 2 * SHOWN])
            self.tell_error(text)

    def on_fault(self, reason: str) -> None:
        """Report malformed bytes from a ROS-TCP peer. The connection must be closed afterwards."""
        self.complain("frame", f"closed: {reason}")

    def tell_error(self, text: str) -> None:
        """Send an error text to the ROS-TCP peer."""
        self.command("__error", text=text)

    # --- topics ---
    def offer(self, topic: str, type_name: str) -> None:
        """Offer a topic of the bus to the ROS-TCP peer from now on. A repeated call has no effect.

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
            self.link.put_message(topic, frame_header(topic, len(body), self.terminate), body)

        self.offered[topic] = self.bus.attach(topic, type_name, put)
        self._undo_if_closed()

    def encode(self, topic: str, message: Any) -> memoryview:
        """Serialize a message for the ROS-TCP peer. The server overrides this method so that all peers share
        the result.
        """
        return self.codec.encode(message)

    def withdraw(self, topic: str) -> None:
        if attachment := self.offered.pop(topic, None):
            attachment.close()
            self.link.outbox.forget(topic)

    def receive_topic(self, topic: str, type_name: str, latch: bool) -> None:
        """Publish on the bus the messages that the ROS-TCP peer sends to a topic.

        A repeated call keeps a latched message.

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

    # --- services that the peer implements ---
    def serve_remote(self, name: str, type_name: str) -> None:
        """Advertise a service of the ROS-TCP peer on the bus, and forward each call to the peer.

        Raises:
            InputError: the service is served on the bus already.
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
                    frame_header(name, len(body), self.terminate),
                    body,
                )
                if self._closed:
                    answer.give(None)  # registered after `close` had ended all waiting calls
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
        """Handle a frame from the ROS-TCP peer. The thread that reads the connection calls this method."""
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
            if self.link.is_over:  # the message was in transit when the connection ended
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
        self._pending = is_request, required_parameter(params, "srv_id", int)

    def _on_response(self, number: int, frame: Frame) -> None:
        with self._lock:
            answer = self._waiting.get(number)
        if answer is None:
            self.complain("late answer", f"an answer to service call {number}, for which no caller waits")
        else:
            answer.give(frame.body)

    def _on_request(self, number: int, frame: Frame) -> None:
        """Answer a service request of the ROS-TCP peer in a worker thread, so that other frames need not
        wait.
        """
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
        with contextlib.suppress(RuntimeError):  # the pool is shut down because the connection has just ended
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
        """Answer a failed service call of the ROS-TCP peer with default values, so that the peer does not
        wait any longer.
        """
        self.complain(f"service {name} {reason[:80]}", f"service {name[:80]}: {reason}")
        type_name = self._service_type(name)
        body: Any = b""
        if type_name is not None:
            body = self.codec.encode(self.bus.schema.new(f"{type_name}Response"))
        self._respond(number, name, body)

    def _service_type(self, name: str) -> str | None:
        """Return the type of a service, as registered by the ROS-TCP peer or,
        otherwise, as known on the bus.
        """
        with contextlib.suppress(InputError):
            return self.service_types.get(name) or self.bus.services().get(resolve(name))
        return None

    def _respond(self, number: int, name: str, body: Any) -> None:
        self.link.put(
            command("__response", {"srv_id": number}, self.terminate),
            frame_header(name, len(body), self.terminate),
            body,
        )

    # --- end of the connection ---
    def close(self) -> None:
        """Remove the topics and services of the ROS-TCP peer from the bus after the connection has ended.

        A second call has no effect.
        """
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
        """Remove a registration of the ROS-TCP peer from the bus if the connection ended during the
        registration.
        """
        if self._closed:
            self.close()


class _Answer:
    """Answer of a ROS-TCP peer to a service call. The method `wait` returns as soon as the answer arrives."""

    def __init__(self) -> None:
        self._there = threading.Event()
        self._data: bytes | None = None

    def give(self, data: bytes | None) -> None:
        self._data = data
        self._there.set()

    def wait(self, timeout: float) -> bytes | None:
        self._there.wait(timeout)
        return self._data


def required_parameter(params: Params, name: str, kind: type) -> Any:
    """Return a required parameter of a command from the ROS-TCP peer. Other parameters are ignored.

    Raises:
        CommandError: the parameter is missing or has another type.
    """
    value = params.get(name)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise CommandError(f"needs {name!r} as {kind.__name__}, has {str(value)[:80]!r}")
    return value
