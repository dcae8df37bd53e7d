"""Touch links found from contact: a cube between a Panda's fingers."""

from __future__ import annotations

import numpy as np
import pytest
from tests.scene.helpers import box, panda

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.touch_links import attached_by_contact, touching_links
from armcell.core import SE3, InputError
from armcell.scene import PlanningScene

FINGERS = {"panda_leftfinger", "panda_rightfinger"}
WIDTH = 0.04  # [m] of the cube


def grasped(gap: float) -> PlanningScene:
    """A cube in the grasp, each finger `gap` [m] off it (negative: into it)."""
    scene = panda(finger_joint1=WIDTH / 2 + gap)
    cube = box("cube", (0.03, WIDTH, 0.03)).at(scene.frame_pose("panda_hand_tcp"))
    return scene.with_object(cube)


@pytest.mark.parametrize("gap", [-0.001, 0.0, 0.0015])
def test_fingers_that_hold(gap):
    assert set(touching_links(grasped(gap), "cube")) == FINGERS


def test_one_that_is_too_far():
    scene = grasped(0.004)
    assert touching_links(scene, "cube") == ()
    assert set(touching_links(scene, "cube", within=0.006)) == FINGERS
    moved = scene.with_object_pose("cube", scene.frame_pose("panda_hand_tcp") @ SE3.from_xyz(0, 0.004, 0))
    assert len(touching_links(moved, "cube")) == 1  # nearer to one finger


def test_after_attaching_by_contact_the_grasp_is_free():
    """The start state in collision after a grasp, which MoveIt users ask about most."""
    scene = grasped(-0.0005)
    bare = scene.with_attached("cube", "panda_hand")
    assert any(c.body_b == "cube" or c.body_a == "cube" for c in ExactChecker(bare).contacts(bare.positions))
    held = attached_by_contact(scene, "cube", "panda_hand")
    assert held.attached["cube"].touch_links == FINGERS | {"panda_hand"}
    assert not ExactChecker(held).contacts(held.positions)
    arm = held.model.group("arm").joint_names
    assert KernelChecker(held, arm).is_free(held.positions[held.model.columns(arm)])


def test_what_is_allowed_does_not_hide_a_contact():
    scene = grasped(-0.001).with_allowed("cube", ["panda_leftfinger", "panda_rightfinger"])
    assert set(touching_links(scene, "cube")) == FINGERS


def test_an_attached_object_can_be_asked_about():
    assert set(touching_links(grasped(0.0).with_attached("cube", "panda_hand"), "cube")) == FINGERS


def test_bad_input():
    with pytest.raises(InputError, match="ghost"):
        touching_links(panda(), "ghost")
    with pytest.raises(InputError, match="within"):
        touching_links(grasped(0.0), "cube", within=np.nan)
