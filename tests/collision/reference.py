"""A second opinion on collisions: pinocchio's geometry model (its own URDF reader, mesh loader and forward
kinematics, every mesh as bare triangles) asked pair by pair, without any broad phase; and signed distances
of primitives to points, by formula.
"""

from __future__ import annotations

from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import yaml
from tests.model.helpers import PinRobot

from armcell.core import SE3, Box, Capsule, Cone, Cylinder, Mesh, Plane, Shape, Sphere
from armcell.kinematics import kinematic_tree
from armcell.model.assets import installed_share, resolve_uri
from armcell.model.loader import LIBRARY
from armcell.scene import PlanningScene


def pin_geometry(name: str) -> tuple[pin.Model, pin.GeometryModel]:
    """A library robot with its collision geometry, parts put together."""
    data = yaml.safe_load((LIBRARY / name / "robot.yaml").read_text())
    if "urdf" in data:
        file = str(resolve_uri(data["urdf"], LIBRARY / name))
        model = pin.buildModelFromUrdf(file)
        shares = [str(s) for s in installed_share()]
        return model, pin.buildGeomFromUrdf(model, file, pin.GeometryType.COLLISION, package_dirs=shares)
    whole, *others = data["parts"]
    model, geometry = pin_geometry(whole["robot"])
    for part in others:
        other, other_geometry = pin_geometry(part["robot"])
        frame = model.getFrameId(part["parent_link"], pin.FrameType.BODY)
        model, geometry = pin.appendModel(model, other, geometry, other_geometry, frame, pin.SE3.Identity())
    return model, geometry


def triangles(vertices: np.ndarray, faces: np.ndarray) -> coal.CollisionGeometry:
    bvh = coal.BVHModelOBBRSS()
    bvh.beginModel(len(faces), len(vertices))
    for face in faces:
        bvh.addTriangle(*(np.asarray(vertices[i], dtype=float) for i in face))
    bvh.endModel()
    return bvh


def coal_shape(shape: Shape) -> coal.CollisionGeometry:
    match shape:
        case Box(x, y, z):
            return coal.Box(x, y, z)
        case Sphere(r):
            return coal.Sphere(r)
        case Cylinder(r, length):
            return coal.Cylinder(r, length)
        case Capsule(r, length):
            return coal.Capsule(r, length)
        case Cone(r, length):
            return coal.Cone(r, length)
        case Mesh():
            return triangles(shape.vertices, shape.faces)
    raise TypeError(shape)


