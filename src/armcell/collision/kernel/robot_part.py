"""Kernel data of the robot: frames, bodies with sphere covers, pairs, and motion bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell._array_store import keep, key_of, recall
from armcell.collision import decompose
from armcell.collision.convex import VERSION as PIECES_VERSION
from armcell.collision.convex import convex_pieces
from armcell.collision.kernel import near
from armcell.collision.kernel.cover import FIT_VERSION, GROUP, Cover, bounding_sphere, cover
from armcell.collision.kernel.lru_cache import LruCache
from armcell.collision.kernel.pieces import Corners, Pieces, Splitter, concatenate, pieces_of
from armcell.core import SE3, SO3, Box, Capsule, Cone, Cylinder, Mesh, Shape, Sphere
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.kinematics.tree import REVOLUTE
from armcell.model import Link
from armcell.scene import PlanningScene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

FINGER_OVERSHOOT = 0.003  # [m]
LINK_OVERSHOOT = 0.010
OBJECT_OVERSHOOT = 0.005  # [m] for held objects, or `OBJECT_SHARE` of the largest extent if that is larger:
LARGE_LINK = 1.5  # [m] longer shapes of links, such as a linear axis, get the coarser covers of objects
OBJECT_SHARE = 1 / 15  # a large object needs no finer cover, and fitting one would take a minute

REVOLUTE_KIND = 1  # as in frames
BODY_VERSION = 1  # increase when `_new_body` returns other spheres or pieces, to invalidate the disk cache


@dataclass(frozen=True, eq=False)
class RobotPart:
    """The kernel's arrays for the robot, which do not depend on the world,
    with body names and convex pieces.
    """

    bodies: tuple[str, ...]
    arrays: dict[str, Any]
    pieces: Pieces


@dataclass(frozen=True, eq=False)
class _Body:
    """Sphere cover and convex pieces of a robot body (a link or held
    object) in the body's own frame, for the kernel.

    Spheres (s, 5), their groups (g, 4) with sizes (g,), and one sphere around all.
    """

    around: F64  # (4,) bounding sphere of the body
    spheres: F64
    groups: F64
    sizes: list[int]
    pieces: Pieces

    def placed(self, T: F64) -> _Placed:
        """Transform the kernel's sphere cover and convex pieces of a
        robot body to a frame of the planning group.

        T (4, 4) is the pose of the body in this frame.
        """

        def at(spheres: F64) -> F32:
            out = spheres.copy()
            out[..., :3] = out[..., :3] @ T[:3, :3].T + T[:3, 3]
            return out.astype(np.float32)

        around, group, sphere = at(self.around), at(self.groups), at(self.spheres)
        group[:, 3] *= UP
        around[3] *= UP
        sphere[:, 3] = sphere[:, 3] * UP + np.float32(1e-6)
        sphere[:, 4] = np.maximum(sphere[:, 4] * np.float32(1 - 1e-5) - np.float32(2e-6), 0)
        return _Placed(around, sphere, group, self.pieces.moved(T))


@dataclass(frozen=True, eq=False)
class _Placed:
    """Sphere cover and convex pieces of a robot body, transformed to a frame of the planning group,
    in the kernel's array format.
    """

    around: F32
    sphere: F32
    group: F32
    pieces: Pieces


@dataclass(frozen=True, eq=False)
class _Chain:
    """Kinematic chain of a planning group in the kernel.
    It contains the frames that the group's joints move; all others are fixed.

    Attributes:
        above: for each frame, the frames from the world's child down to it.
        arm: distance [m] from the origin of each frame's parent to its own origin.
        arrays: the frames in the format of a `Pack`.
    """

    above: list[list[int]]
    arm: list[float]
    arrays: dict[str, Any]


UP = np.float32(1 + 1e-6)  # rounding to float32 must not shrink a cover
_parts: LruCache[RobotPart] = LruCache(8)
_chains: LruCache[_Chain] = LruCache(32)
_bodies: LruCache[_Body] = LruCache(512)
_placed: LruCache[_Placed] = LruCache(512)
_pieces_joined: LruCache[Pieces] = LruCache(32)
_pairs_found: LruCache[I32] = LruCache(256)
_near_found: LruCache[tuple[I32, dict[str, I32]]] = LruCache(64)
_reaches: LruCache[F64] = LruCache(1024)
_moving: LruCache[NDArray[np.bool_]] = LruCache(32)


def robot_part(scene: PlanningScene, joint_names: tuple[str, ...]) -> RobotPart:
    """Return the kernel data of the robot, cached by robot and by the positions of all other joints.

    Positions of the group's joints do not matter.
    """
    model = scene.model
    rest = np.delete(scene.positions, model.columns(joint_names))
    key = (
        model,
        joint_names,
        rest.tobytes(),
        tuple((h.object.shapes, h.link, h.T_link_object.matrix.tobytes(), h.touch_links, name)
              for name, h in scene.attached.items()),
        tuple(sorted(scene.link_scale.items())),
        tuple(sorted(scene.link_padding.items())),
        scene.padding,
        frozenset((k, v) for k, v in scene.allowed.items() if not any(n in scene.objects for n in k)),
    )  # fmt: skip
    return _parts.get(key, lambda: _Builder(scene, joint_names).build())


class _Builder:
    def __init__(self, scene: PlanningScene, joint_names: tuple[str, ...]):
        self.scene, self.model = scene, scene.model
        self.tree = kinematic_tree(scene.model)
        self.columns = {int(c): i for i, c in enumerate(scene.model.columns(joint_names))}
        self.dof, self.joint_names = len(joint_names), joint_names

    def build(self) -> RobotPart:
        self._frames()
        bodies, arrays, pieces = self._bodies()
        pairs, near_tables = self._near_pairs(bodies, arrays)
        reach = self._reach(bodies)
        pair_reach = self._pair_reach(bodies, pairs, reach)
        arrays |= {
            "dof": self.dof,
            **self.chain.arrays,
            "pairs": pairs,
            "pair_margin": np.zeros(len(pairs), np.float32),
            **near_tables,
            "reach": reach,
            "pair_reach": pair_reach,
            "rate": reach.astype(np.float32) * UP,
            "pair_rate": pair_reach.astype(np.float32) * UP,
        }
        return RobotPart(tuple(b for b, _ in bodies), arrays, pieces)

    # --- kinematics: only the group's joints remain, all others are merged ---
    def _frames(self) -> None:
        tree = self.tree
        self.parent, self.fixed, self.kind, self.column = [0], [np.eye(4)[:3].ravel()], [0], [0]
        self.multiplier, self.offset = [1.0], [0.0]
        self.of_link = {0: (0, np.eye(4))}  # link -> frame, T_frame_link
        self.adjustable: set[int] = set()  # links that a joint outside the group moves within their frame
        # (the frame may be the world)
        rest = tree.link_transforms(self.scene.positions)
        # current T_parent_link of every joint: the inverse of the parent's pose times the link's pose
        turn = rest[tree.parent, :3, :3].transpose(0, 2, 1)
        relative = np.tile(np.eye(4), (len(tree.parent), 1, 1))
        relative[:, :3, :3] = turn @ rest[1:, :3, :3]
        relative[:, :3, 3:] = turn @ (rest[1:, :3, 3:] - rest[tree.parent, :3, 3:])
        stiff = np.asarray(tree.kind) == 0  # exact values: the rounding above depends on the arm's positions
        relative[stiff] = tree.T_parent_joint[stiff]
        for j in range(len(tree.parent)):
            frame, T = self.of_link[int(tree.parent[j])]
            column = self.columns.get(int(tree.column[j])) if tree.kind[j] else None
            if column is None:  # the group does not move this joint, so it keeps its current position
                self.of_link[j + 1] = (frame, T @ relative[j])
                if tree.kind[j] or int(tree.parent[j]) in self.adjustable:
                    self.adjustable.add(j + 1)
                continue
            A = _turned_to_z(*tree.axis[j].tolist())
            self.parent.append(frame)
            self.fixed.append((T @ tree.T_parent_joint[j] @ A)[:3].ravel())
            self.kind.append(REVOLUTE_KIND if tree.kind[j] == REVOLUTE else 2)
            self.column.append(column)
            self.multiplier.append(float(tree.multiplier[j]))
            self.offset.append(float(tree.offset[j]))
            self.of_link[j + 1] = (len(self.parent) - 1, A.T)
        fixed = np.array(self.fixed)
        key = (self.model, self.joint_names, fixed.tobytes())
        self.chain = _chains.get(key, lambda: self._chain(fixed))

    def _chain(self, fixed: F64) -> _Chain:
        above: list[list[int]] = [[]]
        for f in range(1, len(self.parent)):
            above.append([*above[self.parent[f]], f])
        arrays = {
            "parent": np.array(self.parent, np.int32),
            "fixed": fixed.astype(np.float32).reshape(-1, 12),
            "kind": np.array(self.kind, np.int32),
            "column": np.array(self.column, np.int32),
            "multiplier": np.array(self.multiplier, np.float32),
            "offset": np.array(self.offset, np.float32),
        }
        return _Chain(above, [math.hypot(*T[[3, 7, 11]]) for T in self.fixed], arrays)

    # --- bodies ---
    def _bodies(self) -> tuple[list[tuple[str, int]], dict[str, Any], Pieces]:
        scene, tree = self.scene, self.tree
        fingers = {f for g in self.model.grippers.values() for f in g.finger_links}
        bodies: list[tuple[str, int]] = []  # name, frame
        placed: list[tuple[_Body, F64]] = []  # and T_frame_body
        # False for bodies whose pose in their frame depends on other joints (a gripper, a resting arm) or on
        # a grasp: computing for each new pose which bodies they can meet takes longer than it saves.
        self.placed_for_good: list[bool] = []
        padding: list[float] = []
        for link in self.model.links.values():
            if not link.collisions:
                continue
            frame, T = self.of_link[tree.link_index[link.name]]
            overshoot = FINGER_OVERSHOOT if link.name in fingers else LINK_OVERSHOOT
            scale = scene.link_scale.get(link.name, 1.0)
            body = _bodies.get(
                (self.model, link.name, scale, overshoot), partial(_link_body, link, scale, overshoot)
            )
            bodies.append((link.name, frame))
            placed.append((body, T))
            padding.append(scene.link_padding.get(link.name, scene.padding))
            self.placed_for_good.append(tree.link_index[link.name] not in self.adjustable)
        for held in scene.attached.values():
            frame, T = self.of_link[tree.link_index[held.link]]
            body = _bodies.get((held.object.shapes,), partial(_held_body, held.object.shapes))
            bodies.append((held.object.name, frame))
            placed.append((body, T @ held.T_link_object.matrix))
            padding.append(scene.link_padding.get(held.link, scene.padding))
            self.placed_for_good.append(False)
        self.owns = tuple(own for own, _ in placed)
        self.placed = [_placed.get((own, T.tobytes()), partial(own.placed, T)) for own, T in placed]
        sizes = [size for own in self.owns for size in own.sizes]
        joined = _pieces_joined.get(self.owns, lambda: concatenate(own.pieces for own in self.owns))
        poses = [np.zeros((0, 12)), *(body.pieces.pose for body in self.placed)]
        return (
            bodies,
            {
                "frame": np.array([f for _, f in bodies], np.int32),
                "body_sphere": np.array([body.around for body in self.placed], np.float32).reshape(-1, 4),
                "body_groups": _ends(len(own.groups) for own in self.owns),
                "padding": np.array(padding, np.float32),
                "group_sphere": np.vstack([np.zeros((0, 4), np.float32), *(b.group for b in self.placed)]),
                "group_spheres": _ends(sizes),
                "sphere": np.vstack([np.zeros((0, 5), np.float32), *(b.sphere for b in self.placed)]),
                "body_pieces": _ends(len(own.pieces.kind) for own in self.owns),
            },
            replace(joined, pose=np.concatenate(poses)),
        )

    def _pairs(self, bodies: list[tuple[str, int]]) -> I32:
        def look() -> I32:
            pairs = [
                (i, j)
                for i, (a, fa) in enumerate(bodies)
                for j, (b, fb) in enumerate(bodies[:i])
                if fa != fb and not self.scene.is_allowed(a, b)
            ]
            return np.array(pairs, np.int32).reshape(-1, 2)

        touch = tuple((name, held.touch_links) for name, held in self.scene.attached.items())
        names = {name for name, _ in bodies}
        said = frozenset((pair, yes) for pair, yes in self.scene.allowed.items() if pair <= names)
        return _pairs_found.get((self.model, tuple(bodies), touch, said), look)

    def _near_pairs(
        self, bodies: list[tuple[str, int]], arrays: dict[str, Any]
    ) -> tuple[I32, dict[str, I32]]:
        """Return the pairs of robot bodies that can touch, and the kernel's tables of their sphere groups.

        The result is cached for all poses of bodies that are not placed for good.
        """
        pairs = self._pairs(bodies)
        key = (
            self.chain,
            pairs.tobytes(),
            arrays["frame"].tobytes(),
            self.owns,
            tuple(b if good else None for b, good in zip(self.placed, self.placed_for_good, strict=True)),
        )

        def look() -> tuple[I32, dict[str, I32]]:
            meeting = self._near(bodies, arrays, pairs)
            # Leave out pairs that cannot meet, and groups of the first body that meet no group of the second.
            some = [p for p, groups in enumerate(meeting) if groups.any()]
            return pairs[some], _near_tables(arrays["body_groups"], pairs[some], [meeting[p] for p in some])

        return _near_found.get(key, look)

    def _near(
        self, bodies: list[tuple[str, int]], arrays: dict[str, Any], pairs: I32
    ) -> list[NDArray[np.bool_]]:
        """Return a mask (g, h) for each pair of robot bodies:
        the sphere groups in the kernel that can touch each other.
        """
        found = []
        for i, j in pairs:
            branch_i, branch_j = self._branches(bodies[i][1], bodies[j][1])
            columns = sorted({self.column[f] for f in (*branch_i, *branch_j)})
            first_i, end_i = arrays["body_groups"][i : i + 2]
            first_j, end_j = arrays["body_groups"][j : j + 2]
            if len(columns) > near.MAX_JOINTS or not (self.placed_for_good[i] and self.placed_for_good[j]):
                found.append(np.ones((end_i - first_i, end_j - first_j), np.bool_))
                continue
            found.append(self._meeting(branch_i, branch_j, columns, arrays, i, j))
        return found

    def _branches(self, f: int, e: int) -> tuple[list[int], list[int]]:
        """Return the kernel's frames from the last common ancestor of two
        robot bodies down to each of the two bodies.

        The common frame itself is not included.
        """
        a, b = self.chain.above[f], self.chain.above[e]
        common = 0
        while common < min(len(a), len(b)) and a[common] == b[common]:
            common += 1
        return a[common:], b[common:]

    def _meeting(self, branch_i, branch_j, columns, arrays, i, j) -> NDArray[np.bool_]:
        lower, upper = [], []
        for c in columns:
            joint = self.model.joints[self.joint_names[c]]
            low, high = joint.limits.lower, joint.limits.upper
            turns = not np.isfinite(high - low) or (high - low > 2 * np.pi and joint.type != "prismatic")
            lower.append(-np.pi if turns else low)
            upper.append(np.pi if turns else high)
        place = {c: k for k, c in enumerate(columns)}
        spheres, groups, starts = [], [], []
        for k in (i, j):
            first, end = arrays["body_groups"][k : k + 2]
            ends = arrays["group_spheres"][first : end + 1]
            groups.append(arrays["group_sphere"][first:end].astype(float))
            spheres.append(arrays["sphere"][ends[0] : ends[-1]].astype(float))
            starts.append(ends - ends[0])
        arguments = (
            np.array(branch_i, np.int64), np.array(branch_j, np.int64), np.array(self.fixed),
            np.array(self.kind), np.array(self.multiplier), np.array(self.offset),
            np.array([place.get(c, 0) for c in self.column]), np.array(lower) - near.BEYOND,
            np.array(upper) + near.BEYOND, self._group_reach(branch_i, columns, groups[0]),
            self._group_reach(branch_j, columns, groups[1]),
            groups[0], starts[0], spheres[0], groups[1], starts[1], spheres[1],
        )  # fmt: skip
        return near.which_meet(*arguments)

    def _group_reach(self, branch: list[int], columns: list[int], groups: F64) -> F64:
        """Return upper bounds (groups, columns) on how far each sphere group
        in the kernel moves when a joint moves by one unit.

        The bounds are like those of `_reach`.

        Args:
            branch: frames from the common frame down to the body's frame.
            columns: joint columns of the result.
            groups: (g, 4) spheres in the body's frame.
        """
        radius = np.linalg.norm(groups[:, :3], axis=1) + groups[:, 3]
        reach = np.zeros((len(groups), len(columns)))
        for frame in reversed(branch):
            m, c = abs(self.multiplier[frame]), columns.index(self.column[frame])
            if self.kind[frame] == REVOLUTE_KIND:
                reach[:, c] += m * radius
            else:
                reach[:, c] += m
                radius = radius + m * self._span(frame) + abs(self.offset[frame])
            radius = radius + self.chain.arm[frame]
        return reach

    # --- motion bounds ---
    def _reach(self, bodies: list[tuple[str, int]]) -> F64:
        """Return upper bounds (bodies, dof) on how far each robot body in
        the kernel moves when a joint moves by one unit.
        """
        reach = np.zeros((len(bodies), self.dof))
        for k, ((_, frame), body) in enumerate(zip(bodies, self.placed, strict=True)):
            reach[k] = _reaches.get((self.chain, frame, body), partial(self._reach_of, frame, body.around))
        return reach

    def _reach_of(self, frame: int, around: F32) -> F64:
        reach = np.zeros(self.dof)
        radius = float(np.linalg.norm(around[:3]) + around[3])
        while frame > 0:
            m, c = abs(self.multiplier[frame]), self.column[frame]
            if self.kind[frame] == REVOLUTE_KIND:
                reach[c] += m * radius
            else:
                reach[c] += m
                radius += m * self._span(frame) + abs(self.offset[frame])
            radius += self.chain.arm[frame]
            frame = self.parent[frame]
        return reach * (1 + 1e-6)

    def _span(self, frame: int) -> float:
        """Return the largest absolute position within the limits of the joint that moves a kernel frame."""
        limits = self.model.joints[self.joint_names[self.column[frame]]].limits
        return max(abs(limits.lower), abs(limits.upper))

    def _pair_reach(self, bodies: list[tuple[str, int]], pairs: I32, reach: F64) -> F64:
        """Return upper bounds (pairs, dof) on how far the bodies of a pair move
        relative to each other when a joint moves by one unit.

        Only joints above exactly one of the two bodies move them relative to each other.
        """
        key = (self.chain, tuple(frame for _, frame in bodies), pairs.tobytes())
        i, j = pairs.T
        moves = _moving.get(key, lambda: self._moves([frame for _, frame in bodies], i, j))
        return np.where(moves, reach[i] + reach[j], 0.0)

    def _moves(self, frames: list[int], i: I32, j: I32) -> NDArray[np.bool_]:
        """Return a mask (pairs, dof) of the joints that move the two
        robot bodies of a pair relative to each other.
        """
        above = np.zeros((len(frames), len(self.parent)), bool)
        for k, frame in enumerate(frames):
            above[k, self.chain.above[frame]] = True
        column = np.zeros((len(self.parent), self.dof))
        column[np.arange(1, len(self.parent)), self.column[1:]] = 1.0
        return (above[i] ^ above[j]) @ column > 0


def _ends(sizes: Iterable[int]) -> I32:
    return np.cumsum([0, *sizes]).astype(np.int32)


@lru_cache
def _turned_to_z(x: float, y: float, z: float) -> F64:
    """Return the transform (4, 4) that rotates the z axis to the axis of a robot joint.
    In the kernel all joints act about or along z.
    """
    A = np.eye(4)
    A[:3, :3] = SO3.between((0.0, 0.0, 1.0), (x, y, z)).matrix
    return A


def _near_tables(body_groups: I32, pairs: I32, meeting: list[NDArray[np.bool_]]) -> dict[str, I32]:
    """Return the kernel's tables of those sphere groups of the robot that can touch each other."""
    first, groups, counts, others = [0], [], [], []
    for (i, j), meets in zip(pairs.tolist(), meeting, strict=True):
        count = meets.sum(axis=1)
        some = count.nonzero()[0]
        groups.append(body_groups[i] + some)
        counts.append(count[some])
        others.append(body_groups[j] + meets.nonzero()[1])
        first.append(first[-1] + len(some))
    none = np.zeros(0, np.int32)
    return {
        "near": np.array(first, np.int32),
        "near_groups": np.concatenate([none, *groups]).astype(np.int32),
        "meet": np.cumsum(np.concatenate([[0], *counts])).astype(np.int32),
        "meet_groups": np.concatenate([none, *others]).astype(np.int32),
    }


