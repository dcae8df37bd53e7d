"""What comes across the rest of a motion: against states sampled densely and asked one by one."""

from __future__ import annotations

import numpy as np
import pytest
from armcell.collision.crossing import crossing, passed_at

from armcell.collision import ExactChecker
from armcell.core import SE3, Box, JointTrajectory
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

ROBOT = load_robot("panda")
NAMES = ROBOT.group("arm").joint_names
LEFT, RIGHT = (np.array([turn, 0.3, 0.0, -1.9, 0.0, 2.2, 0.8]) for turn in (1.2, -0.6))
ROD = CollisionObject.single("rod", Box(0.06, 0.06, 0.5), SE3.from_xyz(0.55, 0.1, 0.6))
SCENE = PlanningScene.of(ROBOT, objects=[ROD])


def motion(kind: str) -> JointTrajectory:
    """3 s from left to right: only positions, as a bare message has them, or quintic from rest to rest."""
    if kind == "linear":
        return JointTrajectory(NAMES, np.array([0.0, 3.0]), np.array([LEFT, RIGHT]))
    rest = np.zeros((2, 7))
    return JointTrajectory(NAMES, np.array([0.0, 3.0]), np.array([LEFT, RIGHT]), rest, rest)


@pytest.mark.parametrize("kind", ["linear", "quintic"])
def test_the_first_contact_is_where_sampling_finds_it(kind):
    way, exact = motion(kind), ExactChecker(SCENE, NAMES)
    times = np.linspace(0.0, 3.0, 3001)
    touching = times[[not exact.is_free(way.sample(t)[0]) for t in times]]
    found = crossing(SCENE, way, 0.0, ["rod"])
    assert found is not None and found.object == "rod"
    assert found.time == pytest.approx(touching[0], abs=0.02)
    assert "rod" in (found.contact.body_a, found.contact.body_b)
    assert crossing(SCENE, way, float(touching[-1]) + 0.02, ["rod"]) is None  # past it
    assert crossing(SCENE, way, 3.0, ["rod"]) is None and crossing(SCENE, way, 0.0, []) is None
    allowed = SCENE.with_allowed("rod", list(ROBOT.links))
    assert crossing(allowed, way, 0.0, ["rod"]) is None


def test_only_what_is_asked_for_counts():
    free = SCENE.with_object(CollisionObject.single("far", Box(0.1, 0.1, 0.1), SE3.from_xyz(-0.6, 0, 0.5)))
    assert crossing(free, motion("quintic"), 0.0, ["far"]) is None
    found = crossing(free, motion("quintic"), 0.0, ["far", "rod"])
    assert found is not None and found.object == "rod"


def test_a_slowed_robot_is_found_on_its_way():
    way = motion("quintic")
    for at in (0.4, 1.0, 2.2):
        q = way.sample(at)[0] + 0.001
        assert at - 0.06 <= passed_at(way, q, most=2.9) <= at + 0.02
    assert passed_at(way, way.sample(2.0)[0], most=1.0) == pytest.approx(1.0)  # no farther than it can be
    assert passed_at(way, LEFT, most=3.0) == 0.0
