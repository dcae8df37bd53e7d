"""Constraint manifold with visibility constraints: a sensor must see its target during the whole motion.

Bounds prove the constraints along a motion. At the middle of an interval between two configurations, every
angle and every distance of a link from the view cone is exact. A joint that turns by d from there rotates
the bodies that it carries by d and moves each of their points by d times the point's largest distance from
the joint's axis. An angle therefore changes by the turns of the joints that move either the sensor or the
target, plus the angle under which the sensor sees the target move; a distance changes by the motion of the
link and of the cone's corners. If these changes are smaller than the remaining margin, the interval is
proven; otherwise it is halved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision import links_by_distance, view_cone
from armcell.core import Constraints, VisibilityConstraint
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.kinematics.ik.chain import chain_of
from armcell.kinematics.tree import FIXED
from armcell.planning.constraints.manifold import ConstraintManifold, Violation, reach_of
from armcell.planning.constraints.visibility import EDGE_ON, own_links, view_of, visibility
from armcell.planning.moved_frame import with_joint_positions
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

ROOM_ANGLE, ROOM = 0.01, 0.003  # [rad], [m] margins while searching, for the motion between configurations
FINEST = 1e-4  # [rad or m] of the joint that moves most: shortest interval of the proof
STEP = 0.05  # [rad or m] between configurations of an edge while searching


class VisibilityManifold(ConstraintManifold):
    """Constraint manifold that also supports visibility constraints.

    `ConstraintManifold` handles the other constraints.
    """

    def __init__(self, scene: PlanningScene, group: str, constraints: Constraints):
        super().__init__(scene, group, constraints)
        self._views = [_View.of(scene, group, c) for c in constraints.visibilities]
        self._back = (ROOM_ANGLE, ROOM)

    def violations(self, q: Array, inside: bool = False) -> list[Violation]:
        found = super().violations(q, inside)
        at = with_joint_positions(self._scene, self.joint_names, q)
        for view in self._views:
            excess, said = visibility(at, view.constraint)[1:]
            if said:
                found.append(Violation("visibility", view.constraint.sensor, float(excess.max()), said))
        return found

    def project(self, q: Array, lower: Array, upper: Array) -> Array | None:
        moved = super().project(q, lower, upper)  # visibility constraints have no projection
        return None if moved is None or self.violations(moved) else moved

    def first_unproven_edge(self, points: Array, room: Array | None = None) -> int:
        first = super().first_unproven_edge(points, room)
        slack = np.zeros(self.dof) if room is None else room
        for edge in range(len(points) - 1 if first < 0 else first):
            if not all(self._stays(view, points[edge], points[edge + 1], slack) for view in self._views):
                return edge
        return first

    def relax_boundary(self, ends: list[Array]) -> None:
        super().relax_boundary(ends)
        self._back = (ROOM_ANGLE, ROOM)
        if any(self.forbids(q) for q in ends):
            self._back = (0.0, 0.0)

    def forbids(self, q: Array) -> bool:
        """Return whether a planner must reject joint positions q (dof,) because they violate a visibility
        constraint or another constraint.

        Positions within a small margin of a visibility constraint's limits are rejected, too. The margin is
        zero if the start or a goal would be rejected (`relax_boundary`).
        """
        return bool(super().violations(q)) or any(
            self._room(view, q, np.zeros(self.dof), *self._back) < 0.0 for view in self._views
        )

    def _stays(self, view: _View, a: Array, b: Array, slack: Array) -> bool:
        waiting = [(0.0, 1.0)]
        while waiting:
            low, high = waiting.pop()
            half = (high - low) / 2 * np.abs(b - a)
            room = self._room(view, a + (low + high) / 2 * (b - a), half + slack)
            if room > 0.0:
                continue
            if room == -np.inf or half.max() < FINEST:
                return False
            waiting += [((low + high) / 2, high), (low, (low + high) / 2)]
        return True

    def _room(self, view: _View, q: Array, moves: Array, back_angle: float = 0.0, back: float = 0.0) -> float:
        """Return the smallest margin [rad or m] to the limits of a visibility constraint when each joint is
        at most `moves` (dof,) away from q (dof,).

        Minus infinity means that q itself violates the constraint.
        """
        at, c = with_joint_positions(self._scene, self.joint_names, q), view.constraint
        sensor, target, view_angle, range_angle = view_of(at, c)
        turn = float(view.turns @ moves)
        shift = float((view.target_reach + view.sensor_reach) * view.apart @ moves)
        distance = float(np.linalg.norm(target.translation - sensor.translation))
        swing = float(np.arcsin(shift / distance)) if shift < distance else np.inf
        height = abs(target.inverse().apply(sensor.translation)[2])
        tightest = height - EDGE_ON - back - shift - (distance + shift) * turn
        if height <= EDGE_ON + back:
            return -np.inf
        for angle, limit, change in (
            (view_angle, c.max_view_angle, turn), (range_angle, c.max_range_angle, turn + swing)
        ):  # fmt: skip
            if limit is not None:
                left = min(limit, np.pi / 2) - back_angle - angle
                if left < 0.0:
                    return -np.inf
                tightest = min(tightest, left - change)
        if tightest <= 0.0:
            return tightest
        corners = view_cone(sensor.translation, target, c.target_radius, c.cone_sides)
        moved = max(view.sensor_reach @ moves, view.rim_reach @ moves)
        changes = dict(zip(view.links, (moved + view.link_reach @ moves).tolist(), strict=True))
        most = max(changes.values(), default=0.0)
        for link, bound, distance in links_by_distance(at, corners, view.own):
            if bound > back and bound - back - most >= tightest:
                break  # neither this link nor a farther one decides
            if (apart := distance()) <= back:
                return -np.inf
            tightest = min(tightest, apart - back - changes[link])
        return tightest


@dataclass(frozen=True, eq=False)
class _View:
    """Visibility constraint of a manifold, with precomputed motion bounds: how far one unit of each joint's
    motion can move the sensor, the target and the robot's links.
    """

    constraint: VisibilityConstraint
    own: frozenset[str]  # links that are allowed in the cone
    apart: Array  # 1 for joints that move one of sensor and target, else 0
    turns: Array  # like `apart`, for revolute joints, times the largest rotation of a link per rad
    sensor_reach: Array  # [m] bound of the sensor origin's distance from each joint's axis
    target_reach: Array  # [m] for the target's center
    rim_reach: Array  # [m] for the target's rim
    links: tuple[str, ...]  # with collision shapes
    link_reach: Array  # (links, dof) [m] for the links' farthest points

    @classmethod
    def of(cls, scene: PlanningScene, group: str, c: VisibilityConstraint) -> _View:
        names = scene.model.group(group).joint_names

        def reach(link: str, point: Array | float) -> Array:
            far = np.array([point, 0.0, 0.0]) if np.isscalar(point) else np.asarray(point)
            return reach_of(_table(scene, names, link), far, scene, names)

        sensor_link, T_sensor = scene.anchor(c.sensor)
        target_link, T_target = scene.anchor(c.frame)
        eye, disc = T_sensor @ c.T_link_sensor, T_target @ c.T_frame_target
        a, b = _carriers(scene, names, sensor_link), _carriers(scene, names, target_link)
        apart = np.array([float(({k} <= a) != ({k} <= b)) for k in range(len(names))])
        turning = np.array([scene.model.joints[n].type != "prismatic" for n in names], float)
        most = np.max(
            [np.ones(len(names)), *(_multipliers(scene, names, k) for k in (sensor_link, target_link))], 0
        )
        links = {n: _farthest(scene, n) for n, link in scene.model.links.items() if link.collisions}
        return cls(
            c, own_links(scene, c), apart, apart * turning * most, reach(sensor_link, eye.translation),
            reach(target_link, disc.translation),
            reach(target_link, float(np.linalg.norm(disc.translation)) + c.target_radius),
            tuple(links),
            np.array([reach(name, far) for name, far in links.items()]).reshape(-1, len(names)),
        )  # fmt: skip


def _farthest(scene: PlanningScene, link: str) -> float:
    """Return how far [m] the shapes of a link extend from the link's origin, for the motion bounds of a
    visibility manifold.
    """
    far, scale = 0.0, scene.link_scale.get(link, 1.0)
    for part in scene.model.links[link].collisions:
        center, half = local_bounds(part.shape)
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        corners = part.T_link_shape.apply(scale * (center + signs * half))
        far = max(far, float(np.linalg.norm(corners, axis=1).max()))
    return far


def _moving(scene: PlanningScene, names: tuple[str, ...], link: str) -> list[tuple[int, float]]:
    """List the joints that move the sensor or target link of a visibility constraint, with the multipliers
    of their mimic joints.
    """
    tree, columns = kinematic_tree(scene.model), {c: k for k, c in enumerate(scene.model.columns(names))}
    found = [j for j in tree.path_to(link) if tree.kind[j] != FIXED and int(tree.column[j]) in columns]
    return [(columns[int(tree.column[j])], abs(float(tree.multiplier[j]))) for j in found]


def _carriers(scene: PlanningScene, names: tuple[str, ...], link: str) -> set[int]:
    return {k for k, _ in _moving(scene, names, link)}


def _multipliers(scene: PlanningScene, names: tuple[str, ...], link: str) -> Array:
    """Return the largest rotation (dof,) [rad] of a sensor or target link per radian of each joint, for the
    motion bounds of a visibility manifold.
    """
    total = np.zeros(len(names))
    for k, multiplier in _moving(scene, names, link):
        total[k] += multiplier
    return total


def _table(scene: PlanningScene, names: tuple[str, ...], link: str) -> Array:
    if not _moving(scene, names, link):
        return np.zeros((0, 16))
    return chain_of(kinematic_tree(scene.model), names, link, scene.positions).table


def make_manifold(scene: PlanningScene, group: str, constraints: Constraints) -> ConstraintManifold:
    """Create the manifold for constraints that may include visibility constraints. If they do, it is a
    `VisibilityManifold`.

    Raises:
        InputError: the constraints are invalid, or no planner supports them.
    """
    return (VisibilityManifold if constraints.visibilities else ConstraintManifold)(scene, group, constraints)
