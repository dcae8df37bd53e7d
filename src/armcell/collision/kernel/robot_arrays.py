"""Kernel data of the robot: frames, bodies with sphere covers, pairs, and motion bounds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel import gap_tables, near_groups
from armcell.collision.kernel.bodies import (
    FINE_OVERSHOOT,
    LINK_OVERSHOOT,
    UP,
    Body,
    PlacedBody,
    held_body,
)
from armcell.collision.kernel.chain import REVOLUTE_KIND, Branches, Chain
from armcell.collision.kernel.convex_pieces import ConvexPieces, concatenate
from armcell.collision.kernel.link_bodies import fine_links, links_of
from armcell.collision.kernel.lru_cache import LruCache
from armcell.core import SO3, Mesh
from armcell.kinematics import kinematic_tree
from armcell.kinematics.tree import REVOLUTE
from armcell.model import Link
from armcell.scene import PlanningScene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class RobotPart:
    """The kernel's arrays for the robot, which do not depend on the world,
    with body names and convex pieces.
    """

    bodies: tuple[str, ...]
    arrays: dict[str, Any]
    pieces: ConvexPieces


_parts: LruCache[RobotPart] = LruCache(8)
_chains: LruCache[Chain] = LruCache(32)
_held: LruCache[Body] = LruCache(512)
_placed: LruCache[PlacedBody] = LruCache(512)
_pieces_joined: LruCache[ConvexPieces] = LruCache(32)
_pairs_found: LruCache[I32] = LruCache(256)
_near_found: LruCache[tuple[I32, dict[str, Any]]] = LruCache(64)
_meetings: LruCache[_Meeting] = LruCache(4096)
_gap_tables: LruCache[_PairGaps | None] = LruCache(4096)
_reaches: LruCache[F64] = LruCache(1024)
_moving: LruCache[NDArray[np.bool_]] = LruCache(32)


def robot_part(scene: PlanningScene, joint_names: tuple[str, ...]) -> RobotPart:
    """Return the kernel data of the robot for a group of joints. The data is cached by robot and by the
    positions of all joints outside the group.

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
        parent, fixed, kind, column = [0], [np.eye(4)[:3].ravel()], [0], [0]
        multiplier, offset = [1.0], [0.0]
        self.of_link = {0: (0, np.eye(4))}  # link -> frame, T_frame_link
        self.adjustable: set[int] = set()  # links that a joint outside the group moves within their frame
        # (the frame may be the world)
        relative = tree.joint_transforms(self.scene.positions)
        for j in range(len(tree.parent)):
            frame, T = self.of_link[int(tree.parent[j])]
            moved_by = self.columns.get(int(tree.column[j])) if tree.kind[j] else None
            if moved_by is None:  # the group does not move this joint, so it keeps its current position
                self.of_link[j + 1] = (frame, T @ relative[j])
                if tree.kind[j] or int(tree.parent[j]) in self.adjustable:
                    self.adjustable.add(j + 1)
                continue
            A = _turned_to_z(*tree.axis[j].tolist())
            parent.append(frame)
            fixed.append((T @ tree.T_parent_joint[j] @ A)[:3].ravel())
            kind.append(REVOLUTE_KIND if tree.kind[j] == REVOLUTE else 2)
            column.append(moved_by)
            multiplier.append(float(tree.multiplier[j]))
            offset.append(float(tree.offset[j]))
            self.of_link[j + 1] = (len(parent) - 1, A.T)
        poses = np.array(fixed)
        key = (self.model, self.joint_names, poses.tobytes())
        self.chain = _chains.get(
            key, lambda: Chain(self.model, self.joint_names, parent, poses, kind, column, multiplier, offset)
        )

    # --- bodies ---
    def _bodies(self) -> tuple[list[tuple[str, int]], dict[str, Any], ConvexPieces]:
        scene, tree = self.scene, self.tree
        bodies: list[tuple[str, int]] = []  # name, frame
        placed: list[tuple[Body, F64]] = []  # and T_frame_body
        # False for bodies whose pose in their frame depends on other joints (a gripper, a resting arm) or on
        # a grasp: computing for each new pose which bodies they can meet takes longer than it saves.
        self.placed_for_good: list[bool] = []
        padding: list[float] = []
        for name, link, body in links_of(self.model, tuple(sorted(scene.link_scale.items()))):
            frame, T = self.of_link[link]
            bodies.append((name, frame))
            placed.append((body, T))
            padding.append(scene.link_padding.get(name, scene.padding))
            self.placed_for_good.append(link not in self.adjustable)
        for held in scene.attached.values():
            frame, T = self.of_link[tree.link_index[held.link]]
            body = _held.get(held.object.shapes, partial(held_body, held.object.shapes))
            bodies.append((held.object.name, frame))
            placed.append((body, T @ held.T_link_object.matrix))
            padding.append(scene.link_padding.get(held.link, scene.padding))
            self.placed_for_good.append(False)
        self.owns = tuple(own for own, _ in placed)
        self.placed = [_placed.get((own, T.tobytes()), partial(own.placed, T)) for own, T in placed]
        sizes = [size for own in self.owns for size in own.sizes]
        joined = _pieces_joined.get(self.owns, lambda: concatenate(own.pieces for own in self.owns))
        poses = [np.zeros((0, 12)), *(body.piece_pose for body in self.placed)]
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
    ) -> tuple[I32, dict[str, Any]]:
        """Return, for the robot's kernel arrays, the pairs of bodies that can touch, and tables of their
        sphere groups and gaps.

        The result is cached for all poses of bodies that are not placed for good.
        """
        pairs = self._pairs(bodies)
        # The kernel tests the groups of a pair's first body against the whole second body: that leaves few
        # groups of the larger body, where the other order would leave nearly all groups of the smaller one.
        radius = arrays["body_sphere"][pairs, 3]
        pairs = np.where(radius[:, :1] < radius[:, 1:], pairs[:, ::-1], pairs)
        key = (
            self.chain,
            pairs.tobytes(),
            arrays["frame"].tobytes(),
            self.owns,
            tuple(b if good else None for b, good in zip(self.placed, self.placed_for_good, strict=True)),
        )

        def look() -> tuple[I32, dict[str, Any]]:
            meeting = [self._near(bodies, arrays, int(i), int(j)) for i, j in pairs]
            # Leave out pairs that cannot meet, and groups of the first body that meet no group of the second.
            some = [p for p, groups in enumerate(meeting) if len(groups.first)]
            near = _near_tables(arrays["body_groups"], pairs[some], [meeting[p] for p in some])
            gaps = [self._gap_table(bodies, arrays, int(i), int(j)) for i, j in pairs[some]]
            return pairs[some], near | _joined_gap_tables(gaps)

        return _near_found.get(key, look)

    def _near(self, bodies: list[tuple[str, int]], arrays: dict[str, Any], i: int, j: int) -> _Meeting:
        """Return which sphere groups of body i can touch which sphere groups of body j. Both bodies belong to
        the robot.
        """
        f, e = bodies[i][1], bodies[j][1]
        if not (self.placed_for_good[i] and self.placed_for_good[j]):
            return _all_meet(len(self.owns[i].groups), len(self.owns[j].groups))

        def look() -> _Meeting:
            branches, columns = self.chain.between(f, e)
            if len(columns) > near_groups.MAX_JOINTS:
                return _all_meet(len(self.owns[i].groups), len(self.owns[j].groups))
            found = near_groups.cached_near_groups(*self._relative_motion(branches, columns, arrays, i, j))
            return _Meeting.of(found)

        return _meetings.get((self.chain, f, e, self.placed[i], self.placed[j]), look)

    def _relative_motion(
        self,
        branches: Branches,
        columns: list[int],
        arrays: dict[str, Any],
        i: int,
        j: int,
    ) -> tuple[near_groups.SphereGroups, near_groups.SphereGroups, near_groups.Frames, F64, F64]:
        """Return the arguments of `near_groups.cached_near_groups` for two robot bodies: their sphere groups,
        the frames, and the ranges of the joint variables that move one body relative to the other.
        """
        place = {c: k for k, c in enumerate(columns)}
        bodies = []
        for k, branch in zip((i, j), branches, strict=True):
            first, end = arrays["body_groups"][k : k + 2]
            ends = arrays["group_spheres"][first : end + 1]
            groups = arrays["group_sphere"][first:end].astype(float)
            spheres = arrays["sphere"][ends[0] : ends[-1]].astype(float)
            reach = self.chain.group_reach(branch, columns, groups)
            bodies.append(
                near_groups.SphereGroups(np.array(branch, np.int64), reach, groups, ends - ends[0], spheres)
            )
        chain = self.chain
        frames = near_groups.Frames(
            chain.fixed, np.array(chain.kind), np.array(chain.multiplier), np.array(chain.offset),
            np.array([place.get(c, 0) for c in chain.column]),
        )  # fmt: skip
        lower, upper, _ = self.chain.ranges(columns)
        return bodies[0], bodies[1], frames, lower - near_groups.BEYOND, upper + near_groups.BEYOND

    def _gap_table(
        self, bodies: list[tuple[str, int]], arrays: dict[str, Any], i: int, j: int
    ) -> _PairGaps | None:
        """Return the gap table of two robot bodies, or None if more than two joints move them relative to
        each other, or if their sphere covers decide about them. The tables are cached on disk.
        """
        _, columns = self.chain.between(bodies[i][1], bodies[j][1])
        links = [self.model.links[bodies[b][0]] for b in (i, j) if bodies[b][0] in self.model.links]
        if (
            not (self.placed_for_good[i] and self.placed_for_good[j])
            or len(columns) not in (1, 2)
            or sum(map(_triangles, links)) > gap_tables.MOST_TRIANGLES
        ):
            return None

        def look() -> _PairGaps | None:
            return self._recalled_gap_table(bodies, arrays, i, j)

        key = (self.chain, bodies[i], bodies[j], self.placed[i], self.placed[j])
        return _gap_tables.get(key, look)

    def _recalled_gap_table(
        self, bodies: list[tuple[str, int]], arrays: dict[str, Any], i: int, j: int
    ) -> _PairGaps | None:
        """Return the gap table of two robot bodies from the disk cache, or compute it. Return None if their
        sphere covers decide about all their configurations.
        """
        branches, columns = self.chain.between(bodies[i][1], bodies[j][1])
        motion = self._relative_motion(branches, columns, arrays, i, j)
        two = 2 - len(columns)  # a missing second joint has no range
        lower, upper, turns = self.chain.ranges(columns)
        reach = sum(
            self.chain.axis_reach(branch, columns, body.spheres)
            for branch, body in zip(branches, motion[:2], strict=True)
        )
        ranges = gap_tables.JointRanges(*(np.pad(a, (0, two)) for a in (lower, upper, turns, reach)))
        fine = fine_links(self.model)
        undecided = sum(FINE_OVERSHOOT if bodies[b][0] in fine else LINK_OVERSHOOT for b in (i, j))
        key = key_of(repr((gap_tables.VERSION, undecided)), *motion[0], *motion[1], *motion[2], *ranges)

        def computed() -> dict[str, NDArray]:
            robot = replace(self.scene, objects={}, attached={})
            exact = ExactChecker(robot, self.joint_names)
            shapes = [[k for k, g in enumerate(exact.geometries) if g.body == bodies[b][0]] for b in (i, j)]
            q = self.scene.positions[self.model.columns(self.joint_names)].copy()

            def distance(values: F64) -> float:
                q[columns] = values[: len(columns)]
                exact.set_configuration(q)
                return min(exact.pair_distance(a, b) for a in shapes[0] for b in shapes[1])

            return {"gaps": gap_tables.gap_table(distance, ranges, undecided)}

        gaps = np.asarray(recall_or_compute("gap tables", key, computed)["gaps"], np.float32)
        if not gaps.size:
            return None
        return _PairGaps(gaps, (columns[0], columns[-1]), gap_tables.grid(ranges, gaps.shape))

    # --- motion bounds ---
    def _reach(self, bodies: list[tuple[str, int]]) -> F64:
        """Return upper bounds (bodies, dof) on how far each robot body in
        the kernel moves when a joint moves by one unit.
        """
        reach = np.zeros((len(bodies), self.dof))
        for k, ((_, frame), body) in enumerate(zip(bodies, self.placed, strict=True)):
            if frame > 0:
                reach[k] = _reaches.get(
                    (self.chain, frame, body), partial(self.chain.reach, frame, body.around)
                )
        return reach

    def _pair_reach(self, bodies: list[tuple[str, int]], pairs: I32, reach: F64) -> F64:
        """Return upper bounds (pairs, dof) on how far the bodies of a pair move
        relative to each other when a joint moves by one unit.

        Only joints above exactly one of the two bodies move them relative to each other.
        """
        key = (self.chain, tuple(frame for _, frame in bodies), pairs.tobytes())
        i, j = pairs.T
        moves = _moving.get(key, lambda: self.chain.moves([frame for _, frame in bodies], i, j))
        return np.where(moves, reach[i] + reach[j], 0.0)


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


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Index lists that state which sphere groups of two robot bodies can touch each other, as arrays for the
    kernel.

    Attributes:
        first: (n,) groups of the first body that can touch a group of the second body.
        counts: (n,) how many groups of the second body each of them can touch.
        second: the groups of the second body, one run per entry of `first`.
    """

    first: I32
    counts: I32
    second: I32

    @staticmethod
    def of(meets: NDArray[np.bool_]) -> _Meeting:
        """Create index lists for the robot's kernel arrays from a mask (g, h) of two bodies. Entry [i, j]
        states whether sphere group i of one body can touch sphere group j of the other.
        """
        counts = meets.sum(axis=1)
        first = counts.nonzero()[0]
        return _Meeting(*(a.astype(np.int32) for a in (first, counts[first], meets.nonzero()[1])))


def _triangles(link: Link) -> int:
    return sum(len(c.shape.faces) for c in link.collisions if isinstance(c.shape, Mesh))


@dataclass(frozen=True, eq=False)
class _PairGaps:
    """Gap table of a pair of robot bodies: the gaps (n1, n2), the columns of the one or two joints that move
    the pair, and the numbers (6,) that `gap_tables.grid` returns.
    """

    gaps: F32
    columns: tuple[int, int]
    grid: F32


def _joined_gap_tables(tables: list[_PairGaps | None]) -> dict[str, Any]:
    """Combine the gap tables of a robot's body pairs into arrays for the kernel. The list contains None for
    each pair without a gap table.
    """
    index, grids = np.full((len(tables), 5), -1, np.int32), np.zeros((len(tables), 6), np.float32)
    parts, first = [np.zeros(0, np.float32)], 0
    for row, table in enumerate(tables):
        if table is not None:
            index[row], grids[row] = (first, *table.columns, *table.gaps.shape), table.grid
            parts.append(table.gaps.ravel())
            first += table.gaps.size
    return {"gap_table": index, "gap_grid": grids, "gaps": np.concatenate(parts)}


@lru_cache(maxsize=1024)
def _all_meet(g: int, h: int) -> _Meeting:
    return _Meeting.of(np.ones((g, h), np.bool_))


def _near_tables(body_groups: I32, pairs: I32, meeting: list[_Meeting]) -> dict[str, I32]:
    """Return the part of the robot's kernel arrays that states which of its sphere groups can touch each
    other.
    """
    lengths = [len(m.first) for m in meeting]
    more = [len(m.second) for m in meeting]
    i, j = body_groups[pairs.T] if len(pairs) else (body_groups[:0],) * 2
    none = np.zeros(0, np.int32)
    counts = np.concatenate([none, *(m.counts for m in meeting)])
    return {
        "near": _ends(lengths),
        "near_groups": np.concatenate([none, *(m.first for m in meeting)]) + np.repeat(i, lengths),
        "meet": _ends(counts),
        "meet_groups": np.concatenate([none, *(m.second for m in meeting)]) + np.repeat(j, more),
    }
