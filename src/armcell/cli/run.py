"""`armcell run`: perform a cell's task, or run a ROS script in a cell."""

from __future__ import annotations

import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import typer
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from armcell.cli.common_options import SEED, seed_or_default
from armcell.cli.console import check_writable, console, errors, millimeters, stage_table
from armcell.cli.gate import check_gate, gate_summary, warn_without_twin
from armcell.cli.goal_options import GAINS
from armcell.cli.page import ALLOW_HOST, HOST, PORT, PageAddress, print_page_address
from armcell.cli.ros_options import DOMAIN, NAMESPACE, OWN_MASTER, REMAP, parse_ros_names
from armcell.cli.run_record import RecordingOptions, add_picture_observers, begin_record, write_result_files
from armcell.cli.script import ScriptConnections
from armcell.core import Event, JointTrajectory, Observer, StateSample


def run(
    cell: str = typer.Argument(
        ...,
        metavar="CELL|SCRIPT.py",
        help="Built-in cell (see `armcell cells`), folder with cell.yaml, or YAML file; or a script.",
    ),
    arguments: list[str] = typer.Argument(None, metavar="[ARGUMENTS]", help="Of a script."),
    in_cell: str | None = typer.Option(
        None, "--cell", metavar="CELL", help="The cell that a script runs in."
    ),
    auto_grip: bool | None = typer.Option(
        None,
        "--auto-grip/--no-auto-grip",
        help="For a script: close a gripper where the arm rests with an object between its fingers. "
        "Default: only where the script commands no gripper.",
        show_default=False,
    ),
    unity: str | None = typer.Option(
        None,
        "--unity",
        metavar="[HOST:PORT]",
        show_default=False,
        help="For a script: open a ROS-TCP endpoint that Unity joins. [default address: 127.0.0.1:10000]",
    ),
    ros1: bool = typer.Option(
        False, "--ros1", help="For a script: it and its cell join the ROS 1 graph at ROS_MASTER_URI."
    ),
    own_master: bool | None = OWN_MASTER,
    ros2: bool = typer.Option(
        False, "--ros2", help="For a script: it and its cell join the ROS 2 domain ROS_DOMAIN_ID."
    ),
    domain: int | None = DOMAIN,
    plan_only: bool = typer.Option(
        False,
        "--plan-only",
        help="For a script, with a wire: the simulator or robot at the other end moves, not a cell here.",
    ),
    ns: str = NAMESPACE,
    remap: list[str] = REMAP,
    seed: int | None = SEED,
    mode: str = typer.Option(
        "sim", help="sim: physics. fake: follows exactly, no physics. real: the cell's real arms."
    ),
    view: bool = typer.Option(False, "--view", help="Show the cell live in the browser, in real time."),
    json_file: Path | None = typer.Option(
        None, "--json", metavar="FILE", help="Write the run's numbers as JSON."
    ),
    headless: bool = typer.Option(
        False,
        "--headless",
        help="For programs: no run folder, no pictures, no progress bar.",
    ),
    runs: Path = typer.Option(
        Path("runs"), metavar="FOLDER", help="Where run folders with report and record go."
    ),
    time_scale: float | None = typer.Option(
        None,
        min=0.001,
        help="1: real time, 0.2: slow motion. Default: 1 with --view, else as fast as it can.",
    ),
    set_: list[str] = typer.Option(
        [],
        "--set",
        metavar="PATH=VALUE",
        help="Another value than in the cell file, e.g. objects.cube.mass=0.3; may be repeated.",
    ),
    gains: str | None = GAINS,
    host: str = HOST,
    port: int = PORT,
    allow_host: list[str] = ALLOW_HOST,
    gate: Path | None = typer.Option(
        None,
        metavar="FILE",
        help="For mode real: the gate record. [default: <cell>.gate.json beside the cell]",
    ),
    without_gate: str | None = typer.Option(
        None, metavar="REASON", help="For mode real: run without a gate record; the reason is recorded."
    ),
    frames: list[str] = typer.Option(
        [],
        "--frames",
        metavar="CAMERA[=HZ]",
        help="Put a simulated camera's pictures into the record, 5 per second by default; may be repeated.",
    ),
) -> int:
    """Run the task of a cell in the physics simulation, or run a rospy or moveit_commander script in a cell.

    Prints the stage table and writes runs/<time>-<cell>/ with an HTML report, the numbers (result.json) and
    a record for Foxglove (run.mcap). Exit status 0 if the task succeeded, 1 if not.

    A script (SCRIPT.py --cell CELL) runs unchanged, with no ROS installed, in real time unless --time-scale
    is given; the exit status is that of the script. Arguments of the script follow --. Its run is recorded,
    too.

    With --unity, --ros1 or --ros2, other programs join the script's cell. With --plan-only as well, the
    script moves the simulator or robot at the other end (such as `armcell sim CELL --connect HOST:PORT`).
    """
    at = PageAddress(host, port, allow_host)
    wires = ScriptConnections(
        unity, ros1, own_master, ros2, domain, plan_only, parse_ros_names(ns, remap, None, ros1=False)
    )
    if json_file is not None:
        check_writable(json_file)
    if headless and view:
        raise typer.BadParameter("--headless and --view exclude each other")
    if cell.endswith(".py") or in_cell is not None:
        from armcell.cli.script import run_script_command

        if gate is not None:
            raise typer.BadParameter(
                "--gate is for a cell's own task; a script goes by --without-gate REASON"
            )

        return run_script_command(
            cell,
            in_cell,
            arguments or [],
            seed_or_default(seed, mode),
            mode,
            time_scale,
            auto_grip,
            view,
            at,
            without_gate,
            RecordingOptions(None if headless else runs, json_file, frames),
            set_,
            wires,
            gains,
        )
    seed = seed_or_default(seed, mode)
    if wires.given:
        option = (wires.words() or ["--own-master" if own_master is not None else "--domain"])[0]
        raise typer.BadParameter(
            f"{option} is for scripts; a cell is served by `armcell serve {cell} {option}`"
        )
    if arguments:
        raise typer.BadParameter(f"unexpected argument {arguments[0]!r}")
    kept = RecordingOptions(None if headless else runs, json_file, frames)
    progress = None
    if not headless and errors.is_terminal:
        progress = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24), TimeElapsedColumn(),
            console=errors, transient=True,
        )  # fmt: skip
    with ExitStack() as stack:
        loading = None
        if progress is not None:
            stack.enter_context(progress)
            loading = progress.add_task(
                "loading (the first run on a machine compiles for about half a minute)", total=None
            )
        # imported late: physics and planners load slowly
        from armcell.cell import announce_code, gains_as_values, load, parse_value, run_task, with_values
        from armcell.cell import health as layers
        from armcell.drivers import drivers
        from armcell.planning import warm_up

        drivers[mode]  # report an unknown mode first
        health = layers.Health()
        stack.callback(_tell_failed_layer, health, headless)
        with health.layer("description"):
            loaded = load(cell)
            values = {**gains_as_values(loaded, gains), **dict(parse_value(one) for one in set_)}
            loaded = with_values(loaded, values)
            layers.check_description(loaded)
        with health.layer("controllers"):
            layers.check_controllers(loaded, mode)
        announce_code(loaded)
        passed = check_gate(loaded, mode, gate, without_gate)
        warm_up()
        scene = loaded.scene(seed)
        observers: list[Observer] = []
        viewer = None
        if view:
            from armcell.viewer import CellViewer

            viewer = stack.enter_context(CellViewer(scene, title=loaded.name, **at._asdict()))
            observers.append(viewer)
            print_page_address(viewer.page)
            time_scale = time_scale or 1.0
        recorder = begin_record(loaded, scene, seed, mode, kept, values, **passed)
        if recorder is not None:
            stack.enter_context(recorder)
            observers.append(recorder)
        if progress is not None and loading is not None:
            progress.remove_task(loading)
            observers.append(_Bar(progress))
        live = loaded.connect(mode, seed, observers, time_scale)
        warn_without_twin(live.driver, cell)
        add_picture_observers(live, loaded, mode, recorder, kept)
        with ExitStack() as connected:
            with health.layer("drivers"):
                connected.enter_context(live)
                layers.check_driver(live)
            with health.layer("planner") as said:
                said.append(layers.check_planner(live))
            with health.layer("task"):
                layers.check_task(loaded)
            if passed:
                live.ctx.emit("note", gate_summary(passed))
            result = {**run_task(loaded, live, seed, mode), **passed, "layers": health.now(live)}
        sets = [part for one in set_ for part in ("--set", one)]
        sets += [] if gains is None else ["--gains", gains]
        draw = [] if seed is None else ["--seed", str(seed)]
        result["command"] = shlex.join(["armcell", "run", cell, *draw, "--mode", mode, *sets])
        if progress is not None:
            progress.stop()
        _print(result)
        report = write_result_files(recorder, result, json_file)
        if report is not None:
            console.print(f"report: {report}", soft_wrap=True)
        if viewer is not None and sys.stdin.isatty():
            console.print("the view stays open; press Enter to end")
            sys.stdin.readline()
    return 0 if result["success"] else 1


