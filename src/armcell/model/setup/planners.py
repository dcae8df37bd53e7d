"""OMPL planners and their parameters, as MoveIt's Setup Assistant writes ompl_planning.yaml."""

from __future__ import annotations

from typing import Any

_RANGE = {"range": 0.0}  # [rad] longest motion that the planner adds to its tree; 0: OMPL chooses
_BIAS = {"range": 0.0, "goal_bias": 0.05}
_PIECES = {"border_fraction": 0.9, "failed_expansion_score_factor": 0.5, "min_valid_path_fraction": 0.5}
_SPARSE = {"stretch_factor": 3.0, "sparse_delta_fraction": 0.25, "dense_delta_fraction": 0.001}

PLANNERS: dict[str, dict[str, Any]] = {
    "AnytimePathShortening": {"shortcut": True, "hybridize": True, "max_hybrid_paths": 24, "num_planners": 4},
    "SBL": _RANGE,
    "EST": _BIAS,
    "LBKPIECE": {"range": 0.0, "border_fraction": 0.9, "min_valid_path_fraction": 0.5},
    "BKPIECE": _RANGE | _PIECES,
    "KPIECE": _BIAS | _PIECES,
    "RRT": _BIAS,
    "RRTConnect": _RANGE,
    "RRTstar": _BIAS | {"delay_collision_checking": 1},
    "TRRT": _BIAS
    | {
        "max_states_failed": 10,
        "temp_change_factor": 2.0,
        "min_temperature": 1e-9,
        "init_temperature": 1e-5,
        "frountier_threshold": 0.0,
        "frountierNodeRatio": 0.1,
        "k_constant": 0.0,
    },
    "PRM": {"max_nearest_neighbors": 10},
    "PRMstar": {},
    "FMT": {
        "num_samples": 1000,
        "radius_multiplier": 1.1,
        "nearest_k": 1,
        "cache_cc": 1,
        "heuristics": 0,
        "extended_fmt": 1,
    },
    "BFMT": {
        "num_samples": 1000,
        "radius_multiplier": 1.0,
        "nearest_k": 1,
        "balanced": 0,
        "optimality": 1,
        "heuristics": 1,
        "cache_cc": 1,
        "extended_fmt": 1,
    },
    "PDST": {},
    "STRIDE": _BIAS
    | {
        "use_projected_distance": 0,
        "degree": 16,
        "max_degree": 18,
        "min_degree": 12,
        "max_pts_per_leaf": 6,
        "estimated_dimension": 0.0,
        "min_valid_path_fraction": 0.2,
    },
    "BiTRRT": _RANGE
    | {
        "temp_change_factor": 0.1,
        "init_temperature": 100,
        "frountier_threshold": 0.0,
        "frountier_node_ratio": 0.1,
        "cost_threshold": 1e300,
    },
    "LBTRRT": _BIAS | {"epsilon": 0.4},
    "BiEST": _RANGE,
    "ProjEST": _BIAS,
    "LazyPRM": _RANGE,
    "LazyPRMstar": {},
    "SPARS": _SPARSE | {"max_failures": 1000},
    "SPARStwo": _SPARSE | {"max_failures": 5000},
}


def config_name(planner: str) -> str:
    """Return the name of an OMPL planner in a MoveIt configuration's ompl_planning.yaml, such as
    `RRTConnectkConfigDefault`.
    """
    return f"{planner}kConfigDefault"


def planner_configs() -> dict[str, dict[str, Any]]:
    """Return the block `planner_configs` of ompl_planning.yaml with all known OMPL planners."""
    return {config_name(n): {"type": f"geometric::{n}", **values} for n, values in PLANNERS.items()}
