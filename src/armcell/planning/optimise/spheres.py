"""The robot as spheres, many configurations at a time (NumPy): where they are, what pulls do to joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker

Array = NDArray[np.float64]
F32 = NDArray[np.float32]


class Spheres:
    """The spheres that cover what a group moves, from the kernel's pack; `m` configurations, `s` spheres.

    Attributes:
        body: (s,) which body each is of. radius: (s,) [m]. moving: (s,) whether the group moves it.
        members: (g, 8) spheres of each group, the last repeated where there are fewer; own (g, 8) where not.
        group_radius: (g,) of the balls around the groups [m].
        low, high: (3,) no sphere's centre can be outside of these [m].
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
        self.centre = np.asarray(p.sphere[:, :3], np.float32)
        # Between the ball that the solid surely fills and the one that surely holds it.
        self.radius = (0.5 * (p.sphere[:, 3] + p.sphere[:, 4])).astype(np.float32)
        self.moving = self.frame > 0
        reach = (
            np.linalg.norm(self._fixed[1:, :, 3], axis=1).sum() + np.linalg.norm(self.centre, axis=1).max()
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
        self._group_centre = np.asarray(p.group_sphere[:, :3], np.float32)
        self.group_radius = np.asarray(p.group_sphere[:, 3], np.float32)
        self._group_frame = self.frame[self.members[:, 0]]
        self._of_frame = [np.flatnonzero(self.frame == f) for f in range(self.frames)]

    def frame_poses(self, q: Array) -> tuple[Array, Array]:
        """Rotations (m, f, 3, 3) and origins (m, f, 3) of the frames at q (m, n)."""
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

    def centres(self, R: Array, o: Array) -> F32:
        """Where in the world the spheres are (m, s, 3) [m]."""
        return self._placed(R, o, self.centre, self.frame)

    def group_centres(self, R: Array, o: Array) -> F32:
        """Where in the world the balls around the groups are (m, g, 3) [m]."""
        return self._placed(R, o, self._group_centre, self._group_frame)

    def _placed(self, R: Array, o: Array, points: F32, frame: NDArray) -> F32:
        out = np.empty((len(R), len(points), 3), np.float32)
        for f in range(self.frames):
            mine = np.flatnonzero(frame == f)
            turn = np.swapaxes(R[:, f], 1, 2).astype(np.float32)
            out[:, mine] = points[mine] @ turn + o[:, f, None].astype(np.float32)
        return out

    def joint_gradient(self, R: Array, o: Array, x: F32, pull: F32) -> Array:
        """J^T of all spheres' pulls (m, s, 3) at x (m, s, 3), summed: (m, n)."""
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


class Meetings:
    """Groups of the robot's own spheres that can meet, and how near they are."""

    def __init__(self, checker: KernelChecker, spheres: Spheres):
        p = checker.pack
        rows = np.repeat(np.arange(len(p.near_groups)), np.diff(p.meet))
        self.a, self.b = p.near_groups[rows], p.meet_groups
        self.spheres = spheres

    def nearest(
        self, R: Array, o: Array, x: F32, within: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], F32]:
        """Configuration, two spheres and their distance [m], of each pair of groups nearer than `within`."""
        s = self.spheres
        at, radius = s.group_centres(R, o), s.radius
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
