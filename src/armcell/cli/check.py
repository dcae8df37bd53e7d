"""`armcell check`: is a cell sound? And `armcell cells`: which are built in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import typer
from rich.table import Table

from armcell.cli.console import console, write_json

Finding = tuple[bool, str, str]  # sound, what was looked at, what was found


def check(
    cell: str = typer.Argument(..., help="Built-in cell, folder with cell.yaml, or YAML file."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the findings as JSON."),
) -> int:
    """Check a cell without running it: files, limits, start state, objects, reach.

    Exit status 0 if all is sound, 1 with the cures if not.
    """
    findings = list(_findings(cell))
    table = Table(box=None, pad_edge=False, show_header=False)
    for sound, what, text in findings:
        table.add_row("[green]ok[/green]" if sound else "[red]no[/red]", what, text)
    console.print(table)
    if json_file is not None:
        write_json(json_file, [{"ok": s, "check": w, "found": t} for s, w, t in findings])
    return 0 if all(sound for sound, _, _ in findings) else 1


def _findings(name: str) -> Iterator[Finding]:
    from armcell.cell import load

    cell = load(name)  # raises with file, element and cure
    model, scene = cell.model, cell.scene()
    yield True, "cell file", str(cell.file)
    yield True, "robot", f"{model.name}: {len(model.links)} links, {model.dof} actuated joints"
    yield from _limits(model)
    yield from _start(scene)
    yield from _objects(scene)
    yield from _task(cell, scene)


def _limits(model) -> Iterator[Finding]:
    for kind in ("velocity", "acceleration"):
        missing = [n for n in model.joint_names if not getattr(model.joints[n].limits, kind) < float("inf")]
        cure = f"{', '.join(missing)} have none: add them to the robot's joint_limits.yaml"
        yield not missing, f"{kind} limits", cure if missing else "every joint has one"


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
    from armcell.collision.exact import overlaps

    for name, item in scene.objects.items():
        if not item.movable:
            continue
        inside = overlaps(scene, name)
        text = ", ".join(f"{depth * 1000:.1f} mm inside {other}" for other, depth in inside)
        yield not inside, f"object {name}", f"{text}: raise or move it" if inside else "overlaps nothing"


def _task(cell, scene) -> Iterator[Finding]:
    from armcell.grasping import grasp_candidates

    for step in cell.spec.task:
        if step.pick is None:
            continue
        item = scene.object(step.pick)
        if not item.movable:
            yield False, f"pick {step.pick}", "the object is fixed: give it 'movable: true'"
            continue
        grasps, rejected = grasp_candidates(item, model_gripper(cell))
        if not grasps:
            yield (
                False,
                f"pick {step.pick}",
                f"no grasp: {rejected[0].reason if rejected else 'no candidates'}",
            )
            continue
        yield _reach(cell, scene, step.pick)


def model_gripper(cell):
    return next(iter(cell.model.grippers.values()))


def _reach(cell, scene, item: str) -> Finding:
    from armcell.tasks import Draft, Planning, search
    from armcell.tasks.stages import ChooseGrasp

    gripper = model_gripper(cell)
    planning = Planning(cell.settings)
    stage = ChooseGrasp(item, gripper, cell.settings.near, cell.settings.approach_distance)
    draft = search([stage], Draft(scene), planning)
    if draft is None:
        return False, f"pick {item}", planning.rejections.summary()
    return True, f"pick {item}", f"reachable ({draft.data['candidate']})"


def cells() -> None:
    """List the built-in cells and robots."""
    from armcell.cell import built_in_cells
    from armcell.model import robot_names

    table = Table(box=None, pad_edge=False, show_header=False)
    for cell in built_in_cells():
        table.add_row(cell.name, cell.description)
    console.print(table)
    console.print(f"robots: {', '.join(robot_names())}")
