"""The constraint manifold of a request: path constraints as flat arrays and as text."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Constraints,
    Cylinder,
    InputError,
    OrientationConstraint,
    Plane,
    PositionConstraint,
    Shape,
    Sphere,
    UnknownNameError,
)
from armcell.kinematics import kinematic_tree
from armcell.kinematics.ik.chain import COLUMN, MULTIPLIER, SLIDE, chain_of
from armcell.kinematics.tree import FIXED
from armcell.planning.constraints import error_kernels as layout
from armcell.planning.constraints.error_kernels import evaluate_errors, scratch_size
from armcell.planning.constraints.projection import project_positions
from armcell.planning.constraints.proof import first_unproven_edge
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

SHARE = 0.25  # share of a tolerance reserved while planning, for the motion between waypoints
MOST = (0.04, 0.01)  # largest reserve [rad], [m]
LEAST = (1e-4, 1e-5)  # [rad], [m] smallest tolerances accepted
LONGEST = 0.5  # [rad] longest projected step
BOUNDARY, BOUNDARY_SHARE = 1e-4, 0.05
"""Margin [rad and m] (also as a share of the smallest tolerance) within which a start or goal counts as being
on the boundary of a tolerance. The motion may then exceed the tolerance by this margin: no motion can be
proven to stay exactly on a boundary."""


@dataclass(frozen=True)
class Violation:
    """Violation of one constraint in a constraint manifold: the kind and name of the constraint, the amount
    of the violation, and a description.
    """

    kind: str  # "joint", "orientation" or "position"
    name: str  # name of the joint or of the constrained link
    amount: float  # [rad or m] part of the error beyond the tolerance
    text: str


class ConstraintManifold:
    """Constraint manifold: the set of all configurations of a planning group that satisfy its path
    constraints.

    Not thread-safe: it owns scratch memory.

    Attributes:
        handle: addresses of the flat arrays, for the compiled functions.
        lower, upper: (dof,) joint ranges of the joint constraints, infinite for joints without a constraint.
        step: [rad] distance between projected configurations. If two configurations keep the planning
            tolerances, the motion between them keeps the full tolerances.
        boundary_margin: [rad and m] see BOUNDARY. allowance: `boundary_margin`, or 0 unless `relax_boundary`
            set it.
    """

    def __init__(self, scene: PlanningScene, group: str, constraints: Constraints):
        self.joint_names = scene.model.group(group).joint_names
        self.dof = len(self.joint_names)
        self._scene, self._group = scene, group
        self.lower, self.upper = _corridors(self.joint_names, constraints, scene)
        self.joints, self.orientations = constraints.joints, constraints.orientations
        self.positions = constraints.positions
        self._ints: list[int] = [0] * layout.HEADER
        self._floats: list[float] = []
        self._margins: list[float] = []  # largest step for each tolerance
        self._least: list[float] = []  # tolerances
        self._links: dict[str, int] = {}
        self._link_rows: list[tuple[int, int, int, int]] = []
        self._tables: list[Array] = []
        self.allowance = 0.0
        self._build()

    # --- building ---
    def _build(self) -> None:
        turns = [self._turn(constraint) for constraint in self.orientations]
        shapes: list[tuple[int, int]] = []
        points = [self._point(constraint, shapes) for constraint in self.positions]
        if 3 * (len(turns) + len(points)) > layout.MAX_ROWS:
            raise InputError(
                f"{len(turns) + len(points)} orientation and position constraints at once",
                hint=f"at most {layout.MAX_ROWS // 3} can be planned with",
            )
        ints = self._ints
        ints[layout.DOF], ints[layout.LINKS] = self.dof, len(self._link_rows)
        ints[layout.TURNS], ints[layout.POINTS] = len(turns), len(points)
        for where, table in (
            (layout.AT_LINKS, self._link_rows),
            (layout.AT_TURNS, turns),
            (layout.AT_POINTS, points),
            (layout.AT_SHAPES, shapes),
        ):
            ints[where] = len(ints)
            ints += [number for row in table for number in row]
        places = sum(12 + 6 * row[0] for row in self._link_rows)
        ints[layout.WORK] = places
        self.ints = np.array(ints, np.int64)
        self.floats = np.array([*self._floats, 0.0])
        self.scratch = np.zeros(scratch_size(self.dof, places))
        self.handle = np.array([a.ctypes.data for a in (self.ints, self.floats, self.scratch)], np.int64)
        self.step = min([LONGEST, *self._margins])
        self.boundary_margin = min([BOUNDARY, *(BOUNDARY_SHARE * tolerance for tolerance in self._least)])
        self._none, self._out = np.zeros(self.dof), np.zeros(3 * len(turns) + len(points) + 1)

    def _keep(self, numbers: Array | list[float]) -> int:
        at = len(self._floats)
        self._floats += np.asarray(numbers, dtype=float).ravel().tolist()
        return at

    def _resolve(self, name: str | None) -> tuple[str, SE3]:
        """Return the robot link that carries a constrained frame, and the pose of the frame in this link. The
        constraint manifold accepts a link or an attached object as a frame; the default is the group's tip.
        """
        scene = self._scene
        if name is None:
            name = scene.model.group(self._group).tip_link
            if name is None:
                raise InputError(
                    f"group {self._group!r} is not a chain, so it has no tip",
                    hint="name the link that is constrained",
                )
        if name in scene.attached:
            body = scene.attached[name]
            return body.link, body.T_link_object
        if name not in scene.model.links:
            raise UnknownNameError("link", name, [*scene.model.links, *scene.attached])
        return name, SE3.identity()

    def _link(self, name: str) -> int:
        """Return the index of a constrained link in the constraint manifold's list of links.

        The link's chain is computed at the first use.
        """
        if name not in self._links:
            tree = kinematic_tree(self._scene.model)
            columns = set(self._scene.model.columns(self.joint_names))
            moved = any(tree.kind[j] != FIXED and int(tree.column[j]) in columns for j in tree.path_to(name))
            if moved:
                chain = chain_of(tree, self.joint_names, name, self._scene.positions)
                base = SE3.from_matrix(np.vstack([chain.inverse_base.reshape(3, 4), [0, 0, 0, 1]])).inverse()
                table = chain.table
            else:
                base, table = self._scene.frame_pose(name), np.zeros((0, 16))
            at_table, at_base = self._keep(table), self._keep(base.matrix[:3])
            place = sum(12 + 6 * row[0] for row in self._link_rows)
            self._links[name] = len(self._link_rows)
            self._link_rows.append((len(table), at_table, at_base, place))
            self._tables.append(table)
        return self._links[name]

    def _frame(self, name: str) -> SE3:
        """Return T_world_frame, the pose of the frame in which a path constraint of the manifold is
        specified.

        The frame must not move with the group.
        """
        scene = self._scene
        link = scene.attached[name].link if name in scene.attached else name
        if link in scene.model.links:
            tree = kinematic_tree(scene.model)
            columns = set(scene.model.columns(self.joint_names))
            if any(tree.kind[j] != FIXED and int(tree.column[j]) in columns for j in tree.path_to(link)):
                raise InputError(
                    f"the path constraint is given in frame {name!r}, which group {self._group!r} moves",
                    hint="give it in a frame that does not move with the group, such as 'world'",
                )
        return scene.frame_pose(name)

    def _turn(self, constraint: OrientationConstraint) -> tuple[int, int, int]:
        link, T = self._resolve(constraint.link)
        wanted = self._frame(constraint.frame).rotation @ constraint.rotation
        tolerance = np.asarray(constraint.tolerance, dtype=float)
        what = f"the orientation constraint of {constraint.link or link}"
        if tolerance.shape != (3,) or np.isnan(tolerance).any():
            raise InputError(f"{what} needs three tolerances, got {constraint.tolerance}")
        if constraint.parameterization not in ("rotation_vector", "xyz_euler"):
            raise UnknownNameError(
                "parameterization", constraint.parameterization, ["rotation_vector", "xyz_euler"]
            )
        if (tolerance < LEAST[0]).any():
            raise InputError(
                f"{what} has a tolerance of {tolerance.min():g} rad",
                hint=f"give at least {LEAST[0]:g}: a timed motion cannot be proven to keep to less",
            )
        free = tolerance >= np.pi
        back = np.minimum(SHARE * tolerance, MOST[0])
        if not free.all():
            self._margins.append(float(np.sqrt(4 * back[~free].min())))
        self._least.append(float(tolerance.min()))
        euler = constraint.parameterization == "xyz_euler"
        number = self._carried(link, T) if T.rotation.log().any() else self._link(link)
        full, inner = np.where(free, layout.FREE, tolerance), np.where(free, layout.FREE, tolerance - back)
        return number, int(euler), self._keep(np.concatenate([wanted.matrix.T.ravel(), full, inner]))

    def _carried(self, link: str, T: SE3) -> int:
        """Add a link-fixed frame to the manifold's constrained links, and return its index."""
        rows, _, base, _ = self._link_rows[self._link(link)]
        numbers = self._tables[self._links[link]].copy()
        at_base = base
        if rows:
            last = SE3.from_matrix(np.vstack([numbers[-1, :12].reshape(3, 4), [0, 0, 0, 1]])) @ T
            numbers[-1, :12] = last.matrix[:3].ravel()
        else:
            at_base = self._keep((self._scene.frame_pose(link) @ T).matrix[:3])
        place = sum(12 + 6 * row[0] for row in self._link_rows)
        self._link_rows.append((rows, self._keep(numbers), at_base, place))
        self._tables.append(numbers)
        return len(self._link_rows) - 1

    def _point(self, constraint: PositionConstraint, shapes: list) -> tuple[int, int, int, int]:
        link, T = self._resolve(constraint.link)
        what = f"the position constraint of {constraint.link or link}"
        if not constraint.region:
            raise InputError(f"{what} has an empty region", hint="give it at least one shape")
        number, point = self._link(link), T.apply(np.asarray(constraint.point, dtype=float))
        frame, first = self._frame(constraint.frame), len(shapes)
        reach = reach_of(self._tables[number], point, self._scene, self.joint_names)
        for shape, pose in constraint.region:
            kind, size = _sizes(shape, what)
            if kind != layout.HALF_SPACE and size[size > 0].min() < LEAST[1]:
                raise InputError(
                    f"{what} has a region only {size[size > 0].min():g} m to each side",
                    hint=f"give at least {LEAST[1]:g}: a timed motion cannot be proven to keep to less",
                )
            self._least += size[size > 0].tolist()
            back = np.minimum(SHARE * size, MOST[1]) if kind != layout.HALF_SPACE else np.full(3, -MOST[1])
            numbers = [*(frame @ pose).inverse().matrix[:3].ravel(), *size, *(size - back)]
            shapes.append((kind, self._keep(numbers)))
            least = np.abs(back[np.abs(back) > 0]).min()
            self._margins.append(float(np.sqrt(8 * least / max(reach.max(), 0.05))))
        return number, first, len(shapes) - first, self._keep([*point, *reach])

    # --- asking ---
    def values(self, q: Array) -> Array:
        """Evaluate a constraint manifold: return its orientation errors (3 values each) [rad] and the
        distances of points from their regions [m].
        """
        evaluate_errors(self.handle, np.ascontiguousarray(q, dtype=float), self._out)
        return self._out[:-1].copy()

    def violations(self, q: Array, inside: bool = False) -> list[Violation]:
        """Check joint positions q (dof,) against the constraints of a manifold. List the violations that
        exceed a small margin (BOUNDARY).

        Args:
            inside: also list constraints that q satisfies by less than the margin.
        """
        found, sign = [], -1 if inside else 1
        allowance = sign * self.boundary_margin
        for joint in self.joints:
            i = self.joint_names.index(joint.joint)
            low, high = joint.position - joint.tolerance_below, joint.position + joint.tolerance_above
            over = max(low - q[i], q[i] - high)
            if over > sign * BOUNDARY:
                text = f"joint {joint.joint} is at {q[i]:.4g}, outside [{low:.4g}, {high:.4g}] by {over:.3g}"
                found.append(Violation("joint", joint.joint, float(over), text))
        values = self.values(q)
        for k, turn in enumerate(self.orientations):
            link = turn.link or self._resolve(None)[0]
            for i, axis in enumerate("xyz"):
                error, tolerance = abs(values[3 * k + i]), float(turn.tolerance[i])
                if tolerance < np.pi and error > tolerance + allowance:
                    text = (
                        f"{link} is turned by {error:.3g} rad about {axis} of its wanted orientation, "
                        f"{error - tolerance:.3g} rad more than its tolerance of {tolerance:.3g}"
                    )
                    found.append(Violation("orientation", link, error - tolerance, text))
        for k, point in enumerate(self.positions):
            far = values[3 * len(self.orientations) + k]
            if far > allowance:
                link = point.link or self._resolve(None)[0]
                text = f"{link} is {1000 * far:.3g} mm outside its region"
                found.append(Violation("position", link, float(far), text))
        return found

    def project(self, q: Array, lower: Array, upper: Array) -> Array | None:
        """Project joint positions q (dof,) onto the constraint manifold; return None if this fails."""
        moved = np.clip(q, lower, upper)
        return moved if project_positions(self.handle, moved, lower, upper) else None

    def first_unproven_edge(self, points: Array, room: Array | None = None) -> int:
        """Return the first edge of a motion (k, dof) that cannot be proven to stay on the constraint
        manifold.

        Return -1 if all edges are proven.

        Args:
            room: (dof,) possible deviation of each joint from the edges.
        """
        slack = self._none if room is None else room
        more = (BOUNDARY if self.allowance else 0.0) - slack
        outside = (points < self.lower - more) | (points > self.upper + more)
        if outside.any():
            return max(int(np.argmax(outside.any(axis=1))) - 1, 0)
        return int(first_unproven_edge(self.handle, np.ascontiguousarray(points), slack, self.allowance))

    def relax_boundary(self, ends: list[Array]) -> None:
        """Widen the tolerances of a constraint manifold slightly if a start or goal (dof,) is on its
        boundary.
        """
        self.allowance = self.boundary_margin if any(self.violations(q, inside=True) for q in ends) else 0.0


