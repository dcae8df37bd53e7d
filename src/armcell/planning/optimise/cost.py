"""What it costs to be near something: of whole paths, with CHOMP's gradient."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.planning.optimise.distance_field import DistanceField, distance_field
from armcell.planning.optimise.spheres import Meetings, Spheres

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

SELF_CLEARANCE = 0.01  # [m] wanted between the robot's own spheres: neighbours are near by build
BENT = 20.0  # [1/m] the largest curvature that counts: spheres that hardly move have any
REFUSED = 0.02  # of a configuration that is not free; a link 20 mm deep over 100 mm costs about as much
STILL = 1e-6  # [m] a sphere that moves less per step has no direction


class ObstacleCost:
    """Costs of configurations of one checker's group, from signed distances of its spheres.

    Args:
        clearance: [m] beyond the padding from which on being near costs something.
    """

    def __init__(self, checker: KernelChecker, clearance: float):
        self.checker, self.spheres = checker, Spheres(checker)
        self.meetings = Meetings(checker, self.spheres)
        self.clearance = clearance
        s, pack = self.spheres, checker.pack
        objects = tuple(checker.scene.objects[name] for name in checker.names.objects)
        self._fields: list[tuple[DistanceField, NDArray[np.int64], F32]] = []
        if not objects:
            return
        margin = np.asarray(pack.margin)[s.body]  # (s, o)
        # Spheres whose bodies may touch the same objects share a field.
        kinds, which = np.unique((margin >= 0) & s.moving[:, None], axis=0, return_inverse=True)
        for number, row in enumerate(kinds):
            mine = np.flatnonzero(which.ravel() == number)
            some = tuple(objects[k] for k in np.flatnonzero(row))
            if some:
                pad = np.where(row, margin[mine], 0.0).max(axis=1)
                field = distance_field(some, s.low, s.high)
                self._fields.append((field, mine, (s.radius[mine] + pad).astype(np.float32)))

    def of_paths(self, paths: Array) -> Array:
        """Cost (k, m) at each waypoint of paths (k, m, n): spheres' costs times the way they come.

        Only groups of spheres that are near something are looked at sphere by sphere. What the checker
        refuses for whatever reason costs REFUSED more: without a gradient that is all that is needed.
        """
        k, m, n = paths.shape
        s, q = self.spheres, paths.reshape(-1, n)
        R, o = s.frame_poses(q)
        at = s.group_centres(R, o)
        speed = np.linalg.norm(_moved(at.reshape(k, m, -1, 3)), axis=-1).reshape(k * m, -1) + STILL
        total = np.array([0.0 if self.checker.is_free(p) else REFUSED for p in q])
        for field, mine, radius in self._fields:
            of_sphere = np.zeros(len(s.radius), np.float32)
            of_sphere[mine] = radius
            groups = np.flatnonzero(np.isin(s.members[:, 0], mine))
            room = s.group_radius[groups] + (of_sphere - s.radius)[s.members[groups, 0]] + self.clearance
            d = field.distances(at[:, groups].reshape(-1, 3)).reshape(k * m, -1)
            which, near = np.nonzero(d < room)
            group = groups[near]
            members = s.members[group]
            frame = s.frame[members[:, 0]]
            x = np.einsum("gij,gkj->gki", R[which, frame], s.centre[members]) + o[which, frame][:, None]
            d = field.distances(x.astype(np.float32).reshape(-1, 3)).reshape(members.shape)
            c = _hinge(d - of_sphere[members], self.clearance)[0] * s.own[group]
            total += np.bincount(which, c.sum(axis=1) * speed[which, group], minlength=len(total))
        return total.reshape(k, m)

    def gradient(self, path: Array) -> tuple[float, Array, float]:
        """CHOMP's functional gradient of a path (m, n), ends included: cost, (m, n), smallest distance [m].

        Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013, eq. 16:
        |x'| ((1 - t t^T) grad c - c k) for each sphere, with its direction t and curvature vector k.
        """
        R, o = self.spheres.frame_poses(path)
        x = self.spheres.centres(R, o)
        value, pull = np.zeros(x.shape[:2], np.float32), np.zeros_like(x)
        least = np.inf
        for field, mine, radius in self._fields:
            d, g = field.gradients(x[:, mine].reshape(-1, 3))
            d = d.reshape(len(x), -1) - radius
            least = min(least, float(d[1:-1].min(initial=np.inf)))
            c, slope = _hinge(d, self.clearance)
            value[:, mine] = c
            pull[:, mine] = slope[..., None] * g.reshape(len(x), -1, 3)
        which, a, b, gap = self.meetings.nearest(R, o, x, SELF_CLEARANCE)
        if len(which):
            inner = (which > 0) & (which < len(path) - 1)
            least = min(least, float(gap[inner].min(initial=np.inf)))
            c, slope = _hinge(gap, SELF_CLEARANCE)
            away = x[which, a] - x[which, b]
            away *= (slope / np.maximum(np.linalg.norm(away, axis=1), 1e-6))[:, None]
            np.add.at(pull, (which, a), away)
            np.add.at(pull, (which, b), -away)
            np.add.at(value, (which, a), c)
            np.add.at(value, (which, b), c)
        v = _moved(x[None])[0]
        speed = np.linalg.norm(v, axis=-1)
        t = v / np.maximum(speed, STILL)[..., None]
        bend = np.zeros_like(x)
        bend[1:-1] = x[2:] - 2 * x[1:-1] + x[:-2]
        bend -= np.einsum("msi,msi->ms", bend, t)[..., None] * t
        bend /= np.maximum(speed, STILL)[..., None] ** 2
        across = pull - np.einsum("msi,msi->ms", pull, t)[..., None] * t
        full = speed[..., None] * (across - value[..., None] * np.clip(bend, -BENT, BENT))
        return float((value * speed).sum()), self.spheres.joint_gradient(R, o, x, full), least


def _hinge(d: F32, clearance: float) -> tuple[F32, F32]:
    """Cost and its slope at distances d [m]: linear inside, a parabola up to the clearance, then nothing."""
    near = np.clip(clearance - d, 0.0, clearance)
    cost = near * near / (2 * clearance) + np.maximum(-d, 0.0)
    return cost.astype(np.float32), (-near / clearance).astype(np.float32)


def _moved(x: NDArray) -> NDArray:
    """How far points (k, m, s, 3) move per step, by central differences."""
    out = np.empty_like(x)
    out[:, 1:-1] = 0.5 * (x[:, 2:] - x[:, :-2])
    out[:, 0], out[:, -1] = x[:, 1] - x[:, 0], x[:, -1] - x[:, -2]
    return out
