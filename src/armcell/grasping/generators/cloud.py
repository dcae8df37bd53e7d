"""Grasps of a cloud of points, after GPD (ten Pas and others 2017) without the learned part.

At points of the cloud a local frame is made of the normal and the direction in which the surface bends most
and least; the hand comes along the normal, turned in steps and tilted, and closes across. Whether points are
between the fingers, and how their normals stand, is judged like every other candidate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.grasping.candidates import Proposals, generators
from armcell.grasping.generators.frames import tcp_pose
from armcell.grasping.hand import Hand
from armcell.grasping.surface import Surface
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAMPLES = 60  # points at which a frame is made
TURNS = 6  # of the hand about its approach, half a circle
RADIUS = 0.015  # [m] around a point within which the surface bends
DEPTHS = (0.008, 0.02, 0.035)  # [m] of the tcp below the point


@generators.register("cloud")
def cloud_grasps(item: CollisionObject, surface: Surface, hand: Hand, up: Array) -> Proposals:
    """Candidates from local frames; needs points with normals only."""
    found, rng = Proposals(), np.random.default_rng(0)
    points, normals = surface.points, surface.normals
    for n, i in enumerate(_far_apart(points, SAMPLES, rng)):
        near = np.linalg.norm(points - points[i], axis=1) < RADIUS
        normal = normals[i]
        # The eigenvectors of the neighbours' normals: the largest is the mean normal, the smallest the
        # direction in which the surface does not bend (a cylinder's axis).
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
    """Indices of points far from each other, the first at random."""
    chosen = [int(rng.integers(len(points)))]
    far = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        far = np.minimum(far, ((points - points[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(np.argmax(far)))
    return chosen
