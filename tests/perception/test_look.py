"""Objects found in depth images, against the simulator's true poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from tests.perception.scenes import TABLE, RandomScene, random_scene
from tests.sizes import sizes

from armcell.core import SE3, SO3, Box, CameraImage, ErrorCode, InputError, Mesh, Pinhole
from armcell.model import load_robot
from armcell.perception import DetectedObject, LookSettings, look, pose_error
from armcell.perception.cloud import clusters
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, DepthNoise, SimWorld, look_at, take_image

STEREO = DepthNoise.for_stereo()


def box_sizes(item: DetectedObject | CollisionObject) -> np.ndarray:
    shape = item.shapes[0][0]
    assert isinstance(shape, Box)
    return np.array([shape.x, shape.y, shape.z])


def same_size_error(seen: DetectedObject, true: CollisionObject, T: SE3) -> tuple[float, float, float]:
    """Position [m] and rotation [rad] of a primitive and its worst size [m], however its axes are called."""
    if isinstance(true.shapes[0][0], Box):
        Ts = seen.T_world_object
        M = Ts.rotation.matrix.T @ T.rotation.matrix
        order = np.argmax(np.abs(M), axis=0)
        size = np.abs(box_sizes(seen)[order] - box_sizes(true)).max()
        signed = np.zeros((3, 3))
        signed[order, range(3)] = np.sign(M[order, range(3)])
        turn = SO3(signed.T @ M).log()
        return float(np.linalg.norm(Ts.translation - T.translation)), float(np.linalg.norm(turn)), float(size)
    a, b = (item.shapes[0][0].half_extents for item in (seen, true))
    return *pose_error(true.shapes, seen.T_world_object, T), 2 * float(np.abs(a - b).max())


def errors(scenes: list[RandomScene], known: bool) -> tuple[np.ndarray, int]:
    """Rows (position [mm], rotation [deg], size [mm]) of what was found, and how many were not."""
    rows, lost = [], 0
    for s in scenes:
        sight = look(s.image, s.world.built.scene, tuple(s.objects.values()) if known else ())
        for name, item in s.objects.items():
            T = s.truth(name)
            near = [
                o for o in sight.objects if o.T_world_object is not None and (o.name == name if known else
                np.linalg.norm(o.T_world_object.translation - T.translation) < 0.03
                and type(o.shapes[0][0]) is type(item.shapes[0][0]))
            ]  # fmt: skip
            if near:
                p, a, size = same_size_error(near[0], item, T)
                rows.append((p * 1000, np.rad2deg(a), size * 1000))
            else:
                lost += 1
    return np.array(rows), lost


@pytest.mark.slow
def test_one_picture_without_noise():
    rows, lost = errors([random_scene(4)], known=False)
    assert lost == 0 and rows[:, 0].max() < 1.0 and rows[:, 1].max() < 1.0 and rows[:, 2].max() < 2.0


@pytest.mark.long
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("count", sizes(3, 10))
def test_the_median_of_many_noisy_pictures(known, count):
    """The bar is 3 mm and 2 degrees; what is measured is a tenth of that."""
    rows, lost = errors([random_scene(s, 4, STEREO) for s in range(count)], known)
    assert lost == 0
    assert np.median(rows[:, 0]) < 0.6 and np.median(rows[:, 1]) < 0.3 and np.median(rows[:, 2]) < 1.5
    assert np.percentile(rows[:, 0], 95) < 3.0 and np.percentile(rows[:, 1], 95) < 2.0


@pytest.mark.long
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("count", sizes(5, 8))
def test_where_things_hide_each_other(known, count):
    """Nine things close together: from the side some are half hidden."""
    scenes = [random_scene(1000 + s, 9, STEREO, apart=-0.025) for s in range(count)]
    rows, lost = errors(scenes, known)
    assert lost <= 0.05 * 9 * count
    assert np.median(rows[:, 0]) < 1.0 and np.median(rows[:, 1]) < 0.5
    assert np.mean((rows[:, 0] < 3.0) & (rows[:, 1] < 2.0)) > 0.95


def bracket(length: float = 0.08) -> Mesh:
    """An L of two plates, one mesh."""
    foot = trimesh.creation.box((length, 0.04, 0.01), SE3.from_xyz(0, 0, 0.005).matrix)
    wall = trimesh.creation.box((0.01, 0.04, 0.06), SE3.from_xyz(-length / 2 + 0.005, 0, 0.03).matrix)
    both = trimesh.util.concatenate([foot, wall])
    return Mesh(both.vertices, both.faces.astype(np.int32))


def seen_bracket(turn: SO3, at: tuple[float, float, float], eye=(0.25, -0.3, 0.55)):
    item = CollisionObject.single("bracket", bracket(), SE3(turn, np.array(at)), movable=True)
    scene = PlanningScene.of(load_robot("parallel_gripper"), objects=[TABLE, item])
    world = SimWorld(scene)
    camera = Camera("eye", look_at(eye, [0.6, 0, 0.03]), 320, 240, noise=STEREO)
    return item, scene, take_image(world, camera)


@pytest.mark.long
@pytest.mark.parametrize(
    "turn, z", [((0, 0, 0.7), 0.0), ((np.pi / 2, 0, -1.0), 0.02), ((0, -np.pi / 2, 2.5), 0.04)]
)
def test_a_known_mesh_on_each_side(turn, z):
    """Standing (where it hides its own middle), on its side, on its end: 320 x 240 pixels and noise."""
    item, scene, image = seen_bracket(SO3.from_rpy(turn), (0.6, 0.02, z))
    sight = look(image, scene, (item.at(SE3.identity()),))
    assert sight.ok, sight.message
    position, angle = sight["bracket"].T_world_object.distance_to(item.T_world_object)
    assert position < 0.003 and np.rad2deg(angle) < 2.0, (position, np.rad2deg(angle))


@pytest.mark.slow
def test_what_no_primitive_explains_says_so():
    item, scene, image = seen_bracket(SO3.identity(), (0.6, 0.02, 0.0), (0.95, -0.3, 0.55))
    sight = look(image, scene)
    assert sight.code is ErrorCode.FAILURE and "thing_1 without a pose" in sight.message
    thing = sight["thing_1"]
    assert thing.T_world_object is None and "no box, cylinder or ball" in thing.message
    assert thing.evidence["costs"] and thing.as_object().has_cloud
    assert np.abs(thing.points - item.T_world_object.translation).max() < 0.08


@pytest.mark.slow
def test_a_known_object_that_is_not_there():
    s = random_scene(4)
    absent = CollisionObject.single("plate", Box(0.2, 0.2, 0.01), movable=True)
    sight = look(s.image, s.world.built.scene, (*s.objects.values(), absent))
    assert sight.code is ErrorCode.FAILURE and sight.missing == ("plate",)
    assert "plate not found" in sight.message and "hidden" in sight.message
    assert sum(o.known for o in sight.objects) == 4


# --- what cannot be used ---
@pytest.mark.slow
def test_a_camera_without_depth_is_said():
    s = random_scene(4)
    sight = look(replace(s.image, depth=None), s.world.built.scene, tuple(s.objects.values()))
    assert sight.code is ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA
    assert "no depth" in sight.message and "depth: true" in sight.message and len(sight.missing) == 4


@pytest.mark.slow
@pytest.mark.cases("nan", "-1.0")
@pytest.mark.parametrize("value", [np.nan, 0.0, -1.0, np.inf])
def test_depth_of_nothing_is_said(value):
    s = random_scene(4)
    sight = look(replace(s.image, depth=np.full_like(s.image.depth, value)), s.world.built.scene)
    assert sight.code is ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA and "no pixel has a depth" in sight.message


@pytest.mark.slow
def test_a_frozen_camera_is_said():
    s = random_scene(4)
    assert look(s.image, s.world.built.scene, now=0.3).ok
    sight = look(s.image, s.world.built.scene, now=2.0)
    assert sight.code is ErrorCode.SENSOR_INFO_STALE
    assert "2.00 s old" in sight.message and "frozen" in sight.message


def test_no_plane_is_said():
    """A wall straight ahead."""
    pinhole = Pinhole.of_fov(64, 48, 45)
    wall = CameraImage("c", pinhole, look_at([0, 0, 1], [1, 0, 1]), 0.0, None, np.ones((48, 64), np.float32))
    sight = look(wall)
    assert sight.code is ErrorCode.FAILURE and "no level plane" in sight.message
    named = look(wall, PlanningScene.of(load_robot("panda"), objects=[TABLE]), settings=_on("table"))
    assert named.code is ErrorCode.FAILURE and "'table' is not seen" in named.message


def _on(surface: str) -> LookSettings:
    return LookSettings(surface=surface)


@pytest.mark.slow
def test_wrong_settings_and_sizes():
    s = random_scene(4)
    with pytest.raises(InputError, match="no scene"):
        look(s.image, settings=_on("table"))
    with pytest.raises(InputError, match="smallest"):
        LookSettings(smallest=3)
    with pytest.raises(InputError, match="shape"):
        replace(s.image, depth=np.ones((3, 4), np.float32))


@pytest.mark.slow
def test_the_robot_and_fixed_things_are_not_objects():
    """A Panda over the table with a wall on it: only the cube is found, on the surface that is named."""
    robot = load_robot("panda")
    wall = CollisionObject.single("wall", Box(0.02, 0.3, 0.2), SE3.from_xyz(0.75, 0.1, 0.1))
    cube = CollisionObject.single("cube", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.55, 0.2, 0.025), movable=True)
    floor = CollisionObject.single("floor", Box(4, 4, 0.02), SE3.from_xyz(0, 0, -0.6))
    scene = PlanningScene.of(robot, objects=[TABLE, wall, cube, floor]).with_state(
        robot.named_state("arm", "home")
    )
    camera = Camera("eye", look_at([1.3, -0.3, 0.9], [0.5, 0.1, 0.1]), 320, 240, 60.0, noise=STEREO)
    sight = look(take_image(SimWorld(scene), camera), scene, (cube,), _on("table"))
    assert sight.ok, sight.message
    assert [o.name for o in sight.objects] == ["cube"]
    assert pose_error(cube.shapes, sight["cube"].T_world_object, cube.T_world_object)[0] < 0.002
    assert abs(sight.plane.normal[2]) > 0.9999 and sight.plane.offset == pytest.approx(0.0, abs=5e-4)


def test_small_parts_of_a_thin_wall_are_one_cluster():
    """A wall one pixel wide falls into parts; parts that are farther away or tiny are noise."""
    v, u = np.mgrid[:30, :200] * 0.002
    points = np.dstack([u, v, np.zeros_like(u)])
    wanted = np.zeros((30, 200), bool)
    for start in (0, 23, 46, 150):  # 20 px each; three of them 8 mm apart
        wanted[5, start : start + 20] = True
    wanted[[15, 20, 25], [10, 12, 14]] = True
    (found,) = clusters(points, wanted, gap=0.015, smallest=40)
    assert len(found) == 60 and found.max() % 200 == 65
    assert not clusters(points, wanted, gap=0.005, smallest=40)
