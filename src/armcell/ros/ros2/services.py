"""ROS 2 services on DDS: a server for requests and a client for services in the domain.

Source: rmw_cyclonedds_cpp. Requests and replies begin with 16 bytes: an instance handle of the client's
writer and the number of the call. Both endpoints of a client or server carry a common id in their user data;
by it the peer knows when it has found both endpoints.
"""

from __future__ import annotations

import itertools
import struct
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from armcell.core import ArmcellError, InputError
from armcell.ros.bus import ServiceError
from armcell.ros.codec import WireError
from armcell.ros.faults import write_failure
from armcell.ros.ros2 import names
from armcell.ros.ros2.codec import HEADER_BYTES
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.dds import DdsError, Sample
from armcell.ros.ros2.qos import SERVICES, QosProfile, user_values

CALL_HEADER = 16
WAIT_FOR_CLIENT = 0.5  # [s] to find the client's reader before a reply is written
POLL = 0.005  # [s]
MAX_KNOWN = 1000  # clients whose readiness is cached


class RequestId(NamedTuple):
    """Identity of a received ROS 2 service call. The reply must contain it.

    `client` and `seq` come from the request's header; `writer` is the local handle of the client's writer.
    """

    client: int
    seq: int
    writer: int


def split(sample: Sample) -> tuple[RequestId, bytes]:
    """Split the serialized request or reply of a ROS 2 service into the header of the call and the bytes of
    the message.

    Raises:
        WireError: the sample is shorter than its header.
    """
    data = sample.data
    if len(data) < HEADER_BYTES + CALL_HEADER:
        raise WireError(f"{len(data)} bytes are no service message")
    client, seq = struct.unpack_from("<Qq" if data[1] & 1 else ">Qq", data, HEADER_BYTES)
    return RequestId(client, seq, sample.writer), data[:HEADER_BYTES] + data[HEADER_BYTES + CALL_HEADER :]


def joined(client: int, seq: int, encoded: memoryview) -> bytes:
    return b"".join((encoded[:HEADER_BYTES], struct.pack("<Qq", client, seq), encoded[HEADER_BYTES:]))


class Server:
    """Server of a ROS 2 service, which uses two DDS topics for requests and replies.

    Args:
        on_request: called in a worker thread with this server, the request and the identity of the call; it
            answers through `reply`, during the call or later.
    """

    def __init__(
        self,
        context: Context,
        name: str,
        type_name: str,
        on_request: Callable[[Server, Any, RequestId], None],
        kind: str = "srv",
        profile: QosProfile = SERVICES,
    ):
        self._context, self.name, self.type = context, name, type_name
        self._request, self._reply = (part(name, type_name, kind) for part in (names.request, names.reply))
        self._on_request = on_request
        self._ready: set[int] = set()
        self._made = threading.Event()
        for part in (self._request, self._reply):
            context.codec.prepare(part.message)
        user_data = f"serviceid={context.service_id()};"
        self._writer = context.writer(self._reply, profile, user_data, wait=True)
        self._reader = context.reader(self._request, profile, self._take, user_data)
        self._made.set()

    def close(self) -> None:
        self._context.drop(self._reader, self._writer)

    def _take(self, sample: Sample) -> None:
        try:
            asked, body = split(sample)
        except WireError as error:
            self._context.complain(f"request {self.name}", f"service {self.name}: {error}")
            return
        if not self._context.run_in_pool(self._answer, asked, body):
            self._context.complain(f"full {self.name}", f"service {self.name}: too many calls wait")
            self.refuse(asked, "too many calls wait")

    def _answer(self, asked: RequestId, body: bytes) -> None:
        self._made.wait()
        try:
            self._on_request(self, self._context.codec.decode(self._request.message, body), asked)
        except ArmcellError as error:
            self._context.complain(f"service {self.name} {str(error)[:80]}", f"service {self.name}: {error}")
            self.refuse(asked, str(error))

    def refuse(self, asked: RequestId, why: str) -> None:
        """Reply to a failed call of a ROS 2 service with default values and with the reason of the
        failure.
        """
        self.reply(asked, write_failure(self._context.codec.new(self._reply.message), why))

    def reply(self, asked: RequestId, response: Any) -> None:
        """Send the response to a ROS 2 service call as soon as the reader of the client has been discovered.

        Raises:
            InputError: a field of the response does not fit its type.
        """
        data = joined(asked.client, asked.seq, self._context.codec.encode(response))
        if self._context.closed or not self._is_there(asked.writer):
            return
        try:
            if not self._writer.write(data):
                self._context.has_dropped()
        except DdsError as error:
            if not self._context.closed:
                self._context.complain(f"reply {self.name}", f"service {self.name}: {error}")

    def _is_there(self, writer: int) -> bool:
        """Return whether the client of a ROS 2 service still exists. If the reader of the client is not yet
        discovered, wait for the reader up to `WAIT_FOR_CLIENT`.
        """
        give_up = time.monotonic() + WAIT_FOR_CLIENT
        while writer not in self._ready and not self._context.closed:
            qos = self._reader.writer_qos(writer)
            if qos is None:
                return False
            client = user_values(qos).get("clientid")
            readers = (self._writer.reader_qos(handle) for handle in self._writer.readers())
            if client is None or any(
                r is not None and user_values(r).get("clientid") == client for r in readers
            ):
                if len(self._ready) >= MAX_KNOWN:
                    self._ready.clear()
                self._ready.add(writer)
            elif time.monotonic() > give_up:
                return True
            else:
                time.sleep(POLL)
        return True


