"""`armcell check`: check a cell without running it; `armcell cells`: list built-in cells."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.table import Table

from armcell.cli.console import check_writable, console, write_json

if TYPE_CHECKING:
    from armcell.cell import Cell

Finding = tuple[bool, str, str]  # passed, name of the check, result


def check(
    cell: str = typer.Argument(..., help="Built-in cell, folder with cell.yaml, or YAML file."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the findings as JSON."),
) -> int:
    """Check a cell without running it. The checks cover its files, limits, start state and objects, and test
    whether the arm can reach the objects.

    Exit status 0 if all checks pass, 1 with the hints if not.
    """
    from armcell.cell import load

    if json_file is not None:
        check_writable(json_file)
    found = list(findings(load(cell)))  # load raises an InputError with file, element and hint
    table = Table(box=None, pad_edge=False, show_header=False)
    for sound, what, text in found:
        table.add_row("[green]ok[/green]" if sound else "[red]no[/red]", what, text)
    console.print(table)
    if json_file is not None:
        write_json(json_file, [{"ok": s, "check": w, "found": t} for s, w, t in found])
    return 0 if all(sound for sound, _, _ in found) else 1


def findings(cell: Cell) -> Iterator[Finding]:
    """Yield the results of `armcell check` for a cell's limits, start state, objects and task."""
    model, scene = cell.model, cell.scene()
    yield True, "cell file", str(cell.file)
    yield True, "robot", f"{model.name}: {len(model.links)} links, {model.dof} actuated joints"
    yield from _limits(model)
    yield from _start(scene)
    yield from _objects(scene)
    yield from _cameras(cell, scene)
    yield from _task(cell, scene)


def _limits(model) -> Iterator[Finding]:
    for kind in ("velocity", "acceleration"):
        missing = [n for n in model.joint_names if not getattr(model.joints[n].limits, kind) < float("inf")]
        hint = f"{', '.join(missing)} have none: add them to the robot's joint_limits.yaml"
        yield not missing, f"{kind} limits", hint if missing else "every joint has one"


def _start(scene) -> Iterator[Finding]:
    from armcell.collision import ExactChecker

    contacts = ExactChecker(scene).contacts(scene.positions, padded=False)
    found = "; ".join(c.describe() for c in contacts[:3])
    yield (
        not contacts,
        "start state",
        f"{found}: choose another 'start' or move the object" if contacts else "touches nothing",
    )


def _objects(scene) -> Iterator[Finding]:
    from armcell.collision.exact_checker import overlaps

    for name, item in scene.objects.items():
        if not item.movable:
            continue
        inside = overlaps(scene, name)
        text = ", ".join(f"{depth * 1000:.1f} mm inside {other}" for other, depth in inside)
        yield not inside, f"object {name}", f"{text}: raise or move it" if inside else "overlaps nothing"


def _cameras(cell, scene) -> Iterator[Finding]:
    from armcell.cell.cameras import in_view

    for camera in cell.cameras:
        parts = [f"{camera.width} x {camera.height} at {camera.rate:g} Hz"]
        parts += [f"on {camera.link}"] if camera.link else []
        if not camera.has_depth:
            parts.append("no depth: pictures and markers only")
        else:
            parts.append("depth without noise" if camera.noise.is_none else "depth with noise")
        seen = in_view(camera, scene)
        parts.append(f"sees {', '.join(seen)}" if seen else "no object is in its view: turn it to one")
        yield bool(seen), f"camera {camera.name}", "; ".join(parts)


def _task(cell, scene) -> Iterator[Finding]:
    for step in cell.spec.task:
        item = step.transfer.object if step.transfer else step.pick
        if item is not None:
            yield _pick(cell, scene, item, step.arm)
        if step.goal is not None:
            yield _place(scene, step.goal)


def _pick(cell, scene, name: str, arm: str | None) -> Finding:
    from armcell.core import InputError
    from armcell.grasping import grasp_candidates, hand_of, nearest_miss

    item, what = scene.object(name), f"pick {name}"
    if not item.movable:
        return False, what, "the object is fixed: give it 'movable: true'"
    try:
        gripper = cell.model.gripper(arm_group=arm)
    except InputError as error:
        return False, what, str(error)
    grasps, rejected = grasp_candidates(
        item, hand_of(cell.model, gripper), pose_error=cell.settings.pose_error
    )
    if not grasps:
        miss = nearest_miss(rejected)
        return False, what, f"no grasp: {miss.reason if miss else 'no candidates'}"
    return _reach(cell, scene, name, gripper)


def _place(scene, goal) -> Finding:
    from armcell.core import InputError
    from armcell.grasping import place_candidates

    what = f"place {goal.object}"
    try:
        found = place_candidates(scene.object(goal.object), scene.object(goal.on), goal.at, up=goal.up)
    except InputError as error:
        return False, what, str(error)
    if not found:
        return False, what, f"does not stand on {goal.on} with {list(goal.up)} up"
    return True, what, f"{len(found)} places on {goal.on}"


def _reach(cell, scene, item: str, gripper) -> Finding:
    from armcell.planning import prepare_group
    from armcell.tasks import PartialSolution, SearchState, search
    from armcell.tasks.stages import ChooseGrasp

    prepare_group(scene, gripper.arm_group)  # otherwise compilation would use up the search time
    planning = SearchState(cell.settings)
    stage = ChooseGrasp(item, gripper, cell.settings.near, cell.settings.approach_distance)
    solution = search([stage], PartialSolution(scene), planning)
    if solution is None:
        return False, f"pick {item}", planning.rejections.summary()
    return True, f"pick {item}", f"reachable ({solution.data['candidate']})"


def cells() -> None:
    """List the built-in cells and robots."""
    from armcell.cell import built_in_cells
    from armcell.model import robot_names

    table = Table(box=None, pad_edge=False, show_header=False)
    for cell in built_in_cells():
        table.add_row(cell.name, cell.description)
    console.print(table)
    console.print(f"robots: {', '.join(robot_names())}")
