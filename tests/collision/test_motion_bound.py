"""MotionBound: never below what bodies really move against each other. Every proof stands on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.model.helpers import (
    MBM,
    chain_of,
    collision,
    dual,
    joint,
    link,
    mbm_robot,
    model_of,
    random_positions,
)
from tests.scene.helpers import box

from armcell.collision import ExactChecker, MotionBound
from armcell.core import SE3
from armcell.model import RobotModel, load_robot
from armcell.scene import CollisionObject, PlanningScene


def forked() -> RobotModel:
    """Slides, mimics and branches: a carriage with two arms, the second following the first at half speed."""
    body = collision('<box size="0.1 0.2 0.3"/>')
    return model_of(
        link("rail"), *(link(name, body) for name in ("car", "a1", "a2", "b1", "b2")),
        joint("slide", "rail", "car", "prismatic", '<axis xyz="0 1 0"/>', '<limit lower="-2" upper="1"/>'),
        joint("ja", "car", "a1", inside='<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>'),
        joint("reach", "a1", "a2", "prismatic", '<origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>',
              '<limit lower="-0.5" upper="0.7"/>'),
        joint("jb", "car", "b1",
              inside='<origin xyz="-0.4 0 0"/><axis xyz="0 1 0"/><mimic joint="ja" multiplier="-0.5"/>'),
        joint("jb2", "b1", "b2", "continuous", '<origin xyz="0 0 0.5"/><axis xyz="1 1 0"/>'),
    )  # fmt: skip


def in_series() -> RobotModel:
    """A mimic joint further down the chain it follows."""
    model = chain_of("revolute 0 0 1", "revolute 0 1 0", "revolute 0 0 1")
    from armcell.core import Box
    from armcell.model import Collision, Mimic

    shape = (Collision(Box(0.1, 0.1, 0.1), SE3.identity()),)
    links = {n: replace(k, collisions=shape) for n, k in model.links.items()}
    joints = {**model.joints, "j3": replace(model.joints["j3"], mimic=Mimic("j1", 2.0))}
    return replace(model, links=links, joints=joints)


def scene_of(name: str) -> tuple[PlanningScene, tuple[str, ...] | None]:
    model = {"dual": dual, "forked": forked, "in_series": in_series}.get(name, lambda: None)()
    if model is None:
        model = mbm_robot(name[4:]) if name.startswith("mbm_") else load_robot(name)
    held = box("held", (0.1, 0.2, 0.05), (0.3, 0.2, 0.4))
    scene = PlanningScene.of(model, objects=[held, box("wall", (0.1, 1, 1), (1, 0, 0))])
    carrier = {
        "panda": "panda_leftfinger",
        "dual": "left_gripper_base",
        "ur10_gripper": "gripper_left_finger",
    }
    if name in carrier:
        scene = scene.with_attached("held", carrier[name])
    names = (
        None if name != "dual" else model.group("left_arm").joint_names + model.group("right_arm").joint_names
    )
    return scene, names


def displacements(checker: ExactChecker, before: np.ndarray, after: np.ndarray) -> list[float]:
    """How far the bodies of each pair move, farthest points summed, seen from the last link above both."""
    Ts = [checker.tree.link_transforms(q) for q in (before, after)]
    corners = {i: _corners(g) for i, g in enumerate(checker.geometries) if g.link >= 0}
    above = {i: _above(checker, i) for i in range(len(checker.geometries))}
    found = []
    for a, b in checker.pairs:
        common = [x for x, y in zip(above[a], above[b]) if x == y]
        base = common[-1] + 1 if common else 0
        total = 0.0
        for g in (a, b):
            if g in corners:
                link = checker.geometries[g].link
                old, new = (corners[g] @ (np.linalg.inv(T[base]) @ T[link]).T for T in Ts)
                total += float(np.linalg.norm(new - old, axis=1).max())
        found.append(total)
    return found


def _corners(geometry) -> np.ndarray:
    """Corners (8, 4) of the box around a geometry, homogeneous, in its link's frame."""
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    points = geometry.T_link_solid.apply(geometry.solid.center + signs * geometry.solid.half)
    return np.column_stack([points, np.ones(8)])


