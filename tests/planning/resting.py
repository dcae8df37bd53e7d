"""Starts in resting contact, and an independent judge of motions that lead out of them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from tests.scene.helpers import box, panda

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import APART, DEEPER, certify_from_rest
from armcell.core import SE3, SO3, JointTrajectory
from armcell.scene import CollisionObject, PlanningScene
from armcell.timing.chords import chords

SINK = 3e-4  # [m] as physics lets objects sink in
FINGERS = ("panda_leftfinger", "panda_rightfinger")
STEP = 2e-3  # [rad] between the judge's samples
FINE = 2e-5  # [rad] that chords may be off the motion
REACH = {"joint2": 0.3, "joint4": -2.2, "joint6": 2.5}
ARM = tuple(f"panda_joint{i}" for i in range(1, 8))


def holding(item: CollisionObject | None = None) -> PlanningScene:
    """A Panda that reaches forward and down, with a 40 mm cube between its fingers."""
    scene = panda(**REACH)
    at = scene.frame_pose("panda_hand_tcp").translation
    scene = scene.with_object(item or box("cube", (0.04, 0.04, 0.04), at))
    return scene.with_attached("cube", "panda_hand", FINGERS)


def on_table(
    sink: float = SINK, padding: float = 0.005, item: CollisionObject | None = None
) -> PlanningScene:
    """The held cube stands on a table."""
    x, y, z = panda(**REACH).frame_pose("panda_hand_tcp").translation
    table = box("table", (1.2, 1.6, 0.04), (x, y, z - 0.04 + sink))
    return holding(item).with_object(table).with_padding(padding)


def in_a_corner(sink: float = SINK) -> PlanningScene:
    """The held cube stands on the table and leans against a wall in front of it."""
    x, y, z = panda(**REACH).frame_pose("panda_hand_tcp").translation
    return on_table(sink).with_object(box("wall", (0.02, 0.3, 0.03), (x + 0.03 - sink, y, z - 0.005)))


def brought_to(
    scene: PlanningScene, item: CollisionObject, way: np.ndarray, sink: float, group: str = "arm"
) -> PlanningScene:
    """The scene with an object moved from where it is along `way` (3,) until it touches, `sink` [m] deep."""
    names = scene.model.group(group).joint_names
    q = scene.positions[scene.model.columns(names)]

    def at(distance: float) -> PlanningScene:
        T = item.T_world_object
        return scene.with_object(item.at(SE3(T.rotation, T.translation + distance * way)))

    def gap(distance: float) -> float:
        exact = ExactChecker(at(distance), names)
        exact.set_configuration(q)
        pairs = [(a, b) for a, b in exact.pairs if exact.geometries[b].body == item.name]
        return min(exact.pair_distance(int(a), int(b)) for a, b in pairs)

    low, high = 0.0, 0.0
    while gap(high) > -sink:
        low, high = high, high + max(0.9 * gap(high), 1e-3)
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if gap(middle) > -sink else (low, middle)
    return at(high)


def judge_from_rest(scene: PlanningScene, trajectory: JointTrajectory) -> None:
    """From the scene's state to rest: what touched gets no deeper, comes apart and stays so; nothing else
    touches. By coal, at samples; and the rule that the motion gate asks holds."""
    names = trajectory.joint_names
    start = scene.positions[scene.model.columns(names)]
    np.testing.assert_allclose(trajectory.positions[0], start, atol=1e-9)
    for values in (trajectory.velocities, trajectory.accelerations):
        assert values is None or not (values[0].any() or values[-1].any())
    exact = ExactChecker(scene, names)
    g, pairs = exact.geometries, exact.pairs
    first = _distances(exact, start)
    rests = first <= 1e-5
    assert rests.any(), "the start does not touch"
    parted = ~rests
    times = np.append(np.arange(0.0, trajectory.duration, 0.004), trajectory.duration)
    places = [trajectory.sample(t)[0] for t in times]
    now = first
    for a, b in pairwise(places):
        n = max(int(np.ceil(np.max(np.abs(b - a)) / STEP)), 1)
        for k in range(1, n + 1):
            now = _distances(exact, a + (b - a) * k / n)
            for p in np.flatnonzero(now <= 0.0):
                pair = (g[pairs[p, 0]].body, g[pairs[p, 1]].body)
                assert not parted[p], (pair, now[p])
                assert now[p] >= min(first[p], 0.0) - DEEPER - 1e-4, (pair, first[p], now[p])
            parted |= now > APART + DEEPER
    assert np.all(now > 0.0)
    assert parted.all() or np.all(now[~parted] > 0.0)
    _, points, room = chords((trajectory,), (0.0,), 0.0, trajectory.duration, error=FINE)
    proof = certify_from_rest(KernelChecker(scene, names), points, room)
    assert proof.free, proof


def _distances(exact: ExactChecker, q: np.ndarray) -> np.ndarray:
    exact.set_configuration(q)
    out = exact.pair_gaps(exact.pairs)
    for p in np.flatnonzero(out < 0.005):
        out[p] = exact.pair_distance(*map(int, exact.pairs[p]))
    return out


def turned(rng: np.random.Generator) -> SO3:
    """Any orientation."""
    axis = rng.normal(size=3)
    return SO3.exp(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))
