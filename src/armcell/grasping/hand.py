"""Gripper geometry as boxes around the TCP, for checking grasps before any motion planning."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.collision.convex_decomposition import convex_pieces
from armcell.core import SE3, InputError, Mesh, Shape
from armcell.core.checks import is_number, require
from armcell.core.geometry import local_bounds
from armcell.grasping import hand_fit_kernel
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel, SuctionGripper
from armcell.model.grippers import RING_THICKNESS

Array = NDArray[np.float64]

POSE_ERROR = 0.005  # [m] by which an object may be beside its believed pose, if the cell sets no other value
OVERLAP = 0.001  # [m] smallest width and height of a pad
THINNEST = 5e-4  # [m] compression beyond the closed jaws with which a hand holds an object
SLANTED = 0.001  # [m] by which a finger's box exceeds the pads' plane from which on slabs replace the box
SLAB = 0.01  # [m] largest height of a slab
AT_THE_PAD = 0.001  # [m] maximum distance of a finger box from the closing plane to count as a pad


@dataclass(frozen=True, eq=False)
class Hand:
    """Geometry of a gripper's closed hand for grasp planning: boxes (n, 6) [m] in the tcp frame.

    A box is its lowest and highest corner.

    Opening moves the fingers by half the width along y: `left` to +y and `right` to -y.
    """

    gripper: Gripper
    palm: Array
    left: Array
    right: Array
    pad: Array  # (2, 2) [m] minimum and maximum x and z of the pads
    thinnest: float = THINNEST  # [m] smallest width of an object that the jaws hold
    cups: Array = field(
        default_factory=lambda: np.zeros((0, 3))
    )  # (c, 3) [m] centers of a suction gripper's rings

    @property
    def closed_width(self) -> float:
        """Return the gap [m] between the jaws of the closed hand."""
        return self.thinnest - THINNEST

    @property
    def boxes(self) -> Array:
        return np.concatenate([self.palm, self.left, self.right])


def pre_opening(width: float, gripper: Gripper, pose_error: float = 0.0) -> float:
    """Return how far [m] the fingers of a hand open before they grasp an object of a given width [m].

    Args:
        pose_error: [m] distance by which the object's true pose may differ from the believed one.
    Raises:
        InputError: a distance is negative or not a finite number.
    """
    for name, value in (("width", width), ("pose_error", pose_error)):
        require(is_number(value) and value >= 0, f"{name} is {value!r}, it must be a distance in meters")
    return hand_fit_kernel.pre_opening(float(width), gripper.max_width, float(pose_error))


@lru_cache(maxsize=32)
def hand_of(model: RobotModel, gripper: Gripper) -> Hand:
    """Return the geometry of the hand of a robot's gripper as boxes in the tcp frame, for grasp planning.

    Raises:
        InputError: the gripper's links have no collision shapes.
    """
    tree = kinematic_tree(model)
    q = model.default_positions()
    # The jaws of a linkage or a single jaw turn as they close: their shape is that at a medium opening.
    width = gripper.max_width / 2 if gripper.curve else 0.0
    for column in model.columns(gripper.joint_names):
        q[column] = gripper.joint_position(width)
    T_tcp_world = gripper.center(width).inverse() @ tree.link_pose(q, gripper.tcp_link).inverse()
    sides = {gripper.finger_links[0]: "left", gripper.finger_links[-1]: "right"} if gripper.curve else {}
    groups: dict[str, list[Array]] = {"palm": [], "left": [], "right": []}
    cups = gripper.cups if isinstance(gripper, SuctionGripper) else ()
    for name in gripper.hand_links:
        T_tcp_link = T_tcp_world @ tree.link_pose(q, name)
        for collision in model.links[name].collisions:
            T = T_tcp_link @ collision.T_link_shape
            shape = collision.shape
            for piece in convex_pieces(shape) if isinstance(shape, Mesh) else (shape,):
                if isinstance(piece, Mesh):
                    at = T.apply(piece.vertices)
                    box = np.concatenate([at.min(0), at.max(0)])
                else:
                    center, half = local_bounds(piece)
                    middle, reach = T.apply(center), np.abs(T.rotation.matrix) @ half
                    box = np.concatenate([middle - reach, middle + reach])
                lips = [
                    (T_tcp_link @ cup.T_link_cup).translation[2]
                    for cup in cups
                    if cup.link == name and cup.lip_reaches(shape, collision.T_link_shape)
                ]
                box[5] = min([box[5], *(z - RING_THICKNESS for z in lips)])  # a held surface bends the lip
                side = sides.get(name, "left" if box[1] + box[4] > 0 else "right")
                if name not in gripper.finger_links:
                    side = "palm"
                    groups[side].append(box)
                    continue
                open_by = (width / 2 if side == "right" else -width / 2) if gripper.curve else 0.0
                inside = box[1] + open_by if side == "left" else -box[4] - open_by
                for part in _slabs(piece, T) if inside < -SLANTED else [box]:
                    part[[1, 4]] += open_by
                    groups[side].append(part)
    if isinstance(gripper, SuctionGripper):
        centers = [(T_tcp_world @ tree.link_pose(q, c.link) @ c.T_link_cup).translation for c in cups]
        palm, none = np.array(groups["palm"]).reshape(-1, 6), np.zeros((0, 6))
        return Hand(gripper, palm, none, none, np.zeros((2, 2)), cups=np.array(centers))
    if not groups["left"] or not groups["right"]:
        raise InputError(
            f"gripper {gripper.name!r} has no collision shapes on both sides of its tcp",
            hint="give its finger links collision shapes",
        )
    palm, left, right = (np.array(groups[k]).reshape(-1, 6) for k in ("palm", "left", "right"))
    pad = np.reshape(gripper.pad, (2, 2)) if gripper.pad else _pad(left, right)
    ends = [model.limits(gripper.joint_names, kind)[0] for kind in ("lower", "upper")]
    closed = min(gripper.width(float(q)) for q in ends)
    return Hand(gripper, palm, left, right, pad, max(closed, 0.0) + THINNEST)


def _outline(piece: Shape) -> tuple[Array, NDArray[np.int32]]:
    """Return the corners (n, 3) and edges (k, 2) of one shape of a hand. A shape that is not a convex mesh is
    replaced by its bounding box.
    """
    if isinstance(piece, Mesh):
        faces = np.asarray(piece.faces)
        return np.asarray(piece.vertices), np.concatenate(
            [faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]
        )
    center, half = local_bounds(piece)
    signs = np.array(list(np.ndindex(2, 2, 2)))
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(signs[a] - signs[b]).sum() == 1]
    return center + (2 * signs - 1) * half, np.array(pairs, dtype=np.int32)


def _slabs(piece: Shape, T_tcp_piece: SE3) -> list[Array]:
    """Cut a convex piece of a finger into slabs at most `SLAB` high along z of the tcp frame, and return a
    box (6,) around each slab. A single box around a slanted finger would fill the space between the pads.
    """
    corners, edges = _outline(piece)
    corners = T_tcp_piece.apply(corners)
    low, high = corners[:, 2].min(), corners[:, 2].max()
    planes = np.linspace(low, high, max(int(np.ceil((high - low) / SLAB)), 1) + 1)
    a, b = corners[edges[:, 0]], corners[edges[:, 1]]
    boxes = []
    for bottom, top in pairwise(planes):
        points = [corners[(corners[:, 2] >= bottom) & (corners[:, 2] <= top)]]
        for z in (bottom, top):
            cut = np.flatnonzero((a[:, 2] - z) * (b[:, 2] - z) < 0)
            share = (z - a[cut, 2]) / (b[cut, 2] - a[cut, 2])
            points.append(a[cut] + share[:, None] * (b[cut] - a[cut]))
        found = np.concatenate(points)
        boxes.append(np.concatenate([found.min(0), found.max(0)]))
    return boxes


def _pad(left: Array, right: Array) -> Array:
    """Return the x range and the z range of a hand's finger pads. A pad is the overlap of two boxes, one per
    finger, that meet when the hand closes.
    """
    inner = (
        left[left[:, 1] < left[:, 1].min() + AT_THE_PAD],
        right[right[:, 4] > right[:, 4].max() - AT_THE_PAD],
    )
    # Several boxes may end at the closing plane: the outermost pair that overlaps is the pad.
    pairs = [
        np.stack([np.maximum(a[[0, 2]], b[[0, 2]]), np.minimum(a[[3, 5]], b[[3, 5]])])
        for a in inner[0]
        for b in inner[1]
    ]
    return max(pairs, key=lambda pad: (bool(np.all(pad[1] - pad[0] > OVERLAP)), pad[1, 1]))
