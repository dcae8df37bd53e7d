"""Scenes for the tests of the rooms from scene to planning."""

from __future__ import annotations

import numpy as np
import trimesh

from armcell.core import SE3, SO3, Box, Mesh
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

DOWN = SO3.from_rpy((np.pi, 0.0, 0.0))


def box(name: str, size, at=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0), **properties) -> CollisionObject:
    return CollisionObject.single(name, Box(*size), SE3.from_xyz_rpy(at, rpy), **properties)


def mesh_of(surface: trimesh.Trimesh) -> Mesh:
    return Mesh(surface.vertices, surface.faces)


def open_bin(width: float = 0.4, height: float = 0.2, wall: float = 0.01) -> trimesh.Trimesh:
    """A box without a lid, floor at z = 0, one closed surface (not convex)."""
    outer = trimesh.creation.box((width, width, height))
    outer.apply_translation((0, 0, height / 2))
    inner = width - 2 * wall
    profile = {  # corners of the outer and inner rectangles, counter-clockwise seen from above
        k: np.array([(-s, -s), (s, -s), (s, s), (-s, s)]) / 2 for k, s in (("out", width), ("in", inner))
    }
    rings = (("out", 0.0), ("out", height), ("in", height), ("in", wall))
    v = np.vstack([np.column_stack([profile[k], np.full(4, z)]) for k, z in rings])
    faces = [(0, 2, 1), (0, 3, 2), (12, 13, 14), (12, 14, 15)]  # floor from below and from inside
    for ring in (0, 4, 8):  # outer walls, rim, inner walls
        for i in range(4):
            a, b = ring + i, ring + (i + 1) % 4
            faces += [(a, b, b + 4), (a, b + 4, a + 4)]
    return trimesh.Trimesh(v, faces, process=False)


def panda(*objects: CollisionObject, **positions: float) -> PlanningScene:
    """The Panda at home with some objects; `joint3=0.5` moves panda_joint3."""
    model = load_robot("panda")
    q = model.default_positions()
    for name, value in positions.items():
        q[model.columns([f"panda_{name}"])] = value
    return PlanningScene.of(model, q, objects)


def ur10(*objects: CollisionObject) -> PlanningScene:
    model = load_robot("ur10_gripper")
    return PlanningScene.of(model, objects=objects)


def floating(*objects: CollisionObject, **pads) -> PlanningScene:
    """A 0.2 m cube of a robot on a slide along x (-2 to 2 m): distances can be told by hand."""
    from tests.model.helpers import collision, joint, link, model_of

    model = model_of(
        link("rail"), link("cube", collision('<box size="0.2 0.2 0.2"/>')),
        joint("x", "rail", "cube", "prismatic", '<axis xyz="1 0 0"/>',
              '<limit lower="-2" upper="2" velocity="1" effort="1"/>'),
    )  # fmt: skip
    return PlanningScene.of(model, objects=objects).with_padding(**pads)