def _corridors(names: tuple[str, ...], constraints: Constraints, scene: PlanningScene) -> tuple[Array, Array]:
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for joint in constraints.joints:
        if joint.joint not in names:
            scene.model.joint(joint.joint)
            raise InputError(
                f"a path constraint names joint {joint.joint!r}, which the group does not move",
                hint=f"its joints are {', '.join(names)}",
            )
        numbers = (joint.position, joint.tolerance_above, joint.tolerance_below)
        if not np.isfinite(joint.position) or np.isnan(numbers).any() or min(numbers[1:]) < 0:
            raise InputError(
                f"the constraint of joint {joint.joint!r} has position {joint.position:g} and tolerances "
                f"{joint.tolerance_above:g} and {joint.tolerance_below:g}",
                hint="the position must be finite and the tolerances not negative",
            )
        i = names.index(joint.joint)
        lower[i] = max(lower[i], joint.position - joint.tolerance_below)
        upper[i] = min(upper[i], joint.position + joint.tolerance_above)
    return lower, upper


def _sizes(shape: Shape, what: str) -> tuple[int, Array]:
    """Convert a shape of a constraint region to the kind and sizes [m] that the compiled kernels of the
    constraint manifold take.
    """
    match shape:
        case Box():
            return layout.BOX, shape.half_extents
        case Sphere():
            return layout.BALL, np.array([shape.radius, 0.0, 0.0])
        case Cylinder():
            return layout.CYLINDER, np.array([shape.radius, shape.length / 2, 0.0])
        case Capsule():
            return layout.CAPSULE, np.array([shape.radius, shape.length / 2, 0.0])
        case Plane():
            return layout.HALF_SPACE, np.zeros(3)
    raise InputError(
        f"{what} has a {type(shape).__name__} in its region",
        hint="regions are made of boxes, spheres, cylinders, capsules and half spaces (Plane)",
    )


def reach_of(table: Array, point: Array, scene: PlanningScene, names: tuple[str, ...]) -> Array:
    """Return, for the constraint manifold, the largest distance (dof,) [m/rad or m/m] that a constrained
    point on a link can move per unit motion of each joint.

    The bounds hold in all configurations.
    """
    reach, radius = np.zeros(len(names)), float(np.linalg.norm(point))
    for row in table[::-1]:
        radius += float(np.linalg.norm(row[[3, 7, 11]]))
        column, multiplier = int(row[COLUMN]), abs(row[MULTIPLIER])
        if row[SLIDE]:
            limits = scene.model.joints[names[column]].limits
            reach[column] += multiplier
            radius += multiplier * max(abs(limits.lower), abs(limits.upper)) + abs(row[MULTIPLIER + 1])
        else:
            reach[column] += multiplier * radius
    return reach