class Client:
    """Thread-safe client of a ROS 2 service, which uses two DDS topics for requests and replies."""

    def __init__(self, context: Context, name: str, type_name: str, kind: str = "srv"):
        self._context, self.name, self.type = context, name, type_name
        self._request, self._reply = (part(name, type_name, kind) for part in (names.request, names.reply))
        self._numbers = itertools.count(1)
        self._waiting: dict[int, PendingResponse] = {}
        self._lock = threading.Lock()
        for part in (self._request, self._reply):
            context.codec.prepare(part.message)
        user_data = f"clientid={context.service_id()};"
        self._writer = context.writer(self._request, SERVICES, user_data, wait=True)
        self._own = self._writer.instance
        self._reader = context.reader(self._reply, SERVICES, self._take, user_data)

    def close(self) -> None:
        self._context.drop(self._reader, self._writer)
        with self._lock:
            waiting = list(self._waiting.values())
        for answer in waiting:
            answer.set_response(None)

    @property
    def service_is_ready(self) -> bool:
        """Return whether discovery has found both endpoints of a ROS 2 service server: its request reader and
        its reply writer.
        """
        return bool(self._writer.readers()) and bool(self._reader.writers())

    def wait(self, timeout: float) -> bool:
        """Wait until a server of the ROS 2 service is available. Return False on timeout.

        Args:
            timeout: limit [s].
        """
        give_up = time.monotonic() + timeout
        while not self.service_is_ready:
            if time.monotonic() > give_up or self._context.closed:
                return False
            time.sleep(POLL)
        return True

    def call(self, request: Any, timeout: float) -> Any:
        """Call the ROS 2 service and return its response.

        Args:
            timeout: limit [s] for finding the server and receiving the response.
        Raises:
            ServiceError: no server was found, or no response arrived in time.
        """
        began = time.monotonic()
        if not self.wait(timeout):
            raise ServiceError(f"service {self.name}: no ROS 2 node serves it")
        waiting = self.call_async(request)
        answer = waiting.wait(max(began + timeout - time.monotonic(), 0.0))
        if answer is None:
            raise ServiceError(f"service {self.name}: no answer from ROS 2 in {timeout:g} s")
        return answer

    def call_async(self, request: Any) -> PendingResponse:
        """Send a request to a ROS 2 service without waiting.
        Return a `PendingResponse` object, which receives the response.

        Raises:
            InputError: a field of the request does not fit its type.
            ServiceError: the request could not be sent.
        """
        number = next(self._numbers)
        waiting = PendingResponse(lambda: self._forget(number))
        with self._lock:
            self._waiting[number] = waiting
        try:
            if not self._writer.write(joined(self._own, number, self._context.codec.encode(request))):
                raise ServiceError(f"service {self.name}: too many requests wait")
        except (DdsError, InputError, ServiceError) as error:
            self._forget(number)
            raise error if not isinstance(error, DdsError) else ServiceError(str(error)) from None
        return waiting

    def _forget(self, number: int) -> None:
        with self._lock:
            self._waiting.pop(number, None)

    def _take(self, sample: Sample) -> None:
        answer, waiting = None, None
        try:
            asked, body = split(sample)
            if asked.client != self._own:
                return  # the reply belongs to another client
            with self._lock:
                waiting = self._waiting.pop(asked.seq, None)
            answer = self._context.codec.decode(self._reply.message, body)
        except WireError as error:
            self._context.complain(f"reply {self.name}", f"service {self.name}: {error}")
        if waiting is not None:
            waiting.set_response(answer)


class PendingResponse:
    """Response to a ROS 2 service call that may still be pending."""

    def __init__(self, forget: Callable[[], None]):
        self._there = threading.Event()
        self._answer: Any = None
        self._forget = forget

    def set_response(self, answer: Any) -> None:
        self._answer = answer
        self._there.set()

    def wait(self, timeout: float) -> Any:
        """Wait for the response of a ROS 2 service and return it, or return None on timeout.

        The method may be called repeatedly.

        Args:
            timeout: limit [s].
        """
        self._there.wait(timeout)
        return self._answer

    def cancel(self) -> None:
        self._forget()
