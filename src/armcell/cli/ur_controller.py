"""`armcell ur-controller`: an emulated Universal Robots controller."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from armcell.cli.console import console, print_addresses
from armcell.cli.emulate import run_emulator
from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.emulators.ur.notices import Notice

EXAMPLES = """
Examples:

  armcell ur-controller --model UR10e --host 127.0.0.2     one arm, joints follow without physics

  armcell ur-controller --cell six_axis_pick               the cell's arm, in physics

  armcell ur-controller --model UR10 --host 127.0.0.2 --host 127.0.0.3    two arms in one process

  armcell ur-controller --cell dual_ur10_rod --host 127.0.0.2 --host 127.0.0.3    both in one world

  armcell ur-dashboard 127.0.0.2 "armcell reset"    puts arms and objects back to their start

  armcell ur-dashboard 127.0.0.2 "armcell protective stop"    buttons and faults ("armcell help" lists them)
"""


def ur_controller(
    model: str = typer.Option(
        "UR10", help="UR3, UR5, UR10 (CB3, 125 Hz), UR3e, UR5e, UR10e, UR16e, UR20 or UR30 (500 Hz)."
    ),
    software: str | None = typer.Option(
        None, metavar="VERSION", help="Software that the controllers report and speak, such as 3.4 or 5.11."
    ),
    host: list[str] = typer.Option(
        ["127.0.0.2"], help="Address to serve; give it once per arm. A UR's ports are fixed."
    ),
    serial: list[str] = typer.Option([], help="Serial number per arm. Default: 20260001, 20260002, ..."),
    cell: str | None = typer.Option(None, help="Put the arms into this cell's physics, one host per arm."),
    seed: int | None = typer.Option(None, min=0, help="Draw of the cell's randomised values."),
    calibration: int | None = typer.Option(
        None, min=0, help="Seed of each arm's deviation from nominal geometry. Default: none."
    ),
    local: bool = typer.Option(False, "--local", help="Begin in local control (e-Series)."),
    external_control: list[str] = typer.Option(
        [],
        metavar="ADDRESS[:PORT]",
        help="The URCap External Control is installed and asks this script sender (port 50002) for its "
        "program: dashboard 'load external_control.urp', 'play'. Once for all arms, or once per arm.",
    ),
    trace: Path | None = typer.Option(
        None, metavar="FILE", help="Write every control step of every arm (ur_controller.controller.TRACE)."
    ),
    reset_between_runs: bool = typer.Option(
        False,
        "--reset-between-runs",
        help="Put arms and objects back to their start once all RTDE clients have left for 1 s, so that "
        "the same run works again. At any time: armcell ur-dashboard HOST 'armcell reset'.",
    ),
    off: bool = typer.Option(False, "--off", help="Begin powered off."),
) -> int:
    """Emulate controllers of Universal Robots until Ctrl-C, with ports for RTDE, dashboard and scripts.

    Runs with real-time priority if permitted (as root on Linux).
    """
    from armcell.emulators.rack import SharedWorld
    from armcell.emulators.ur import ControllerSettings, PhysicsPlant, RemoteHost, UrRack

    hosts = list(host)
    if len(set(hosts)) != len(hosts):
        raise InputError("two arms have the same address", hint="such as --host 127.0.0.2 --host 127.0.0.3")
    plants: list = [None] * len(hosts)
    if cell is not None:
        from armcell.cell import load
        from armcell.sim import SimWorld

        loaded = load(cell)
        arms = [g.name for g in loaded.model.groups.values() if g.tip_link and len(g.joint_names) == 6]
        if len(arms) != len(hosts):
            raise InputError(
                f"cell {cell!r} has {len(arms)} arms ({', '.join(arms)}), {len(hosts)} addresses are given",
                hint="give --host once per arm",
            )
        shared = SharedWorld(SimWorld(loaded.scene(seed), loaded.physics))
        plants = [PhysicsPlant(shared, arm, model) for arm in arms]
    senders = [RemoteHost.parse(each) for each in external_control]
    if len(senders) not in (0, 1, len(hosts)):
        raise InputError(
            f"{len(senders)} script senders for {len(hosts)} arms",
            hint="give --external-control once per arm",
        )
    remotes = senders if len(senders) == len(hosts) else (senders or [None]) * len(hosts)
    serials = [*serial, *(f"2026{i + 1:04d}" for i in range(len(serial), len(hosts)))]
    settings = [
        ControllerSettings(
            model,
            h,
            s,
            None if calibration is None else calibration + i,
            remote=not local,
            powered=not off,
            external_control=remote,
            software=software,
        )
        for i, (h, s, remote) in enumerate(zip(hosts, serials, remotes))
    ]
    file = trace.open("wb", buffering=0) if trace is not None else None
    rack = UrRack(settings, plants, file, reset_between_runs)
    rack.open()
    for each, controller in zip(settings, rack.controllers, strict=True):
        console.print(f"{each.model} (serial {each.serial}) at {each.host}", soft_wrap=True)
        print_addresses(controller.network.endpoints)
        controller.robot.listeners.append(partial(_print_notice, each.host))
    run_emulator(rack, file)
    return 0


def _print_notice(host: str, notice: Notice) -> None:
    """Print a notice of an emulated UR controller, as the teach pendant would show it."""
    from armcell.emulators.ur.notices import Popup, ScriptFault

    if isinstance(notice, Popup | ScriptFault):
        console.print(f"{host}: {notice}", soft_wrap=True, markup=False, highlight=False)


def ur_dashboard(
    host: str = typer.Argument(..., help="The robot's address."),
    command: list[str] = typer.Argument(..., help='What to send, such as "robotmode" or "power on".'),
) -> int:
    """Send a command to the dashboard server of a real or emulated UR robot, and print the answer.

    Common commands: robotmode, safetymode, power on, brake release, unlock protective stop, pause, play.
    """
    from armcell.drivers.ur.dashboard import DashboardClient

    with DashboardClient(host) as dashboard:
        console.print(dashboard.ask(" ".join(command)), markup=False, highlight=False)
    return 0
