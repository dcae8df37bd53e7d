"""`ExactChecker`: exact collision and distance queries with the coal library."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.broad_phase import box_gaps, world_boxes
from armcell.collision.certify import Certificate, certify_path
from armcell.collision.coal_shapes import CoalGeometry, distance_to_primitives, solid, touches_primitives
from armcell.core import SE3, Contact, InputError
from armcell.core.checks import float_array
from armcell.kinematics import kinematic_tree
from armcell.scene import CollisionObject, PlanningScene

Array = NDArray[np.float64]

MANY = 1000  # largest number of contacts of two surfaces among which the deepest is searched


@dataclass(frozen=True, eq=False)
class Geometry:
    """Collision geometry of one body in the exact checker. `link` is -1 for an object in the world."""

    body: str
    link: int
    solid: CoalGeometry
    T_link_solid: SE3
    padding: float  # [m], applies to pairs with objects


class ExactChecker:
    """Exact collision and distance checker for one scene and for the joints of one group.

    Configurations `q` (n,) contain the group's joints; the other joints keep the scene's positions.
    `contacts` reports all pairs. `is_free`, which planners call, ignores pairs whose relative pose the group
    cannot change. The checker reuses its buffers and is not thread-safe: create one per thread.
    """

    def __init__(self, scene: PlanningScene, joint_names: Iterable[str] | None = None):
        self.scene = scene
        self.model = scene.model
        self.tree = kinematic_tree(scene.model)
        self.joint_names = tuple(joint_names) if joint_names is not None else scene.model.joint_names
        self.columns = np.array(scene.model.columns(self.joint_names), dtype=np.int64)
        self._q = np.array(scene.positions, dtype=float)
        self.geometries = _geometries(scene)
        self.checks = 0
        self._prepare_boxes()
        self._prepare_pairs()

    # --- preparation ---
    def _prepare_boxes(self) -> None:
        n = len(self.geometries)
        self._link = np.array([g.link for g in self.geometries], dtype=np.int64)
        self._static = self._link < 0
        self._center = np.array([g.T_link_solid.apply(g.solid.center) for g in self.geometries]).reshape(n, 3)
        self._R_half = np.array(
            [g.T_link_solid.rotation.matrix * g.solid.half for g in self.geometries]
        ).reshape(n, 3, 3)
        self._world_center = self._center.copy()
        self._world_half = np.abs(self._R_half).sum(axis=2)
        self._transforms = [coal.Transform3s() for _ in range(n)]
        self._R_local = [g.T_link_solid.rotation.matrix for g in self.geometries]
        self._t_local = [g.T_link_solid.translation for g in self.geometries]
        for i, g in enumerate(self.geometries):
            if g.link < 0:
                self._transforms[i].setTransform(self._R_local[i], self._t_local[i])
        self._stamp = np.zeros(n, dtype=np.int64)  # number of the query that last updated each transform
        self._query = 0

    def _prepare_pairs(self) -> None:
        scene, geometries = self.scene, self.geometries
        rigid = {link: i for i, links in enumerate(self.model.rigid_groups) for link in links}
        # World objects and links rigidly fixed to the root never move against each other: contact between a
        # robot's base and its table is the mounting, not a collision.
        root = rigid[self.model.root_link]
        home = [root if g.link < 0 else rigid[self.tree.link_names[g.link]] for g in geometries]
        moved_by = [self._group_joints_above(g.link) for g in geometries]
        active, fixed, margins_active, margins_fixed = [], [], [], []
        for i, a in enumerate(geometries):
            for j in range(i + 1, len(geometries)):
                b = geometries[j]
                if a.body == b.body or home[i] == home[j] or scene.is_allowed(a.body, b.body):
                    continue
                against_object = a.link < 0 or b.link < 0
                margin = a.padding + b.padding if against_object else 0.0
                if moved_by[i] == moved_by[j]:
                    fixed.append((i, j))
                    margins_fixed.append(margin)
                else:
                    active.append((i, j))
                    margins_active.append(margin)
        self.pairs = np.array(active, dtype=np.int64).reshape(-1, 2)
        self.fixed_pairs = np.array(fixed, dtype=np.int64).reshape(-1, 2)
        self.margins = np.array(margins_active)
        self.fixed_margins = np.array(margins_fixed)
        self._gaps = np.empty(len(self.pairs))
        self._request = coal.CollisionRequest()
        self._result = coal.CollisionResult()
        self._all_request, self._all_result = coal.CollisionRequest(), coal.CollisionResult()
        self._all_request.num_max_contacts = MANY
        self._distance_request = coal.DistanceRequest()
        self._distance_result = coal.DistanceResult()

    def _group_joints_above(self, link: int) -> frozenset[int]:
        if link < 0:
            return frozenset()
        mine = set(self.columns.tolist())
        path = self.tree.path_to(self.tree.link_names[link])
        # By joint, not by column: two fingers that mimic one joint move against each other.
        return frozenset(int(j) for j in path if self.tree.kind[j] != 0 and int(self.tree.column[j]) in mine)

    # --- placing ---
    def full(self, q: ArrayLike) -> Array:
        """Set the group's joints to q (n,) and return the positions (dof,) of all joints in the exact
        checker.
        """
        self._q[self.columns] = float_array(q, (len(self.columns),), "a configuration")
        return self._q

    def set_configuration(self, q: ArrayLike) -> None:
        """Move all bodies in the exact checker to their poses at the configuration q (n,).

        The pair methods refer to the last placement.
        """
        self.Ts = self.tree.link_transforms(self.full(q))
        world_boxes(
            self.Ts,
            self._link,
            self._center,
            self._R_half,
            self._static,
            self._world_center,
            self._world_half,
        )
        self._query += 1

    def set_object_pose(self, i: int, T_world_solid: SE3) -> None:
        """Set the pose of a world object's geometry in the exact checker. The pose remains in effect until
        the next call.
        """
        R, g = T_world_solid.rotation.matrix, self.geometries[i].solid
        self._transforms[i].setTransform(R, T_world_solid.translation)
        self._world_center[i] = T_world_solid.apply(g.center)
        self._world_half[i] = np.abs(R) @ g.half

    def _transform(self, i: int) -> coal.Transform3s:
        transform = self._transforms[i]
        link = self._link[i]
        if link >= 0 and self._stamp[i] != self._query:
            T = self.Ts[link]
            R = T[:3, :3]
            transform.setTransform(R @ self._R_local[i], R @ self._t_local[i] + T[:3, 3])
            self._stamp[i] = self._query
        return transform

    def pair_gaps(self, pairs: NDArray[np.int64]) -> Array:
        """Return lower bounds [m] on the distances of geometry pairs (p, 2) in the exact checker.

        Raises:
            InputError: `pairs` is not an int64 array (p, 2).
        """
        if not isinstance(pairs, np.ndarray) or pairs.ndim != 2 or pairs.dtype != np.int64:
            raise InputError(f"pairs must be whole numbers (p, 2), not {pairs!r}")
        gaps = np.empty(len(pairs))
        box_gaps(pairs, self._world_center, self._world_half, gaps)
        return gaps

    def _touch(self, a: int, b: int, margin: float) -> bool:
        ga, gb = self.geometries[a].solid, self.geometries[b].solid
        self._request.security_margin = margin
        self._result.clear()
        if gb.primitives is not None:  # such shapes are world objects, so they come second in a pair
            here, there = self._transform(a), self._transform(b)
            return touches_primitives(ga, here, gb.primitives, there, self._request, self._result)
        hit = coal.collide(
            ga.exact, self._transform(a), gb.exact, self._transform(b), self._request, self._result
        )
        return bool(hit) or self._one_inside(a, b)

    def _one_inside(self, a: int, b: int) -> bool:
        """Check exactly whether one of two geometries encloses the other although their surfaces do not
        touch.
        """
        for outer, inner in ((a, b), (b, a)):
            around, other = self.geometries[outer].solid, self.geometries[inner].solid
            if around.hollow is None or not self._solid_inside(outer):
                continue
            point = other.hollow.vertices[0] if other.hollow is not None else other.center
            here, there = self._transform(inner), self._transform(outer)
            world = here.getRotation() @ point + here.getTranslation()
            if around.holds(there.getRotation().T @ (world - there.getTranslation())):
                return True
        return False

    def _solid_inside(self, i: int) -> bool:
        """Return whether the exact checker treats the interior of a mesh as solid.

        Links are always solid; a world object is solid if its mesh is watertight.
        """
        return self._link[i] >= 0 or self.geometries[i].solid.closed

    def pair_touches(self, a: int, b: int) -> bool:
        """Check exactly whether two geometries, given by index, touch. This is faster than
        `pair_distance`.
        """
        return self._touch(a, b, 0.0)

    def pair_distance(self, a: int, b: int, outer: bool = False, below: float = np.inf) -> float:
        """Return the exact signed distance [m] of two geometries, given by index.

        Args:
            outer: measure between the convex outer shapes instead of the exact shapes.
            below: [m] of a larger distance, only a lower bound that is at least `below` is returned, which
                is found several times faster.
        """
        ga, gb = self.geometries[a].solid, self.geometries[b].solid
        self._distance_result.clear()
        self._distance_result.min_distance = min(below, self._distance_result.min_distance)
        if gb.primitives is not None:
            here, there = self._transform(a), self._transform(b)
            request, result = self._distance_request, self._distance_result
            return distance_to_primitives(ga, here, gb.primitives, there, request, result, outer)
        distance = float(
            coal.distance(
                ga.outer if outer else ga.exact, self._transform(a),
                gb.outer if outer else gb.exact, self._transform(b),
                self._distance_request, self._distance_result,
            )
        )  # fmt: skip
        if outer:
            return distance
        if distance > 0 and self._one_inside(a, b):
            return -distance  # the depth is the distance to the nearest surface
        if distance <= 0 and (ga.hollow is not None or gb.hollow is not None):
            return min(distance, self._deepest(a, b))
        return distance

    def _deepest(self, a: int, b: int) -> float:
        """Return the exact penetration depth of two touching geometries, as a negative distance [m].

        At least one geometry is a triangle surface. The value is the deepest penetration of all triangle
        pairs, whereas `coal.distance` returns only that of the first triangle pair in contact.
        """
        ga, gb = self.geometries[a].solid, self.geometries[b].solid
        self._all_result.clear()
        count = coal.collide(
            ga.exact, self._transform(a), gb.exact, self._transform(b), self._all_request, self._all_result
        )
        depths = [self._all_result.getContact(k).penetration_depth for k in range(count)]
        return float(min(depths, default=0.0))

    def contact_of(self, a: int, b: int, distance: float | None = None) -> Contact:
        """Return the exact contact between two geometries, given by index, with its distance and location.

        Args:
            distance: result [m] of `pair_distance(a, b)` if that was this checker's last call.
        """
        if distance is None:
            distance = self.pair_distance(a, b)
        p = (self._distance_result.getNearestPoint1() + self._distance_result.getNearestPoint2()) / 2
        if not np.all(np.isfinite(p)):
            p = (self._world_center[a] + self._world_center[b]) / 2
        x, y, z = (float(v) for v in p)
        return Contact(self.geometries[a].body, self.geometries[b].body, distance, (x, y, z))

    # --- queries ---
    def is_free(self, q: ArrayLike) -> bool:
        """Return whether the configuration q is collision-free: all bodies that the group can move touch
        nothing. The check is exact and includes padding.
        """
        self.checks += 1
        self.set_configuration(q)
        box_gaps(self.pairs, self._world_center, self._world_half, self._gaps)
        for p in np.flatnonzero(self._gaps <= self.margins):
            if self._touch(self.pairs[p, 0], self.pairs[p, 1], float(self.margins[p])):
                return False
        return True

    def relax_margins(self, q: ArrayLike) -> None:
        """Reduce the exact checker's padding for body pairs whose distance at
        q (n,) is smaller than the padding but not zero.

        The new padding is 0.1 mm less than the current distance, so a motion can start at q and leave, but
        cannot come closer.
        """
        self.relaxed_margins(q)

    def relaxed_margins(self, q: ArrayLike) -> dict[tuple[str, str], float]:
        """Reduce the exact checker's padding for body pairs that are closer at q (n,) than their padding.
        Return the reduced padding [m] of each of these pairs (body, object).
        """
        self.set_configuration(q)
        lowered: dict[tuple[str, str], float] = {}
        for pairs, margins in ((self.pairs, self.margins), (self.fixed_pairs, self.fixed_margins)):
            for p in np.flatnonzero((self.pair_gaps(pairs) <= margins) & (margins > 0)):
                a, b = int(pairs[p, 0]), int(pairs[p, 1])
                distance = self.pair_distance(a, b)
                if distance <= margins[p]:
                    margins[p] = max(distance - 1e-4, 0.0)
                    key = (self.geometries[a].body, self.geometries[b].body)
                    lowered[key] = min(margins[p], lowered.get(key, np.inf))
        return lowered

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, *, evidence: bool = True
    ) -> Certificate:
        """Certify with the exact checker that a piecewise linear motion (k, n) is collision-free.

        Args:
            waypoints: (k, n) joint positions.
            slack: (n,) largest deviation of each joint from the straight edges [rad or m].
            evidence: no effect; this checker always reports the touching pair. Other checkers need extra time
                for it.
        """
        return certify_path(self, waypoints, slack)

    def contacts(self, q: ArrayLike, padded: bool = True) -> list[Contact]:
        """Return every pair of bodies that touch at q (n,) according to the exact checker, deepest contact
        first.

        Args:
            padded: also return pairs that are closer than their padding.
        """
        self.set_configuration(q)
        worst: dict[frozenset[str], Contact] = {}
        for pairs, margins in ((self.pairs, self.margins), (self.fixed_pairs, self.fixed_margins)):
            limits = margins if padded else np.zeros(len(margins))
            for p in np.flatnonzero(self.pair_gaps(pairs) <= limits):
                a, b = int(pairs[p, 0]), int(pairs[p, 1])
                if not self._touch(a, b, float(limits[p])):
                    continue
                contact = self.contact_of(a, b)
                key = frozenset((contact.body_a, contact.body_b))
                if key not in worst or contact.distance < worst[key].distance:
                    worst[key] = contact
        return sorted(worst.values(), key=lambda c: c.distance)

    def touching(self, q: ArrayLike) -> set[frozenset[str]]:
        """Return the pairs of body names that touch at q (n,) according to the exact checker, without
        padding. For overlapping meshes, this is much faster than `contacts`, which also computes depths.
        """
        self.set_configuration(q)
        near = (pairs[self.pair_gaps(pairs) <= 0] for pairs in (self.pairs, self.fixed_pairs))
        return {
            frozenset((self.geometries[a].body, self.geometries[b].body))
            for a, b in np.vstack(list(near)).tolist()
            if self._touch(a, b, 0.0)
        }

    def nearest(self, q: ArrayLike, cutoff: float = np.inf) -> Contact | None:
        """Return the closest pair of bodies whose relative pose the group can change,
        according to the exact checker.

        Args:
            q: (n,) configuration.
            cutoff: pairs farther apart [m] are not measured; if all pairs are, the result is None.
        """
        self.set_configuration(q)
        gaps = self.pair_gaps(self.pairs)
        best, best_pair = cutoff, None
        for p in np.argsort(gaps, kind="stable"):
            if gaps[p] >= best:
                break
            a, b = int(self.pairs[p, 0]), int(self.pairs[p, 1])
            if self.pair_distance(a, b, outer=True) >= best:
                continue
            distance = self.pair_distance(a, b, below=best)
            if distance < best:
                best, best_pair = distance, (a, b)
        return None if best_pair is None else self.contact_of(*best_pair)


def _geometries(scene: PlanningScene) -> list[Geometry]:
    tree = kinematic_tree(scene.model)
    found = []
    for link in scene.model.links.values():
        padding = scene.link_padding.get(link.name, scene.padding)
        scale = scene.link_scale.get(link.name, 1.0)
        for c in link.collisions:
            found.append(
                Geometry(
                    link.name, tree.link_index[link.name], solid(c.shape, scale), c.T_link_shape, padding
                )
            )
    for body in scene.attached.values():
        padding = scene.link_padding.get(body.link, scene.padding)
        for shape, T_object_shape in body.object.shapes:
            T = body.T_link_object @ T_object_shape
            found.append(Geometry(body.object.name, tree.link_index[body.link], solid(shape), T, padding))
    for item in scene.objects.values():
        for shape, T_object_shape in item.shapes:
            found.append(Geometry(item.name, -1, solid(shape), item.T_world_object @ T_object_shape, 0.0))
    return found


def neighbors(scene: PlanningScene, name: str, within: float = 0.002) -> list[str]:
    """Return the objects near a world object, for example those that support it. Their exact distances from
    the object are at most `within` [m].

    Args:
        name: object in the world.
        within: largest distance of the surfaces [m].
    """
    item = scene.object(name)
    request, near = coal.DistanceRequest(), []
    for other in scene.objects.values():
        if other.name != name and object_distance(item, other, request) <= within:
            near.append(other.name)
    return near


def object_distance(a: CollisionObject, b: CollisionObject, request: coal.DistanceRequest) -> float:
    """Return the exact distance [m] between two world objects, negative if they overlap. Pairs of clouds are
    skipped.
    """
    best, result = np.inf, coal.DistanceResult()
    for shape_a, T_a in a.shapes:
        A = a.T_world_object @ T_a
        for shape_b, T_b in b.shapes:
            B = b.T_world_object @ T_b
            result.clear()
            one = (solid(shape_a), coal.Transform3s(A.rotation.matrix, A.translation))
            two = (solid(shape_b), coal.Transform3s(B.rotation.matrix, B.translation))
            if one[0].primitives is not None:
                one, two = two, one
            if one[0].primitives is not None:
                continue  # distances between two point clouds are not needed
            if two[0].primitives is not None:
                found = distance_to_primitives(*one, two[0].primitives, two[1], request, result)
            else:
                found = coal.distance(one[0].exact, one[1], two[0].exact, two[1], request, result)
            best = min(best, found)
    return float(best)


def overlaps(scene: PlanningScene, name: str, tolerance: float = 5e-4) -> list[tuple[str, float]]:
    """Return the objects that overlap a world object according to exact collision checks, with penetration
    depths [m], deepest first.

    Args:
        name: object in the world.
        tolerance: smaller overlaps [m] are ignored.
    """
    item, request = scene.object(name), coal.DistanceRequest()
    depths = [(o.name, -object_distance(item, o, request)) for o in scene.objects.values() if o.name != name]
    return sorted([(n, d) for n, d in depths if d > tolerance], key=lambda nd: -nd[1])
