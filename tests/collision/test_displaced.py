"""The bound of how far bodies are from where they were planned: against points that are placed one by one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.motion_proof import DISPLACED, ActiveMotion, displacement, first_conflict
from armcell.core import SE3, SO3, Box, JointTrajectory
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

ROBOT = load_robot("panda")
NAMES = ROBOT.group("arm").joint_names
HELD = CollisionObject.single("held", Box(0.04, 0.04, 0.2), movable=True)
CUBE = CollisionObject.single("cube", Box(0.1, 0.1, 0.1), SE3.from_xyz(0.6, 0.1, 0.2), movable=True)
PLANNED = PlanningScene.of(ROBOT, objects=[CUBE, HELD.at(SE3.from_xyz(0.3, 0.0, 0.6))])
PLANNED = PLANNED.with_attached("held", "panda_hand", ("panda_leftfinger",))


def moved(T: SE3, rng: np.random.Generator, size: float) -> SE3:
    return SE3(SO3.exp(rng.normal(0, size, 3)) @ T.rotation, T.translation + rng.normal(0, size, 3))


def measured(rng: np.random.Generator, size: float = 1e-3) -> PlanningScene:
    """The planned scene with the fingers, the cube and the held object elsewhere."""
    q = PLANNED.positions.copy()
    q[ROBOT.columns(["panda_finger_joint1"])] += rng.uniform(0, size)
    q[ROBOT.columns(NAMES)] += rng.uniform(-0.2, 0.2, 7)  # does not count
    held = PLANNED.attached["held"]
    held = replace(held, T_link_object=moved(held.T_link_object, rng, size))
    cube = CUBE.at(moved(CUBE.T_world_object, rng, size))
    return replace(PLANNED, positions=q, objects={"cube": cube}, attached={"held": held})


def corners(scene: PlanningScene, body: str) -> np.ndarray:
    half = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    shape = scene.object(body).shapes[0][0]
    assert isinstance(shape, Box)
    return scene.object(body).T_world_object.apply(half * (shape.x, shape.y, shape.z))


def test_no_two_bodies_are_nearer_than_it_says():
    rng, largest = np.random.default_rng(0), 0.0
    for _ in range(50):
        scene = measured(rng)
        there = replace(scene, positions=np.where(
            np.isin(ROBOT.joint_names, NAMES), PLANNED.positions, scene.positions
        ))  # fmt: skip
        steps = [
            np.linalg.norm(corners(there, n) - corners(PLANNED, n), axis=1).max() for n in ("held", "cube")
        ]
        bound = displacement(PLANNED, scene, NAMES)
        assert sum(steps) <= bound < 0.05
        largest = max(largest, sum(steps) / bound)
    assert largest > 0.4  # not far above what there is
    assert displacement(PLANNED, PLANNED, NAMES) == 0.0


def test_scenes_that_differ_in_more_than_places_are_not_compared():
    larger = CollisionObject.single("cube", Box(0.2, 0.1, 0.1), CUBE.T_world_object)
    more = CollisionObject.single("more", Box(0.2, 0.1, 0.1))
    forbidden = PLANNED.with_allowed("cube", ("panda_link7",), False)
    for scene in (
        replace(PLANNED, objects={"cube": larger}), PLANNED.with_object(more), replace(PLANNED, attached={}),
        PLANNED.with_padding(link_scale={"panda_link1": 1.1}),
        PlanningScene(load_robot("ur10"), load_robot("ur10").default_positions()),
    ):  # fmt: skip
        assert displacement(PLANNED, scene, NAMES) == math.inf
    assert displacement(PLANNED.with_allowed("cube", ("panda_link7",)), forbidden, NAMES) == math.inf
    assert displacement(PLANNED, PLANNED.without_object("cube"), NAMES) == 0.0
    assert displacement(PLANNED, PLANNED.with_allowed("cube", ("panda_link7",)), NAMES) == 0.0


def test_a_certified_distance_is_the_clearance():
    checker = KernelChecker(replace(PLANNED, attached={}), NAMES)
    q = PLANNED.positions[checker.columns]
    path = np.array([q, q + 0.1 * np.eye(7)[0]])
    room = checker.clearance(path)
    assert 0.005 < room < 0.2
    assert checker.certify(path, distance=room - 2e-3, evidence=False).free
    assert not checker.certify(path, distance=room + 2e-3, evidence=False).free
    assert checker.certify(path).free  # the distance is forgotten


@pytest.mark.slow
@pytest.mark.parametrize("nearer", [0.0, 0.9 * DISPLACED, 2.0 * DISPLACED])
def test_what_came_nearer_than_planned_is_found(nearer):
    """An object beside the path in the plan's scene, and in the measured one just in the path or not."""
    tip = PLANNED.frame_pose("panda_hand_tcp").translation
    q = PLANNED.positions[ROBOT.columns(NAMES)]
    way = ActiveMotion(JointTrajectory(NAMES, np.array([0.0, 1.0]), np.array([q, q + 0.05 * np.eye(7)[5]])))
    bare = replace(PLANNED, attached={}, objects={})

    def beside(gap: float) -> PlanningScene:
        plate = CollisionObject.single(
            "plate", Box(0.5, 0.5, 0.02), SE3.from_xyz(tip[0], tip[1], tip[2] - gap)
        )
        return bare.with_object(plate)

    low, high = 0.0, 0.3
    while high - low > 1e-4:  # the smallest gap in which the motion is free
        middle = 0.5 * (low + high)
        low, high = (low, middle) if first_conflict(beside(middle), way) is None else (middle, high)
    planned = beside(high + 0.25 * DISPLACED)
    scene = planned.with_object_pose(
        "plate", SE3.from_xyz(tip[0], tip[1], tip[2] - high - 0.25 * DISPLACED + nearer)
    )
    found = first_conflict(scene, way, planned=planned)
    assert (found is None) == (first_conflict(scene, way) is None) == (nearer == 0.0)
