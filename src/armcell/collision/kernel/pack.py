"""A scene and a group of joints as flat arrays for the kernel."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armcell.collision.convex import convex_pieces
from armcell.collision.kernel import gjk
from armcell.collision.kernel.cover import GROUP, bounding_sphere, cover
from armcell.collision.kernel.simd import L
from armcell.collision.shapes import is_convex
from armcell.core import SE3, SO3, Box, Capsule, Cone, Cylinder, InputError, Mesh, Plane, Shape, Sphere
from armcell.kinematics import kinematic_tree
from armcell.kinematics.tree import PRISMATIC, REVOLUTE
from armcell.scene import PlanningScene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

FINGER_OVERSHOOT = 0.003  # [m]
LINK_OVERSHOOT = 0.010
OBJECT_OVERSHOOT = 0.005  # of a held object, or this share of its largest extent, whichever is more:
OBJECT_SHARE = 1 / 15  # a crate needs no finer cover than a cube, and fitting one would take a minute


class Pack(NamedTuple):
    """Everything the kernel reads. `f` frames (0 is the world), `k` bodies, `g` groups, `s` spheres,
    `o` world shapes, `e` exact pieces. Vectors are per lane where an array ends in L."""

    dof: int
    # frames: T_parent_joint with the joint's axis turned to z
    parent: I32  # (f,)
    fixed: F32  # (f, 12) rows of 3x4
    kind: I32  # (f,) 1 revolute, 2 prismatic
    column: I32  # (f,) of the group's positions
    multiplier: F32  # (f,)
    offset: F32  # (f,)
    # bodies: links and attached objects that the group moves
    frame: I32  # (k,)
    body_sphere: F32  # (k, 4) centre in the frame, radius
    body_groups: I32  # (k + 1,) first group of each
    padding: F32  # (k,) against world shapes, the largest of its margins
    margin: F32  # (k, o) padding of each body against each world shape, -1 where contact is ignored
    group_sphere: F32  # (g, 4)
    group_spheres: I32  # (g + 1,) first sphere of each
    sphere: F32  # (s, 5) centre in the frame, outer radius, inner radius
    body_pieces: I32  # (k + 1,) first exact piece of each
    # pairs of bodies
    pairs: I32  # (p, 2)
    # world shapes
    shape_kind: I32  # (o,)
    shape_pose: F32  # (o, 12) rows of T_shape_world (world to shape)
    shape_size: F32  # (o, 3)
    shape_planes: I32  # (o + 1,) of convex meshes
    planes: F32  # (n, 4) outward normal and offset
    boxes: F32  # (blocks, 6, L) axis-aligned boxes, 16 shapes a block; unused lanes are empty
    shape_pieces: I32  # (o + 1,) first exact piece of each world shape
    # exact pieces: convex solids of bodies (in their frame) and of world shapes (in the world)
    piece_kind: I32  # (e,)
    piece_size: F64  # (e, 3)
    piece_pose: F64  # (e, 12) rows of T_frame_piece, or T_world_piece
    piece_points: I32  # (e, 2) first point and count
    piece_ball: F64  # (e, 4) bounding ball in the frame (bodies) or world (shapes)
    points: F64  # (n, 3)
    # motion
    reach: F64  # (k, dof) how far a body's points move per unit of each joint, at most
    pair_reach: F64  # (p, dof) the same for the relative motion of a pair


class Names(NamedTuple):
    """What the numbers of a pack stand for."""

    bodies: tuple[str, ...]
    shapes: tuple[str, ...]  # object of each world shape


def pack(scene: PlanningScene, joint_names: tuple[str, ...]) -> tuple[Pack, Names]:
    """The kernel's view of a scene for the joints of one group; the other joints stay where they are."""
    return _Packer(scene, joint_names).build()


