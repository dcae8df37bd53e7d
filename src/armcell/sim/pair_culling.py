"""Motion bounds with which MuJoCo skips collision tests of body pairs that are far apart.

MuJoCo's broad phase compares bounding boxes and spheres at every step. `PairCulling` measures the distance
of a pair once; MuJoCo skips the pair until the joints between its two bodies have moved far enough to use
up this distance. A body with no pair left to test does not enter the broad phase at all. The contacts are
exactly those that MuJoCo finds without `PairCulling`.
"""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.mujoco_model import BuiltModel
from armcell.sim.step_kernel import ALL

Array = NDArray[np.float64]

BITS = 31  # of MuJoCo's contact masks: a body takes one; the lowest bit is for the bodies without their own
UNKNOWN = {int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("PLANE", "HFIELD", "SDF")}
"""Geom types for which MuJoCo cannot compute distances."""
FREE, SLIDE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_SLIDE)
BEYOND = 0.05  # [m] assumed largest overshoot of a slide joint beyond its limits


class PairCulling:
    """Pairs of bodies that are far apart, with bounds on their motion. MuJoCo skips the contact tests of a
    pair until its bodies could touch.

    `step_kernel.take_steps` reads and updates the arrays.

    Attributes:
        arrays: tuple for p body pairs with c joint values and k geom pairs in total, in this order:
            (c,) index in qpos of each joint value that moves one body of a pair against the other;
            (c,) upper bound of the relative motion of the two bodies per unit of this joint value [m];
            (c,) joint value at the time of the last distance measurement;
            (p + 1,) offsets of each pair's first joint value;
            (p,) motion allowed since the last measurement [m];
            (p,) lower bound of the motion still allowed from now on [m];
            (p,) True where MuJoCo skips the pair;
            (p,) True where this step must measure the distance of the pair;
            (nq,) largest motion bound of all pairs per unit of qpos [m];
            (nq,) qpos before the last step;
            (p, 2) bodies; (k, 2) geoms; (p + 1,) offsets of each pair's first geom pair;
            (geom,) contact mask bit of the geom's body; (geom,) contact mask of the bodies it may touch;
            (body,) number of pairs that MuJoCo tests; (body,) contype mask; (body,) conaffinity mask;
            (geom,) radius of the bounding sphere [m].
    """

    def __init__(self, built: BuiltModel):
        model = built.mj
        self._model, n = model, model.nq
        comparable = _comparable(model)
        plain = [b for b in range(model.nbody) if _plain(model, b)]
        bits = _free_bits(model, plain)[: len(plain)]
        plain = plain[: len(bits)]
        if model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4):  # RK4 moves the bodies within a step
            plain, bits = [], []
        known = set(plain)
        self._pairs = np.array([p for p in comparable if known.issuperset(p)], np.int64).reshape(-1, 2)
        self._bit = np.zeros(model.ngeom, dtype=np.int32)
        for bit, body in zip(bits, plain, strict=True):
            self._bit[_geoms(model, body)] = bit
        self._all = sum(bits) | 1
        some = self._bit > 0
        _touch_all(model, ~some, self._all)
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
            np.ascontiguousarray(columns), reach[rows, columns], np.zeros(len(rows)),
            np.searchsorted(rows, np.arange(count + 1)), np.zeros(count),
            self._left, self._shut, np.zeros(count, np.bool_),
            reach.max(axis=0, initial=0.0), np.zeros(n), self._pairs,
            np.array([pair for some in geoms for pair in some], np.int64).reshape(-1, 2),
            np.cumsum([0, *map(len, geoms)]), self._bit, model.geom_conaffinity,
            self._open, model.body_contype, model.body_conaffinity, model.geom_rbound,
        )  # fmt: skip
        self.forget()

    def forget(self) -> None:
        """Discard the stored distances between bodies,
        so that MuJoCo tests all body pairs for contact again.
        """
        model = self._model
        self._left[:], self._shut[:], self._open[:] = -1.0, False, self._looked_at
        model.geom_conaffinity[self._bit > 0] = self._all
        model.body_contype[self._bodies] = model.body_conaffinity[self._bodies] = ALL


def _free_bits(model: mujoco.MjModel, plain: list[int]) -> list[int]:
    """Return the bits of MuJoCo's contact masks that pair culling may use: bits that no geom uses, except
    geoms of the bodies in `plain`. The lowest bit is excluded.

    Geoms of MJCF files may use any bits.
    """
    others = ~np.isin(model.geom_bodyid, plain)
    used = np.bitwise_or.reduce((model.geom_contype | model.geom_conaffinity)[others], initial=1)
    return [1 << k for k in range(BITS) if not int(used) >> k & 1]


def _touch_all(model: mujoco.MjModel, others: NDArray[np.bool_], bits: int) -> None:
    """Let each geom that has no bit for pair culling still touch the bodies that have one, if its default
    contact mask allowed this.
    """
    accepting = others & (model.geom_conaffinity & 1 > 0)
    model.geom_conaffinity[accepting] |= bits
    for body in set(model.geom_bodyid[accepting].tolist()):
        model.body_conaffinity[body] |= bits


def _geoms(model: mujoco.MjModel, body: int) -> list[int]:
    start = int(model.body_geomadr[body])
    return list(range(start, start + int(model.body_geomnum[body])))


def _comparable(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the pairs of body ids that pair culling can handle: MuJoCo may skip their contact tests while
    the bodies are far apart.
    """
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
    """Return whether a body is suitable for pair culling. This requires default collision masks and known
    distance functions for all geoms of the body.

    A body without geoms yields False.
    """
    geoms = _geoms(model, body)
    masks = (model.geom_contype[geoms] == 1).all() and (model.geom_conaffinity[geoms] == 1).all()
    return bool(geoms) and bool(masks) and UNKNOWN.isdisjoint(model.geom_type[geoms].tolist())


def _reach(model: mujoco.MjModel, pairs: NDArray[np.int64]) -> Array:
    """Return bounds (p, nq) [m] on how far the bodies of a pair move
    relative to each other when one qpos value changes by 1.

    Entry [i, j] bounds how far a point of one body of pair i can move against the other body when qpos[j]
    changes by one unit.
    """
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
    """Return all joints that move a body, with bounds on how far each joint moves the body, for pair culling.

    Returns:
        The joints by body id, from the given body up to the world. Each joint is a tuple: start index in
        qpos, and motion of the given body's farthest point [m] per unit of each qpos value.
    """
    offsets = np.linalg.norm(model.geom_pos[(geoms := _geoms(model, body))], axis=1)
    # distance from the link's origin to its farthest point; each ancestor below adds the offset of its frame
    reach = float((offsets + model.geom_rbound[geoms]).max())
    way: dict[int, list[tuple[int, tuple[float, ...]]]] = {}
    while body > 0:
        start, slides, joints = int(model.body_jntadr[body]), 0.0, []
        for j in range(start, start + int(model.body_jntnum[body])):
            if model.jnt_type[j] == FREE:
                # two unit quaternions d apart differ by a rotation of 4 asin(d / 2), a chord of at most 2 d
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