def _link_body(link: Link, scale: float, overshoot: float) -> _Body:
    shapes = [(_scaled(c.shape, scale), c.T_link_shape.matrix) for c in link.collisions]
    return _body([(s, T, overshoot if _size(s) < LARGE_LINK else _object_overshoot(s)) for s, T in shapes])


def _held_body(shapes: tuple[tuple[Shape, SE3], ...]) -> _Body:
    return _body([(s, t.matrix, _object_overshoot(s)) for s, t in shapes], decompose.object_pieces)


def _body(shapes: list[tuple[Shape, F64, float]], split: Splitter = convex_pieces) -> _Body:
    """Return the kernel's sphere cover and convex pieces of a robot body from its shapes,
    their poses and the allowed overshoots [m].

    The result is cached on disk, so that later starts need no mesh library.
    """
    if not any(isinstance(shape, Mesh) for shape, _, _ in shapes):
        return _new_body(shapes, split)
    version = PIECES_VERSION if split is convex_pieces else (split.__name__, decompose.VERSION)
    versions = repr((BODY_VERSION, FIT_VERSION, version, GROUP))
    key = key_of(versions, *(part for shape, T, over in shapes for part in _content(shape, T, over)))
    stored = recall("bodies", key)
    if stored is None:
        body = _new_body(shapes, split)
        p = body.pieces
        keep(
            "bodies", key, around=body.around, spheres=body.spheres, groups=body.groups,
            sizes=np.array(body.sizes, np.int64), piece_kind=p.kind, piece_size=p.size, piece_pose=p.pose,
            piece_ball=p.ball, corner_count=p.corners.count, corners=p.corners.points,
        )  # fmt: skip
        return body
    corners = Corners(stored["corner_count"], stored["corners"])
    pieces = Pieces(
        stored["piece_kind"], stored["piece_size"], stored["piece_pose"], stored["piece_ball"], corners
    )
    return _Body(stored["around"], stored["spheres"], stored["groups"], stored["sizes"].tolist(), pieces)


def _content(shape: Shape, T: F64, overshoot: float) -> tuple[NDArray[Any] | str, ...]:
    """Return a cache key for the kernel data of a robot body.
    It contains all values that determine the sphere cover and the pieces.
    """
    if isinstance(shape, Mesh):
        return (T, repr(overshoot), shape.vertices, shape.faces.astype(np.int64))
    return (T, repr((overshoot, shape)))


def _new_body(shapes: list[tuple[Shape, F64, float]], split: Splitter) -> _Body:
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
    return _Body(np.append(center, radius), np.vstack(spheres), every, sizes, pieces)


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
    """Return the longest side [m] of a shape's bounding box, to prepare a robot's shapes for the kernel."""
    _, half = local_bounds(shape)
    return 2 * float(half.max())
