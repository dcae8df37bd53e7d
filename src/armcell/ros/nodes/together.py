"""Whether motions of different arms may run at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import JointTrajectory
from armcell.scene import PlanningScene

STEP = 0.02  # [s] between the places that are joined by straight lines and proven
SHIFTS = (0.0, -0.15, 0.15)  # [s] that one motion may be late or early against the others


def contact_together(scene: PlanningScene, running: Sequence[JointTrajectory], new: JointTrajectory) -> str:
    """What would touch if a motion began now beside others that run; empty where nothing does.

    Proven for motions in step and for the new one up to 0.15 s early or late: arms do not keep their times
    to the millisecond.

    Args:
        scene: as it is now.
        running: what is left of the others' motions.
    """
    names = tuple(n for t in (*running, new) for n in t.joint_names)
    scene = replace(scene, positions=np.clip(scene.positions, scene.model.lower, scene.model.upper))
    checker = KernelChecker(scene, names)
    for shift in SHIFTS:
        certificate = checker.certify(_waypoints(running, new, shift))
        if not certificate.free:
            found = certificate.contact
            return found.describe() if found is not None else "the motions meet"
    return ""


def _waypoints(running: Sequence[JointTrajectory], new: JointTrajectory, shift: float) -> np.ndarray:
    """Positions (k, n) of all joints, one motion's after the other's."""
    end = max([t.duration for t in running] + [new.duration + abs(shift)])
    times = np.linspace(0.0, end, max(int(np.ceil(end / STEP)), 1) + 1)
    rows = [np.array([t.sample(s)[0] for s in times]) for t in running]
    rows.append(np.array([new.sample(s + shift)[0] for s in times]))
    return np.hstack(rows)
