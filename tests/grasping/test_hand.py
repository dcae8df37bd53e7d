"""Boxes of a hand: they cover its links, and leave the space between slanted fingers free."""

from __future__ import annotations

import pytest

from armcell.grasping import hand_of
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.model.setup.hand_geometry import surface_points


@pytest.mark.parametrize("name", ["z1", "so101", "panda"])
def test_boxes_cover_the_fingers_and_follow_their_slant(name):
    model = load_robot(name)
    gripper = model.gripper()
    hand, tree, q = hand_of(model, gripper), kinematic_tree(model), model.default_positions()
    width = gripper.max_width / 2 if gripper.curve else 0.0
    q[model.columns(gripper.joint_names)] = gripper.joint_position(width)
    T = gripper.center(width).inverse() @ tree.link_pose(q, gripper.tcp_link).inverse()
    for link, boxes, side in zip(gripper.finger_links, (hand.left, hand.right), (1.0, -1.0), strict=True):
        points = (T @ tree.link_pose(q, link)).apply(surface_points(model.links[link], 0.004))
        points[:, 1] -= side * (width / 2 if gripper.curve else 0.0)
        low, high = boxes[:, None, :3] - 1e-6, boxes[:, None, 3:] + 1e-6
        assert ((points >= low) & (points <= high)).all(2).any(0).all()
        # near the pads, no box exceeds the pads' plane by much more than the finger itself
        near = (points[:, 2] > hand.pad[0, 1]) & (points[:, 2] < hand.pad[1, 1])
        level = (boxes[:, 2] < hand.pad[1, 1]) & (boxes[:, 5] > hand.pad[0, 1])
        inner = (side * boxes[level][:, [1, 4]]).min()
        assert inner > (side * points[near, 1]).min() - 0.006
