"""One ROS-TCP socket with two threads for reading and sending, and its bounded send queues (outbox).

Adding to the queues never blocks. Commands and service answers are always kept. Each topic has its own
queue, which drops its oldest message when it is full. A client that reads slowly therefore gets the
newest state of every topic, and memory use is bounded.
"""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from armcell.ros.tcp.framing import KEEP_ALIVE, MAX_BODY, Frame, FrameError, FrameReader

Part = bytes | memoryview
logger = logging.getLogger(__name__)
RECEIVE_BYTES = 256 << 10
SEND_BYTES = 64 << 10  # bytes that one write joins; larger frames are sent part by part without a copy
GOODBYE = 1.0  # [s] for the peer to read the reason of a disconnection
UNSENT_BYTES = 128 << 10  # limit of unsent bytes in the kernel; further messages wait in the outbox


class OutboxLimits(NamedTuple):
    """Limits on the size of the outbox of a ROS-TCP connection."""

    messages: int = 10  # per topic
    topic_bytes: int = 8 << 20  # per topic; one message is always kept
    control_bytes: int = 64 << 20  # for commands and answers; exceeding it ends the connection


class Outbox:
    """Thread-safe queues of the data that a ROS-TCP connection must send. Many threads add data and one
    thread sends it.

    Args:
        on_overflow: called when waiting commands exceed `OutboxLimits.control_bytes`; must return quickly.

    Attributes:
        dropped: number of dropped messages by topic.
        waiting_bytes: bytes that wait to be sent.
    """

    def __init__(self, caps: OutboxLimits = OutboxLimits(), on_overflow: Callable[[], None] = lambda: None):
        self._caps, self._on_overflow = caps, on_overflow
        self._condition = threading.Condition()
        self._control: deque[tuple[Part, ...]] = deque()
        self._control_bytes = 0
        self._topics: dict[str, deque[tuple[Part, ...]]] = {}
        self._bytes: Counter[str] = Counter()
        self._turns: deque[str] = deque()  # topic of each waiting message, in sending order
        self._closed = self._finishing = False
        self.dropped: Counter[str] = Counter()
        self.overflowed = False

    @property
    def waiting_bytes(self) -> int:
        return self._control_bytes + sum(self._bytes.values())

    def put(self, *parts: Part) -> None:
        """Queue a ROS-TCP command or answer in the outbox, ahead of all messages of topics."""
        with self._condition:
            if self._closed or self._finishing or self.overflowed:
                return
            self._control.append(parts)
            self._control_bytes += _size(parts)
            self.overflowed = self._control_bytes > self._caps.control_bytes
            self._condition.notify()
        if self.overflowed:
            self._on_overflow()

    def put_message(self, topic: str, *parts: Part) -> None:
        """Queue a message of a ROS-TCP topic in the outbox. If the queue is full, the oldest messages are
        dropped.
        """
        size = _size(parts)
        with self._condition:
            if self._closed or self._finishing:
                return
            queue = self._topics.setdefault(topic, deque())
            gone = 0
            while queue and (
                len(queue) >= self._caps.messages or self._bytes[topic] + size > self._caps.topic_bytes
            ):
                self._bytes[topic] -= _size(queue.popleft())
                gone += 1
            self.dropped[topic] += gone
            if not gone:
                self._turns.append(topic)
            for _ in range(gone - 1):  # the new message takes the turn of the first dropped one
                self._turns.remove(topic)
            queue.append(parts)
            self._bytes[topic] += size
            self._condition.notify()

    def forget(self, topic: str) -> None:
        """Discard the queued messages of a ROS-TCP topic that has lost its subscribers. They do not count as
        dropped.
        """
        with self._condition:
            for _ in self._topics.pop(topic, ()):
                self._turns.remove(topic)
            self._bytes.pop(topic, None)

    @property
    def is_empty(self) -> bool:
        return not (self._control or self._turns)

    def wait(self, timeout: float | None) -> bool:
        """Wait until the ROS-TCP outbox contains data to send. Return False on timeout.

        Args:
            timeout: limit [s]; None waits without limit.
        Raises:
            EOFError: the outbox is closed, or waiting commands exceed `OutboxLimits.control_bytes`.
        """
        with self._condition:
            self._condition.wait_for(
                lambda: self._control or self._turns or self._closed or self._finishing, timeout
            )
            if self._closed or self.overflowed or (self._finishing and self.is_empty):
                raise EOFError
            return not self.is_empty

    def take(self, max_bytes: int) -> list[Part]:
        """Remove the next parts of ROS-TCP frames from the outbox and return them in the order in which they
        must be sent.

        Args:
            max_bytes: approximate size [bytes]; at least one frame is returned if any waits.
        """
        with self._condition:
            taken: list[Part] = []
            size = 0
            while size < max_bytes and (self._control or self._turns):
                if self._control:
                    parts = self._control.popleft()
                    self._control_bytes -= _size(parts)
                else:
                    topic = self._turns.popleft()
                    parts = self._topics[topic].popleft()
                    self._bytes[topic] -= _size(parts)
                taken += parts
                size += _size(parts)
            return taken

    def finish(self) -> None:
        """Accept no further messages in the ROS-TCP outbox, but still send the messages that are queued."""
        with self._condition:
            self._finishing = True
            self._condition.notify_all()

    def close(self) -> None:
        with self._condition:
            self._closed = True
            self._condition.notify_all()