def _above(checker: ExactChecker, geometry: int) -> list[int]:
    link = checker.geometries[geometry].link
    return [] if link < 0 else checker.tree.path_to(checker.tree.link_names[link]).tolist()


ROBOTS = [
    "ur10",
    "ur10_gripper",
    "dual",
    "panda",
    "forked",
    "in_series",
    *(
        pytest.param(f"mbm_{n}", marks=pytest.mark.skipif(not MBM.is_dir(), reason="needs MotionBenchMaker"))
        for n in ("ur5", "baxter")
    ),
]


@pytest.mark.slow
@pytest.mark.cases("dual", "panda", "ur10_gripper", "ur10", "in_series", "forked")
@pytest.mark.parametrize("name", ROBOTS)
def test_it_is_never_below_the_measured_motion(name):
    scene, names = scene_of(name)
    checker = ExactChecker(scene, names)
    bound, rng = MotionBound(checker), np.random.default_rng(0)
    assert len(checker.pairs)
    for size in (1e-3, 0.1, 1.0):
        for _ in range(4):
            start = random_positions(scene.model, rng)
            dq = rng.uniform(-size, size, len(checker.columns)) * (rng.random(len(checker.columns)) < 0.6)
            end = start.copy()
            end[checker.columns] = np.clip(
                start[checker.columns] + dq,
                scene.model.lower[checker.columns],
                scene.model.upper[checker.columns],
            )
            allowed = bound.along(end[checker.columns] - start[checker.columns])
            for pair, moved, most in zip(
                checker.pairs, displacements(checker, start, end), allowed, strict=True
            ):
                bodies = [checker.geometries[g].body for g in pair]
                assert moved <= most + 1e-9, f"{bodies} move {moved:.4f} m, the bound is {most:.4f} m"


@pytest.mark.slow
def test_it_is_not_far_above_either():
    """A bound of meters for millimeters would prove nothing; 4 times the largest motion seen is fine."""
    scene, _ = scene_of("ur10_gripper")
    checker = ExactChecker(scene)
    bound, rng = MotionBound(checker), np.random.default_rng(1)
    dq = 0.01 * np.eye(len(checker.columns))
    for k in range(len(dq)):
        most = np.zeros(len(checker.pairs))
        for _ in range(20):
            q = random_positions(scene.model, rng)
            most = np.maximum(most, displacements(checker, q, q + dq[k]))
        allowed = bound.along(dq[k])
        assert allowed.max() <= 4 * most.max()
        assert np.all(allowed[most == 0.0] == 0.0)  # what a joint does not move costs nothing


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_an_unbounded_slide_is_still_bounded_below_it():
    """A turn above a slide without limits: nothing can be proven, but nothing may be "proven" by a NaN."""
    floor = collision('<box size="0.2 0.2 0.2"/>')
    model = model_of(
        link("world_link"), link("turn", floor), link("base"),
        joint("first", "world_link", "turn", "continuous"),
        joint("drive", "turn", "base", "planar", '<axis xyz="0 0 1"/>', ""),
    )  # fmt: skip
    from armcell.core import Box
    from armcell.model import Collision

    base = replace(model.links["base"], collisions=(Collision(Box(0.2, 0.2, 0.2), SE3.identity()),))
    model = replace(model, links={**model.links, "base": base})
    wall = CollisionObject.single("wall", Box(0.2, 0.2, 0.2), SE3.from_xyz(3, 0, 0))
    checker = ExactChecker(PlanningScene.of(model, objects=[wall]))
    for dq in np.vstack([np.eye(4), np.zeros(4)]):
        assert not np.any(np.isnan(MotionBound(checker).along(dq)))
