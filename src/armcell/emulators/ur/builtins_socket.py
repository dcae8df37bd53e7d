"""URScript's socket functions: TCP connections that a program opens from the robot."""

from __future__ import annotations

import struct
from collections.abc import Callable, Generator
from typing import Any

from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.urscript.values import Vec

Wait = Generator[None, None, Any]


def socket_functions(
    robot: Robot, network: Network
) -> tuple[dict[str, Callable[..., Wait]], dict[str, Callable[..., Any]], Callable[[], None]]:
    """Return the URScript socket functions for one program of the emulated UR robot.

    Returns:
        Functions that take time (generators), functions that return immediately, and a function that closes
        all sockets of the program.
    """
    links: dict[str, TcpConnection] = {}

    def close_all() -> None:
        for link in links.values():
            link.close()

    def alive(name: str) -> TcpConnection | None:
        link = links.get(name)
        return link if link is not None and link.open else None

    def socket_open(address: str, port: int, name: str = "socket_0") -> Wait:
        yield
        old = links.pop(name, None)
        if old is not None:
            old.close()
        link = network.connect(address, int(port))
        if link is None:
            return False
        links[name] = link
        return True

    def _receive(name: str, count: int, timeout: float) -> Wait:
        """Receive `count` bytes from a URScript socket, or return None after a timeout [s].
        A timeout of 0 means no limit.
        """
        end = robot.time + timeout
        while True:
            link = links.get(name)
            if link is None:
                yield  # a loop that reads a closed socket must not block the controller
                return None
            if len(link.received) >= count:
                data = bytes(link.received[:count])
                del link.received[:count]
                return data
            closed = not link.open
            if not closed and timeout > 0 and robot.time > end - 0.5 * robot.period:
                return None
            yield
            if closed:
                return None

    def socket_read_binary_integer(number: int, name: str = "socket_0", timeout: float = 2.0) -> Wait:
        data = yield from _receive(name, 4 * int(number), timeout)
        if data is None:
            return Vec([0] + [0] * int(number))
        return Vec((int(number), *struct.unpack(f">{int(number)}i", data)))

    def socket_read_byte_list(number: int, name: str = "socket_0", timeout: float = 2.0) -> Wait:
        data = yield from _receive(name, int(number), timeout)
        return Vec([0] + [0] * int(number)) if data is None else Vec((int(number), *data))

    def socket_read_line(name: str = "socket_0", timeout: float = 2.0) -> Wait:
        end = robot.time + timeout
        while True:
            link = links.get(name)
            if link is None or b"\n" in link.received or not link.open:
                break
            if timeout > 0 and robot.time > end - 0.5 * robot.period:
                return ""
            yield
        if link is None or b"\n" not in link.received:
            yield
            return ""
        line, _, rest = bytes(link.received).partition(b"\n")
        link.received[:] = rest
        return line.decode("ascii", "replace").rstrip("\r")

    def _send(name: str, data: bytes) -> bool:
        link = alive(name)
        if link is not None:
            link.send(data)
        return link is not None

    def socket_close(name: str = "socket_0") -> None:
        link = links.pop(name, None)
        if link is not None:
            link.close()

    def socket_read_string(
        name: str = "socket_0", prefix: str = "", suffix: str = "", interpret_escape: bool = False,
        timeout: float = 2.0,
    ) -> Wait:  # fmt: skip
        """Return text received from a URScript socket,
        optionally only the text between a prefix and a suffix.
        """
        begin, stop, end = str(prefix).encode(), str(suffix).encode(), robot.time + timeout
        while True:
            link = links.get(name)
            found = _between(link.received, begin, stop) if link is not None else None
            if link is not None and found is not None:
                return found.decode("utf-8", "replace")
            if timeout > 0 and robot.time > end - 0.5 * robot.period:
                return ""
            yield
            if link is None or not link.open:
                return ""

    def socket_read_ascii_float(number: int, name: str = "socket_0", timeout: float = 2.0) -> Wait:
        """Receive numbers as text, such as `(1.5, 2, 3)`, from a URScript socket.
        Return their count and their values.
        """
        text = yield from socket_read_string(name, "(", ")", False, timeout)
        try:
            values = [float(part) for part in text.split(",")] if text else []
        except ValueError:
            values = []
        return Vec((len(values), *values)) if len(values) == int(number) else Vec([0] + [0] * int(number))

    def socket_set_var(variable: str, value: int, name: str = "socket_0") -> None:
        _send(name, f"SET {variable} {int(value)}\n".encode())

    def socket_get_var(variable: str, name: str = "socket_0") -> Wait:
        _send(name, f"GET {variable}\n".encode())
        line = yield from socket_read_line(name)
        return int(line.rsplit(" ", 1)[-1]) if line.rsplit(" ", 1)[-1].lstrip("-").isdigit() else 0

    waiting = (
        socket_open, socket_read_binary_integer, socket_read_byte_list, socket_read_line, socket_read_string,
        socket_read_ascii_float, socket_get_var,
    )  # fmt: skip
    instant: dict[str, Callable[..., Any]] = {
        "socket_close": socket_close,
        "socket_set_var": socket_set_var,
        "socket_send_int": lambda value, name="socket_0": _send(name, struct.pack(">i", int(value))),
        "socket_send_byte": lambda value, name="socket_0": _send(name, bytes([int(value) & 255])),
        "socket_send_string": lambda text, name="socket_0": _send(name, str(text).encode()),
        "socket_send_line": lambda text, name="socket_0": _send(name, f"{text}\n".encode()),
    }
    return {f.__name__: f for f in waiting}, instant, close_all


def _between(received: bytearray, begin: bytes, stop: bytes) -> bytes | None:
    """Remove the text between two marks from the buffer of a URScript socket, and return it.
    Return None if it is incomplete.

    Without marks, all received data is returned.
    """
    first = received.find(begin)
    last = received.find(stop, first + len(begin)) if stop else len(received)
    if not received or first < 0 or last < 0:
        return None
    text = bytes(received[first + len(begin) : last])
    del received[: last + len(stop)]
    return text
