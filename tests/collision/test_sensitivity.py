"""Padding and scale: how sensitive collision checks are, against objects and of the robot with itself."""

from __future__ import annotations

import numpy as np
import pytest
from tests.model.helpers import random_positions
from tests.scene.helpers import box, floating, panda

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.scene import AllowCollisionByDefault, PlanningScene, SceneDiff, SetPadding

WALL = box("wall", (0.2, 1, 1), (1.0, 0, 0))  # its face at x = 0.9; the cube's at x + 0.1


def free(scene: PlanningScene, x: float) -> list[bool]:
    return [make(scene, ["x"]).is_free([x]) for make in (ExactChecker, KernelChecker)]


@pytest.mark.parametrize(
    ("change", "reach"),
    [
        (SetPadding(0.03), 0.13), (SetPadding(0.03, {"cube": 0.05}), 0.15),
        (SetPadding(0.03, {"cube": 0}), 0.1),
        (SetPadding(scales={"cube": 1.5}), 0.15), (SetPadding(0.02, scales={"cube": 1.5}), 0.17),
        (SetPadding(0.03, {"rail": 0.2}), 0.13), (SetPadding(), 0.1),
    ],
)  # fmt: skip
def test_against_objects(change, reach):
    """A diff sets them, and both checkers keep to them to the tenth of a millimeter."""
    scene = floating(WALL).apply(SceneDiff.of(change))
    assert free(scene, 0.9 - reach - 2e-4) == [True, True]
    assert free(scene, 0.9 - reach + 2e-4) == [False, False]


def test_of_the_robot_with_itself():
    """Links scaled up come nearer to each other; padding counts against objects only (as in MoveIt)."""
    scene = panda()
    arm = scene.model.group("arm").joint_names
    columns = scene.model.columns(arm)
    grown = scene.with_padding(link_scale=dict.fromkeys(scene.model.links, 1.3))
    variants = (scene, scene.with_padding(0.1), grown)
    checkers = [[make(s, arm) for s in variants] for make in (ExactChecker, KernelChecker)]
    rng, told = np.random.default_rng(0), []
    for _ in range(60):
        q = random_positions(scene.model, rng)[columns]
        exact, kernel = ([c.is_free(q) for c in row] for row in checkers)
        assert exact == kernel
        told.append(exact)
    plain, padded, larger = np.array(told).T
    assert np.array_equal(plain, padded)
    assert np.sum(plain & ~larger) > 5 and larger.any()


def test_default_entries_reach_the_kernel():
    scene = floating(WALL)
    assert free(scene, 0.9) == [False, False]
    assert free(scene.apply(SceneDiff.of(AllowCollisionByDefault("wall"))), 0.9) == [True, True]
    assert free(scene.apply(SceneDiff.of(AllowCollisionByDefault("cube"))), 0.9) == [True, True]
    mixed = SceneDiff.of(AllowCollisionByDefault("cube"), AllowCollisionByDefault("wall", False))
    assert free(scene.apply(mixed), 0.9) == [False, False]
    again = scene.apply(SceneDiff.of(AllowCollisionByDefault("wall"), AllowCollisionByDefault("wall", None)))
    assert free(again, 0.9) == [False, False]


def test_after_removal_the_name_is_new():
    """What was allowed for the old wall is not for the new one, also in what the kernel keeps."""
    scene = floating(WALL).with_allowed("wall", "cube")
    assert free(scene, 0.9) == [True, True]
    assert free(scene.without_object("wall").with_object(WALL), 0.9) == [False, False]
    assert np.array_equal(scene.positions, floating().positions)
