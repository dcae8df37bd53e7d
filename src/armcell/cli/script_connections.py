"""Connections of `armcell run SCRIPT.py` to Unity, ROS 1 and ROS 2."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from typer.core import TyperCommand

from armcell import _interrupts
from armcell.cli.console import err, errors
from armcell.cli.ros1 import Join, check_own_master
from armcell.cli.ros2 import check_domain
from armcell.cli.ros_name_options import RosNameOptions, unused_remappings_warning
from armcell.cli.server_addresses import print_addresses
from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.moveit.session import Session

UNITY = "127.0.0.1:10000"
ADDRESS = re.compile(r"[\w.-]+:\d+")
LOOK = 0.1  # [s] between two checks whether the other end publishes


class UnityCommand(TyperCommand):
    """Typer command for ROS scripts, with the connection option `--unity`. The value HOST:PORT of the option
    can be omitted.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        full: list[str] = []
        for i, word in enumerate(args):
            if word == "--":
                return super().parse_args(ctx, [*full, *args[i:]])
            full.append(word)
            if word == "--unity" and not ADDRESS.fullmatch((args[i + 1 :] or [""])[0]):
                full.append(UNITY)
        return super().parse_args(ctx, full)


@dataclass(frozen=True)
class ScriptConnections:
    """Connections that a ROS script and its cell open to other programs: Unity, ROS 1 and ROS 2.

    Attributes:
        unity: HOST:PORT of the ROS-TCP endpoint, or None.
        ros1, own_master: join a ROS 1 graph; see `join` in ros1.py.
        ros2, domain: join a ROS 2 domain, instead of ROS_DOMAIN_ID.
        plan_only: the script controls a simulator or robot at the other end of the connection.
        names: namespace and remappings of the cell's and the script's names.
    """

    unity: str | None = None
    ros1: bool = False
    own_master: bool | None = None
    ros2: bool = False
    domain: int | None = None
    plan_only: bool = False
    names: RosNameOptions = RosNameOptions("", (), ())

    @property
    def given(self) -> bool:
        return self != ScriptConnections()

    def check(self) -> None:
        """Check that the command-line options for connections to Unity, ROS 1 and ROS 2 are consistent.

        Raises:
            InputError: the options do not go together.
        """
        check_own_master(self.ros1, self.own_master)
        check_domain(self.ros2, self.domain)
        if self.plan_only and not (self.unity or self.ros1 or self.ros2):
            raise InputError(
                "--plan-only needs a wire to the simulator or robot", hint="add --unity, --ros1 or --ros2"
            )
        if self.names.command_line and not (self.unity or self.ros1 or self.ros2):
            raise InputError(
                f"{self.names.command_line[0]} needs a wire to other programs",
                hint="add --unity, --ros1 or --ros2",
            )

    def words(self) -> list[str]:
        """Return the options for a script's connections (Unity, ROS
        1, ROS 2) in the form of a command line.
        """
        return [
            *(("--unity", self.unity) if self.unity else ()),
            *(["--ros1"] if self.ros1 else []),
            *(["--ros2"] if self.ros2 else []),
            *(["--plan-only"] if self.plan_only else []),
            *self.names.command_line,
        ]

    def reserve(self, stack: ExitStack, bus: Any) -> list[Join]:
        """Reserve the connections of a script (the ports for Unity and ROS 2),
        and return the functions that open them.

        The script session itself joins ROS 1.

        Raises:
            InputError: a port is in use, or an address or environment variable is wrong.
        """
        from armcell.cli.ros2 import join
        from armcell.cli.serve import address, serve_unity

        found: list[Join] = []
        if self.unity:
            host, port = address(self.unity)
            found.append(serve_unity(stack, bus, host, port, "auto"))
        if self.ros2:
            found.append(join(stack, bus, "armcell", self.domain, namespace=self.names.namespace))
        return found

    def open(self, session: Session, joins: Sequence[Join]) -> None:
        """Open the connections of a script's cell to other programs. With --plan-only, also wait until the
        other program sends joint states.
        """
        from armcell.ros.nodes import ServedPlanner

        if session.graph is not None:
            print_addresses(session.graph.endpoints(), errors)  # standard output belongs to the script
        for join in joins:
            wire = join()
            errors.print(wire.ready, markup=False, highlight=False, soft_wrap=True)
            print_addresses(wire.endpoints, errors)
        if odd := unused_remappings_warning(session.bus):
            err(odd)
        if not isinstance(session.served, ServedPlanner):
            return
        robot = session.served.driver
        if not robot.has_joint_states:
            err(f"waiting for /joint_states of the simulator or robot ({self._how()})")
        while not robot.has_joint_states:
            _interrupts.sleep(LOOK)

    def _how(self) -> str:
        if self.unity:
            return f"Unity, or `armcell sim CELL --connect {self.unity}`"
        return f"its own node, or `armcell sim CELL --ros{1 if self.ros1 else 2}`"
