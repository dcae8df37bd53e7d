"""Pose estimation of known meshes by rendering: candidate poses are judged by all that the cameras see.

Candidates rest on each stable side of the mesh, at every yaw. The best ones are refined with all six degrees
of freedom, first on few triangles and pixels, then on all. A pose is ambiguous if another one, in which the
mesh does not look the same, explains the images about as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.convex_decomposition import evenly_spread
from armcell.core import SE3, SO3, Shape
from armcell.model.mesh_decimation import decimated
from armcell.perception import depth_render as D
from armcell.perception.depth_render import DepthEvidence
from armcell.perception.solid_fit import SLIDING, CameraEvidence, cost_at, fit_solid
from armcell.perception.solids import Solid, solid_of, surface_mesh
from armcell.scene import solid_inertia
from armcell.scene.resting import hull_rests, plane_axes

F64 = NDArray[np.float64]
Faces = NDArray[np.int32]
Triangles = tuple[F64, Faces, bool]
"""Vertices (n, 3) and faces (m, 3) of a mesh, and whether its surface is closed, with outward normals."""

COARSE_PIXELS, FINE_PIXELS = 2500, 8000
"""Maximum numbers of pixels of each camera for the search and for the final comparison."""
_COARSE_FACES, _MEDIUM_FACES, _FINE_FACES = 600, 3000, 6000
_YAWS = 36
_APART = np.deg2rad(10.0)  # [rad] resting sides that are closer are one start
_MOST_SIDES = 40
_MOST_SYMMETRIES = 60
_DIRECTIONS = 120  # in which the outermost points of a mesh show its outline
_SEARCHED, _REFINED = 12, 8  # candidates of each kind with few triangles, and candidates with more of them
_NUDGE = np.deg2rad(15.0)  # [rad] rotation after which the evidence must pull the mesh back
_SLIDE = 0.06  # shift along the longest axis of inertia, relative to the diameter, likewise
_START_APART = 0.3  # [rad] angle between candidates of one kind
_FEW, _SOME = (60, 0), (80, 20)  # points and rays that rank the starts, and that move them
_HOPEFUL = 1.6  # maximum loss of candidates, relative to the best, that are refined with more triangles
_PROMISING = 1.4  # the same ratio after a few iterations
_LEFT = 1.2  # the same ratio of candidates that are refined on the fine evidence
_SAMPLES, _SURFACE = 1000, 40_000  # points with which two poses are compared, and points of the surface
_SAME = 0.025  # distance between the surfaces in two equal poses, relative to the object's diameter
_MOST_SAME = 0.0025  # [m] largest such distance
_DIFFERENT = 0.02  # fraction of the surface that may be farther apart in equal poses, such as a can's tab


@dataclass(frozen=True, eq=False)
class KnownMesh:
    """Mesh that is prepared for the estimation of its pose: triangles, resting sides, and samples of the
    surface.
    """

    solid: Solid
    coarse: Triangles
    medium: Triangles
    fine: Triangles
    corners: F64  # (n, 3) outermost points
    ups: F64  # (k, 3) upward directions on the resting sides
    center: F64  # (3,) of the bounding box
    middle: F64  # (3,) of the surface
    axes: F64  # (3, 3) columns: axes of inertia of the surface
    radius: float  # [m] rms distance of the surface from the center
    diameter: float
    samples: F64
    tree: Any  # scipy.spatial.KDTree of the surface

    @cached_property
    def rests(self) -> tuple[F64, F64]:
        """Return the rotations (k, 3, 3) of the mesh on each resting side at each yaw angle, and its turned
        outermost points (k, n, 3).
        """
        yaws = [SO3.exp([0, 0, yaw]).matrix for yaw in np.arange(_YAWS) * 2 * np.pi / _YAWS]
        sides = [np.stack([*plane_axes(up), up]) for up in self.ups]
        Rs = np.array([yaw @ side for side in sides for yaw in yaws])
        return Rs, self.corners @ Rs.transpose(0, 2, 1)

    @cached_property
    def symmetries(self) -> tuple[SE3, ...]:
        """Return the rotations after which the mesh looks the same, the identity first.

        They are products of rotations by multiples of 15 deg about the axes of the frame and of inertia.
        """
        middle, axes = self.middle, self.axes
        group = [SO3.identity()]

        def about(turn: SO3) -> SE3:
            return SE3(turn, middle - turn.matrix @ middle)

        def joins(turn: SO3) -> bool:
            known = np.array([g.matrix for g in group])
            if (np.einsum("kij,ij->k", known, turn.matrix) > 1 + 2 * np.cos(0.1)).any():
                return False
            if self.same(SE3.identity(), about(turn)):
                group.append(turn)
                return True
            return False

        turns = (SO3.exp(axis * k * np.pi / 12) for axis in (*np.eye(3), *axes.T) for k in range(1, 24))
        new = [turn for turn in turns if joins(turn)]
        while new and len(group) < _MOST_SYMMETRIES:  # a ball has no end of them
            new = [c for c in (a @ b for a in new for b in tuple(group)[1:]) if joins(c)]
        return tuple(about(turn) for turn in group)

    def same(self, a: SE3, b: SE3) -> bool:
        """Return whether the mesh looks the same in two poses: hardly any of its surface is far apart."""
        limit = min(_SAME * self.diameter, _MOST_SAME)
        away = a.inverse() @ b
        if np.linalg.norm(away.apply(self.middle) - self.middle) > limit + _DIFFERENT * self.diameter:
            return False
        there = away.apply(self.samples)
        return all(  # most pairs of poses already differ at the first few samples
            np.mean(np.isinf(self.tree.query(some, distance_upper_bound=limit)[0])) <= share
            for some, share in ((there[:30], 0.2), (there[:200], 0.06), (there, _DIFFERENT))
        )


@lru_cache(maxsize=64)
def known_mesh(shapes: tuple[tuple[Shape, SE3], ...]) -> KnownMesh:
    """Prepare the surface mesh of an object for the estimation of the mesh's pose."""
    import trimesh
    from scipy.spatial import ConvexHull, KDTree

    mesh = surface_mesh(shapes)
    hull = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    mass, _ = solid_inertia(shapes, 1.0)
    ups = np.zeros((0, 3))
    for rest in hull_rests(mesh.vertices, mass):
        if not len(ups) or (ups @ rest.up).max() < np.cos(_APART):
            ups = np.vstack([ups, rest.up])
    directions = np.vstack([evenly_spread(_DIRECTIONS), -ups])
    corners = hull[np.unique(np.argmax(hull @ directions.T, axis=0))]
    tri = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points = np.asarray(trimesh.sample.sample_surface(tri, _SURFACE, seed=0)[0])
    closed = _is_closed(trimesh.Trimesh(mesh.vertices, mesh.faces))  # with equal corners of triangles merged
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    middle = points.mean(axis=0)
    return KnownMesh(
        solid=solid_of(shapes),
        coarse=_few(mesh.vertices, mesh.faces, _COARSE_FACES, closed),
        medium=_few(mesh.vertices, mesh.faces, _MEDIUM_FACES, closed),
        fine=_few(mesh.vertices, mesh.faces, _FINE_FACES, closed),
        corners=corners,
        ups=ups[:_MOST_SIDES],
        center=center,
        middle=middle,
        axes=np.linalg.eigh(np.cov((points - middle).T))[1],
        radius=float(np.sqrt(((points - center) ** 2).sum(axis=1).mean())),
        diameter=float(np.linalg.norm(np.ptp(points, axis=0))),
        samples=points[:: _SURFACE // _SAMPLES],
        tree=KDTree(points),
    )


def _is_closed(mesh: Any) -> bool:
    """Return whether each body of a mesh (trimesh.Trimesh) is closed, with outward normals."""
    from trimesh.graph import connected_component_labels

    if not (mesh.is_watertight and mesh.is_winding_consistent):
        return False
    body = connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return bool((np.bincount(body, np.einsum("ij,ij->i", a, np.cross(b, c))) > 0).all())


def _few(vertices: F64, faces: Faces, most: int, closed: bool) -> Triangles:
    v, f = decimated(vertices, faces, most)
    # copies: for the read-only arrays of a mesh, Numba would compile all kernels once more
    return np.array(v, order="C"), np.array(f, np.int32, order="C"), closed


@dataclass(frozen=True, eq=False)
class Candidate:
    """Candidate pose of a mesh in the frame of its support, with its total loss on some evidence."""

    T: SE3
    loss: float


def search(
    e: DepthEvidence, points: CameraEvidence, mesh: KnownMesh, partly: bool = False
) -> list[Candidate]:
    """Return candidate poses of a mesh, best first, from coarse evidence.

    Half of the candidates are the starts with the lowest loss of rendered depth. The other half are the
    starts nearest to the points, moved onto the points first: thin walls overlap their image only there.

    Args:
        partly: whether the cluster may be only a corner of the mesh.
    """
    Rs, ts = start_poses(e, mesh, partly)
    starts = [SE3(SO3(R), t) for R, t in zip(Rs, ts, strict=True)]
    few = points.thinned(*_FEW)
    chosen = [starts[i] for i in _leading(D.losses(*mesh.coarse, Rs, ts, e), Rs)]
    near = np.array([cost_at(few, mesh.solid, T) for T in starts])
    some = points.thinned(*_SOME)
    chosen += [fit_solid(some, mesh.solid, SLIDING, np.zeros(3), starts[i], 6).T for i in _leading(near, Rs)]
    pixel = _pixel(e)
    first = [_refined(e, mesh, mesh.coarse, T, pixel, 4) for T in chosen]
    first = _distinct(sorted(first, key=lambda c: c.loss), mesh)
    moved = [_refined(e, mesh, mesh.coarse, c.T, pixel, 4).T for c in first[:_SEARCHED]]
    exact = _distinct(_by_loss(e, mesh, moved), mesh)
    hopeful = [c.T for c in exact[:_REFINED] if c.loss <= _HOPEFUL * exact[0].loss + 3.0]
    return _promising(e, mesh, hopeful, [])


def _by_loss(e: DepthEvidence, mesh: KnownMesh, poses: list[SE3]) -> list[Candidate]:
    """Return poses of a mesh with their losses on coarse evidence, best first."""
    Rs, ts = np.array([T.rotation.matrix for T in poses]), np.array([T.translation for T in poses])
    found = zip(poses, D.losses(*mesh.medium, Rs, ts, e), strict=True)
    return sorted((Candidate(T, float(x)) for T, x in found), key=lambda c: c.loss)


def _leading(found: F64, Rs: F64) -> list[int]:
    """Return the indices of the mesh poses with the lowest losses. Of poses with similar rotations, only the
    best one is returned.
    """
    kept: list[int] = []
    for i in np.argsort(found, kind="stable"):
        turns = np.einsum("kij,ij->k", Rs[kept], Rs[i])
        if not (turns > 1 + 2 * np.cos(_START_APART)).any():
            kept.append(int(i))
        if len(kept) >= _SEARCHED:
            break
    return kept


def _promising(
    e: DepthEvidence, mesh: KnownMesh, tried: list[SE3], known: list[Candidate]
) -> list[Candidate]:
    """Refine poses of a mesh, and return them with the known ones, best first. Most poses are soon hopeless,
    or on their way to the same pose as another one.
    """
    begun = [_refined(e, mesh, mesh.medium, T, _pixel(e), 3) for T in tried]
    every = _distinct(sorted(known + begun, key=lambda c: c.loss), mesh)
    hopeful = [c for c in every if c in begun and c.loss <= _PROMISING * every[0].loss]
    refined = [_refined(e, mesh, mesh.medium, c.T, _pixel(e), 6) for c in hopeful]
    return _distinct(sorted(known + refined, key=lambda c: c.loss), mesh)


def settle(
    coarse: DepthEvidence, fine: DepthEvidence, mesh: KnownMesh, found: list[Candidate]
) -> list[Candidate]:
    """Refine the candidate poses that `search` found on coarse evidence, and return the distinct ones with
    their losses on the fine evidence, best first.

    Poses beside the best one are tried, too: if no camera sees the handle of a mug, the mug can be turned; if
    the blade of a knife hardly stands out from the table, the knife may lie farther along its length.
    """
    best = found[0]
    about = [SO3.exp(sign * _NUDGE * axis) for axis in mesh.axes.T for sign in (1, -1)]
    moves = [SE3(turn, mesh.middle - turn.matrix @ mesh.middle) for turn in about]
    moves += [SE3.from_xyz(*(sign * _SLIDE * mesh.diameter * mesh.axes[:, 2])) for sign in (1, -1)]
    beside = [T for T in (best.T @ move for move in moves) if not mesh.same(best.T, T)]
    every = _promising(coarse, mesh, beside, found)
    left = [c.T for c in every if c.loss <= _LEFT * every[0].loss]
    refined = [_refined(fine, mesh, mesh.fine, T, _pixel(fine), 6) for T in left]
    return _distinct(sorted(refined, key=lambda c: c.loss), mesh)


def refit(e: DepthEvidence, mesh: KnownMesh, T: SE3) -> SE3:
    """Refine one pose of a mesh on fine evidence."""
    return _refined(e, mesh, mesh.fine, T, _pixel(e), 6).T


def pixel_errors(e: DepthEvidence, mesh: KnownMesh, T: SE3) -> tuple[F64, NDArray[np.bool_]]:
    """Return the signed errors (n + SUNK,) of a pose of a mesh, as `depth_render.loss` writes them, and a
    mask (n + SUNK,) of the pixels that show the cluster or the mesh.
    """
    drawn, errors = np.empty(len(e.depth)), np.empty(len(e.depth) + D.SUNK)
    D.loss(*mesh.fine, T.rotation.matrix, T.translation, e, drawn, errors)
    near = ((drawn < e.floor) | (e.kinds == D.OWN)) & (e.depth > 0)
    return errors, np.append(near, np.zeros(D.SUNK, bool))


def _refined(
    e: DepthEvidence, mesh: KnownMesh, triangles: Triangles, T: SE3, pixel: float, iterations: int
) -> Candidate:
    R, t, loss = D.refine(
        *triangles, mesh.center, mesh.radius, T.rotation.matrix, T.translation, e, pixel, iterations
    )
    u, _, v = np.linalg.svd(R)
    return Candidate(SE3(SO3(u @ v), t), float(loss))


def _distinct(found: list[Candidate], mesh: KnownMesh) -> list[Candidate]:
    kept: list[Candidate] = []
    for one in found:
        if not any(mesh.same(other.T, one.T) for other in kept):
            kept.append(one)
    return kept


def _pixel(e: DepthEvidence) -> float:
    """Return the size [m] of a camera pixel at the object whose mesh pose is estimated. With several cameras,
    return the smallest size.
    """
    own = e.depth[(e.kinds == D.OWN) & (e.depth > 0)]
    return float(np.median(own)) / float(e.cameras[:, 0].max())


def start_poses(e: DepthEvidence, mesh: KnownMesh, partly: bool) -> tuple[F64, F64]:
    """Return start poses Rs (k, 3, 3), ts (k, 3) for the fit of a mesh: each resting side at each yaw.

    In the first image, the center of the mesh's outline coincides with the center of the point cluster. If
    the cluster is only a part of the object, each corner of the outline coincides with that of the cluster.
    """
    R, turned = mesh.rests
    _, h, w = e.sizes[0]
    own = np.nonzero(e.kinds[: h * w].reshape(h, w) == D.OWN)
    low, high = np.array([[i.min(), i.max()] for i in own[::-1]], float).T
    corners = np.zeros((1, 2))
    if partly:
        corners = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]) / 2
        R, turned = np.tile(R, (4, 1, 1)), np.tile(turned, (4, 1, 1))
    corners = np.repeat(corners, len(R) // len(corners), axis=0)
    ts = np.zeros((len(R), 3))
    ts[:, 2] = -turned[:, :, 2].min(axis=1)
    ts[:, :2] = -(turned[:, :, :2].min(axis=1) + turned[:, :, :2].max(axis=1)) / 2
    c = e.cameras[0]
    M, p = c[4:13].reshape(3, 3), c[13:]
    for _ in range(3):
        seen = (turned + ts[:, None]) @ M.T + p
        uv = c[:2] * seen[..., :2] / seen[..., 2:] + c[2:4]
        first, last = uv.min(axis=1), uv.max(axis=1)
        off = (low + high - first - last) / 2 + corners * ((last - first) - (high - low))
        # the outline's middle moves with the object in the plane
        z = seen[..., 2].mean(axis=1)
        at = seen.mean(axis=1)
        # the Jacobian of its pixel, [k, 2, 2]
        J = c[:2, None] * (M[:2, :2] - at[:, :2, None] / z[:, None, None] * M[2, :2]) / z[:, None, None]
        ts[:, :2] += np.linalg.solve(J, off[:, :, None])[:, :, 0]
    return R, ts
