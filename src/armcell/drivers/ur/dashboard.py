"""Client of a UR dashboard server: power, brakes, stops, and the robot's identity."""

from __future__ import annotations

import contextlib
import re
import socket

from armcell.core import ArmcellError, InputError

PORT = 29999


class DashboardClient:
    """Connection to the dashboard server of a UR robot. `with` connects and disconnects."""

    def __init__(self, host: str, port: int = PORT, timeout: float = 3.0):
        self.host, self._port, self._timeout = host, port, timeout

    def __enter__(self) -> DashboardClient:
        """Connect to the dashboard server.

        Raises:
            InputError: no server answers, or the server is not a UR dashboard.
        """
        try:
            self._socket = socket.create_connection((self.host, self._port), self._timeout)
        except OSError as error:
            raise InputError(
                f"no robot answers at {self.host}:{self._port} ({error.strerror or error})",
                hint="check the address on the pendant (Settings, System, Network), the cable, and that this "
                f"computer is in the same subnet: ping {self.host}",
            ) from None
        self._file = self._socket.makefile("rwb")
        try:
            greeting = self._line()
        except (OSError, ArmcellError):
            greeting = ""
        if "Universal Robots Dashboard" not in greeting:
            self.__exit__()
            raise InputError(
                f"{self.host}:{self._port} is not a Universal Robots dashboard (it says {greeting[:60]!r})",
                hint="check the address",
            )
        return self

    def __exit__(self, *exc: object) -> None:
        with contextlib.suppress(OSError):  # flushing the last bytes may fail
            self._file.close()
        self._socket.close()

    def _line(self) -> str:
        line = self._file.readline(4096)
        if not line.endswith(b"\n"):
            raise ArmcellError(f"the dashboard of {self.host} closed the connection")
        return line.decode("utf-8", "replace").strip()

    def ask(self, command: str) -> str:
        """Send a command to the UR dashboard server, and return its answer, which is one line.

        Raises:
            ArmcellError: the dashboard does not answer.
        """
        try:
            self._file.write(command.encode() + b"\n")
            self._file.flush()
            return self._line()
        except OSError as error:
            raise ArmcellError(f"the dashboard of {self.host} does not answer {command!r}: {error}") from None

    def word(self, command: str) -> str:
        """Send a command to the UR dashboard server, and return the last word of the answer.

        For example, `robotmode` is answered by `Robotmode: RUNNING`; the result is RUNNING.
        """
        return (self.ask(command).rsplit(maxsplit=1) or [""])[-1]

    def version(self) -> tuple[int, ...]:
        """Return the software version of the UR controller from the dashboard: major, minor, bugfix."""
        found = re.search(r"(\d+)\.(\d+)\.(\d+)", self.ask("PolyscopeVersion"))
        if found is None:
            raise ArmcellError(f"the dashboard of {self.host} does not tell its version")
        return tuple(int(n) for n in found.groups())

    def in_remote_control(self) -> bool | None:
        """Ask the UR dashboard whether the robot is in remote control.
        The answer is None for CB3, which lacks this mode.
        """
        answer = self.ask("is in remote control").lower()
        return answer == "true" if answer in ("true", "false") else None
