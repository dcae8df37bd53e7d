"""Obstacle cost of whole paths with CHOMP's gradient, on spheres that cover the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.planning.planners.distance_field import DistanceField, distance_field

Array = NDArray[np.float64]
F32 = NDArray[np.float32]


class RobotSpheres:
    """Spheres that approximate the bodies moved by a planning group.
    The obstacle cost is computed from these spheres.

    The spheres come from the kernel's pack. Shapes use s for spheres and m for configurations.

    Attributes:
        body: (s,) body of each sphere. radius: (s,) [m]. moving: (s,) whether the group moves the sphere.
        members: (g, 8) spheres of each group, the last repeated as padding; own (g, 8): False for the
            padding.
        group_radius: (g,) radius of the ball around each group [m].
        low, high: (3,) bounds of all sphere centers [m].
    """

    def __init__(self, checker: KernelChecker):
        p = checker.pack
        self.dof, self.frames = p.dof, len(p.parent)
        self._parent, self._kind, self._column = p.parent, p.kind, p.column
        self._fixed = np.asarray(p.fixed, float).reshape(-1, 3, 4)
        self._multiplier, self._offset = np.asarray(p.multiplier, float), np.asarray(p.offset, float)
        per_body = np.diff(p.group_spheres[p.body_groups])
        self.body = np.repeat(np.arange(len(p.frame)), per_body)
        self.frame = p.frame[self.body]
        self.center = np.asarray(p.sphere[:, :3], np.float32)
        # Mean of the inner ball (filled by the solid) and the outer ball (holds the solid).
        self.radius = (0.5 * (p.sphere[:, 3] + p.sphere[:, 4])).astype(np.float32)
        self.moving = self.frame > 0
        reach = (
            np.linalg.norm(self._fixed[1:, :, 3], axis=1).sum() + np.linalg.norm(self.center, axis=1).max()
        )
        slides = np.abs([checker.model.joints[n].limits.upper for n in checker.joint_names])
        if np.any(self._kind == 2):
            reach += float(slides[np.isfinite(slides)].sum())
        base = self._fixed[1, :, 3] if self.frames > 1 else np.zeros(3)
        self.low, self.high = base - reach, base + reach
        first, end = p.group_spheres[:-1], p.group_spheres[1:]
        most = int(np.max(end - first, initial=1))
        numbers = first[:, None] + np.arange(most)
        self.members, self.own = np.minimum(numbers, end[:, None] - 1), numbers < end[:, None]
        self._group_center = np.asarray(p.group_sphere[:, :3], np.float32)
        self.group_radius = np.asarray(p.group_sphere[:, 3], np.float32)
        self._group_frame = self.frame[self.members[:, 0]]
        self._of_frame = [np.flatnonzero(self.frame == f) for f in range(self.frames)]

    def frame_poses(self, q: Array) -> tuple[Array, Array]:
        """Compute the rotations (m, f, 3, 3) and origins (m, f, 3) of the robot's frames at positions q (m,
        n), for the obstacle cost.
        """
        m = len(q)
        R, o = np.empty((m, self.frames, 3, 3)), np.empty((m, self.frames, 3))
        R[:, 0], o[:, 0] = np.eye(3), 0.0
        for f in range(1, self.frames):
            F, parent = self._fixed[f], self._parent[f]
            A = R[:, parent] @ F[:, :3]
            at = o[:, parent] + R[:, parent] @ F[:, 3]
            value = self._multiplier[f] * q[:, self._column[f]] + self._offset[f]
            if self._kind[f] == 2:
                R[:, f], o[:, f] = A, at + value[:, None] * A[:, :, 2]
                continue
            c, s = np.cos(value)[:, None], np.sin(value)[:, None]
            R[:, f, :, 0] = A[:, :, 0] * c + A[:, :, 1] * s
            R[:, f, :, 1] = A[:, :, 1] * c - A[:, :, 0] * s
            R[:, f, :, 2] = A[:, :, 2]
            o[:, f] = at
        return R, o

    def centers(self, R: Array, o: Array) -> F32:
        """Compute the world positions (m, s, 3) [m] of the robot's spheres, for the obstacle cost."""
        return self._placed(R, o, self.center, self.frame)

    def group_centers(self, R: Array, o: Array) -> F32:
        """Compute the world positions (m, g, 3) [m] of the balls that enclose groups of the robot's spheres,
        for the obstacle cost.
        """
        return self._placed(R, o, self._group_center, self._group_frame)

    def _placed(self, R: Array, o: Array, points: F32, frame: NDArray) -> F32:
        out = np.empty((len(R), len(points), 3), np.float32)
        for f in range(self.frames):
            mine = np.flatnonzero(frame == f)
            turn = np.swapaxes(R[:, f], 1, 2).astype(np.float32)
            out[:, mine] = points[mine] @ turn + o[:, f, None].astype(np.float32)
        return out

    def joint_gradient(self, R: Array, o: Array, x: F32, pull: F32) -> Array:
        """Compute the gradient (m, n) of the obstacle cost in joint space from the forces `pull` (m, s, 3) on
        the robot's spheres, which have positions x (m, s, 3).

        The result is the sum of J^T f over the spheres.
        """
        m = len(R)
        force, moment = np.zeros((m, self.frames, 3)), np.zeros((m, self.frames, 3))
        turning = np.cross(x, pull)
        for f, mine in enumerate(self._of_frame):
            if len(mine):
                force[:, f] = pull[:, mine].sum(axis=1)
                moment[:, f] = turning[:, mine].sum(axis=1)
        out = np.zeros((m, self.dof))
        for f in range(self.frames - 1, 0, -1):  # a joint carries all frames after it
            axis = R[:, f, :, 2]
            about = moment[:, f] - np.cross(o[:, f], force[:, f])
            effect = force[:, f] if self._kind[f] == 2 else about
            out[:, self._column[f]] += self._multiplier[f] * np.einsum("mi,mi->m", axis, effect)
            force[:, self._parent[f]] += force[:, f]
            moment[:, self._parent[f]] += moment[:, f]
        return out


