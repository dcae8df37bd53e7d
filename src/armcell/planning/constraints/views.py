"""Path constraints of which some ask that a sensor sees its target: proven along a motion by bounds.

What is proven between two configurations: at the middle of an interval every angle and every distance of a
link from the view cone is exact. From there a joint that turns by d turns what it carries by d and moves a
point of it by d times the point's largest distance from its axis. So an angle changes by the turns of the
joints that move the sensor or the target but not both, and by the angle under which the sensor sees the
target move; a distance by what the link and the cone's corners move. Where that is less than the room that
is left, the interval is proven, else halved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision import cone, links_apart
from armcell.core import Constraints, VisibilityConstraint
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.kinematics.ik.chain import chain_of
from armcell.kinematics.tree import FIXED
from armcell.planning.constraints.description import Manifold, Violation, reach_of
from armcell.planning.placed import positioned
from armcell.planning.visibility import EDGE_ON, own_links, view_of, visibility
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

ROOM_ANGLE, ROOM = 0.01, 0.003  # [rad], [m] kept back while searching, for what lies between
FINEST = 1e-4  # [rad or m] of the joint that moves most: shorter intervals are not looked at
STEP = 0.05  # [rad or m] between the configurations of an edge that is searched for


class Seen(Manifold):
    """Constraints with visibilities among them. What else they ask is kept as `Manifold` does."""

    def __init__(self, scene: PlanningScene, group: str, constraints: Constraints):
        super().__init__(scene, group, constraints)
        self._views = [_View.of(scene, group, c) for c in constraints.visibilities]
        self._back = (ROOM_ANGLE, ROOM)

    def violations(self, q: Array, inside: bool = False) -> list[Violation]:
        found = super().violations(q, inside)
        at = positioned(self._scene, self.joint_names, q)
        for view in self._views:
            excess, said = visibility(at, view.constraint)[1:]
            if said:
                found.append(Violation("visibility", view.constraint.sensor, float(excess.max()), said))
        return found

    def projected(self, q: Array, lower: Array, upper: Array) -> Array | None:
        moved = super().projected(q, lower, upper)  # nothing projects onto what a sensor sees
        return None if moved is None or self.violations(moved) else moved

    def leaves(self, points: Array, room: Array | None = None) -> int:
        first = super().leaves(points, room)
        slack = np.zeros(self.dof) if room is None else room
        for edge in range(len(points) - 1 if first < 0 else first):
            if not all(self._stays(view, points[edge], points[edge + 1], slack) for view in self._views):
                return edge
        return first

    def allow_edges(self, ends: list[Array]) -> None:
        super().allow_edges(ends)
        self._back = (ROOM_ANGLE, ROOM)
        if any(self.forbids(q) for q in ends):
            self._back = (0.0, 0.0)

    def forbids(self, q: Array) -> bool:
        """Whether q (dof,) does not keep to the constraints, with a little room where the ends have it."""
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
        """What is left [rad or m] of the tightest limit when each joint may be off q (dof,) by `moves`.

        Minus infinity: q itself does not keep to it.
        """
        at, c = positioned(self._scene, self.joint_names, q), view.constraint
        sensor, target, view_angle, range_angle = view_of(at, c)
        turn = float(view.turns @ moves)
        shift = float((view.target_reach + view.sensor_reach) * view.apart @ moves)
        distance = float(np.linalg.norm(target.translation - sensor.translation))
        swing = float(np.arcsin(shift / distance)) if shift < distance else np.inf
        height = abs(target.inv().apply(sensor.translation)[2])
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
        corners = cone(sensor.translation, target, c.target_radius, c.cone_sides)
        moved = max(view.sensor_reach @ moves, view.rim_reach @ moves)
        for link, apart in links_apart(at, corners, view.own).items():
            if apart <= back:
                return -np.inf
            tightest = min(tightest, apart - back - float(moved + view.link_reach[link] @ moves))
        return tightest


@dataclass(frozen=True, eq=False)
class _View:
    """A visibility constraint with how far each joint (dof,) moves what it is about, per rad or m."""

    constraint: VisibilityConstraint
    own: frozenset[str]  # links that may be in the cone
    apart: Array  # 1 for joints that move one of sensor and target, else 0
    turns: Array  # the same for joints that turn, with the most they turn a link by
    sensor_reach: Array  # of the sensor's origin
    target_reach: Array  # of the target's centre
    rim_reach: Array  # of the target's rim
    link_reach: dict[str, Array]  # of the links' farthest points

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
            {name: reach(name, far) for name, far in links.items()},
        )  # fmt: skip


def _farthest(scene: PlanningScene, link: str) -> float:
    """[m] from a link's origin to the farthest corner of the boxes around its bodies."""
    far, scale = 0.0, scene.link_scale.get(link, 1.0)
    for part in scene.model.links[link].collisions:
        centre, half = local_bounds(part.shape)
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        corners = part.T_link_shape.apply(scale * (centre + signs * half))
        far = max(far, float(np.linalg.norm(corners, axis=1).max()))
    return far


def _moving(scene: PlanningScene, names: tuple[str, ...], link: str) -> list[tuple[int, float]]:
    """Joints of the group on the way to a link: their place in it, and how much they move it by."""
    tree, columns = kinematic_tree(scene.model), {c: k for k, c in enumerate(scene.model.columns(names))}
    found = [j for j in tree.path_to(link) if tree.kind[j] != FIXED and int(tree.column[j]) in columns]
    return [(columns[int(tree.column[j])], abs(float(tree.multiplier[j]))) for j in found]


def _carriers(scene: PlanningScene, names: tuple[str, ...], link: str) -> set[int]:
    return {k for k, _ in _moving(scene, names, link)}


def _multipliers(scene: PlanningScene, names: tuple[str, ...], link: str) -> Array:
    """(dof,) by how much a link turns per rad of each joint, mimic joints among them."""
    total = np.zeros(len(names))
    for k, multiplier in _moving(scene, names, link):
        total[k] += multiplier
    return total


def _table(scene: PlanningScene, names: tuple[str, ...], link: str) -> Array:
    if not _moving(scene, names, link):
        return np.zeros((0, 16))
    return chain_of(kinematic_tree(scene.model), names, link, scene.positions).table


def manifold_of(scene: PlanningScene, group: str, constraints: Constraints) -> Manifold:
    """What keeps to path constraints.

    Raises:
        InputError: constraints that cannot be understood or kept.
    """
    return (Seen if constraints.visibilities else Manifold)(scene, group, constraints)
