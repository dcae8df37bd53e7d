"""URScript's socket functions: connections a program opens from the robot."""

from __future__ import annotations

import struct
from collections.abc import Callable, Generator
from typing import Any

from armcell.control.ur_controller.network import Link, Network
from armcell.control.ur_controller.robot import Robot
from armcell.control.ur_controller.urscript.values import Vec

Wait = Generator[None, None, Any]


def socket_functions(
    robot: Robot, network: Network
) -> tuple[dict[str, Callable[..., Wait]], dict[str, Callable[..., Any]]]:
    """(those that wait, those that answer at once) for one program; its end closes the sockets."""
    links: dict[str, Link] = {}

    def close_all() -> None:
        for link in links.values():
            link.close()

    robot.on_program_end(close_all)

    def alive(name: str) -> Link | None:
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
        """`count` bytes, or None when they have not come in time (0: wait for ever)."""
        end = robot.time + timeout
        while True:
            link = links.get(name)
            if link is None:
                return None
            if len(link.received) >= count:
                data = bytes(link.received[:count])
                del link.received[:count]
                return data
            if not link.open or (timeout > 0 and robot.time > end - 0.5 * robot.period):
                return None
            yield

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

    waiting = (socket_open, socket_read_binary_integer, socket_read_byte_list, socket_read_line)
    return {f.__name__: f for f in waiting}, {
        "socket_close": socket_close,
        "socket_send_int": lambda value, name="socket_0": _send(name, struct.pack(">i", int(value))),
        "socket_send_byte": lambda value, name="socket_0": _send(name, bytes([int(value) & 255])),
        "socket_send_string": lambda text, name="socket_0": _send(name, str(text).encode()),
        "socket_send_line": lambda text, name="socket_0": _send(name, f"{text}\n".encode()),
    }
