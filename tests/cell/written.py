"""A second opinion on what `armcell setup` wrote: the URDF read by pinocchio, the SRDF by lxml, the meshes by
trimesh, contact by coal; nothing of armcell's."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlparse

import coal
import numpy as np
import pinocchio as pin
import trimesh
from lxml import etree
from tests.collision.reference import contains, triangles
from tests.model.helpers import EXAMPLES

SURE = 50  # samples in which a body that touches nothing is looked for inside another as well


class Written:
    """Links of a written folder, placed by pinocchio.

    Attributes:
        disabled: (link, link, reason) of the SRDF.
    """

    def __init__(self, folder: Path):
        (urdf,), (srdf,) = folder.glob("config/*.urdf"), folder.glob("config/*.srdf")
        self.pin = pin.buildModelFromUrdf(str(urdf))
        self.data = self.pin.createData()
        root = etree.parse(str(urdf)).getroot()
        self.shapes = {
            link.get("name"): [_shape(c) for c in link.findall("collision")] for link in root.findall("link")
        }
        self.frame = {n: self.pin.getFrameId(n, pin.FrameType.BODY) for n in self.shapes}
        self.mimic = {
            j.get("name"): (m.get("joint"), float(m.get("multiplier", 1)), float(m.get("offset", 0)))
            for j in root.findall("joint")
            if (m := j.find("mimic")) is not None
        }
        semantic = etree.parse(str(srdf)).getroot()
        self.disabled = [
            (e.get("link1"), e.get("link2"), e.get("reason")) for e in semantic.findall("disable_collisions")
        ]

    def sample(self, rng: np.random.Generator) -> None:
        """Put the robot into a random state within its limits."""
        q = pin.neutral(self.pin)
        values = {}
        for i in range(1, self.pin.njoints):
            joint, at = self.pin.joints[i], self.pin.idx_qs[i]
            if joint.nq == 2:  # continuous: a point on the circle
                angle = rng.uniform(-np.pi, np.pi)
                q[at : at + 2] = np.cos(angle), np.sin(angle)
                continue
            low, high = self.pin.lowerPositionLimit[at], self.pin.upperPositionLimit[at]
            q[at] = values[self.pin.names[i]] = rng.uniform(low, high)
        for name, (source, factor, offset) in self.mimic.items():
            i = self.pin.getJointId(name)
            if i < self.pin.njoints:
                q[self.pin.idx_qs[i]] = factor * values[source] + offset
        pin.framesForwardKinematics(self.pin, self.data, q)
        self.placed: dict[str, list[coal.Transform3s]] = {}

    def _place(self, link: str) -> list[coal.Transform3s]:
        if link not in self.placed:
            M = self.data.oMf[self.frame[link]]
            self.placed[link] = [
                coal.Transform3s(T.rotation, T.translation) for T in (M * own for _, own in self.shapes[link])
            ]
        return self.placed[link]

    def touch(self, a: str, b: str, inside: bool) -> bool:
        """Whether two links' meshes are in contact, or (if asked) one is within the other."""
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        for (A, _), TA in zip(self.shapes[a], self._place(a), strict=True):
            for (B, _), TB in zip(self.shapes[b], self._place(b), strict=True):
                result.clear()
                if coal.collide(A, TA, B, TB, request, result):
                    return True
                if inside and (contains(A, TA, B, TB) or contains(B, TB, A, TA)):
                    return True
        return False

    def count(self, samples: int, seed: int) -> dict[tuple[str, str], int]:
        """How often each disabled pair but the adjacent ones touches in random states."""
        rng = np.random.default_rng(seed)
        pairs = [(a, b) for a, b, reason in self.disabled if reason != "Adjacent"]
        links = sorted({link for pair in pairs for link in pair})
        at = np.array([[links.index(a), links.index(b)] for a, b in pairs])
        balls = np.array([_ball(self.shapes[link]) for link in links])
        frames = [self.frame[link] for link in links]
        reach = balls[at[:, 0], 3] + balls[at[:, 1], 3]
        counts = dict.fromkeys(pairs, 0)
        known: dict[int, tuple[np.ndarray, bool]] = {}  # of links that do not move relative to each other
        for i in range(samples):
            self.sample(rng)
            centers = np.array([self.data.oMf[f].act(b[:3]) for f, b in zip(frames, balls, strict=True)])
            apart = np.linalg.norm(centers[at[:, 0]] - centers[at[:, 1]], axis=1)
            for k in np.flatnonzero(apart <= reach):
                a, b = pairs[k]
                T = self.data.oMf[self.frame[a]].actInv(self.data.oMf[self.frame[b]]).homogeneous
                if i < SURE or k not in known or np.abs(known[k][0] - T).max() > 1e-12:
                    known[k] = T, self.touch(a, b, i < SURE)
                counts[a, b] += known[k][1]
        return counts


def _ball(shapes: list[tuple[coal.CollisionGeometry, pin.SE3]]) -> np.ndarray:
    """A ball (4,) around a link's shapes, in its frame."""
    corners = []
    for shape, own in shapes:
        shape.computeLocalAABB()
        center, radius = own.act(shape.aabb_center), shape.aabb_radius
        corners += [center - radius, center + radius]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return np.append((low + high) / 2, np.linalg.norm(high - low) / 2)


def _shape(element: etree._Element) -> tuple[coal.CollisionGeometry, pin.SE3]:
    geometry, origin = element.find("geometry")[0], element.find("origin")
    own = pin.SE3.Identity()
    if origin is not None:
        numbers = [np.array([float(v) for v in origin.get(k, "0 0 0").split()]) for k in ("xyz", "rpy")]
        own = pin.SE3(pin.rpy.rpyToMatrix(numbers[1]), numbers[0])
    match geometry.tag:
        case "box":
            return coal.Box(*(float(v) for v in geometry.get("size").split())), own
        case "sphere":
            return coal.Sphere(float(geometry.get("radius"))), own
        case "cylinder":
            return coal.Cylinder(float(geometry.get("radius")), float(geometry.get("length"))), own
    scale = np.array([float(v) for v in geometry.get("scale", "1 1 1").split()])
    mesh = trimesh.load(_file(geometry.get("filename")), force="mesh", process=False)
    return triangles(np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces)), own


def _file(uri: str) -> Path:
    if uri.startswith("file://"):
        return Path(unquote(urlparse(uri).path))
    assert uri.startswith("package://example-robot-data/"), uri
    return EXAMPLES.parents[1] / uri.removeprefix("package://")
