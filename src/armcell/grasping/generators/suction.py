"""Grasps with suction cups: on points of the surface, the hand's axis along the normal.

Points are far apart from each other and move away from edges by up to a cup's radius; the projections of the
center of mass onto the faces are added. The hand, or one of its cups, is centered on the point and turned
about the normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.grasping.candidates import Proposals, generators
from armcell.grasping.grasp import directions_around, tcp_pose
from armcell.grasping.hand import Hand
from armcell.grasping.surface import Surface
from armcell.model import SuctionGripper
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAMPLES = 40  # points
TURNS = 8  # hand orientations about the normal
AROUND, PARALLEL = 2.0, 0.99  # radii of a cup over which a point is averaged, cosine of equal normals
SAME = 0.002  # [m] points and projections closer than this count as one


@generators.register("suction")
def suction_grasps(item: CollisionObject, surface: Surface, hand: Hand, up: Array) -> Proposals:
    """Generate suction grasps at points of a surface and at the projections of the center of mass.

    The result is deterministic.
    """
    gripper = hand.gripper
    assert isinstance(gripper, SuctionGripper)
    found, taken = Proposals(), set()
    centers = hand.cups - hand.cups.mean(0)
    anchors = [np.zeros(3), *centers] if len(centers) > 1 else [np.zeros(3)]
    middle, widest = hand.cups.mean(0), max(cup.radius for cup in gripper.cups)
    for n, i in enumerate(_far_apart(surface.points, SAMPLES)):
        normal = surface.normals[i]
        flat = np.linalg.norm(surface.points - surface.points[i], axis=1) < AROUND * widest
        flat &= surface.normals @ normal > PARALLEL
        point = surface.points[flat].mean(0)
        over = surface.center_of_mass + normal * ((point - surface.center_of_mass) @ normal)
        for at, name in ((over, "over the center of mass"), (point, f"point {n}")):
            key = (*np.round(at / SAME).astype(int).tolist(), *np.round(normal * 20).astype(int).tolist())
            if key in taken:
                continue
            taken.add(key)
            for turn, closing in enumerate(directions_around(normal, TURNS, np.eye(3)[1])):
                T = tcp_pose(closing, -normal, at)
                for k, anchor in enumerate(anchors):
                    which = f", cup {k}" if k else ""
                    pose = T.copy()
                    pose[:3, 3] -= T[:3, :3] @ (anchor + middle * (1.0, 1.0, 0.0))
                    found.add(f"{_side(normal, up)} {name} at {360 // TURNS * turn} deg{which}", pose)
    return found


def _far_apart(points: Array, count: int) -> list[int]:
    """Select surface points at which to generate suction grasps: points that are far from each other, by
    farthest point sampling. Return their indices.
    """
    chosen = [0]
    far = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        far = np.minimum(far, ((points - points[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(np.argmax(far)))
    return chosen


def _side(normal: Array, up: Array) -> str:
    """Describe the side of an object from which a generated suction grasp approaches: "top", "side", "slope"
    or "bottom".
    """
    height = float(normal @ up)
    return (
        "top" if height > 0.95 else "bottom" if height < -0.95 else "side" if abs(height) < 0.1 else "slope"
    )
