"""PTP, LIN or CIRC that stops, touches or asks too much of a joint: slower, otherwise, or freely."""

from __future__ import annotations

import numpy as np

from armcell.core import Constraints, ErrorCode, PlanRequest
from armcell.planning.explanation.case import Case, tell_margins
from armcell.planning.explanation.changes import change_request
from armcell.planning.explanation.contacts import free_objects
from armcell.planning.problem import INDUSTRIAL, normalized_pipeline_id

POINTS = ("interim", "center")  # parameters of CIRC alone


def is_told(case: Case) -> bool:
    """Whether it is such a motion that failed on its way, and not its start or its goal."""
    request, result = case.request, case.result
    return (
        isinstance(request, PlanRequest)
        and normalized_pipeline_id(request.pipeline_id) == INDUSTRIAL
        and ("fraction" in result.evidence or result.code is ErrorCode.INVALID_MOTION_PLAN)
    )


def told_motion(case: Case) -> None:
    request, evidence = case.request, case.result.evidence
    assert isinstance(request, PlanRequest)
    tell_margins(case)
    case.data["planner"] = request.planner_id
    if "fraction" in evidence:
        case.data["fraction"] = evidence["fraction"]
    if "slower" in evidence:
        slower = {k: evidence[k] for k in ("velocity_scaling", "acceleration_scaling")}
        told = " and ".join(f"{name} {value:.3g}" for name, value in slower.items())
        case.suggest(f"move slower: {told}", change_request, slower, effort=evidence["slower"] - 1.0)
    case.contacts = list(evidence.get("contacts", ()))
    if "positions" in evidence:
        case.state = case.group_state(evidence["positions"])
    _otherwise(case, request)
    if case.contacts:
        free_objects(case, [evidence["positions"]], case.contacts, padded=True)


def _otherwise(case: Case, request: PlanRequest) -> None:
    """Another of these motions to the same goal, or one that is searched."""
    ours = {k: v for k, v in request.parameters.items() if k not in POINTS}
    less = {"path_constraints": Constraints()} if request.planner_id == "CIRC" else {}
    for name in ("LIN", "PTP"):
        if name != request.planner_id:
            parameters = {k: v for k, v in ours.items() if name != "PTP" or k == "smoothing"}
            case.suggest(
                f"move by {name}",
                change_request,
                {"planner_id": name, "parameters": parameters, **less},
                effort=float(np.inf),
            )
    freely = {"pipeline_id": "native", "planner_id": "RRTConnect", "parameters": {}, "planner_configs": {}}
    case.suggest(
        "go there freely: plan with RRTConnect of pipeline native", change_request, {**freely, **less},
        effort=float(np.inf),
    )  # fmt: skip
