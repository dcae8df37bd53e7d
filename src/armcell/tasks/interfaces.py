"""Checks of stage interfaces before planning: every stage must find its inputs.

Stages declare in `requires`, `provides` and `consumes` which data of a solution they read, add and remove.
`holding("cube")` is the name for "a hand holds the cube". The fields `object`, `support`, `group` and `link`
of a stage must exist in the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Protocol, cast

from armcell.core import InputError
from armcell.scene import PlanningScene
from armcell.tasks.search import PartialSolution, Stage


def holding_condition(item: str) -> str:
    """Return the name with which stages declare the condition "a hand holds the object".

    Stages list this name in `requires`, `provides` or `consumes`.
    """
    return f"{item} in a hand"


class TaskError(InputError):
    """Error for a task with stages whose interfaces do not fit together. `problems` lists all faults."""

    def __init__(self, problems: Sequence[str], task: str = ""):
        self.problems = tuple(problems)
        super().__init__("; ".join(problems), element=f"task {task!r}" if task else None)


class Container(Stage, Protocol):
    """Stage that contains other stages and checks that their interfaces fit together."""

    stages: tuple[Stage, ...]

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck: ...


@dataclass(frozen=True)
class InterfaceCheck:
    """Result of an interface check: the names that are available
    after a stage of a task, and the problems found.
    """

    have: frozenset[str]
    problems: tuple[str, ...] = ()


def check_task(stages: Sequence[Stage], start: PartialSolution, name: str = "") -> None:
    """Check the interfaces of a task's stages: every stage must find the inputs that it requires.

    Raises:
        TaskError: lists all missing inputs and unknown names.
    """
    found = serial(stages, available(start), start.scene)
    if found.problems:
        raise TaskError(found.problems, name)


def available(start: PartialSolution) -> frozenset[str]:
    """Return the names of the data that are available at the interface of a task's first stage."""
    return frozenset(start.data) | {holding_condition(item) for item in start.scene.attached}


def serial(stages: Sequence[Stage], have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
    """Check the interfaces (inputs and outputs) of stages that run in sequence."""
    problems: list[str] = []
    for i, stage in enumerate(stages):
        later = {name: s.name for s in stages[:i:-1] for name in getattr(s, "provides", ())}
        found = single(stage, have, scene, later)
        problems += found.problems
        have = found.have
    return InterfaceCheck(have, tuple(problems))


def single(
    stage: Stage, have: frozenset[str], scene: PlanningScene | None, later: Mapping[str, str] = {}
) -> InterfaceCheck:
    """Check the interface (inputs and outputs) of one stage.
    If the stage is a container, its inner stages are checked too.

    Args:
        later: names of later stages, by the names that they provide.
    """
    label = f"stage {stage.name!r} ({type(stage).__name__})"
    requires = frozenset(getattr(stage, "requires", ()))
    problems = [
        f"{label} requires {need!r}"
        + (f", which {later[need]!r} provides only later" if need in later else "")
        for need in sorted(requires - have)
    ]
    problems += [f"{label}: {unknown}" for unknown in _unknown(stage, scene)]
    provides = frozenset(getattr(stage, "provides", ()))
    have = have | requires  # report a missing name once, not for every later stage
    if hasattr(stage, "check_interface"):
        inner = cast(Container, stage).check_interface(have, scene)
        problems += [f"in {stage.name!r}: {problem}" for problem in inner.problems]
        have = inner.have
    return InterfaceCheck((have - frozenset(getattr(stage, "consumes", ()))) | provides, tuple(problems))


def _unknown(stage: Stage, scene: PlanningScene | None) -> Iterator[str]:
    """Check the interface of a stage: yield a message for each name
    in its fields that does not exist in the scene.
    """
    if scene is None:
        return
    model, objects = scene.model, {*scene.objects, *scene.attached}
    places = {
        "object": ("object", objects),
        "support": ("object", objects),
        "group": ("planning group", model.groups),
        "link": ("link", model.links),
    }
    for field, (kind, known) in places.items():
        name = getattr(stage, field, "")
        if isinstance(name, str) and name and name not in known:
            near = get_close_matches(name, list(known), n=1)
            mean = f" (did you mean {near[0]!r}?)" if near else f" (known: {', '.join(sorted(known)[:8])})"
            yield f"no {kind} {name!r}{mean}"
