"""Robot bodies of the kernel: sphere covers (finer at narrow gaps) and convex pieces of links and objects.

Base links need a finer sphere cover if an arm link passes them at a small distance. The upper arm of a
UR5 is 16 mm from its base in most states: covers of 10 mm each overlap there, and the kernel would test
the convex pieces of both links in each of these states. A base link is never tested against the world,
so its finer cover costs no time elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.collision.coal_shapes import solid
from armcell.collision.convex_decomposition import VERSION as PIECES_VERSION
from armcell.collision.convex_decomposition import convex_pieces
from armcell.collision.kernel.convex_pieces import ConvexPieces, HullVertices, Splitter, pieces_of
from armcell.collision.kernel.cover import FIT_VERSION, GROUP, Cover, bounding_sphere, cover
from armcell.collision.object_decomposition import VERSION as OBJECT_VERSION
from armcell.collision.object_decomposition import object_pieces
from armcell.core import SE3, Box, Capsule, Cone, Cylinder, Mesh, Shape, Sphere
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.kinematics.tree import FIXED
from armcell.model import Link, RobotModel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

FINE_OVERSHOOT = 0.003  # [m] for fingers, and for base links in `narrow_gaps`
LINK_OVERSHOOT = 0.010
OBJECT_OVERSHOOT = 0.005  # [m] for held objects, or `OBJECT_SHARE` of the largest extent if that is larger:
LARGE_LINK = 1.5  # [m] longer shapes of links, such as a linear axis, get the coarser covers of objects
OBJECT_SHARE = 1 / 15  # a large object needs no finer cover, and fitting one would take a minute

BODY_VERSION = 1  # increase when `_new_body` returns other spheres or pieces, to invalidate the disk cache
UP = np.float32(1 + 1e-6)  # rounding to float32 must not shrink a cover
NARROW_GAPS_VERSION = 1  # increase when the results change, to invalidate the disk cache
STATES = 32  # random states in which distances are computed
NARROW_SHARE = 0.3  # share of the states in which only the finer cover leaves a gap
JOINTS = 2  # between the base and the other link; links with more joints between them are rarely that close


@dataclass(frozen=True, eq=False)
class Body:
    """Robot body (a link or held object) as the collision kernel stores it: sphere cover and convex pieces in
    the body's own frame.

    Spheres (s, 5), their groups (g, 4) with sizes (g,), and one sphere around all.
    """

    around: F64  # (4,) bounding sphere of the body
    spheres: F64
    groups: F64
    sizes: list[int]
    pieces: ConvexPieces

    @cached_property
    def _centers(self) -> F64:
        """Return the centers (1 + g + s, 3) of a kernel body's spheres: its bounding sphere, its g sphere
        groups and its s small spheres.
        """
        return np.concatenate([self.around[None, :3], self.groups[:, :3], self.spheres[:, :3]])

    @cached_property
    def _radii(self) -> F32:
        """Return the outer and inner radii (1 + g + s, 2) of a kernel body's bounding sphere, g sphere groups
        and s spheres. Outer radii are rounded up and inner radii down.
        """
        one, g = 1, 1 + len(self.groups)
        radii = np.zeros((g + len(self.spheres), 2), np.float32)
        radii[0, 0], radii[one:g, 0], radii[g:] = self.around[3], self.groups[:, 3], self.spheres[:, 3:]
        radii[:, 0] *= UP
        radii[g:, 0] += np.float32(1e-6)
        radii[g:, 1] = np.maximum(radii[g:, 1] * np.float32(1 - 1e-5) - np.float32(2e-6), 0)
        return radii

    def placed(self, T: F64) -> PlacedBody:
        """Transform a kernel body (sphere cover and convex pieces) to a frame of the planning group.

        T (4, 4) is the pose of the body in this frame.
        """
        balls, g = np.empty((len(self._radii), 5), np.float32), 1 + len(self.groups)
        balls[:, :3] = self._centers @ T[:3, :3].T + T[:3, 3]
        balls[:, 3:] = self._radii
        return PlacedBody(balls[0, :4], balls[g:], balls[1:g, :4], self.pieces.poses_after(T))


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """Robot body in the collision kernel's array format: sphere cover and convex pieces, transformed to a
    frame of the planning group.
    """

    around: F32
    sphere: F32
    group: F32
    piece_pose: F64  # (e, 12)


def link_body(link: Link, scale: float, overshoot: float) -> Body:
    """Return the kernel body of a robot link (sphere cover and convex pieces), with the link's collision
    shapes enlarged by the factor `scale`.

    Args:
        overshoot: largest distance [m] by which a sphere may extend beyond the shape.
    """
    shapes = [(_scaled(c.shape, scale), c.T_link_shape.matrix) for c in link.collisions]
    return _body([(s, T, overshoot if _size(s) < LARGE_LINK else _object_overshoot(s)) for s, T in shapes])


def held_body(shapes: tuple[tuple[Shape, SE3], ...]) -> Body:
    """Return the kernel body (sphere cover and convex pieces) of a held object, given its shapes and their
    poses in the object frame.
    """
    return _body([(s, t.matrix, _object_overshoot(s)) for s, t in shapes], object_pieces)


def _body(shapes: list[tuple[Shape, F64, float]], split: Splitter = convex_pieces) -> Body:
    """Return the kernel body (sphere cover and convex pieces) for shapes of a robot body. Each shape comes
    with its pose and its overshoot: how far [m] a cover sphere may protrude from the shape.

    The result is cached on disk, so that later starts need no mesh library.
    """
    if not any(isinstance(shape, Mesh) for shape, _, _ in shapes):
        return _new_body(shapes, split)
    version = PIECES_VERSION if split is convex_pieces else (split.__name__, OBJECT_VERSION)
    versions = repr((BODY_VERSION, FIT_VERSION, version, GROUP))
    key = key_of(versions, *(part for shape, T, over in shapes for part in _content(shape, T, over)))

    def computed() -> dict[str, NDArray]:
        body = _new_body(shapes, split)
        p = body.pieces
        return {
            "around": body.around, "spheres": body.spheres, "groups": body.groups,
            "sizes": np.array(body.sizes, np.int64), "piece_kind": p.kind, "piece_size": p.size,
            "piece_pose": p.pose, "piece_ball": p.ball, "corner_count": p.corners.count,
            "corners": p.corners.points,
        }  # fmt: skip

    stored = recall_or_compute("bodies", key, computed)
    corners = HullVertices(stored["corner_count"], stored["corners"])
    pieces = ConvexPieces(
        stored["piece_kind"], stored["piece_size"], stored["piece_pose"], stored["piece_ball"], corners
    )
    return Body(stored["around"], stored["spheres"], stored["groups"], stored["sizes"].tolist(), pieces)


def _content(shape: Shape, T: F64, overshoot: float) -> tuple[NDArray[Any] | str, ...]:
    """Return a cache key for the kernel data of a robot body. It contains all values that determine the
    body's sphere cover and convex pieces.
    """
    if isinstance(shape, Mesh):
        return (T, repr(overshoot), shape.vertices, shape.faces.astype(np.int64))
    return (T, repr((overshoot, shape)))


def _new_body(shapes: list[tuple[Shape, F64, float]], split: Splitter) -> Body:
    spheres, groups, sizes = [], [], []
    for shape, T, overshoot in shapes:
        found: Cover = cover(shape, overshoot)
        centers = found.centers @ T[:3, :3].T + T[:3, 3]
        spheres.append(np.column_stack([centers, found.outer, found.inner]))
        groups.append(np.column_stack([found.groups[:, :3] @ T[:3, :3].T + T[:3, 3], found.groups[:, 3]]))
        n = len(centers)
        sizes += [min(GROUP, n - i) for i in range(0, n, GROUP)]
    every = np.vstack(groups)
    center, radius = bounding_sphere(every[:, :3], every[:, 3])
    pieces = pieces_of([(s, T) for s, T, _ in shapes], split)
    return Body(np.append(center, radius), np.vstack(spheres), every, sizes, pieces)


def _scaled(shape: Shape, scale: float) -> Shape:
    if scale == 1.0:
        return shape
    match shape:
        case Mesh():
            return Mesh(shape.vertices * scale, shape.faces, shape.file)
        case Box():
            return Box(shape.x * scale, shape.y * scale, shape.z * scale)
        case Sphere():
            return Sphere(shape.radius * scale)
        case Cylinder() | Capsule() | Cone():
            return type(shape)(shape.radius * scale, shape.length * scale)
    return shape


def _object_overshoot(shape: Shape) -> float:
    return max(OBJECT_OVERSHOOT, OBJECT_SHARE * _size(shape))


def _size(shape: Shape) -> float:
    """Return the longest side [m] of the bounding box of a shape that belongs to a kernel body."""
    _, half = local_bounds(shape)
    return 2 * float(half.max())


def narrow_gaps(model: RobotModel) -> frozenset[str]:
    """Return the robot's base links whose kernel bodies need a finer sphere cover, because the gap to another
    link is often too narrow for the normal cover.

    The distances are cached on disk.
    """
    tree = kinematic_tree(model)
    joints_above = {0: 0}
    for j, parent in enumerate(tree.parent.tolist()):
        joints_above[j + 1] = joints_above[parent] + int(tree.kind[j] != FIXED)
    links = [model.links[name] for name in tree.link_names]
    bases = [k for k, link in enumerate(links) if not joints_above[k] and _is_mesh(link)]
    pairs = [
        (base, k)
        for base in bases
        for k, link in enumerate(links)
        if joints_above[k] == JOINTS
        and _is_mesh(link)
        and frozenset((links[base].name, link.name)) not in model.disabled_collisions
    ]
    if not pairs:
        return frozenset()
    low, high = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    states = np.random.default_rng(0).uniform(low, high, (STATES, model.dof))
    poses = np.array([tree.link_transforms(q) for q in states])
    used = sorted({k for pair in pairs for k in pair})
    meshes = [a for k in used for a in _mesh_arrays(links[k])]
    key = key_of(repr((NARROW_GAPS_VERSION, pairs, FINE_OVERSHOOT, LINK_OVERSHOOT)), poses[:, used], *meshes)

    def computed() -> dict[str, NDArray]:
        share = [
            np.mean([_needs_fine_cover(links[base], T[base], links[k], T[k]) for T in poses])
            for base, k in pairs
        ]
        return {"share": np.array(share)}

    stored = recall_or_compute("gaps", key, computed)
    return frozenset(
        links[base].name
        for (base, _), share in zip(pairs, stored["share"], strict=True)
        if share >= NARROW_SHARE
    )


def _is_mesh(link: Link) -> bool:
    return len(link.collisions) == 1 and isinstance(link.collisions[0].shape, Mesh)


def _mesh_arrays(link: Link) -> tuple[np.ndarray, ...]:
    (collision,) = link.collisions
    assert isinstance(collision.shape, Mesh)
    return collision.shape.vertices, collision.shape.faces.astype(np.int64), collision.T_link_shape.matrix


def _needs_fine_cover(base: Link, T_base: np.ndarray, other: Link, T_other: np.ndarray) -> bool:
    """Return whether a base link's kernel body needs a fine sphere cover: the gap to another link is too
    narrow for two normal covers, but wide enough if the base has a fine cover.
    """
    arguments = []
    for link, T in ((base, T_base), (other, T_other)):
        (collision,) = link.collisions
        T = T @ collision.T_link_shape.matrix
        arguments += [solid(collision.shape).exact, coal.Transform3s(T[:3, :3], T[:3, 3])]
    gap = coal.distance(*arguments, coal.DistanceRequest(), coal.DistanceResult())
    return FINE_OVERSHOOT + LINK_OVERSHOOT < gap < 2 * LINK_OVERSHOOT
