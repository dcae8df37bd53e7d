"""Is a task whole? Every stage's needs against what the stages before it give, before anything is planned.

Stages say in `needs`, `gives` and `takes` which of a draft's data they read, add and end. That something is
in a hand is one of these names too: `holding("cube")`. Fields called `object`, `support`, `group` or `link`
are names in the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Protocol, cast

from armcell.core import InputError
from armcell.scene import PlanningScene
from armcell.tasks.search import Draft, Stage


def holding(item: str) -> str:
    """The name in a stage's interface of an object's being in a hand."""
    return f"{item} in a hand"


class TaskError(InputError):
    """A task whose stages do not fit together; `problems` has all of them, a line each."""

    def __init__(self, problems: Sequence[str], task: str = ""):
        self.problems = tuple(problems)
        super().__init__("; ".join(problems), element=f"task {task!r}" if task else None)


class Container(Stage, Protocol):
    """A stage that has stages, and says what they may use and what it then gives."""

    stages: tuple[Stage, ...]

    def checked(self, have: frozenset[str], scene: PlanningScene | None) -> Checked: ...


@dataclass(frozen=True)
class Checked:
    """What is there after a stage, and what was missing on the way."""

    have: frozenset[str]
    problems: tuple[str, ...] = ()


def check_task(stages: Sequence[Stage], start: Draft, name: str = "") -> None:
    """Check that every stage finds what it needs.

    Raises:
        TaskError: some do not; it lists all of them.
    """
    found = serial(stages, available(start), start.scene)
    if found.problems:
        raise TaskError(found.problems, name)


def available(start: Draft) -> frozenset[str]:
    """What there is before the first stage."""
    return frozenset(start.data) | {holding(item) for item in start.scene.attached}


def serial(stages: Sequence[Stage], have: frozenset[str], scene: PlanningScene | None) -> Checked:
    """Stages after one another."""
    problems: list[str] = []
    for i, stage in enumerate(stages):
        later = {name: s.name for s in stages[:i:-1] for name in getattr(s, "gives", ())}
        found = single(stage, have, scene, later)
        problems += found.problems
        have = found.have
    return Checked(have, tuple(problems))


def single(
    stage: Stage, have: frozenset[str], scene: PlanningScene | None, later: Mapping[str, str] = {}
) -> Checked:
    """One stage, or a container with what is in it.

    Args:
        later: stages that come after it, by what they give.
    """
    label = f"stage {stage.name!r} ({type(stage).__name__})"
    needs = frozenset(getattr(stage, "needs", ()))
    problems = [
        f"{label} lacks {need!r}" + (f", which {later[need]!r} gives only after it" if need in later else "")
        for need in sorted(needs - have)
    ]
    problems += [f"{label}: {unknown}" for unknown in _unknown(stage, scene)]
    gives = frozenset(getattr(stage, "gives", ()))
    have = have | needs  # what is lacking is said once, not again by every stage after it
    if hasattr(stage, "checked"):
        inner = cast(Container, stage).checked(have, scene)
        problems += [f"in {stage.name!r}: {problem}" for problem in inner.problems]
        have = inner.have
    return Checked((have - frozenset(getattr(stage, "takes", ()))) | gives, tuple(problems))


def _unknown(stage: Stage, scene: PlanningScene | None) -> Iterator[str]:
    """Names in a stage's fields that are not in the scene."""
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
