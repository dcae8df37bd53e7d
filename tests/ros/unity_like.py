"""A client that behaves on the wire as Unity's ROS-TCP-Connector 0.7 does, with framing of its own.

Written from the connector's source: keep-alive on connecting, registrations sent twice, names and JSON ended
in NUL in ROS 2 mode, small writes with Nagle's algorithm on, reads polled every 10 ms, ids from 101.
"""

from __future__ import annotations

import json
import socket
import struct
import time

POLL = 0.010  # [s] the connector's SleepTimeSeconds


class UnityLike:
    """Connects at once. `read` gives the next frame, polling as the connector does."""

    def __init__(self, address, ros2=False, poll=POLL):
        self.nul = b"\0" if ros2 else b""
        self.poll = poll
        self.socket = socket.create_connection(address, timeout=5.0)
        self.buffer = b""
        self.next_id = 101
        self.send(b"", b"")

    def send(self, name, body):
        """As the connector writes: name length, name, body length, body, each on its own."""
        for piece in (struct.pack("<I", len(name)), name, struct.pack("<I", len(body)), body):
            if piece:
                self.socket.sendall(piece)

    def command(self, name, **params):
        self.send(name.encode() + self.nul, json.dumps(params).encode() + self.nul)

    def message(self, topic, data):
        self.send(topic.encode() + self.nul, bytes(data))

    def register(self, command, topic, message_name, **more):
        self.command(command, topic=topic, message_name=message_name, **more)

    def call(self, service, data):
        """Send a service request; its id."""
        number, self.next_id = self.next_id, self.next_id + 1
        self.command("__request", srv_id=number)
        self.message(service, data)
        return number

    def read(self, timeout=5.0):
        """The next frame as (name, body); commands' bodies as dicts. None at the connection's end.

        Raises:
            TimeoutError: none came.
        """
        end = time.monotonic() + timeout
        while True:
            if (frame := self._cut()) is not None:
                name, body = frame
                return (name, json.loads(body)) if name.startswith("__") else (name, body)
            if time.monotonic() > end:
                raise TimeoutError
            self.socket.settimeout(self.poll or 0.001)
            try:
                data = self.socket.recv(1 << 16)
            except TimeoutError:
                continue
            except ConnectionError:
                return None
            if not data:
                return None
            self.buffer += data
            if self.poll and len(data) < 1 << 16:
                time.sleep(self.poll / 2)  # on average half a period passes before the connector looks

    def _cut(self):
        if len(self.buffer) < 4:
            return None
        (n,) = struct.unpack_from("<I", self.buffer)
        if len(self.buffer) < 8 + n:
            return None
        (m,) = struct.unpack_from("<I", self.buffer, 4 + n)
        if len(self.buffer) < 8 + n + m:
            return None
        name, body = self.buffer[4 : 4 + n], self.buffer[8 + n : 8 + n + m]
        self.buffer = self.buffer[8 + n + m :]
        return name.decode("ascii"), body

    def read_until(self, name, timeout=5.0):
        """The body of the next frame with this name; others are passed over."""
        end = time.monotonic() + timeout
        while (frame := self.read(max(end - time.monotonic(), 0.0))) is not None:
            if frame[0] == name:
                return frame[1]
        raise ConnectionError("closed")

    def close(self):
        self.socket.close()

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()
