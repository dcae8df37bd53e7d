"""Diagnosis of failed PTP, LIN and CIRC motions and blends.

The suggestions are slower motions, another motion type, or a smaller blend radius.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.core import (
    ArmcellError,
    Constraints,
    ErrorCode,
    Explanation,
    Outcome,
    PlanRequest,
    PlanResult,
    SequenceRequest,
    Suggestion,
)
from armcell.planning.diagnosis.changes import change_request
from armcell.planning.diagnosis.contacts import suggest_freeing_objects
from armcell.planning.diagnosis.diagnosis import Diagnosis, report_limit_margins
from armcell.planning.planners.registry import PILZ, normalized_pipeline_id
from armcell.scene import PlanningScene

POINTS = ("interim", "center")  # parameters of CIRC alone


def is_pilz_motion_failure(diagnosis: Diagnosis) -> bool:
    """Return whether the failure of a PTP, LIN or CIRC motion lies on its path, not in its start or goal."""
    request, result = diagnosis.request, diagnosis.result
    return (
        isinstance(request, PlanRequest)
        and normalized_pipeline_id(request.pipeline_id) == PILZ
        and ("fraction" in result.evidence or result.code is ErrorCode.INVALID_MOTION_PLAN)
    )


def explain_pilz_motion(diagnosis: Diagnosis) -> None:
    """Explain why a PTP, LIN or CIRC motion failed, and suggest changes that make the motion succeed."""
    request, evidence = diagnosis.request, diagnosis.result.evidence
    assert isinstance(request, PlanRequest)
    report_limit_margins(diagnosis)
    diagnosis.data["planner"] = request.planner_id
    if "fraction" in evidence:
        diagnosis.data["fraction"] = evidence["fraction"]
    if "slower" in evidence:
        slower = {k: evidence[k] for k in ("velocity_scaling", "acceleration_scaling")}
        text = " and ".join(f"{name} {value:.3g}" for name, value in slower.items())
        diagnosis.suggest(f"move slower: {text}", change_request, slower, effort=evidence["slower"] - 1.0)
    diagnosis.contacts = list(evidence.get("contacts", ()))
    if "positions" in evidence:
        diagnosis.state = diagnosis.group_state(evidence["positions"])
    _otherwise(diagnosis, request)
    if diagnosis.contacts:
        suggest_freeing_objects(diagnosis, [evidence["positions"]], diagnosis.contacts, padded=True)


def _otherwise(diagnosis: Diagnosis, request: PlanRequest) -> None:
    """Suggest replacing a failed PTP, LIN or CIRC motion with a
    different type of motion or with a path search.
    """
    ours = {k: v for k, v in request.parameters.items() if k not in POINTS}
    less = {"path_constraints": Constraints()} if request.planner_id == "CIRC" else {}
    for name in ("LIN", "PTP"):
        if name != request.planner_id:
            parameters = {k: v for k, v in ours.items() if name != "PTP" or k == "smoothing"}
            diagnosis.suggest(
                f"move by {name}",
                change_request,
                {"planner_id": name, "parameters": parameters, **less},
                effort=float(np.inf),
            )
    freely = {"pipeline_id": "native", "planner_id": "RRTConnect", "parameters": {}, "planner_configs": {}}
    diagnosis.suggest(
        "go there freely: plan with RRTConnect of pipeline native", change_request, {**freely, **less},
        effort=float(np.inf),
    )  # fmt: skip


HALVINGS = 5
SPARE = 1.02  # safety factor of the suggested slowdown


def change_blend_radius(
    scene: PlanningScene, sequence: SequenceRequest, number: int, radius: float
) -> tuple[PlanningScene, SequenceRequest]:
    """Apply a suggested change to a failed Pilz sequence: set the blend radius [m] at the end of one
    motion.
    """
    items = list(sequence.items)
    items[number] = (items[number][0], radius)
    return scene, replace(sequence, items=tuple(items))


def slow_motions(
    scene: PlanningScene, sequence: SequenceRequest, number: int, factor: float
) -> tuple[PlanningScene, SequenceRequest]:
    """Apply a suggested change to a failed Pilz sequence: slow down two consecutive motions by a factor. The
    first of them has the index `number`.
    """
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
    """Explain why two PTP, LIN or CIRC motions cannot be blended, and find the largest radius or speed that
    works.
    """
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
