"""Attached bodies follow their link; what may touch."""

from __future__ import annotations

import numpy as np
import pytest
from tests.model.helpers import random_positions
from tests.scene.helpers import box, panda

from armcell.core import SE3
from armcell.kinematics import kinematic_tree

CUBE = box("cube", (0.05, 0.05, 0.05), (0.4, 0.1, 0.3), (0.1, 0.2, 0.3))
TURN = 1e-7  # [rad] what the logarithm of a rotation near identity can tell


def test_attaching_and_detaching_keep_the_pose():
    scene = panda(CUBE)
    held = scene.with_attached("cube", "panda_hand")
    assert "cube" not in held.objects and "cube" in held.attached
    for s in (held, held.with_detached("cube")):
        assert s.frame_pose("cube").isclose(CUBE.T_world_object, 1e-9, TURN)
        assert s.object("cube").T_world_object.isclose(CUBE.T_world_object, 1e-9, TURN)


@pytest.mark.parametrize("link", ["panda_hand", "panda_leftfinger", "panda_link3"])
def test_it_follows_its_link(link):
    held = panda(CUBE).with_attached("cube", link)
    tree, rng = kinematic_tree(held.model), np.random.default_rng(0)
    T_link_cube = held.transform(link, "cube")
    for _ in range(5):
        q = random_positions(held.model, rng)
        moved = held.with_positions(q)
        expected = tree.link_pose(q, link) @ T_link_cube
        assert moved.frame_pose("cube").isclose(expected, 1e-9, TURN)
        put_down = moved.with_detached("cube")
        assert put_down.frame_pose("cube").isclose(expected, 1e-9, TURN)
        again = put_down.with_positions(held.positions)  # no longer held: it stays
        assert again.frame_pose("cube").isclose(expected, 1e-9, TURN)


def test_properties_survive():
    item = box("cube", (0.05, 0.05, 0.05), movable=True, mass=0.3, color=(1, 0, 0, 1))
    back = panda(item).with_attached("cube", "panda_hand").with_detached("cube").object("cube")
    assert (back.movable, back.mass, back.color, back.shapes) == (True, 0.3, item.color, item.shapes)


def test_touch_links_may_touch():
    held = panda(CUBE).with_attached("cube", "panda_hand", ["panda_leftfinger"])
    assert held.attached["cube"].touch_links == {"panda_hand", "panda_leftfinger"}
    for a, b in (("cube", "panda_hand"), ("panda_leftfinger", "cube")):
        assert held.is_allowed(a, b) and held.is_allowed(b, a)
    assert not held.is_allowed("cube", "panda_rightfinger")
    assert not held.with_detached("cube").is_allowed("cube", "panda_hand")


def test_touch_links_may_be_any_iterable():
    links = (name for name in ["panda_leftfinger"])
    assert (
        "panda_leftfinger"
        in panda(CUBE).with_attached("cube", "panda_hand", links).attached["cube"].touch_links
    )


def test_allowing_overrides_touch_links_and_the_srdf():
    held = panda(CUBE).with_attached("cube", "panda_hand", ["panda_leftfinger"])
    strict = held.with_allowed("cube", "panda_leftfinger", allow=False)
    assert not strict.is_allowed("panda_leftfinger", "cube") and held.is_allowed("panda_leftfinger", "cube")
    assert held.is_allowed("panda_link0", "panda_link1")  # the SRDF says so
    assert not held.with_allowed("panda_link0", "panda_link1", allow=False).is_allowed(
        "panda_link1", "panda_link0"
    )


def test_allowing_several_at_once_and_taking_it_back():
    scene = panda(CUBE)
    assert not scene.is_allowed("cube", "panda_hand")
    allowed = scene.with_allowed("cube", ["panda_hand", "panda_link7"])
    assert all(allowed.is_allowed(n, "cube") for n in ("panda_hand", "panda_link7"))
    assert not allowed.is_allowed("cube", "panda_link6")
    assert not allowed.with_allowed("panda_hand", "cube", allow=False).is_allowed("cube", "panda_hand")


def test_a_world_object_moves_with_nothing():
    scene = panda(CUBE)
    moved = scene.with_positions(random_positions(scene.model, np.random.default_rng(1)))
    assert moved.frame_pose("cube").isclose(CUBE.T_world_object)
    placed = scene.with_object_pose("cube", SE3.from_xyz(1, 2, 3))
    assert placed.frame_pose("cube").isclose(SE3.from_xyz(1, 2, 3))
