"""Bodies that the engine need not compare, because they are known to be apart.

It tells bodies apart by boxes and spheres around them, at every step. Here a pair is not looked at as long as
its distance, once measured, is more than the joints between the two can have made up for since; and a body
with no pair to be looked at is not even sorted in. So the contacts are the same.
"""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built import BuiltModel
from armcell.sim.stepping import ALL

Array = NDArray[np.float64]

MOST_BODIES = 30  # one bit each of the engine's masks; the lowest is everything else's
UNKNOWN = {int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("PLANE", "HFIELD", "SDF")}
"""Kinds of geoms whose distances the engine does not tell."""
FREE, SLIDE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_SLIDE)
BEYOND = 0.05  # [m] how far a slide may go beyond its range


class Apart:
    """Pairs of bodies, for `stepping.take_steps`.

    Attributes:
        arrays: of p pairs, the c joint values between their bodies, and k pairs of their geoms:
            (c,) index in qpos; (c,) how far a point of one can move against the other for each unit [m];
            (c,) the value when the distance was measured; (p + 1,) where those of a pair begin;
            (p,) how far both may have moved since [m], and (p,) how far from now on, at least;
            (p,) whether the engine does not look at the pair, and whether it is to be measured in this step;
            (nq,) the largest way of any pair for each unit of qpos, and qpos as it was before the last step;
            (p, 2) bodies; (k, 2) geoms, and (p + 1,) where those of a pair begin;
            (geom,) the bit of its body in the engine's masks, and the masks of what it may touch;
            (body,) how many pairs of each the engine looks at, and its two masks of bodies;
            (geom,) radius of the sphere around each [m].
    """

    def __init__(self, built: BuiltModel):
        model = built.mj
        self._model, n = model, model.nq
        comparable = _comparable(model)
        plain = [b for b in range(model.nbody) if _plain(model, b)][:MOST_BODIES]
        if model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4):  # which moves within a step
            plain = []
        known = set(plain)
        self._pairs = np.array([p for p in comparable if known.issuperset(p)], np.int64).reshape(-1, 2)
        self._bit = np.zeros(model.ngeom, dtype=np.int32)
        for i, body in enumerate(plain):
            self._bit[_geoms(model, body)] = 1 << (i + 1)
        some = self._bit > 0
        model.geom_contype[some] = self._bit[some]
        self._looked_at = np.bincount(np.array(comparable, np.int64).ravel(), minlength=model.nbody)
        self._open = self._looked_at.copy()
        self._bodies = np.array(plain, np.int64)
        geoms = [
            [(g, h) for g in _geoms(model, a) for h in _geoms(model, b)] for a, b in self._pairs.tolist()
        ]
        reach = _reach(model, self._pairs)
        count = len(self._pairs)
        rows, columns = reach.nonzero()
        self._left, self._shut = np.zeros(count), np.zeros(count, np.bool_)
        self.arrays = (
            columns, reach[rows, columns], np.zeros(len(rows)), np.searchsorted(rows, np.arange(count + 1)),
            np.zeros(count), self._left, self._shut, np.zeros(count, np.bool_),
            reach.max(axis=0, initial=0.0), np.zeros(n), self._pairs,
            np.array([pair for some in geoms for pair in some], np.int64).reshape(-1, 2),
            np.cumsum([0, *map(len, geoms)]), self._bit, model.geom_conaffinity,
            self._open, model.body_contype, model.body_conaffinity, model.geom_rbound,
        )  # fmt: skip
        self.forget()

    def forget(self) -> None:
        """Let the engine look at every pair."""
        model = self._model
        self._left[:], self._shut[:], self._open[:] = -1.0, False, self._looked_at
        model.geom_conaffinity[self._bit > 0] = ALL
        model.body_contype[self._bodies] = model.body_conaffinity[self._bodies] = ALL


def _geoms(model: mujoco.MjModel, body: int) -> list[int]:
    start = int(model.body_geomadr[body])
    return list(range(start, start + int(model.body_geomnum[body])))


def _comparable(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Pairs of bodies that the engine compares."""
    excluded = {(s >> 16, s & 0xFFFF) for s in model.exclude_signature.tolist()}
    weld = model.body_weldid.tolist()
    above = [weld[parent] for parent in model.body_parentid[weld].tolist()]
    solid = (model.body_contype | model.body_conaffinity).tolist()
    return [
        (a, b)
        for a, b in combinations([b for b in range(model.nbody) if solid[b]], 2)
        if weld[a] != weld[b]
        and (a, b) not in excluded
        and not (weld[a] and weld[b] and (above[a] == weld[b] or above[b] == weld[a]))
    ]


def _plain(model: mujoco.MjModel, body: int) -> bool:
    """Whether it has geoms, and all touch whatever there is and are of a kind whose distances are known."""
    geoms = _geoms(model, body)
    masks = (model.geom_contype[geoms] == 1).all() and (model.geom_conaffinity[geoms] == 1).all()
    return bool(geoms) and bool(masks) and UNKNOWN.isdisjoint(model.geom_type[geoms].tolist())


def _reach(model: mujoco.MjModel, pairs: NDArray[np.int64]) -> Array:
    """Of each pair (p, nq): how far a point of one can move against the other for each unit of qpos [m]."""
    ways = {body: _way_up(model, body) for body in set(pairs.ravel().tolist())}
    found = np.zeros((len(pairs), model.nq))
    for row, (a, b) in zip(found, pairs.tolist(), strict=True):
        for body, other in ((a, b), (b, a)):
            for up, moves in ways[body].items():
                if up in ways[other]:
                    break
                for start, values in moves:
                    row[start : start + len(values)] = values
    return found


def _way_up(model: mujoco.MjModel, body: int) -> dict[int, list[tuple[int, tuple[float, ...]]]]:
    """Of a body and all above it, the joints: where each begins in qpos, and how far the body's farthest
    point moves for each unit."""
    offsets = np.linalg.norm(model.geom_pos[(geoms := _geoms(model, body))], axis=1)
    # from the link's origin to its farthest point, and then on from frame to frame
    reach = float((offsets + model.geom_rbound[geoms]).max())
    way: dict[int, list[tuple[int, tuple[float, ...]]]] = {}
    while body > 0:
        start, slides, joints = int(model.body_jntadr[body]), 0.0, []
        for j in range(start, start + int(model.body_jntnum[body])):
            if model.jnt_type[j] == FREE:
                # two unit quaternions d apart are a turn by 4 asin(d / 2), which moves no point by more
                moves = (1.0,) * 3 + (2.0 * reach,) * 4
            elif model.jnt_type[j] == SLIDE:
                moves = (1.0,)
                slides += float(np.abs(model.jnt_range[j]).max()) + BEYOND
            else:
                moves = (reach,)
            joints.append((int(model.jnt_qposadr[j]), moves))
        way[body] = joints
        reach += float(np.linalg.norm(model.body_pos[body])) + slides
        body = int(model.body_parentid[body])
    way[0] = []
    return way
