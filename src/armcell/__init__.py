"""armcell: a robot work cell in one install.

Plan like MoveIt, grasp in real physics, run the same task on simulated or real arms.

    import armcell

    cell = armcell.load("panda_pick")
    with cell.connect(mode="sim") as live:
        live.arm.pick("cube")
        live.arm.place("cube", on="tray")
"""

from __future__ import annotations

import sys
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any

from armcell._cache import use_cache

use_cache()  # before anything imports numba

__version__ = "0.1.0"

if TYPE_CHECKING:
    from armcell.cell import Cell, LiveCell, load
    from armcell.core import (
        SE3,
        SO3,
        ArmcellError,
        Box,
        Capsule,
        CartesianRequest,
        Cone,
        Constraints,
        Cylinder,
        ErrorCode,
        Event,
        InputError,
        JointConstraint,
        JointGoal,
        JointPath,
        JointState,
        JointTrajectory,
        Mesh,
        NamedGoal,
        OrientationConstraint,
        Outcome,
        Plane,
        PlanRequest,
        PlanResult,
        PointCloud,
        PoseGoal,
        PositionConstraint,
        SequenceRequest,
        Sphere,
        VisibilityConstraint,
    )
    from armcell.kinematics import ik_solver
    from armcell.model import RobotModel, load_robot
    from armcell.planning import explain, plan, plan_cartesian, plan_sequence
    from armcell.scene import CollisionObject, PlanningScene

__all__ = [
    "SE3",
    "SO3",
    "ArmcellError",
    "Box",
    "Capsule",
    "CartesianRequest",
    "Cell",
    "CollisionObject",
    "Cone",
    "Constraints",
    "Cylinder",
    "ErrorCode",
    "Event",
    "InputError",
    "JointConstraint",
    "JointGoal",
    "JointPath",
    "JointState",
    "JointTrajectory",
    "LiveCell",
    "Mesh",
    "NamedGoal",
    "OrientationConstraint",
    "Outcome",
    "PlanRequest",
    "PlanResult",
    "Plane",
    "PlanningScene",
    "PointCloud",
    "PoseGoal",
    "PositionConstraint",
    "RobotModel",
    "SequenceRequest",
    "Sphere",
    "VisibilityConstraint",
    "__version__",
    "explain",
    "ik_solver",
    "load",
    "load_robot",
    "plan",
    "plan_cartesian",
    "plan_sequence",
]

# Imported on first use, so that `import armcell` and `armcell --help` stay fast.
_MODULE_OF = dict.fromkeys(__all__, "armcell.core") | {
    "Cell": "armcell.cell",
    "LiveCell": "armcell.cell",
    "load": "armcell.cell",
    "ik_solver": "armcell.kinematics",
    "RobotModel": "armcell.model",
    "load_robot": "armcell.model",
    "explain": "armcell.planning",
    "plan": "armcell.planning",
    "plan_cartesian": "armcell.planning",
    "plan_sequence": "armcell.planning",
    "CollisionObject": "armcell.scene",
    "PlanningScene": "armcell.scene",
}
_SUBPACKAGES = {module.name for module in iter_modules(__path__) if module.ispkg}


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        from armcell.core.gc_pauses import gc_paused

        with gc_paused():
            return getattr(import_module(_MODULE_OF[name]), name)
    if name in _SUBPACKAGES:
        return import_module(f"armcell.{name}")
    raise AttributeError(f"module 'armcell' has no attribute {name!r}")


def _report_with_new_name(
    kind: type[BaseException], error: BaseException, trace: Any, report: Any = sys.excepthook
) -> None:
    """Report an exception that ends the program. If the program used a name that armcell has renamed, the
    traceback ends with the new name.
    """
    from armcell._renamed import new_name

    if note := new_name(error):
        error.add_note(note)
    report(kind, error, trace)


sys.excepthook = _report_with_new_name


def __dir__() -> list[str]:
    return sorted({*__all__, *_SUBPACKAGES, *globals()})