def _size(parts: tuple[Part, ...]) -> int:
    return sum(len(p) for p in parts)


class RosTcpConnection:
    """Connection to a ROS-TCP peer, which is open from `start` to `close`. The connection consists of a
    socket, a reading thread and a writing thread.

    Args:
        on_frame: called with each frame in the reading thread.
        on_end: called once with the reason when the connection is over.
        on_fault: called with the reason when the peer's bytes are malformed, just before the end.
        keep_alive: seconds of silence after which the link sends eight zero bytes; None sends none.
    """

    def __init__(
        self,
        sock: socket.socket,
        on_frame: Callable[[Frame], None],
        on_end: Callable[[str], None],
        on_fault: Callable[[str], None],
        max_body: int = MAX_BODY,
        caps: OutboxLimits = OutboxLimits(),
        keep_alive: float | None = None,
    ):
        self._socket, self._on_frame = sock, on_frame
        self._on_end, self._on_fault = on_end, on_fault
        self._reader = FrameReader(max_body)
        self._keep_alive = keep_alive
        self.outbox = Outbox(caps, self._shut)
        self.opened = time.monotonic()
        self.bytes_in = self.bytes_out = 0
        self._ended = threading.Lock()
        self._counting, self._running = threading.Lock(), 2
        self._sending = threading.Lock()  # held while bytes are written, so that frames stay whole
        self._rest = b""  # unsent remainder of a partly sent frame
        self._started = False
        self._over = threading.Event()
        _tune(sock)
        self._threads = [
            threading.Thread(target=self._read, name="ros-tcp read", daemon=True),
            threading.Thread(target=self._write, name="ros-tcp write", daemon=True),
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()
        self._started = True

    @property
    def is_over(self) -> bool:
        return self._over.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the ROS-TCP connection has ended. Return False on timeout.

        Args:
            timeout: limit [s]; None waits without limit.
        """
        return self._over.wait(timeout)

    def close(self, reason: str = "closed here") -> None:
        """End the ROS-TCP connection and wait for its threads, except the calling thread."""
        self._end(reason)
        for thread in self._threads:
            if thread.ident is not None and thread is not threading.current_thread():
                thread.join(timeout=2.0)

    def _read(self) -> None:
        buffer = bytearray(RECEIVE_BYTES)
        view = memoryview(buffer)
        reason = "closed by the other side"
        try:
            while count := self._socket.recv_into(buffer):
                _acknowledge_quickly(self._socket)
                self.bytes_in += count
                for frame in self._reader.feed(view[:count]):
                    if not frame.is_keep_alive:
                        self._on_frame(frame)
        except FrameError as error:
            reason = str(error)
            self._say_goodbye(reason)
        except OSError as error:
            reason = error.strerror or str(error)
        except Exception as error:  # a bug in armcell ends this connection, but not the server
            logger.exception("a frame could not be handled")
            reason = f"{type(error).__name__}: {error}"
        self._end(reason)
        self._leave()

    def _say_goodbye(self, reason: str) -> None:
        """Keep the socket open for a moment, so that the ROS-TCP peer can
        read the reason for the end of the connection.

        Closing a socket with unread bytes would reset the connection and lose the text.
        """
        self._on_fault(reason)
        self.outbox.finish()
        end = time.monotonic() + GOODBYE
        while (left := end - time.monotonic()) > 0 and select.select([self._socket], [], [], left)[0]:
            if not self._socket.recv(RECEIVE_BYTES):
                return

    def _write(self) -> None:
        reason = "closed here"
        try:
            while True:
                waiting = self.outbox.wait(self._keep_alive)
                with self._sending:
                    self._send(self.outbox.take(SEND_BYTES) if waiting else [KEEP_ALIVE])
        except EOFError:
            if not (self.is_over or self.outbox.overflowed):  # reason sent; the reading thread ends the link
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)
                self._leave()
                return
        except OSError as error:
            reason = error.strerror or str(error)
        self._end(reason)
        self._leave()

    def put(self, *parts: Part) -> None:
        """Send a ROS-TCP command or service answer over the connection without blocking. Any thread may call
        this method.
        """
        if not self._send_at_once(parts):
            self.outbox.put(*parts)

    def put_message(self, topic: str, *parts: Part) -> None:
        """Send a message of a topic over the ROS-TCP connection. If the topic's queue is full, its oldest
        message is dropped.

        Any thread may call it.
        """
        if not self._send_at_once(parts):
            self.outbox.put_message(topic, *parts)

    def _send_at_once(self, parts: tuple[Part, ...]) -> bool:
        """Send a small ROS-TCP frame directly from the calling thread if no earlier frames are waiting in the
        outbox.

        Under load from Python threads this saves milliseconds, because a woken thread must wait for the
        interpreter.

        Returns:
            Whether the frame was handled; False means that the caller must queue it.
        """
        if sum(len(p) for p in parts) > SEND_BYTES or not self._sending.acquire(blocking=False):
            return False
        try:
            if self._rest or not self.outbox.is_empty or not self._started or self.is_over:
                return False
            data = b"".join(parts)
            try:
                count = self._socket.send(data, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return False
            except OSError:
                return True  # the reading thread gets the error as well, and ends the connection
            self.bytes_out += count
            if count < len(data):
                self._rest = data[count:]
                self.outbox.put()  # wakes the writing thread
            return True
        finally:
            self._sending.release()

    def _send(self, parts: list) -> None:
        """Send the parts of a ROS-TCP frame. Only the thread that writes calls this method, with the lock
        held.
        """
        if self._rest:
            self._socket.sendall(self._rest)
            self._rest = b""
        size = sum(len(p) for p in parts)
        if size <= 2 * SEND_BYTES:
            self._socket.sendall(b"".join(parts))
        else:
            for part in parts:
                self._socket.sendall(part)
        self.bytes_out += size

    def _end(self, reason: str) -> None:
        """End the ROS-TCP connection and wake both of its threads. Further calls have no effect.

        The last thread to leave closes the socket, so that its file descriptor is not reused too early.
        """
        if self._ended.acquire(blocking=False):  # never released, so that the connection ends only once
            self.outbox.close()
            self._shut()
            self._on_end("it does not read what it asked for" if self.outbox.overflowed else reason)
            self._over.set()

    def _shut(self) -> None:
        """Shut down the socket of a ROS-TCP connection, so that blocking calls in its reading and writing
        threads return.
        """
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _leave(self) -> None:
        with self._counting:
            self._running -= 1
            last = self._running == 0
        if last:
            self._socket.close()


def _tune(sock: socket.socket) -> None:
    """Set the socket options of a ROS-TCP connection, which reduce latency,
    detect dead peers and limit the data buffered in the kernel.
    """
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    _acknowledge_quickly(sock)


def _acknowledge_quickly(sock: socket.socket) -> None:
    """Acknowledge received data at once.
    ROS-TCP peers that use Nagle's algorithm wait for the acknowledgment before they send more.

    Unity's connector writes small pieces with Nagle's algorithm on, so each piece waits for our
    acknowledgment. The kernel resets the option, so it must be set again after each receive. A service
    answered by Unity takes 8 ms with the option and 47 ms without it (measured).
    """
    if hasattr(socket, "TCP_QUICKACK"):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
