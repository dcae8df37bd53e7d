"""One connected socket: a thread that reads frames, a thread that sends what waits in the outbox."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
import time
from collections.abc import Callable

from armcell.ros.tcp.frames import KEEP_ALIVE, MAX_BODY, Frame, FrameError, FrameReader
from armcell.ros.tcp.outbox import Caps, Outbox, Part

logger = logging.getLogger(__name__)
RECEIVE_BYTES = 256 << 10
SEND_BYTES = 64 << 10  # joined into one write; bigger frames go out part by part without a copy
GOODBYE = 1.0  # [s] a peer has to read why it is disconnected
UNSENT_BYTES = 128 << 10  # what the kernel may hold unsent, so that backlog waits where its oldest is dropped


class Link:
    """Starts at `start`; calls `on_frame` from the reading thread, `on_end` once, when it is over.

    Args:
        on_fault: called when the peer's bytes cannot be followed any more, just before the end.
        keep_alive: send eight zero bytes after so many seconds of silence; None: never.
    """

    def __init__(
        self,
        sock: socket.socket,
        on_frame: Callable[[Frame], None],
        on_end: Callable[[str], None],
        on_fault: Callable[[str], None],
        max_body: int = MAX_BODY,
        caps: Caps = Caps(),
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
        self._rest = b""  # of a frame that was sent in part
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
        """Whether the connection is over, after waiting for that."""
        return self._over.wait(timeout)

    def close(self, reason: str = "closed here") -> None:
        """End the connection; returns when nothing of it runs any more (but for the calling thread)."""
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
        except Exception as error:  # a fault of ours ends this connection, not the server
            logger.exception("a frame could not be handled")
            reason = f"{type(error).__name__}: {error}"
        self._end(reason)
        self._leave()

    def _say_goodbye(self, reason: str) -> None:
        """Let the peer read why: closing with bytes unread would reset the connection and lose the text."""
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
            if not (self.is_over or self.outbox.overflowed):  # the goodbye is out: the reading thread ends it
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)
                self._leave()
                return
        except OSError as error:
            reason = error.strerror or str(error)
        self._end(reason)
        self._leave()

    def put(self, *parts: Part) -> None:
        """Send a command or answer; from any thread, never waits."""
        if not self._send_at_once(parts):
            self.outbox.put(*parts)

    def put_message(self, topic: str, *parts: Part) -> None:
        """Send a topic's message; from any thread, never waits. It may push out an older one."""
        if not self._send_at_once(parts):
            self.outbox.put_message(topic, *parts)

    def _send_at_once(self, parts: tuple[Part, ...]) -> bool:
        """A small frame goes out from the caller's own thread if nothing is before it: no thread to wake.

        Under a load of Python threads that saves milliseconds: a woken thread waits for the interpreter.
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
                return True  # the reading thread sees it as well, and ends the connection
            self.bytes_out += count
            if count < len(data):
                self._rest = data[count:]
                self.outbox.put()  # wakes the writing thread
            return True
        finally:
            self._sending.release()

    def _send(self, parts: list) -> None:
        """By the writing thread, with the sending lock held."""
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
        """Wake both threads; the last one to leave closes the socket, lest its number be reused early."""
        if self._ended.acquire(blocking=False):  # never released: it ends once
            self.outbox.close()
            self._shut()
            self._on_end("it does not read what it asked for" if self.outbox.overflowed else reason)
            self._over.set()

    def _shut(self) -> None:
        """Wakes both threads, wherever they wait."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _leave(self) -> None:
        with self._counting:
            self._running -= 1
            last = self._running == 0
        if last:
            self._socket.close()


def _tune(sock: socket.socket) -> None:
    """No waiting for more to send, dead peers noticed, little backlog in the kernel."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    _acknowledge_quickly(sock)


def _acknowledge_quickly(sock: socket.socket) -> None:
    """Unity's connector writes small pieces with Nagle's algorithm on: each waits for our acknowledgement.

    The option falls back by itself, hence again after each receive. A service answered by Unity takes 8 ms
    with it, 47 ms without (measured; shared facts).
    """
    if hasattr(socket, "TCP_QUICKACK"):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