def is_inside(point: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether a closed mesh winds around a point (sum of solid angles, van Oosterom and Strackee 1983)."""
    a, b, c = (vertices[faces[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    dot = (
        np.einsum("ij,ij->i", a, b) * lc + np.einsum("ij,ij->i", b, c) * la + np.einsum("ij,ij->i", c, a) * lb
    )
    return abs(2 * np.arctan2(triple, la * lb * lc + dot).sum()) > 2 * np.pi


@lru_cache(maxsize=1000)
def corners_and_faces(bvh: coal.CollisionGeometry) -> tuple[np.ndarray, np.ndarray]:
    faces = [[t[0], t[1], t[2]] for t in (bvh.tri_indices(i) for i in range(bvh.num_tris))]
    return np.array(bvh.vertices()), np.array(faces)


def contains(A, TA: coal.Transform3s, B, TB: coal.Transform3s) -> bool:
    """Whether one point of B is inside A, where A is triangles (coal takes other shapes as solid anyway)."""
    if not isinstance(A, coal.BVHModelOBBRSS):
        return False
    point = B.vertex(0) if isinstance(B, coal.BVHModelOBBRSS) else np.zeros(3)
    local = TA.getRotation().T @ (TB.getRotation() @ point + TB.getTranslation() - TA.getTranslation())
    vertices, faces = corners_and_faces(A)
    if np.any(local < vertices.min(0)) or np.any(local > vertices.max(0)):
        return False
    return is_inside(local, vertices, faces)


INSIDE = -1.0  # [m] told for a body whose surface touches nothing because it is inside another


class BruteForce:
    """Touching pairs and distances of a scene's robot, all joints, nothing padded."""

    def __init__(self, scene: PlanningScene, name: str):
        self.scene, self.tree = scene, kinematic_tree(scene.model)
        model, self.geometry = pin_geometry(name)
        self.robot = PinRobot(model, scene.model)
        rigid = {link: i for i, links in enumerate(scene.model.rigid_groups) for link in links}
        self.links = [model.frames[o.parentFrame].name for o in self.geometry.geometryObjects]
        self.fixed = [
            (item.name, coal_shape(shape), item.T_world_object @ T)
            for item in scene.objects.values()
            for shape, T in item.shapes
        ]
        self.pairs = [
            (i, j)
            for i, a in enumerate(self.links)
            for j, b in enumerate(self.links[:i])
            if rigid[a] != rigid[b] and frozenset((a, b)) not in scene.model.disabled_collisions
        ]
        self.root = rigid[scene.model.root_link]
        self.rigid = rigid

    def pairs_at(self, q: np.ndarray):
        """(name, name, coal geometry, transform, geometry, transform) of everything that may touch."""
        self.robot.place(self.tree.full_positions(q))
        data = self.geometry.createData()
        pin.updateGeometryPlacements(self.robot.pin, self.robot.data, self.geometry, data)
        root = self.robot.frame(self.scene.model.root_link).inverse()
        placed = []
        for o, M in zip(self.geometry.geometryObjects, data.oMg, strict=True):
            T = root * M
            placed.append((o.geometry, coal.Transform3s(T.rotation, T.translation)))
        for i, j in self.pairs:
            yield self.links[i], self.links[j], *placed[i], *placed[j]
        for i, link in enumerate(self.links):
            if self.rigid[link] == self.root:
                continue  # a base may touch what it stands on
            for name, shape, T in self.fixed:
                yield link, name, *placed[i], shape, coal.Transform3s(T.rotation.matrix, T.translation)

    def distances(self, q: np.ndarray) -> dict[frozenset[str], float]:
        """Distance of each pair of bodies [m], 0 where they touch, `INSIDE` where one is in the other."""
        best: dict[frozenset[str], float] = {}
        for a, b, *pair in self.pairs_at(q):
            touching = coal.collide(*pair, coal.CollisionRequest(), coal.CollisionResult())
            d = 0.0 if touching else coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult())
            if not touching and (contains(*pair) or contains(*pair[2:], *pair[:2])):
                d = INSIDE
            key = frozenset((a, b))
            best[key] = min(best.get(key, np.inf), d)
        return best


def signed_distance(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Distance of points (m, 3) to a primitive's surface, negative inside (I. Quilez' formulas)."""
    radial = np.linalg.norm(points[:, :2], axis=1)
    z = points[:, 2]
    match shape:
        case Plane():
            return z
        case Sphere(r):
            return np.linalg.norm(points, axis=1) - r
        case Box():
            q = np.abs(points) - shape.half_extents
            return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
        case Cylinder(r, length):
            q = np.column_stack([radial - r, np.abs(z) - length / 2])
            return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
        case Capsule(r, length):
            return np.hypot(radial, z - np.clip(z, -length / 2, length / 2)) - r
        case Cone(r, length):
            # In the (radius, z) half plane: the triangle of base center, base rim and apex.
            p, rim, apex = (
                np.column_stack([radial, z]),
                np.array([r, -length / 2]),
                np.array([0.0, length / 2]),
            )
            slope = apex - rim
            t = np.clip((p - rim) @ slope / (slope @ slope), 0, 1)
            on_slope = np.linalg.norm(p - rim - t[:, None] * slope, axis=1)
            on_base = np.hypot(np.maximum(radial - r, 0), z + length / 2)
            outward = np.array([slope[1], -slope[0]])
            inside = ((p - rim) @ outward < 0) & (z > -length / 2)
            return np.where(inside, -1, 1) * np.minimum(on_slope, on_base)
    raise TypeError(shape)


def distance_to_points(shape: Shape, T_world_shape: SE3, points: np.ndarray) -> float:
    """Smallest signed distance of world points (m, 3) to a shape."""
    return float(signed_distance(shape, T_world_shape.inverse().apply(points)).min())
