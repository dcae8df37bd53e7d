"""Updated point clouds against clouds that are built at once, and against distances by formula."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.collision.reference import signed_distance
from tests.scene.helpers import floating, panda
from tests.sizes import seeds

from armcell.collision import ExactChecker, remove_robot_points
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.cloud_arrays import Cloud, cloud_of
from armcell.core import SE3, SO3, Box, InputError, PointCloud
from armcell.scene import CollisionObject, ReplacePoints, SceneDiff

CUBE = Box(0.2, 0.2, 0.2)  # what slides in `floating`
RADIUS = 0.01
EDGE = 0.25  # [m] of tiles


def obstacle(cloud: PointCloud, T: SE3 | None = None) -> CollisionObject:
    return CollisionObject.single("cloud", cloud, T)


def some_points(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on two walls and in the air, some of them twice, and some on the borders of tiles."""
    points = rng.uniform(-1, 1, (count, 3)) * [2.0, 0.4, 0.4]
    points[: count // 3, 1] = 0.3
    points[count // 3 : count // 2, 2] = -0.25
    on_borders = rng.random(count) < 0.1
    points[on_borders] = np.round(points[on_borders] / EDGE) * EDGE
    again = rng.integers(0, max(count, 1), count // 10)
    points[: len(again)] = points[again]
    return points


def content(cloud: Cloud) -> np.ndarray:
    """The centers that a walk down the tree finds in its boxes, sorted, without repetitions."""
    found, stack = [np.zeros((0, 3))], [(0, np.full(3, -np.inf), np.full(3, np.inf))]
    while stack:
        block, low, high = stack.pop()
        for k in np.flatnonzero(cloud.boxes[block, 0] <= cloud.boxes[block, 3]):
            a, b = cloud.boxes[block, :3, k], cloud.boxes[block, 3:, k]
            assert np.all(a >= low) and np.all(b <= high)
            child = int(cloud.child[block, k])
            if child < 0:
                stack.append((-child, a, b))
                continue
            x, y, z, r = cloud.parts[child].astype(float)
            centers = np.column_stack([x, y, z])
            assert np.all(centers - r[:, None] >= a) and np.all(centers + r[:, None] <= b)
            assert np.all(r >= RADIUS - 1e-9) and np.all(r < RADIUS + 1e-5)
            found.append(centers + cloud.T_shape_box[:3, 3])
    every = np.vstack(found)
    half = np.array([cloud.box.x, cloud.box.y, cloud.box.z]) / 2
    assert np.all(np.abs(every - cloud.T_shape_box[:3, 3]) + RADIUS <= half + 1e-5)
    return every


def assert_same_content(cloud: PointCloud) -> None:
    """The kernel has each point, and no others."""
    found = cloud_of(cloud)
    assert found is not None
    centers = content(found)
    if len(cloud.points) == 0:
        assert len(centers) == 0 and found.empty
        return
    assert cKDTree(centers).query(cloud.points)[0].max() < 1e-6
    assert cKDTree(cloud.points).query(centers)[0].max() < 1e-6


def an_update(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """What a camera may do: points to clear and points to add."""
    n = len(points)
    low = np.floor(rng.uniform([-2, -0.4, -0.4], [1.8, 0.3, 0.3]) / EDGE) * EDGE
    tile = np.all((points >= low) & (points < low + EDGE), axis=1)
    kind = rng.integers(0, 7)
    inside = rng.uniform(low, low + EDGE, (rng.integers(1, 60), 3))
    match kind:
        case 0:  # a tile is replaced
            return tile, inside
        case 1:  # a tile is free now
            return tile, np.zeros((0, 3))
        case 2:  # single points, anywhere
            return rng.random(n) < 0.02, some_points(int(rng.integers(0, 30)), rng)
        case 3:  # nothing
            return np.zeros(n, bool), np.zeros((0, 3))
        case 4:  # points that are there already
            return np.zeros(n, bool), points[rng.integers(0, n, 20)] if n else inside
        case 5:  # slightly beyond the border, where the map grows
            return np.zeros(n, bool), np.array([[2.0 + rng.uniform(0, 0.3), 0.0, 0.0]])
    return rng.random(n) < 0.4, inside  # most blocks change


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(4, range(40)))
def test_random_updates(seed):
    """Like a cloud built at once: the same parts, checks and distances."""
    rng = np.random.default_rng(seed)
    points = some_points(int(rng.choice([0, 1, 16, 17, 300, 3000])), rng)
    cloud = PointCloud(points.copy(), RADIUS)
    assert_same_content(cloud)
    for _ in range(12):
        clear, more = an_update(points, rng)
        cloud = cloud.updated(more, clear)
        points = np.vstack([points[~clear], more])
        assert np.array_equal(cloud.points, points)
        assert_same_content(cloud)
    scene = floating(obstacle(cloud))
    kernel, exact = KernelChecker(scene), ExactChecker(scene)
    rebuilt = KernelChecker(floating(obstacle(PointCloud(points.copy(), RADIUS))))
    for x in np.linspace(-2, 2, 41):
        distance = min(signed_distance(CUBE, points - [x, 0, 0]), default=np.inf) - RADIUS
        if abs(distance) > 1e-5:
            assert kernel.is_free([x]) == rebuilt.is_free([x]) == exact.is_free([x]) == (distance > 0)


def test_all_points_are_removed_and_come_back():
    rng = np.random.default_rng(0)
    points = some_points(500, rng)
    cloud = PointCloud(points.copy(), RADIUS)
    empty = cloud.updated(clear=np.ones(500, bool))
    assert len(empty.points) == 0 and KernelChecker(floating(obstacle(empty))).is_free([0.0])
    assert_same_content(empty)
    assert_same_content(empty.updated())
    assert_same_content(empty.updated(points))
    tile = cloud.inside(np.full(3, -np.inf), np.full(3, np.inf))
    assert tile.all() and len(cloud.updated(clear=tile).points) == 0


@pytest.mark.slow
def test_adjacent_tiles_contain_each_point_once():
    rng = np.random.default_rng(1)
    cloud = PointCloud(some_points(2000, rng), RADIUS)
    T = SE3(SO3.from_rpy((0.3, -0.5, 1.0)), np.array([0.1, 0.05, -0.02]))
    for pose in (SE3.identity(), SE3.from_xyz(0.5, 0.25, -0.25), T):
        corners = np.stack(np.meshgrid(*[np.arange(-12, 12) * EDGE] * 3), -1).reshape(-1, 3)
        rows = pose.apply(cloud.points)
        corners = corners[np.all((corners <= rows.max(0)) & (corners + EDGE > rows.min(0)), axis=1)]
        count = np.zeros(len(cloud.points), int)
        for low in corners:
            mask = cloud.inside(low, low + EDGE, pose)
            count += mask
            decided = np.abs(rows - low).min(axis=1) > 1e-9
            decided &= np.abs(rows - low - EDGE).min(axis=1) > 1e-9
            expected = np.all((rows >= low) & (rows < low + EDGE), axis=1)
            assert np.array_equal(mask[decided], expected[decided])
        assert np.all(count == 1)


def test_updates_that_are_not_possible():
    cloud = PointCloud(np.zeros((3, 3)), RADIUS)
    for clear in ([0, 1, 0], np.zeros(4, bool), np.zeros((3, 3), bool)):
        with pytest.raises(InputError, match=r"boolean array of shape \(3,\)"):
            cloud.updated(clear=clear)
    with pytest.raises(InputError, match="NaN"):
        cloud.updated([[0, 0, np.nan]])
    for low, high in (([0, 0, 1], [1, 1, 0]), ([np.nan, 0, 0], [1, 1, 1])):
        with pytest.raises(InputError, match="low, then high"):
            cloud.inside(low, high)


def test_an_update_leaves_its_input_as_it_was():
    more = np.ones((2, 3))
    cloud = PointCloud(np.zeros((90, 3)), RADIUS)
    changed = cloud.updated(more, np.arange(90) < 1)
    more[:] = 5.0  # still writable
    assert len(cloud.points) == 90 and changed.points[-1].tolist() == [1, 1, 1]
    for other in (copy.copy(changed), pickle.loads(pickle.dumps(changed))):
        assert other.update is None and np.array_equal(other.points, changed.points)


@pytest.mark.slow
def test_many_updates_keep_one_earlier_cloud():
    """A chain of updates does not keep all clouds in memory, nor does the conversion become slower."""
    rng = np.random.default_rng(2)
    cloud = PointCloud(some_points(4000, rng), RADIUS)
    bases, incremental = set(), 0
    for k in range(60):
        low = np.array([-2 + 0.06 * k, -0.4, -0.4])
        clear = cloud.inside(low, low + 0.2)
        cloud = cloud.updated(rng.uniform(low, low + 0.2, (40, 3)), clear)
        if cloud.update is not None:
            assert cloud.update.base.update is None
            bases.add(id(cloud.update.base))
            incremental += cloud_of(cloud).order is None
        assert_same_content(cloud)
    assert len(bases) < 10 and incremental > 50


def test_replaced_points_of_a_scene():
    """In a frame of the robot, with the robot filtered out; the scene before is unchanged."""
    rng = np.random.default_rng(3)
    T = SE3.from_xyz_rpy((0.3, 0.1, 0.6), (0.2, 0.1, -0.4))
    before = panda(obstacle(PointCloud(some_points(3000, rng), RADIUS), T))
    hand = before.frame_pose("panda_hand")
    seen = remove_robot_points(before, hand.apply(rng.uniform(-0.2, 0.2, (400, 3))))
    low, high = [-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]
    change = ReplacePoints("cloud", hand.inverse().apply(seen), low, high, "panda_hand")
    after = before.apply(SceneDiff.of(change))
    old = T.apply(before.objects["cloud"].shapes[0][0].points)
    local = hand.inverse().apply(old)
    left = old[~np.all((local >= low) & (local < high), axis=1)]
    cloud = after.objects["cloud"].shapes[0][0]
    assert isinstance(cloud, PointCloud) and cloud.update is not None
    np.testing.assert_allclose(T.apply(cloud.points), np.vstack([left, seen]), atol=1e-12)
    assert len(before.objects["cloud"].shapes[0][0].points) == 3000
    kernel, rebuilt = (
        KernelChecker(scene) for scene in (after, panda(obstacle(PointCloud(cloud.points.copy(), RADIUS), T)))
    )
    for _ in range(300):
        q = before.positions + rng.normal(0, 0.5, len(before.positions))
        assert kernel.is_free(q) == rebuilt.is_free(q)


def test_replaced_points_need_a_cloud():
    scene = panda(obstacle(PointCloud(np.zeros((1, 3)), RADIUS)), CollisionObject.single("box", CUBE))
    box = [-1.0, -1, -1], [1.0, 1, 1]
    with pytest.raises(InputError, match="0 point clouds"):
        ReplacePoints("box", (), *box).applied_to(scene)
    with pytest.raises(InputError, match="did you mean 'cloud'"):
        ReplacePoints("clod", (), *box).applied_to(scene)
    cleared = ReplacePoints("cloud", (), *box).applied_to(scene)
    assert len(cleared.objects["cloud"].shapes[0][0].points) == 0
