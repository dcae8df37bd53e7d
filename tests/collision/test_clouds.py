"""Point clouds, octrees and meshes with cavities, against references that share nothing with the kernel:
signed distance formulas, a k-d tree, and coal on the robot's bare meshes."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from tests.collision.reference import contains, pin_geometry, signed_distance, triangles
from tests.collision.test_exact import ell
from tests.model.helpers import PinRobot, random_positions
from tests.scene.helpers import box, floating, mesh_of, open_bin, panda, ur10

from armcell.collision import ExactChecker
from armcell.collision.exact_checker import neighbors
from armcell.collision.kernel.box_tree import box_tree
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.cloud_arrays import cloud_of
from armcell.core import SE3, SO3, Box, InputError, Mesh, Octree, PointCloud, finite_points
from armcell.kinematics import kinematic_tree
from armcell.scene import CollisionObject, PlanningScene

CUBE = Box(0.2, 0.2, 0.2)  # what slides in `floating`
TOLERANCE = 2e-4  # [m] from touching, within which two checkers may differ
PIECES = 0.015  # [m] by which the convex pieces of the UR10's links may reach beyond these
TILTED = SE3(SO3.from_rpy((0.3, -0.5, 1.0)), np.array([0.1, 0.05, -0.02]))


def scatter(n: int, rng: np.random.Generator, spread=(3.0, 0.5, 0.5)) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, (n, 3)) * spread


def obstacle(shape, T=None) -> CollisionObject:
    return CollisionObject.single("cloud", shape, T or SE3.identity())


def cube_distance(shape: PointCloud | Octree, T: SE3) -> Callable[[float], float]:
    """Distance of the sliding cube at x to a cloud, by formula; of cells, densely on their surfaces."""
    if isinstance(shape, PointCloud):
        points, radius = T.apply(shape.points), shape.radius
    else:
        step = np.linspace(-0.5, 0.5, 21)
        grid = np.stack(np.meshgrid(step, step, step), -1).reshape(-1, 3)
        grid = grid[np.abs(grid).max(axis=1) == 0.5]
        points = T.apply((shape.centers[:, None] + grid[None] * shape.sizes[:, None, None]).reshape(-1, 3))
        radius = 0.0
    return lambda x: float(signed_distance(CUBE, points - [x, 0, 0]).min()) - radius


# --- shapes ---
def test_points_that_are_not_finite():
    points = np.array([[0.0, 0, 0], [np.nan, 0, 0], [1, np.inf, 0]])
    with pytest.raises(InputError, match=r"2 of 3 points.*finite_points"):
        PointCloud(points, 0.01)
    with pytest.raises(InputError, match=r"2 of 3 centers"):
        Octree(points, np.ones(3))
    kept, dropped = finite_points(points)
    assert dropped == 2 and np.array_equal(PointCloud(kept, 0.01).points, [[0, 0, 0]])


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan])
def test_sizes_must_be_positive(radius):
    with pytest.raises(InputError, match="positive"):
        PointCloud(np.zeros((1, 3)), radius)
    with pytest.raises(InputError, match="positive"):
        Octree(np.zeros((1, 3)), [radius])


def test_a_grid_as_an_octree():
    rng = np.random.default_rng(0)
    grid = rng.random((9, 6, 13)) < 0.3
    grid[2:8, 0:5, 3:12] = True
    tree = Octree.from_grid(grid, 0.1, (1.0, 2.0, 3.0))
    assert len(tree.centers) < grid.sum() - 100  # some were put together
    cells = np.argwhere(np.ones_like(grid))
    middles = (cells + 0.5) * 0.1 + [1.0, 2.0, 3.0]
    inside = np.abs(middles[:, None] - tree.centers) < tree.sizes[:, None] / 2 - 1e-9
    held = inside.all(axis=2).sum(axis=1)
    assert np.array_equal(held, grid[tuple(cells.T)].astype(int))  # each occupied one held once, no other
    assert np.isclose(np.sum(tree.sizes**3), grid.sum() * 1e-3)


def test_clouds_stand():
    cloud = PointCloud(np.zeros((1, 3)), 0.01)
    with pytest.raises(InputError, match="cannot move"):
        CollisionObject.single("cloud", cloud, movable=True)
    with pytest.raises(InputError, match="cannot move or be held"):
        panda(obstacle(cloud)).with_attached("cloud", "panda_hand")


def test_bounds():
    rng = np.random.default_rng(0)
    low, high = obstacle(PointCloud(rng.random((100, 3)), 0.1)).bounds()
    assert np.all(low >= -0.1) and np.all(low < 0) and np.all(high <= 1.1) and np.all(high > 1)
    item = obstacle(Octree([[0.0, 0, 0], [1.0, 0, 0]], [0.2, 0.4]))
    assert np.allclose(item.bounds(), ([-0.1, -0.2, -0.2], [1.2, 0.2, 0.2]))
    assert np.isclose(item.extent(np.array([1.0, 0, 0])), 1.3)


# --- both checkers against formulas ---
CLOUDS = {
    "none": PointCloud(np.zeros((0, 3)), 0.01),
    "one": PointCloud([[0.9, 0.05, 0.02]], 0.01),
    "the same 40 times": PointCloud(np.tile([[0.9, 0.15, 0.02]], (40, 1)), 0.07),
    "few": PointCloud(scatter(17, np.random.default_rng(1)), 0.05),
    "many": PointCloud(scatter(3000, np.random.default_rng(2), (3, 1.5, 1.5)) + np.array([0, 1.0, 0]), 0.004),
    "no cells": Octree(np.zeros((0, 3)), np.zeros(0)),
    "one cell": Octree([[0.9, 0.0, 0.0]], [0.1]),
    "cells": Octree(scatter(60, np.random.default_rng(3)), np.random.default_rng(4).choice([0.02, 0.04], 60)),
}


@pytest.mark.slow
@pytest.mark.cases("none-*", "one-*", "few-*", "many-*", "the same *", "no cells-*", "one cell-*")
@pytest.mark.parametrize("pads", [{}, {"padding": 0.02}], ids=str)
@pytest.mark.parametrize("T", [SE3.identity(), TILTED], ids=["upright", "tilted"])
@pytest.mark.parametrize("name", CLOUDS)
def test_a_cube_sliding_past(name, T, pads):
    shape = CLOUDS[name]
    scene = floating(obstacle(shape, T), **pads)
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    margin = pads.get("padding", 0.0)
    empty = len(getattr(shape, "points", ())) == len(getattr(shape, "centers", ())) == 0
    distance_at = (lambda x: np.inf) if empty else cube_distance(shape, T)
    for x in np.linspace(-2, 2, 61):
        distance = distance_at(x)
        near = 0.02 if isinstance(shape, Octree) else 0.0  # the reference looks at points of the cells only
        if -TOLERANCE < distance - margin < near + TOLERANCE:
            continue
        assert kernel.is_free([x]) == exact.is_free([x]) == (distance > margin), (x, distance)
        nearest = exact.nearest([x])
        if np.isfinite(distance) and distance > 0:
            assert nearest is not None and abs(nearest.distance - distance) < near + 1e-6
        if distance < margin:
            assert [c.body_b for c in exact.contacts([x])] == ["cloud"]


def surface_points(n: int, rng: np.random.Generator) -> np.ndarray:
    """On a table, two boxes on it and a wall."""
    every = []
    for size, at in (((1.0, 1.6, 0.06), (0.8, 0, -0.1)), ((0.2, 0.2, 0.4), (0.6, 0.4, 0.2)),
                     ((0.25, 0.3, 0.5), (0.6, -0.4, 0.25)), ((0.05, 2.0, 1.5), (-0.6, 0, 0.6))):  # fmt: skip
        solid = trimesh.creation.box(size)
        solid.apply_translation(at)
        every.append(trimesh.sample.sample_surface(solid, n // 4, seed=int(rng.integers(1000)))[0])
    return np.vstack(every)


class BareMeshes:
    """Distance of a robot's links (pinocchio's reader, coal on bare triangles) to the parts near them."""

    def __init__(self, scene: PlanningScene, name: str, shape: PointCloud | Octree):
        model, self.geometry = pin_geometry(name)
        self.robot, self.tree, self.scene = PinRobot(model, scene.model), kinematic_tree(scene.model), scene
        rigid = next(g for g in scene.model.rigid_groups if scene.model.root_link in g)
        frames = [model.frames[o.parentFrame].name for o in self.geometry.geometryObjects]
        self.moving = [k for k, name in enumerate(frames) if name not in rigid]
        self.points = isinstance(shape, PointCloud)
        self.centers = shape.points if isinstance(shape, PointCloud) else shape.centers
        for item in self.geometry.geometryObjects:
            item.geometry.computeLocalAABB()
        sizes = np.full(len(self.centers), shape.radius) if isinstance(shape, PointCloud) else shape.sizes / 2
        self.sizes, self.near = sizes, cKDTree(self.centers)

    def distance(self, q: np.ndarray, within: float = 0.05) -> float:
        import pinocchio as pin

        self.robot.place(self.tree.full_positions(q))
        data = self.geometry.createData()
        pin.updateGeometryPlacements(self.robot.pin, self.robot.data, self.geometry, data)
        root = self.robot.frame(self.scene.model.root_link).inverse()
        best = np.inf
        for k in self.moving:
            shape, M = self.geometry.geometryObjects[k].geometry, root * data.oMg[k]
            ball = shape.aabb_radius + within + float(self.sizes.max()) * 2
            T = coal.Transform3s(M.rotation, M.translation)
            for i in self.near.query_ball_point(M.rotation @ shape.aabb_center + M.translation, ball):
                size = float(self.sizes[i])
                part = coal.Sphere(size) if self.points else coal.Box(*[2 * size] * 3)
                at = coal.Transform3s(np.eye(3), self.centers[i])
                d = coal.distance(shape, T, part, at, coal.DistanceRequest(), coal.DistanceResult())
                best = min(best, d, -1.0 if contains(shape, T, part, at) else np.inf)
        return best


@pytest.mark.slow
@pytest.mark.cases("ur10_gripper-points", "panda-cells")
@pytest.mark.parametrize("kind", ["points", "cells"])
@pytest.mark.parametrize("robot", ["panda", "ur10_gripper"])
def test_robots_among_parts(robot, kind):
    rng = np.random.default_rng(0)
    points = surface_points(1500, rng)
    shape = (
        PointCloud(points, 0.01)
        if kind == "points"
        else Octree(points, rng.choice([0.01, 0.02], len(points)))
    )
    scene = (panda if robot == "panda" else ur10)(obstacle(shape))
    kernel, exact, bare = KernelChecker(scene), ExactChecker(scene), BareMeshes(scene, robot, shape)
    alone = ExactChecker((panda if robot == "panda" else ur10)())
    excess = 0.0 if robot == "panda" else PIECES
    seen = {True: 0, False: 0}
    while min(seen.values()) < 12:
        q = random_positions(scene.model, rng)
        if not alone.is_free(q):
            continue
        distance = bare.distance(q)
        if abs(distance) < TOLERANCE:
            continue
        seen[distance > 0] += 1
        assert exact.is_free(q) == (distance > 0), distance
        assert kernel.is_free(q) == (distance > 0) or 0 < distance < excess, distance
        if 0 < distance < 0.04:
            nearest = exact.nearest(q)
            assert nearest is not None and nearest.distance <= distance + 1e-6


# --- meshes with cavities ---
def bin_mesh() -> Mesh:
    return mesh_of(open_bin(0.6, 0.5, 0.005))


def sheet() -> Mesh:
    """An open box without thickness: a surface that encloses nothing."""
    solid = trimesh.creation.box((0.6, 0.6, 0.5))
    return mesh_of(
        trimesh.Trimesh(solid.vertices, solid.faces[solid.face_normals[:, 2] < 0.5], process=False)
    )


def turned_inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def fine(mesh: Mesh, times: int) -> Mesh:
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces)
    for _ in range(times):
        surface = surface.subdivide()
    return mesh_of(surface)


MESHES = {
    "bin": bin_mesh,
    "fine bin": lambda: fine(bin_mesh(), 4),
    "sheet": sheet,
    "L": lambda: mesh_of(ell()),
    "L inside out": lambda: turned_inside_out(mesh_of(ell())),
    "torus": lambda: mesh_of(trimesh.creation.torus(0.5, 0.15)),
}


@pytest.mark.slow
@pytest.mark.cases("L-*", "bin-*", "sheet-*", "torus-upright-{}")
@pytest.mark.parametrize("pads", [{}, {"padding": 0.02}], ids=str)
@pytest.mark.parametrize("T", [SE3.from_xyz(0.0, 0.0, -0.25), TILTED], ids=["upright", "tilted"])
@pytest.mark.parametrize("name", MESHES)
def test_a_cube_in_and_around_a_mesh(name, T, pads):
    mesh = MESHES[name]()
    scene = floating(CollisionObject.single("mesh", mesh, T), **pads)
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    surface = triangles(mesh.vertices, mesh.faces)
    there = coal.Transform3s(T.rotation.matrix, T.translation)
    closed = trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
    margin = pads.get("padding", 0.0)
    for x in np.linspace(-1.5, 1.5, 91):
        here = coal.Transform3s(np.eye(3), np.array([x, 0.0, 0.0]))
        pair = (coal.Box(0.2, 0.2, 0.2), here, surface, there)
        distance = coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult())
        if abs(distance - margin) < TOLERANCE:
            continue
        free = distance > margin and not (closed and contains(surface, there, coal.Box(0.2, 0.2, 0.2), here))
        assert exact.is_free([x]) == free and kernel.is_free([x]) == free, (x, distance)


def test_wholly_inside_a_closed_mesh():
    """The surface is 0.2 m away on all sides: only asking what is inside tells."""
    thick = trimesh.creation.box((1.0, 1.0, 1.0))
    hole = trimesh.creation.box((0.1, 0.1, 0.1))
    hole.apply_translation((0.4, 0.4, 0.4))
    hole.invert()
    mesh = mesh_of(trimesh.util.concatenate([thick, hole]))  # not convex: a bubble in its corner
    scene = floating(CollisionObject.single("mesh", mesh))
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    for x, free in ((0.0, False), (0.2, False), (0.55, False), (0.7, True), (-1.5, True)):
        assert kernel.is_free([x]) == exact.is_free([x]) == free
    assert not KernelChecker(scene).certify([[-0.05], [0.05]]).free


def test_a_robot_reaches_into_a_bin():
    """The kernel and the exact checker agree wherever these are decided, and there is room in the bin."""
    bin_ = CollisionObject.single("bin", mesh_of(open_bin(0.5, 0.35, 0.006)), SE3.from_xyz(0.5, 0.0, 0.1))
    scene, rng, inside = panda(bin_), np.random.default_rng(3), 0
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    alone = ExactChecker(panda())
    tree = kinematic_tree(scene.model)
    while inside < 15:
        q = random_positions(scene.model, rng)
        tip = tree.link_pose(q, "panda_hand").translation
        if np.any(np.abs(tip - [0.5, 0, 0.3]) > [0.2, 0.2, 0.15]) or not alone.is_free(q):
            continue
        nearest = exact.nearest(q)
        if nearest is not None and abs(nearest.distance) < TOLERANCE:
            continue
        inside += 1
        assert kernel.is_free(q) == exact.is_free(q)


@pytest.mark.slow
@pytest.mark.cases("mesh", "points")
# --- proofs ---
@pytest.mark.parametrize("kind", ["points", "cells", "mesh"])
def test_what_is_proven_is_free(kind):
    """Proven motions, sampled densely with the bare meshes or by the exact checker."""
    rng = np.random.default_rng(5)
    points = surface_points(4000, rng)
    shape = {
        "points": lambda: PointCloud(points, 0.005),
        "cells": lambda: Octree(points, rng.choice([0.01, 0.02], len(points))),
        "mesh": lambda: mesh_of(open_bin(0.8, 0.4, 0.01)),
    }[kind]()
    scene = panda(obstacle(shape, SE3.from_xyz(0.6, 0.0, -0.05) if kind == "mesh" else None))
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    proven = refused = 0
    while proven < 12 or refused < 5:
        a, b = random_positions(scene.model, rng), random_positions(scene.model, rng)
        b = a + (b - a) * 0.3
        if not (kernel.is_free(a) and kernel.is_free(b)):
            continue
        if kernel.certify([a, b]).free:
            proven += 1
            assert proven > 12 or all(exact.is_free(a + t * (b - a)) for t in np.linspace(0, 1, 80))
        else:
            refused += 1


def test_a_proof_up_to_the_last_millimeter():
    wall = scatter(500, np.random.default_rng(0), (0.0, 1.0, 1.0))
    for shape in (PointCloud(wall, 0.01), Octree(wall, np.full(500, 0.02))):
        kernel = KernelChecker(floating(obstacle(shape, SE3.from_xyz(1.0, 0, 0))))
        assert kernel.certify([[0.0], [0.889]]).free  # 1 mm left
        assert not kernel.certify([[0.0], [0.891]]).free


# --- size ---
@pytest.mark.slow
def test_two_hundred_thousand_points():
    rng = np.random.default_rng(0)
    cloud = PointCloud(surface_points(200_000, rng), 0.003)
    found = cloud_of(cloud)
    assert found is not None
    assert found.parts.nbytes + found.boxes.nbytes + found.child.nbytes < 20 * len(cloud.points)
    near, scene = cKDTree(cloud.points), floating(obstacle(cloud))
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    for x in np.linspace(-2, 2, 201):
        hits = near.query_ball_point([x, 0, 0], 0.2)
        distance = min(signed_distance(CUBE, cloud.points[hits] - [x, 0, 0]), default=np.inf) - cloud.radius
        if abs(distance) > 1e-5:
            assert kernel.is_free([x]) == exact.is_free([x]) == (distance > 0)


def test_a_tree_holds_what_is_in_it():
    rng = np.random.default_rng(0)
    for n in (0, 1, 16, 17, 300, 5000):
        low = rng.uniform(-1, 1, (n, 3))
        high = low + rng.uniform(0, 0.1, (n, 3))
        boxes, child = box_tree(low, high)
        found: list[int] = []
        stack = [(0, np.full(3, -np.inf), np.full(3, np.inf))]
        while stack:
            block, lo, hi = stack.pop()
            for k in range(16):
                a, b = boxes[block, :3, k], boxes[block, 3:, k]
                if np.any(a > b):
                    continue
                assert np.all(a >= lo) and np.all(b <= hi)
                if child[block, k] < 0:
                    stack.append((-child[block, k], a, b))
                else:
                    o = child[block, k]
                    assert np.all(a <= low[o]) and np.all(b >= high[o])
                    found.append(int(o))
        assert sorted(found) == list(range(n))


def test_what_stands_on_a_cloud():
    floor = PointCloud(scatter(2000, np.random.default_rng(0), (1.0, 1.0, 0.0)), 0.01)
    scene = panda(obstacle(floor), box("part", (0.1, 0.1, 0.1), (0.2, 0.2, 0.0605)))
    assert neighbors(scene, "part") == ["cloud"]
    assert neighbors(scene, "cloud") == ["part"]
