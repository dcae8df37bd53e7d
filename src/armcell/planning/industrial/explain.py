"""A blend that cannot be made: the largest radius that works."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from armcell.core import ArmcellError, Explanation, Outcome, PlanResult, SequenceRequest, Suggestion
from armcell.scene import PlanningScene

HALVINGS = 5
SPARE = 1.02  # what is said to be slow enough is by so much slower


def change_blend_radius(
    scene: PlanningScene, sequence: SequenceRequest, number: int, radius: float
) -> tuple[PlanningScene, SequenceRequest]:
    """Another blend radius [m] after one of the motions, counted from 0."""
    items = list(sequence.items)
    items[number] = (items[number][0], radius)
    return scene, replace(sequence, items=tuple(items))


def slow_motions(
    scene: PlanningScene, sequence: SequenceRequest, number: int, factor: float
) -> tuple[PlanningScene, SequenceRequest]:
    """The motion counted from 0 and the next one slower by a factor >= 1."""
    items = list(sequence.items)
    for k in (number, number + 1):
        request, radius = items[k]
        slower = replace(
            request,
            velocity_scaling=request.velocity_scaling / factor,
            acceleration_scaling=request.acceleration_scaling / factor**2,
        )
        items[k] = (slower, radius)
    return scene, replace(sequence, items=tuple(items))


def explain_blend(
    scene: PlanningScene, sequence: SequenceRequest, outcome: Outcome,
    solve: Callable[[PlanningScene, Any], PlanResult], seconds: float,
) -> Explanation:  # fmt: skip
    """What was wrong, and how much smaller the radius or how much slower the motions would have to be."""
    deadline, number = time.monotonic() + seconds, outcome.evidence["item"]
    radius = sequence.items[number][1]

    def tried(changed: tuple[PlanningScene, SequenceRequest]) -> bool:
        try:
            return solve(*changed).ok
        except ArmcellError:
            return False

    def works(smaller: float) -> bool:
        return tried(change_blend_radius(scene, sequence, number, smaller))

    low, high = 0.0, radius
    suggestions: list[Suggestion] = []
    factor = SPARE * outcome.evidence.get("slower", 1.0)
    if "slower" in outcome.evidence and tried(slow_motions(scene, sequence, number, factor)):
        text = f"make motions {number + 1} and {number + 2} {factor:.3g} times slower"
        arguments = {"number": number, "factor": factor}
        suggestions.append(Suggestion(text, slow_motions, arguments, factor - 1.0, works=True))
    if works(0.0):
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            if time.monotonic() > deadline:
                break
            low, high = (middle, high) if works(middle) else (low, middle)
        text = (
            f"give motion {number + 1} a blend radius of {low * 1000:.3g} mm instead of {radius * 1000:.3g}"
        )
        arguments = {"number": number, "radius": low}
        suggestions.append(Suggestion(text, change_blend_radius, arguments, radius - low, works=True))
    summary = outcome.message
    if suggestions:
        summary += f"; it would work to {suggestions[0].text}"
    contacts = tuple(outcome.evidence.get("contacts", ()))
    return Explanation(
        outcome.code, summary, suggestions=tuple(suggestions), contacts=contacts, data=outcome.evidence
    )