class _Packer:
    def __init__(self, scene: PlanningScene, joint_names: tuple[str, ...]):
        self.scene, self.model = scene, scene.model
        self.tree = kinematic_tree(scene.model)
        self.columns = {int(c): i for i, c in enumerate(scene.model.columns(joint_names))}
        self.dof = len(joint_names)
        self.pieces: list[tuple[int, list[float], NDArray[Any], NDArray[Any], NDArray[Any]]] = []

    def build(self) -> tuple[Pack, Names]:
        self._frames()
        bodies, body_arrays = self._bodies()
        shapes, shape_arrays = self._shapes()
        margin = np.array(
            [
                [-1.0 if self.scene.is_allowed(b, o) else body_arrays["padding"][k] for o in shapes]
                for k, (b, _) in enumerate(bodies)
            ],
            dtype=np.float32,
        ).reshape(len(bodies), len(shapes))
        pairs = self._pairs(bodies)
        reach = self._reach(bodies, body_arrays["body_sphere"])
        piece_arrays = self._piece_arrays()
        result = Pack(
            dof=self.dof,
            parent=np.array(self.parent, np.int32),
            fixed=np.array(self.fixed, np.float32).reshape(-1, 12),
            kind=np.array(self.kind, np.int32),
            column=np.array(self.column, np.int32),
            multiplier=np.array(self.multiplier, np.float32),
            offset=np.array(self.offset, np.float32),
            pairs=pairs,
            margin=margin,
            reach=reach,
            pair_reach=self._pair_reach(bodies, pairs, reach),
            **body_arrays,
            **shape_arrays,
            **piece_arrays,
        )
        return result, Names(tuple(b for b, _ in bodies), tuple(shapes))

    # --- kinematics: only the group's joints are left, everything else is merged ---
    def _frames(self) -> None:
        tree, q = self.tree, self.scene.positions
        self.parent, self.fixed, self.kind, self.column = [0], [_rows(np.eye(4))], [0], [0]
        self.multiplier, self.offset = [1.0], [0.0]
        self.of_link = {0: (0, np.eye(4))}  # link -> frame, T_frame_link
        rest = tree.link_transforms(q)
        for j in range(len(tree.parent)):
            frame, T = self.of_link[int(tree.parent[j])]
            T = T @ tree.T_parent_joint[j]
            column = self.columns.get(int(tree.column[j])) if tree.kind[j] else None
            if column is None:  # not moved by the group: where it is now
                relative = np.linalg.inv(rest[tree.parent[j]] @ tree.T_parent_joint[j]) @ rest[j + 1]
                self.of_link[j + 1] = (frame, T @ relative)
                continue
            A = np.eye(4)
            A[:3, :3] = SO3.between((0.0, 0.0, 1.0), tree.axis[j]).matrix
            self.parent.append(frame)
            self.fixed.append(_rows(T @ A))
            self.kind.append(1 if tree.kind[j] == REVOLUTE else 2)
            self.column.append(column)
            self.multiplier.append(float(tree.multiplier[j]))
            self.offset.append(float(tree.offset[j]))
            self.of_link[j + 1] = (len(self.parent) - 1, A.T)
        self.joint_of_frame = [-1] + [
            j for j in range(len(tree.parent)) if tree.kind[j] and int(tree.column[j]) in self.columns
        ]

    # --- bodies ---
    def _bodies(self):
        scene, tree = self.scene, self.tree
        fingers = {f for g in self.model.grippers.values() for f in g.finger_links}
        bodies: list[tuple[str, int]] = []  # name, frame
        per_body: list[list[tuple[Shape, F64, float]]] = []
        padding: list[float] = []
        for link in self.model.links.values():
            if not link.collisions:
                continue
            frame, T = self.of_link[tree.link_index[link.name]]
            overshoot = FINGER_OVERSHOOT if link.name in fingers else LINK_OVERSHOOT
            scale = scene.link_scale.get(link.name, 1.0)
            bodies.append((link.name, frame))
            per_body.append(
                [(_scaled(c.shape, scale), T @ c.T_link_shape.matrix, overshoot) for c in link.collisions]
            )
            padding.append(scene.link_padding.get(link.name, scene.padding))
        for held in scene.attached.values():
            frame, T = self.of_link[tree.link_index[held.link]]
            bodies.append((held.object.name, frame))
            per_body.append(
                [
                    (s, T @ held.T_link_object.matrix @ t.matrix, _object_overshoot(s))
                    for s, t in held.object.shapes
                ]
            )
            padding.append(scene.link_padding.get(held.link, scene.padding))
        body_sphere, body_groups, group_sphere, group_first, spheres = [], [0], [], [0], []
        body_pieces = [0]
        for parts in per_body:
            mine = []
            for shape, T, overshoot in parts:
                found = cover(shape, overshoot)
                move = SE3.from_matrix(T).apply
                mine.append(np.column_stack([move(found.groups[:, :3]), found.groups[:, 3]]))
                every = np.column_stack([move(found.centres), found.outer, found.inner])
                spheres.append(every)
                sizes = [len(every[i : i + GROUP]) for i in range(0, len(every), GROUP)]
                group_first += (group_first[-1] + np.cumsum(sizes)).tolist()
            around = np.vstack(mine)
            group_sphere += around.tolist()
            body_groups.append(len(group_sphere))
            c, r = bounding_sphere(around[:, :3], around[:, 3])
            body_sphere.append([*c, r])
            for shape, T, _ in parts:
                self._add_pieces(shape, T)
            body_pieces.append(len(self.pieces))
        up = np.float32(1 + 1e-6)  # rounding to float32 may not shrink a cover
        group = np.array(group_sphere, np.float32).reshape(-1, 4)
        body = np.array(body_sphere, np.float32).reshape(-1, 4)
        sphere = np.vstack(spheres).astype(np.float32) if spheres else np.zeros((0, 5), np.float32)
        group[:, 3] *= up
        body[:, 3] *= up
        sphere[:, 3] = sphere[:, 3] * up + np.float32(1e-6)
        sphere[:, 4] = np.maximum(sphere[:, 4] * np.float32(1 - 1e-5) - np.float32(2e-6), 0)
        return bodies, {
            "frame": np.array([f for _, f in bodies], np.int32),
            "body_sphere": body,
            "body_groups": np.array(body_groups, np.int32),
            "padding": np.array(padding, np.float32),
            "group_sphere": group,
            "group_spheres": np.array(group_first, np.int32),
            "sphere": sphere,
            "body_pieces": np.array(body_pieces, np.int32),
        }

    def _pairs(self, bodies: list[tuple[str, int]]) -> I32:
        pairs = [
            (i, j)
            for i, (a, fa) in enumerate(bodies)
            for j, (b, fb) in enumerate(bodies[:i])
            if fa != fb and not self.scene.is_allowed(a, b)
        ]
        return np.array(pairs, np.int32).reshape(-1, 2)

    # --- the world ---
    def _shapes(self):
        names, kinds, poses, sizes, planes, first_plane, low, high, first_piece = (
            [],
            [],
            [],
            [],
            [],
            [0],
            [],
            [],
            [],
        )
        for item in self.scene.objects.values():
            for shape, T_object_shape in item.shapes:
                T = (item.T_world_object @ T_object_shape).matrix
                for part in _first_tier(shape):
                    names.append(item.name)
                    kind, size = _solid(part)
                    kinds.append(kind)
                    sizes.append(size)
                    poses.append(_rows(np.linalg.inv(T)))
                    if isinstance(part, Mesh):
                        planes += _hull_planes(part).tolist()
                    first_plane.append(len(planes))
                    lo, hi = _world_box(part, T)
                    low.append(lo)
                    high.append(hi)
                    first_piece.append(len(self.pieces))
                    self._add_pieces(part, T)
        first_piece.append(len(self.pieces))
        blocks = max(-(-len(names) // L), 1)
        boxes = np.full((blocks, 6, L), 1e9, np.float32)
        boxes[:, 3:] = -1e9
        for i, (lo, hi) in enumerate(zip(low, high, strict=True)):
            boxes[i // L, :3, i % L] = np.asarray(lo) - 1e-5
            boxes[i // L, 3:, i % L] = np.asarray(hi) + 1e-5
        return names, {
            "shape_kind": np.array(kinds, np.int32),
            "shape_pose": np.array(poses, np.float32).reshape(-1, 12),
            "shape_size": np.array(sizes, np.float32).reshape(-1, 3),
            "shape_planes": np.array(first_plane, np.int32),
            "planes": np.array(planes, np.float32).reshape(-1, 4),
            "boxes": boxes,
            "shape_pieces": np.array(first_piece, np.int32),
        }

    # --- exact pieces ---
    def _add_pieces(self, shape: Shape, T: F64) -> None:
        parts = [shape]
        if isinstance(shape, Mesh) and not is_convex(shape):
            parts = list(convex_pieces(shape))
        for part in parts:
            kind, size = _solid(part)
            points = np.zeros((0, 3))
            if isinstance(part, Mesh):
                points = _hull_points(part)
            if isinstance(part, Plane):
                ball = np.array([0.0, 0.0, 0.0, 1e9])
            else:
                lo, hi = _local_box(part)
                centre = T[:3, :3] @ ((lo + hi) / 2) + T[:3, 3]
                ball = np.append(centre, np.linalg.norm(hi - lo) / 2)
            self.pieces.append((kind, size, T, points, ball))

    def _piece_arrays(self):
        first, ranges = 0, []
        for _, _, _, points, _ in self.pieces:
            ranges.append((first, len(points)))
            first += len(points)
        every = [p for _, _, _, p, _ in self.pieces if len(p)]
        return {
            "piece_kind": np.array([p[0] for p in self.pieces], np.int32),
            "piece_size": np.array([p[1] for p in self.pieces], np.float64).reshape(-1, 3),
            "piece_pose": np.array([_rows(p[2]) for p in self.pieces], np.float64).reshape(-1, 12),
            "piece_points": np.array(ranges, np.int32).reshape(-1, 2),
            "piece_ball": np.array([p[4] for p in self.pieces], np.float64).reshape(-1, 4),
            "points": np.vstack(every) if every else np.zeros((1, 3)),
        }

    # --- motion bounds ---
    def _reach(self, bodies: list[tuple[str, int]], body_sphere: F32) -> F64:
        """Joint by joint, the largest distance a body's point can be from the joint's axis."""
        reach = np.zeros((len(bodies), self.dof))
        for k, (_, frame) in enumerate(bodies):
            radius = float(np.linalg.norm(body_sphere[k, :3]) + body_sphere[k, 3])
            while frame > 0:
                joint = self.joint_of_frame[frame]
                m, c = abs(self.multiplier[frame]), self.column[frame]
                if self.kind[frame] == PRISMATIC:
                    reach[k, c] += m
                    limits = self.model.joints[self.model.joint_names[self.tree.column[joint]]].limits
                    radius += m * max(abs(limits.lower), abs(limits.upper)) + abs(self.offset[frame])
                else:
                    reach[k, c] += m * radius
                radius += float(np.linalg.norm(np.array(self.fixed[frame]).reshape(3, 4)[:, 3]))
                frame = self.parent[frame]
        return reach * (1 + 1e-6)

    def _pair_reach(self, bodies: list[tuple[str, int]], pairs: I32, reach: F64) -> F64:
        """Only joints above exactly one of the two bodies move them against each other."""
        above = []
        for _, frame in bodies:
            joints = set()
            while frame > 0:
                joints.add(frame)
                frame = self.parent[frame]
            above.append(joints)
        out = np.zeros((len(pairs), self.dof))
        for p, (i, j) in enumerate(pairs):
            for c in {self.column[f] for f in above[i] ^ above[j]}:
                out[p, c] = reach[i, c] + reach[j, c]
        return out


def _rows(T: NDArray[Any]) -> list[float]:
    return np.asarray(T)[:3].ravel().tolist()


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
    low, high = _local_box(shape)
    return max(OBJECT_OVERSHOOT, OBJECT_SHARE * float((high - low).max()))


def _first_tier(shape: Shape) -> list[Shape]:
    """Convex shapes whose union holds a world shape."""
    if isinstance(shape, Mesh) and not is_convex(shape):
        return list(convex_pieces(shape))
    return [shape]


def _solid(shape: Shape) -> tuple[int, list[float]]:
    """Kind and three numbers of a convex shape, as gjk wants them."""
    match shape:
        case Mesh():
            return gjk.POINTS, [0.0, 0.0, 0.0]
        case Sphere():
            return gjk.SPHERE, [shape.radius, 0.0, 0.0]
        case Box():
            return gjk.BOX, [shape.x / 2, shape.y / 2, shape.z / 2]
        case Capsule():
            return gjk.CAPSULE, [shape.radius, shape.length / 2, 0.0]
        case Cylinder():
            return gjk.CYLINDER, [shape.radius, shape.length / 2, 0.0]
        case Cone():
            return gjk.CONE, [shape.radius, shape.length / 2, 0.0]
        case Plane():
            return gjk.HALFSPACE, [0.0, 0.0, 0.0]
    raise InputError(f"the kernel does not know {type(shape).__name__}")


@lru_cache(maxsize=1024)
def _hull_planes(mesh: Mesh) -> F64:
    """Outward normals and offsets (n, 4) of a mesh's hull."""
    from scipy.spatial import ConvexHull

    equations = ConvexHull(mesh.vertices).equations  # n x + d <= 0 inside
    _, index = np.unique(np.round(equations, 6), axis=0, return_index=True)
    planes = equations[np.sort(index)]
    return np.column_stack([planes[:, :3], -planes[:, 3]])


@lru_cache(maxsize=1024)
def _hull_points(mesh: Mesh) -> F64:
    from scipy.spatial import ConvexHull

    return mesh.vertices[ConvexHull(mesh.vertices).vertices]


def _local_box(shape: Shape) -> tuple[F64, F64]:
    from armcell.core.geometry import local_bounds

    centre, half = local_bounds(shape)
    return centre - half, centre + half


def _world_box(shape: Shape, T: F64) -> tuple[F64, F64]:
    if isinstance(shape, Plane):
        return np.full(3, -1e6), np.full(3, 1e6)
    low, high = _local_box(shape)
    centre = T[:3, :3] @ ((low + high) / 2) + T[:3, 3]
    half = np.abs(T[:3, :3]) @ ((high - low) / 2)
    return centre - half, centre + half
