"""Grasps of a point cloud, based on GPD (ten Pas et al. 2017) without its classifier.

At points of the cloud, a local frame is formed from the normal and the directions of largest and smallest
curvature. The hand approaches along the normal, rotated in steps and tilted, and closes across. The common
grasp checks test whether points are between the fingers and whether their normals oppose each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.grasping.candidates import Proposals, generators
from armcell.grasping.grasp import tcp_pose
from armcell.grasping.hand import Hand
from armcell.grasping.surface import Surface
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAMPLES = 60  # number of local frames
TURNS = 6  # hand orientations about the approach axis, over half a circle
RADIUS = 0.015  # [m] neighborhood radius for the curvature
DEPTHS = (0.008, 0.02, 0.035)  # [m] depths of the TCP below the point


@generators.register("cloud")
def cloud_grasps(item: CollisionObject, surface: Surface, hand: Hand, up: Array) -> Proposals:
    """Propose grasps for a point cloud with normals. The surface normals around sampled points determine the
    grasp poses.
    """
    found, rng = Proposals(), np.random.default_rng(0)
    points, normals = surface.points, surface.normals
    for n, i in enumerate(_far_apart(points, SAMPLES, rng)):
        near = np.linalg.norm(points - points[i], axis=1) < RADIUS
        normal = normals[i]
        # Eigenvectors of the neighbors' normals: the largest is the mean normal, the smallest the direction
        # without curvature (a cylinder's axis).
        _, axes = np.linalg.eigh(normals[near].T @ normals[near])
        axis = axes[:, 0] - (axes[:, 0] @ normal) * normal
        if np.linalg.norm(axis) < 1e-6:
            continue
        axis /= np.linalg.norm(axis)
        across = np.cross(normal, axis)
        for turn in range(TURNS):
            t = np.pi * turn / TURNS
            closing = np.cos(t) * across + np.sin(t) * axis
            for depth in DEPTHS:
                if depth > hand.gripper.finger_depth:
                    continue
                name = f"point {n} at {180 // TURNS * turn} deg, {depth * 1000:.0f} mm deep"
                found.add(name, tcp_pose(closing, -normal, points[i] - normal * depth))
    return found


def _far_apart(points: Array, count: int, rng: np.random.Generator) -> list[int]:
    """Choose points of a cloud that are far from each other, by farthest point sampling,
    to propose grasps there. Return their indices.

    The first point is random.
    """
    chosen = [int(rng.integers(len(points)))]
    far = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        far = np.minimum(far, ((points - points[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(np.argmax(far)))
    return chosen
