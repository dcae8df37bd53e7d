"""`armcell franka-controller`: an emulated Franka controller."""

from __future__ import annotations

import socket
from pathlib import Path

import typer

from armcell.cli.console import console, print_addresses
from armcell.cli.emulate import run_emulator
from armcell.core import ArmcellError, InputError

EXAMPLES = """
Examples:

  armcell franka-controller --model fr3 --host 127.0.0.3          an arm and a hand, in physics

  armcell franka-controller --cell panda_pick --host 127.0.0.3    the cell's arm and objects

  armcell franka-operator 127.0.0.3 "user stop on"     buttons and Desk ("help" lists all)

  armcell franka-operator 127.0.0.3 "fault loss 0.2"   faults
"""


def franka_controller(
    model: str = typer.Option("fr3", help="fr3 or panda: the limits that the controller enforces."),
    protocol: int | None = typer.Option(
        None, help="Version of Franka's protocol: 5 or 10. [default: 5 for a panda, 10 for an fr3]"
    ),
    host: str = typer.Option("127.0.0.3", help="Address to serve. A Franka's ports are fixed."),
    cell: str | None = typer.Option(
        None, help="Put the arm into this cell's physics. Default: an arm with a hand in free space."
    ),
    seed: int | None = typer.Option(None, min=0, help="Seed of the cell's randomized values."),
    locked: bool = typer.Option(False, "--locked", help="Begin with locked brakes."),
    inactive: bool = typer.Option(False, "--inactive", help="Begin without active FCI (Desk)."),
    unhomed: bool = typer.Option(False, "--unhomed", help="Begin with a hand that is not homed."),
    trace: Path | None = typer.Option(
        None, metavar="FILE", help="Write every control step (emulators.franka.controller.TRACE)."
    ),
    reset_between_runs: bool = typer.Option(
        False,
        "--reset-between-runs",
        help="Put the arm and objects back to their start once the client has left for 1 s.",
    ),
) -> int:
    """Emulate a Franka controller until Ctrl-C, with FCI commands, states at 1 kHz and a hand.

    Runs with real-time priority if permitted (as root on Linux).
    """
    from armcell.emulators.franka import (
        ControllerSettings,
        FrankaPlant,
        FrankaRack,
        scene_without_cell,
        torque_world,
    )
    from armcell.emulators.rack import SharedWorld

    if cell is None:
        world = torque_world(scene_without_cell())
    else:
        from armcell.cell import load

        loaded = load(cell)
        world = torque_world(loaded.scene(seed), loaded.physics)
    chains = {tuple(g.joint_names): g.name for g in world.robot.groups.values() if g.tip_link}
    arms = [name for joints, name in chains.items() if len(joints) == 7]
    if len(arms) != 1:
        raise InputError(
            f"cell {cell!r} has {len(arms)} groups of seven joints with a tip", hint="use a cell with one arm"
        )
    plant = FrankaPlant(SharedWorld(world), arms[0])
    settings = ControllerSettings(
        model, host, locked=locked, active=not inactive, homed=not unhomed, protocol=protocol
    )
    file = trace.open("wb", buffering=0) if trace is not None else None
    rack = FrankaRack([settings], [plant], arms, file, reset_between_runs)
    rack.open()
    controller = rack.controllers[0]
    console.print(f"{model} at {host}, protocol {settings.version}", soft_wrap=True)
    print_addresses(controller.network.endpoints)
    controller.robot.listeners.append(
        lambda text: console.print(f"{host}: {text}", soft_wrap=True, markup=False, highlight=False)
    )
    run_emulator(rack, file)
    return 0


def franka_operator(
    host: str = typer.Argument(..., help="The emulated robot's address."),
    command: list[str] = typer.Argument(..., help='What to do, such as "user stop on" or "help".'),
) -> int:
    """Act as the operator of an emulated Franka robot: user stop, brakes, Desk and injected faults."""
    from armcell.emulators.franka.operator_server import PORT

    try:
        with socket.create_connection((host, PORT), timeout=2.0) as sock, sock.makefile("rw") as file:
            file.write(" ".join(command) + "\n")
            file.flush()
            answer = file.readline().strip()
    except OSError as error:
        raise ArmcellError(
            f"no emulated Franka answers at {host}:{PORT}: {error.strerror or error} "
            "(start one with armcell franka-controller)"
        ) from None
    console.print(answer, markup=False, highlight=False, soft_wrap=True)
    return 0
