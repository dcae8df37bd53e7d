"""Sphere covers: few spheres that contain a solid, chosen from points on its surface and inside it.

A sphere with radius d + e around an interior point at depth d extends at most e beyond the solid,
because the ball of radius d is inside the solid. From such spheres, a greedy choice covers all surface
points; the spacing of the points is subtracted from the radii, so that the surface between the points is
covered too. If the cover is free of contact, the solid is free; if the inner ball (radius d) touches,
the solid certainly touches.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.collision.kernel.triangle_tree import LEAF, TriangleTree, distances, near_and_far
from armcell.collision.winding import WindingNumbers
from armcell.core import Box, Capsule, Cone, Cylinder, Mesh, Octree, Plane, PointCloud, Shape, Sphere

F64 = NDArray[np.float64]

SECTIONS = 48  # number of facets around round shapes
GROUP = 8  # spheres that share a bounding sphere
FIT_VERSION = 3  # increase when `fit` returns other spheres, to invalidate the disk cache


def triangulated(shape: Shape) -> tuple[F64, NDArray[np.int64], float]:
    """Triangulate a shape to cover it with spheres: return the vertices (v, 3), the faces (f, 3), and the
    largest gap [m] to the shape's true surface.

    The gap is the largest distance by which the true surface is outside the triangles.
    """
    import trimesh  # slow to import, and not needed if the covers are in the disk cache

    match shape:
        case Mesh():
            return np.asarray(shape.vertices, float), shape.faces.astype(np.int64), 0.0
        case Box():
            mesh, gap = trimesh.creation.box((shape.x, shape.y, shape.z)), 0.0
        case Cylinder():
            mesh = trimesh.creation.cylinder(shape.radius, shape.length, sections=SECTIONS)
            gap = shape.radius * (1 - np.cos(np.pi / SECTIONS))
        case Cone():
            mesh = trimesh.creation.cone(shape.radius, shape.length, sections=SECTIONS)
            mesh.apply_translation((0, 0, -shape.length / 2))
            gap = shape.radius * (1 - np.cos(np.pi / SECTIONS))
        case Capsule():
            mesh = trimesh.creation.capsule(shape.length, shape.radius, count=(24, 24))
            mesh.apply_translation(-mesh.bounds.mean(axis=0))
            gap = shape.radius * (1 - np.cos(np.pi / 24)) * 2
        case Sphere():
            mesh = trimesh.creation.icosphere(3, shape.radius)
            gap = shape.radius * 0.01
        case Plane() | PointCloud() | Octree():
            raise ValueError(
                f"a {type(shape).__name__} has no cover: it is no part of robots or moving objects"
            )
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64), float(gap)


def small_triangles(vertices: F64, faces: NDArray[np.int64], edge: float) -> F64:
    """Split the surface of a solid into triangles (m, 3, 3) with edges of at most `edge` [m], which the
    spheres of a cover must contain.

    The algorithm halves the longest edges. A sphere is convex, so it contains a triangle if it contains its
    vertices: covers need no margin between sample points.
    """
    left, done = vertices[faces], []
    while len(left):
        sides = np.stack([left[:, (k + 1) % 3] - left[:, k] for k in range(3)], axis=1)
        lengths = (sides**2).sum(axis=2)
        big = lengths.max(axis=1) > edge * edge
        done.append(left[~big])
        left, k = left[big], lengths[big].argmax(axis=1)
        rows = np.arange(len(left))
        a, b, c = left[rows, k], left[rows, (k + 1) % 3], left[rows, (k + 2) % 3]
        middle = (a + b) / 2
        left = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def outer_skin(vertices: F64, faces: NDArray[np.int64], edge: float) -> tuple[F64, F64]:
    """Return the outer surface of a solid's mesh for its sphere cover, in two versions: as small triangles
    (m, 3, 3) with edges of at most `edge` [m], and as fewer triangles (k, 3, 3).

    Parts of the surface that are inside the same mesh are left out and need no cover: robot meshes often
    consist of several closed solids that intersect.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, parts = connected_components(
        coo_matrix(
            (np.ones(3 * len(faces)), (faces.ravel(), np.roll(faces, 1, axis=1).ravel())),
            (len(vertices),) * 2,
        )
    )
    part_of_face = parts[faces[:, 0]]
    names = np.unique(part_of_face)
    if len(names) == 1:
        return small_triangles(vertices, faces, edge), vertices[faces]
    solids = {part: faces[part_of_face == part] for part in names}
    winding = {part: WindingNumbers(vertices, solid) for part, solid in solids.items()}
    kept, surface = [], []
    for part in names:
        elements = small_triangles(vertices, solids[part], edge)
        buried = np.zeros(len(elements), dtype=bool)
        # Test points slightly outside the face: where two solids abut, each face is inside the other solid.
        normal = np.cross(elements[:, 1] - elements[:, 0], elements[:, 2] - elements[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-18)
        points = elements.mean(axis=1) + 2e-4 * normal
        for other in names:
            if other == part:
                continue
            solid = solids[other]
            low, high = vertices[solid].min(axis=(0, 1)), vertices[solid].max(axis=(0, 1))
            near = np.flatnonzero(~buried & np.all((points > low) & (points < high), axis=1))
            buried[near] = winding[other](points[near]) > 0.5
        kept.append(elements[~buried])
        surface.append(kept[-1] if buried.any() else vertices[solids[part]])
    return np.concatenate(kept), np.concatenate(surface)


def interior_points(vertices: F64, faces: NDArray[np.int64], spacing: float) -> F64:
    """Return the points (m, 3) of a regular grid that are inside a solid. The sphere cover of the solid must
    contain all these points.
    """
    low, high = vertices.min(0), vertices.max(0)
    axes = [np.arange(a + (b - a) % spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if len(grid) == 0:
        return grid
    return grid[WindingNumbers(vertices, faces)(grid) > 0.5]


@dataclass(frozen=True, eq=False)
class Cover:
    """Sphere cover of a solid: `centers` (k, 3), `outer` and `inner` radii (k,) [m].

    The spheres are sorted so that each run of `GROUP` spheres is spatially compact; `groups` (g, 4) are the
    bounding spheres of these runs.
    """

    centers: F64
    outer: F64
    inner: F64
    groups: F64


def _grouped(centers: F64, outer: F64, inner: F64) -> Cover:
    groups = [
        np.append(*bounding_sphere(centers[i : i + GROUP], outer[i : i + GROUP]))
        for i in range(0, len(centers), GROUP)
    ]
    return Cover(centers, outer, inner, np.array(groups))


@njit(cache=True)
def _holds(e, x, y, z, reach2):
    """Return whether a ball of a sphere cover contains all three corners of an element (9,)."""
    for i in range(0, 9, 3):
        dx, dy, dz = e[i] - x, e[i + 1] - y, e[i + 2] - z
        if dx * dx + dy * dy + dz * dz > reach2:
            return False
    return True


@njit(cache=True)
def _gain(tree, left, ball, take, exact):
    """Count the uncovered elements of a shape that a ball contains.

    Args:
        tree: the elements; a leaf's uncovered elements come first.
        left: (k,) uncovered elements of each node. The counts below a node without any are outdated.
        ball: center x, y, z and squared radius.
        take: mark the counted elements as covered.
        exact: if False, also count the uncovered elements outside the ball in leaves that the ball meets.
    """
    x, y, z, reach2 = ball
    count, stack = 0, np.empty(64, np.int64)
    stack[0], depth = 0, 1
    while depth > 0:
        depth -= 1
        n = stack[depth]
        if left[n] == 0:
            continue
        near, far = near_and_far(tree.box[n], x, y, z)
        if near > reach2:
            continue
        found = left[n]
        if far > reach2:
            if n < tree.leaves:
                stack[depth], stack[depth + 1] = 2 * n + 1, 2 * n + 2
                depth += 2
                continue
            if exact:
                found = _held_of_leaf(tree, (n - tree.leaves) * LEAF, left[n], ball, take)
        count += found
        if take:
            left[n] -= found
            while n > 0:
                n = (n - 1) // 2
                left[n] -= found
    return count


@njit(cache=True)
def _held_of_leaf(tree, first, count, ball, take):
    """Count the elements of a tree leaf that a ball contains. The leaf has `count` elements from index
    `first` on. With `take`, the contained elements move to the end of the leaf.
    """
    x, y, z, reach2 = ball
    found, t = 0, first
    while t < first + count:
        if _holds(tree.triangles[t], x, y, z, reach2):
            found += 1
            if take:
                count -= 1
                end = first + count
                last = tree.triangles[end].copy()
                tree.triangles[end], tree.triangles[t] = tree.triangles[t], last
                tree.order[t], tree.order[end] = tree.order[end], tree.order[t]
                continue
        t += 1
    return found


@njit(cache=True)
def _choose(tree, left, centers, reach2, held):
    """Choose the balls of a sphere cover greedily, in compiled code. Update the counts `left` (k,) of
    uncovered elements, and clear the flags `held` (n,) of the elements that no ball contains.

    See `_greedy` for the method and `_gain` for the counts.
    """
    best = [(0, 0)]  # a heap of -gain, ball
    best.pop()
    for c in range(len(centers)):
        ball = (centers[c, 0], centers[c, 1], centers[c, 2], reach2[c])
        best.append((-_gain(tree, left, ball, False, False), c))
    heapq.heapify(best)
    chosen = []
    while len(best) > 0 and best[0][0] < 0:
        gain, c = best[0]
        ball = (centers[c, 0], centers[c, 1], centers[c, 2], reach2[c])
        now = _gain(tree, left, ball, False, True)
        if now < -gain:
            heapq.heapreplace(best, (-now, c))
            continue
        heapq.heappop(best)
        chosen.append(c)
        _gain(tree, left, ball, True, True)
    for n in range(1, len(left)):
        if left[(n - 1) // 2] == 0:
            left[n] = 0
        if n >= tree.leaves:
            first = (n - tree.leaves) * LEAF
            held[tree.order[first : first + left[n]]] = False
    return np.array(chosen, dtype=np.int64)


def _greedy(elements: F64, centers: F64, reach2: F64) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Choose balls for a sphere cover greedily: each step adds the ball that contains the most uncovered
    elements of the shape, until no ball contains any.

    A ball's gain only decreases, so old gains are upper bounds: only those of the best balls are counted
    again.

    Args:
        elements: (n, 3, 3) corners of the elements [m].
        centers: (m, 3) centers of the balls [m].
        reach2: (m,) squared radii of the balls [m^2].
    Returns:
        The chosen balls, and which elements they contain.
    """
    tree = TriangleTree.of(elements)
    left = [np.clip(len(elements) - np.arange(len(tree.box) - tree.leaves) * LEAF, 0, LEAF)]
    while len(left[-1]) > 1:
        left.append(left[-1][::2] + left[-1][1::2])
    held = np.ones(len(elements), bool)
    return _choose(tree, np.concatenate(left[::-1]), centers, reach2, held), held


@lru_cache(maxsize=4096)
def cover(shape: Shape, overshoot: float = 0.010) -> Cover:
    """Return a set of spheres that covers a shape and extends at most `overshoot` [m] beyond it.

    A sphere is its own cover. Other covers are cached on disk by the content of the shape, so each robot's
    covers are fitted once per machine.
    """
    if isinstance(shape, Sphere):
        radius = np.array([shape.radius])
        return _grouped(np.zeros((1, 3)), radius, radius)
    key = shape_key(shape, overshoot)

    def fitted() -> dict[str, F64]:
        found = fit(shape, overshoot)
        return {"centers": found.centers, "outer": found.outer, "inner": found.inner}

    stored = recall_or_compute("covers", key, fitted)
    return _grouped(stored["centers"], stored["outer"], stored["inner"])


def fit(shape: Shape, overshoot: float) -> Cover:
    """Compute the sphere cover of a shape without using the cache."""
    vertices, faces, round_gap = triangulated(shape)
    elements, surface = outer_skin(vertices, faces, 0.7 * overshoot)
    size = float((vertices.max(0) - vertices.min(0)).max())
    inside = interior_points(vertices, faces, max(0.8 * overshoot, size / 35))
    depth = distances(inside, TriangleTree.of(surface)) if len(inside) else np.zeros(0)
    if not np.isfinite(depth).all():  # a ball of radius NaN would hold every element and touch nothing
        raise FloatingPointError("the distance of an interior point from the surface is not finite")
    # The cover must contain the solid's interior as well as its skin: each grid point is a small element.
    elements = np.concatenate([elements, np.repeat(inside[:, None, :], 3, axis=1)])
    # Balls around surface points (depth 0) reach corners that no interior ball reaches; a few are enough.
    skin = elements[: len(elements) - len(inside)].mean(axis=1)
    cells = np.round(skin / (2 * overshoot)).astype(np.int64)
    cells -= cells.min(axis=0)
    # One number per cell: rows take ten times as long to sort.
    _, thin = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1)), return_index=True)
    centers = np.vstack([inside, skin[np.sort(thin)]])
    inner = np.concatenate([depth, np.zeros(len(thin))])
    outer = inner + overshoot
    reach2 = (outer - round_gap) ** 2
    chosen, held = _greedy(elements, centers, reach2)
    missing = elements[~held]  # repair: elements that no candidate contains get their own ball
    while len(missing):
        center = missing[0].mean(axis=0)
        centers, inner, outer = (
            np.vstack([centers, center]),
            np.append(inner, 0.0),
            np.append(outer, overshoot),
        )
        chosen = np.append(chosen, len(centers) - 1)
        missing = missing[((missing - center) ** 2).sum(axis=2).max(axis=1) > (overshoot - round_gap) ** 2]
    order = _neighbors_together(centers[chosen])
    chosen = chosen[order]
    return _grouped(centers[chosen], outer[chosen], inner[chosen])


def _neighbors_together(centers: F64) -> NDArray[np.int64]:
    """Order the sphere centers of a cover such that each run of `GROUP` centers is close together in space.

    The function splits the centers in halves along the longest axis.
    """

    def split(index: NDArray[np.int64]) -> list[int]:
        if len(index) <= GROUP:
            return index.tolist()
        points = centers[index]
        axis = int(np.argmax(np.ptp(points, axis=0)))
        index = index[np.argsort(points[:, axis], kind="stable")]
        half = GROUP * max(round(len(index) / 2 / GROUP), 1)
        return split(index[:half]) + split(index[half:])

    return np.array(split(np.arange(len(centers))), dtype=np.int64)


def bounding_sphere(centers: F64, radii: F64) -> tuple[F64, float]:
    """Return the center and radius of a small sphere that contains all spheres of a cover, which have centers
    (n, 3) and radii (n,).

    The iteration starts from the center of the bounding box and moves toward the farthest sphere.
    """
    low, high = np.min(centers - radii[:, None], axis=0), np.max(centers + radii[:, None], axis=0)
    *center, radius = _shrink(np.ascontiguousarray(centers), np.ascontiguousarray(radii), (low + high) / 2)
    return np.array(center), radius


@njit(cache=True)
def _shrink(centers, radii, start):
    """Compute a small bounding sphere around the spheres of a cover: in 60 steps, its center moves from
    `start` (3,) toward the farthest sphere. Return the center and the radius.
    """
    x, y, z = start
    step = 0.05
    reach = 0.0
    for k in range(61):
        far = 0
        reach = -1.0
        for i in range(len(radii)):
            dx, dy, dz = centers[i, 0] - x, centers[i, 1] - y, centers[i, 2] - z
            r = np.sqrt(dx * dx + dy * dy + dz * dz) + radii[i]
            if r > reach:
                far, reach = i, r
        if k < 60:
            x += step * (centers[far, 0] - x)
            y += step * (centers[far, 1] - y)
            z += step * (centers[far, 2] - z)
            step *= 0.93
    return x, y, z, reach


def shape_key(shape: Shape, overshoot: float) -> str:
    """Return the key under which a shape's sphere cover is cached. It is the same in every process.

    The key changes with the version of the fitting algorithm.
    """
    version = f"{FIT_VERSION} {overshoot:.6f}"
    vertices = getattr(shape, "vertices", None)
    if vertices is None:
        return key_of(version, repr(shape))
    return key_of(version, vertices, shape.faces)  # type: ignore[union-attr]