def _tell_failed_layer(health: Any, headless: bool) -> None:
    """Print the state of each layer of the cell if a layer failed to start in `armcell run`.

    The error message follows separately. If the description failed, print nothing: the error message is
    sufficient.
    """
    if (
        not headless
        and health.states["description"] == "ok"
        and any(state.startswith("failed") for state in health.states.values())
    ):
        words = (f"{name} {state.partition(':')[0]}" for name, state in health.states.items())
        errors.print("start: " + ", ".join(words), highlight=False)


def _print(result: dict[str, Any]) -> None:
    from armcell.cell import run_failures

    console.print(stage_table(result))
    numbers = [
        f"slip in hold {millimeters(result['slip_m'], 3)}" if result["slip_m"] is not None else "",
        f"placed {millimeters(result['placement_error_m'], 2)} off"
        if result["placement_error_m"] is not None
        else "",
        f"clearance {millimeters(result['min_clearance_m'])}"
        if result["min_clearance_m"] is not None
        else "",
        f"unwanted contacts {len(result['unwanted_contacts'])}",
        f"welds {len(result['welds'])}",
        f"task {result['task_time_s']:.1f} s",
        f"planning {result['total_planning_time_s']:.2f} s",
    ]
    console.print(", ".join(n for n in numbers if n))
    ill = [f"{name} {state}" for name, state in result["layers"].items() if state != "ok"]
    console.print("layers: " + ("; ".join(ill) or "all ok"), markup=False, highlight=False)
    for line in run_failures(result):
        console.print(f"[red]{line}[/red]", highlight=False)
    if result["success"]:
        draw = "things where the cell file says" if result["seed"] is None else f"seed {result['seed']}"
        console.print(f"[green]success[/green] ({draw})")
    else:
        console.print(f"[red]failed[/red]: {result['error_name']}: ", end="")
        console.print(result["message"], markup=False)


class _Bar:
    """Progress bar of `armcell run`, which shows the present stage.
    It pulses because the number of stages is unknown.
    """

    def __init__(self, progress: Progress):
        self._progress = progress
        self._task = progress.add_task("planning", total=None)
        self._stage = "planning"

    def on_state(self, sample: StateSample) -> None:
        self._progress.update(self._task, description=f"{self._stage}  (t = {sample.time:.1f} s)")

    def on_event(self, event: Event) -> None:
        if event.kind == "stage":
            self._stage = event.text if event.data.get("phase") == "begin" else "planning"

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass
