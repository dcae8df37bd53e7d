"""Named frames: subframes of objects and fixed frames, wherever a frame may be named."""

from __future__ import annotations

import numpy as np
import pytest
from tests.scene.helpers import box, panda

from armcell.core import SE3, InputError, UnknownNameError
from armcell.kinematics import kinematic_tree

HANDLE = SE3.from_xyz_rpy((0.05, 0, 0.02), (0, np.pi / 2, 0))
CUP = box("cup", (0.06, 0.06, 0.1), (0.4, 0.1, 0.3), (0.1, 0.2, 0.3), subframes={"handle": HANDLE})
TURN = 1e-7


def test_a_subframe_goes_with_its_object():
    scene = panda(CUP)
    expected = CUP.T_world_object @ HANDLE
    assert scene.frame_pose("cup/handle").isclose(expected, 1e-12, TURN)
    held = scene.with_attached("cup", "panda_hand")
    q = held.positions.copy()
    q[:6] += 0.05
    moved = held.with_positions(q)
    T_hand_handle = scene.frame_pose("panda_hand").inverse() @ expected
    hand = kinematic_tree(held.model).link_pose(moved.positions, "panda_hand")
    assert moved.frame_pose("cup/handle").isclose(hand @ T_hand_handle, 1e-9, TURN)
    assert moved.transform("panda_hand", "cup/handle").isclose(T_hand_handle, 1e-9, TURN)
    link, T = held.anchor("cup/handle")
    assert link == "panda_hand" and T.isclose(T_hand_handle, 1e-9, TURN)
    assert held.with_detached("cup").frame_pose("cup/handle").isclose(expected, 1e-9, TURN)


def test_names_with_a_slash():
    """The object "a" with a subframe "b/c" and the object "a/b" with a subframe "d"."""
    one = box("a", (1, 1, 1), subframes={"b/c": SE3.from_xyz(1, 0, 0)})
    two = box("a/b", (1, 1, 1), subframes={"d": SE3.from_xyz(2, 0, 0)})
    scene = panda(one, two)
    assert scene.frame_pose("a/b/c").translation[0] == 1 and scene.frame_pose("a/b/d").translation[0] == 2
    assert scene.frame_pose("a/b").translation[0] == 0


def test_attaching_to_a_frame_of_a_held_object():
    lid = box("lid", (0.05, 0.05, 0.01), (0.4, 0.1, 0.36))
    held = panda(CUP, lid).with_attached("cup", "panda_hand").with_attached("lid", "cup/handle")
    assert held.attached["lid"].link == "panda_hand"
    assert held.frame_pose("lid").isclose(lid.T_world_object, 1e-9, TURN)


def test_fixed_frames():
    scene = panda(CUP).with_fixed_frame("camera", SE3.from_xyz(1, 0, 1))
    scene = scene.with_fixed_frame("lens", SE3.from_xyz(0, 0, 0.1), "camera")
    np.testing.assert_allclose(scene.transform("world", "lens").translation, [1, 0, 1.1])
    np.testing.assert_allclose(
        scene.transform("lens", "cup").matrix,
        np.linalg.inv(scene.frame_pose("lens").matrix) @ CUP.T_world_object.matrix, atol=1e-12,
    )  # fmt: skip
    with pytest.raises(InputError, match="fixed frame"):
        scene.with_object(box("lens", (1, 1, 1)))


@pytest.mark.parametrize("name", ["cup/spout", "mug/handle", "cup/", "/handle", ""])
def test_unknown_frames(name):
    with pytest.raises(UnknownNameError, match="unknown frame.*cup/handle"):
        panda(CUP).frame_pose(name)


@pytest.mark.parametrize("name", ["", " ", "a "])
def test_subframes_need_names(name):
    with pytest.raises(InputError, match="subframe"):
        box("cup", (1, 1, 1), subframes={name: SE3.identity()})