class SelfCollisionPairs:
    """Pairs of sphere groups on the robot that could collide with each other; the obstacle cost includes such
    self-collisions.
    """

    def __init__(self, checker: KernelChecker, spheres: RobotSpheres):
        p = checker.pack
        rows = np.repeat(np.arange(len(p.near_groups)), np.diff(p.meet))
        self.a, self.b = p.near_groups[rows], p.meet_groups
        self.spheres = spheres

    def nearest(
        self, R: Array, o: Array, x: F32, within: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], F32]:
        """For each self-collision pair, find the two nearest spheres if they are closer than `within` [m].
        The obstacle cost depends on their distance.

        Return configurations, spheres of both groups and gaps [m].
        """
        s = self.spheres
        at, radius = s.group_centers(R, o), s.radius
        apart = at[:, self.a] - at[:, self.b]
        room = s.group_radius[self.a] + s.group_radius[self.b] + within
        which, pair = np.nonzero(np.einsum("mpi,mpi->mp", apart, apart) < room * room)
        i, j = s.members[self.a[pair]], s.members[self.b[pair]]
        gaps = (
            np.linalg.norm(x[which[:, None], i][:, :, None] - x[which[:, None], j][:, None], axis=-1)
            - radius[i][:, :, None]
            - radius[j][:, None]
        )
        best = gaps.reshape(len(which), -1).argmin(axis=1)
        rows = np.arange(len(which))
        k, n = np.divmod(best, i.shape[1]) if len(which) else (best, best)
        return which, i[rows, k], j[rows, n], gaps.reshape(len(which), -1)[rows, best]


SELF_CLEARANCE = 0.01  # [m] between the robot's own spheres; neighbors are close by design
BENT = 20.0  # [1/m] largest curvature used: the curvature of slow spheres is unbounded
REFUSED = 0.02  # cost of a configuration that is not free, like a link 20 mm deep over 100 mm
STILL = 1e-6  # [m] smallest motion per step with a direction


class ObstacleCost:
    """Obstacle cost of a planning group's configurations, computed from the signed distances between the
    robot's spheres and the obstacles.

    Args:
        clearance: [m] distance beyond the padding below which an obstacle adds cost.
    """

    def __init__(self, checker: KernelChecker, clearance: float):
        self.checker, self.spheres = checker, RobotSpheres(checker)
        self.self_pairs = SelfCollisionPairs(checker, self.spheres)
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
        """Compute the obstacle cost (k, m) at every waypoint of several paths (k, m, n).

        The cost is the sum of sphere costs times sphere speeds. Only sphere groups near an obstacle are
        evaluated sphere by sphere. A configuration that the checker rejects for another reason costs REFUSED
        more, which suffices without a gradient.
        """
        k, m, n = paths.shape
        s, q = self.spheres, paths.reshape(-1, n)
        R, o = s.frame_poses(q)
        at = s.group_centers(R, o)
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
            x = np.einsum("gij,gkj->gki", R[which, frame], s.center[members]) + o[which, frame][:, None]
            d = field.distances(x.astype(np.float32).reshape(-1, 3)).reshape(members.shape)
            c = _hinge(d - of_sphere[members], self.clearance)[0] * s.own[group]
            total += np.bincount(which, c.sum(axis=1) * speed[which, group], minlength=len(total))
        return total.reshape(k, m)

    def gradient(self, path: Array) -> tuple[float, Array, float]:
        """Compute the functional gradient of the obstacle cost for a path (m, n), as defined for CHOMP.

        Return cost, gradient (m, n) and smallest distance [m].

        Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013, eq. 16:
        |x'| ((1 - t t^T) grad c - c k) for each sphere, with its direction t and curvature vector k.
        """
        R, o = self.spheres.frame_poses(path)
        x = self.spheres.centers(R, o)
        value, pull = np.zeros(x.shape[:2], np.float32), np.zeros_like(x)
        least = np.inf
        for field, mine, radius in self._fields:
            d, g = field.gradients(x[:, mine].reshape(-1, 3))
            d = d.reshape(len(x), -1) - radius
            least = min(least, float(d[1:-1].min(initial=np.inf)))
            c, slope = _hinge(d, self.clearance)
            value[:, mine] = c
            pull[:, mine] = slope[..., None] * g.reshape(len(x), -1, 3)
        which, a, b, gap = self.self_pairs.nearest(R, o, x, SELF_CLEARANCE)
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
    """Compute the obstacle cost of signed distances d [m], and its slope.

    The cost is linear inside the obstacle, parabolic up to the clearance, then 0.
    """
    near = np.clip(clearance - d, 0.0, clearance)
    cost = near * near / (2 * clearance) + np.maximum(-d, 0.0)
    return cost.astype(np.float32), (-near / clearance).astype(np.float32)


def _moved(x: NDArray) -> NDArray:
    """Compute the displacement of each sphere per waypoint of a path, by central differences of the sphere
    positions x (k, m, s, 3). Its length weights the obstacle cost.
    """
    out = np.empty_like(x)
    out[:, 1:-1] = 0.5 * (x[:, 2:] - x[:, :-2])
    out[:, 0], out[:, -1] = x[:, 1] - x[:, 0], x[:, -1] - x[:, -2]
    return out
