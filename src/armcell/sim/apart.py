"""Bodies that the engine compares at every step although they hardly ever touch.

It tells bodies apart by the spheres around them. Those of a link and the next but one always overlap, and
those of a table and all links, too. Here such a pair is not looked at as long as its distance, once measured,
is more than the joints between the two can have made up for since. So the contacts are the same.
"""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built import BuiltModel

Array = NDArray[np.float64]

NEIGHBOURS = 2  # joints between links whose spheres always overlap
LARGE = 0.5  # [m] radius of the sphere around an object that stands among the links
MOST_BODIES = 30  # one bit each of the engine's masks; the lowest is everything else's
ALL = 0x7FFFFFFF
BEYOND = 0.05  # [m] how far a slide may go beyond its range


class Apart:
    """Pairs of bodies, for `stepping.take_steps`.

    Attributes:
        arrays: of p pairs and k pairs of their geoms:
            (p, j) index in qpos of the joints between two bodies;
            (p, j) how far a point of one can move against the other for each unit of a joint [m];
            (p, j) those joints when the distance was measured;
            (p,) how far both may have moved since [m];
            (k, 2) geoms, and (p + 1,) where those of a pair begin;
            (geom,) the bit of its body in the engine's masks, and the masks of what it may touch;
            (p,) whether the pair is to be looked at in this step.
    """

    def __init__(self, built: BuiltModel):
        model = built.mj
        self._affinity = model.geom_conaffinity
        pairs = [] if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else _pairs(built)
        bits: dict[int, int] = {}
        for body in (b for a, b, _ in pairs for b in (a, b)):
            bits.setdefault(body, 1 << (len(bits) + 1))
        pairs = [pair for pair in pairs if max(bits[pair[0]], bits[pair[1]]) < 1 << MOST_BODIES]
        geoms = [[(g, h) for g in _geoms(model, a) for h in _geoms(model, b)] for a, b, _ in pairs]
        self._bit = np.zeros(model.ngeom, dtype=np.int32)
        for body, bit in bits.items():
            if bit < 1 << MOST_BODIES:
                self._bit[_geoms(model, body)] = bit
                model.body_contype[body] = model.body_conaffinity[body] = ALL
        some = self._bit > 0
        model.geom_contype[some] = self._bit[some]
        self._affinity[some] = ALL
        self._limit = np.full(len(pairs), -1.0)
        most = max((len(joints) for *_, joints in pairs), default=0)
        columns, moves = np.zeros((len(pairs), most), np.int64), np.zeros((len(pairs), most))
        for p, (*_, joints) in enumerate(pairs):
            for j, (column, reach) in enumerate(joints):
                columns[p, j], moves[p, j] = column, reach
        self.arrays = (
            columns, moves, np.zeros_like(moves), self._limit,
            np.array([pair for some in geoms for pair in some], np.int64).reshape(-1, 2),
            np.cumsum([0, *map(len, geoms)]), self._bit, self._affinity, np.zeros(len(pairs), np.bool_),
        )  # fmt: skip

    def forget(self) -> None:
        """Let the engine look at every pair."""
        self._limit[:] = -1.0
        self._affinity[self._bit > 0] = ALL


def _geoms(model: mujoco.MjModel, body: int) -> list[int]:
    start = int(model.body_geomadr[body])
    return list(range(start, start + int(model.body_geomnum[body])))


def _pairs(built: BuiltModel) -> list[tuple[int, int, list[tuple[int, float]]]]:
    """Bodies that may touch, and of each joint between them its index in qpos and its reach."""
    model = built.mj
    excluded = {(s >> 16, s & 0xFFFF) for s in model.exclude_signature.tolist()}
    links = {built.body[name] for name in built.owners[: built.link_count]}
    fixed = {built.body[name] for name in built.owners[built.link_count :]}
    fixed = {
        b
        for b in fixed
        if model.body_weldid[b] == 0 and model.geom_rbound[_geoms(model, b)].max(initial=0) > LARGE
    }
    found = []
    for a, b in combinations(sorted(b for b in links | fixed if _plain(model, b)), 2):
        joints = _joints_between(model, a, b)
        near = len(joints) <= NEIGHBOURS or a in fixed or b in fixed
        if joints and near and (a, b) not in excluded:
            found.append((a, b, joints))
    return found


def _plain(model: mujoco.MjModel, body: int) -> bool:
    """Whether it has geoms, and all touch whatever there is and are of a kind whose distances are known."""
    geoms = _geoms(model, body)
    kinds = mujoco.mjtGeom
    masks = (model.geom_contype[geoms] == 1).all() and (model.geom_conaffinity[geoms] == 1).all()
    unknown = (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD, kinds.mjGEOM_SDF)
    return bool(geoms) and bool(masks) and not any(model.geom_type[g] in unknown for g in geoms)


def _joints_between(model: mujoco.MjModel, a: int, b: int) -> list[tuple[int, float]]:
    joints = []
    ways = {body: _way_up(model, body) for body in (a, b)}
    for body, other in ((a, b), (b, a)):
        # from the link's origin to its farthest point, and then on from frame to frame
        reach = max(
            float(np.linalg.norm(model.geom_pos[g]) + model.geom_rbound[g]) for g in _geoms(model, body)
        )
        for up in ways[body]:
            if up in ways[other]:
                break
            start, slides = int(model.body_jntadr[up]), 0.0
            for j in range(start, start + int(model.body_jntnum[up])):
                slide = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
                joints.append((int(model.jnt_qposadr[j]), 1.0 if slide else reach))
                slides += float(np.abs(model.jnt_range[j]).max()) + BEYOND if slide else 0.0
            reach += float(np.linalg.norm(model.body_pos[up])) + slides
    return joints


def _way_up(model: mujoco.MjModel, body: int) -> list[int]:
    way = [body]
    while way[-1] > 0:
        way.append(int(model.body_parentid[way[-1]]))
    return way
