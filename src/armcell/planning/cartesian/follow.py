"""Following a line: joint positions step by step, the spare joints of a redundant arm used to come through.

Each step is a descent from the one before. A redundant arm may move along its null space meanwhile: away
from joint limits, and where that does not come through, as `way_of_spare_joint` says. An arm without spare
joints has one way only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import Leaving, allowing, resting_pairs, touching
from armcell.core import SE3, CartesianRequest, Contact
from armcell.kinematics import IKSolver
from armcell.planning.cartesian.spare import way_of_spare_joint
from armcell.planning.cartesian.stops import (
    RELATIVE,
    SLIDING,
    TURNING,
    Stop,
    at_violation,
    collided,
    jumped,
    unreached,
    violated,
)
from armcell.planning.constraints.description import Manifold

Array = NDArray[np.float64]
Wish = Callable[
    [Array, int], Array
]  # (positions (n,), number of the step) -> how they would like to change (n,)

TASK = 6  # numbers of a pose: joints beyond so many are spare
ZONE, ZONE_SHARE = 0.35, 0.15  # [rad or m], and of the joint's range, from a limit in which it is left
GAIN = 0.15  # of the way out of that zone in one step
FASTEST = 0.05  # [rad or m] along the null space in one step


@dataclass(frozen=True, eq=False)
class Leg:
    """Joint positions (k, n) of the steps that were taken, and why there are no more (None: arrived)."""

    path: list[Array]
    stop: Stop | None


def _near(checker: KernelChecker, q: Array) -> list[Contact]:
    """What touches at q (n,), or is within the padding; the nearest pair if only the kernel says so."""
    if found := checker.exact.contacts(q):
        return found
    nearest = checker.exact.nearest(q)
    return [] if nearest is None else [nearest]


class Resting:
    """A start (n,) in resting contact: where the arm may stand on its way out.

    Attributes:
        contacts: at the start, deepest first.
    """

    def __init__(self, checker: KernelChecker, start: Array):
        self.contacts = touching(checker, start)
        near = resting_pairs(checker.exact, start)
        self._leaving = Leaving(checker.exact, start, near)
        self._others = KernelChecker(allowing(checker.scene, near), checker.joint_names)
        self._others.relax_margins(start)

    def refuses(self, q: Array) -> list[Contact] | None:
        """What keeps the arm from standing at q (n,), or None."""
        if (contact := self._leaving.refuses(q)) is not None:
            return [contact]
        return None if self._others.is_free(q) else _near(self._others, q)


class Follower:
    """Follows lines with one group's joints; the others stay at `rest` (dof,).

    Args:
        bounds: (n, 2) that the joints keep to.
        resting: where the start is in resting contact.
    """

    def __init__(
        self, request: CartesianRequest, ik: IKSolver, checker: KernelChecker | None,
        manifold: Manifold | None, rest: Array, bounds: Array, cancel: threading.Event,
        resting: Resting | None = None,
    ):  # fmt: skip
        self.cancel, self.resting = cancel, resting
        self.request, self.ik, self.checker, self.manifold = request, ik, checker, manifold
        self.rest, self.bounds = rest, np.ascontiguousarray(bounds)
        slides = np.array([ik.model.joint(name).type == "prismatic" for name in ik.joint_names])
        most = np.where(slides, request.prismatic_jump_threshold, request.jump_threshold)
        self.most = np.where(most > 0, most, np.inf)  # 0 switches the test off, as in MoveIt
        self.slides = slides
        span = bounds[:, 1] - bounds[:, 0]
        self.zone = np.where(np.isfinite(span), np.minimum(ZONE, ZONE_SHARE * span), 0.0)

    def leg(self, poses: list[SE3], start: Array) -> Leg:
        """The farthest way from start (n,) along poses that is found."""
        best = None
        for wish in self._wishes(poses, start):
            tried = self._walk(poses, start, wish)
            if best is None or len(tried.path) > len(best.path):
                best = tried
            if best.stop is None:
                break
        assert best is not None
        return best

    def _wishes(self, poses: list[SE3], start: Array) -> Iterator[Wish | None]:
        if len(start) <= TASK:
            yield None
            return
        yield self._from_limits
        yield None
        way = way_of_spare_joint(
            self.ik, poses, start, self.rest, self.bounds, self.zone, lambda q: self._refused(q) is None
        )
        if way is not None:
            yield lambda q, k: way[k] - q

    def _from_limits(self, q: Array, k: int) -> Array:
        low, high = self.bounds[:, 0] + self.zone - q, q - self.bounds[:, 1] + self.zone
        return GAIN * (np.maximum(low, 0.0) - np.maximum(high, 0.0))

    def _walk(self, poses: list[SE3], start: Array, wish: Wish | None) -> Leg:
        ik, q = self.ik, self._full(start)
        path: list[Array] = []
        last = start
        for k, pose in enumerate(poses):
            if self.cancel.is_set():
                break
            before = q.copy()
            step = None
            if wish is not None:
                step = wish(last, k)
                step *= min(1.0, FASTEST / max(float(np.max(np.abs(step))), 1e-12))
            metres, radians, ok = ik.descend(q, pose, wish=step, bounds=self.bounds)
            now = q[ik.columns].copy()
            if not ok:
                at = (now - self.bounds[:, 0] < 1e-3) | (self.bounds[:, 1] - now < 1e-3)
                limits = [name for name, yes in zip(ik.joint_names, at, strict=True) if yes]
                short = (metres, radians)
                return Leg(path, Stop(partial(unreached, ik, pose, before, q, short, limits)))
            moved = np.abs(now - last)
            worst = int(np.argmax(moved / self.most))
            if moved[worst] > self.most[worst]:
                jump = (ik.joint_names[worst], float(moved[worst]), float(self.most[worst]))
                kind = (SLIDING, "m") if self.slides[worst] else (TURNING, "rad")
                return Leg(path, Stop(partial(jumped, *jump, *kind)))
            if (stop := self._refused(now)) is not None:
                return Leg(path, stop)
            path.append(now)
            last = now
        return Leg(path, None)

    def _refused(self, q: Array) -> Stop | None:
        """Why the arm may not stand at q (n,), or None."""
        checker, manifold = self.checker, self.manifold
        if checker is not None and not checker.is_free(q):
            if self.resting is None:
                return Stop(lambda: collided(_near(checker, q)))
            if (found := self.resting.refuses(q)) is not None:
                return Stop(lambda: collided(found))
        if manifold is not None and at_violation(manifold, q):
            return Stop(lambda: violated(manifold, q))
        return None

    def _full(self, q: Array) -> Array:
        full = self.rest.copy()
        full[self.ik.columns] = q
        return full


def relative_jump(
    path: Array, names: tuple[str, ...], slides: NDArray[np.bool_], factor: float
) -> tuple[int, Stop] | None:
    """The first step of a path (k, n) that is longer than so many times the mean step, as MoveIt tells it.

    The length of a step is the sum of what the joints move. Args: slides (n,) which joints are prismatic.
    """
    moved = np.abs(np.diff(path, axis=0))
    steps = moved.sum(axis=1)
    if factor <= 0 or not len(steps) or not np.any(steps > factor * steps.mean()):
        return None
    k = int(np.argmax(steps > factor * steps.mean()))
    joint = int(np.argmax(moved[k]))
    unit = "m" if slides[joint] else "rad"
    return k, Stop(partial(jumped, names[joint], float(moved[k, joint]), factor, RELATIVE, unit))
