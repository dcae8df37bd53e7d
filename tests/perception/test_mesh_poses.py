"""Poses of known meshes: resolved by the whole image, symmetric, or ambiguous with the alternatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from tests.perception.scenes import TABLE
from tests.perception.test_look import bracket

from armcell.core import SE3, SO3, Box, CameraImage, ErrorCode, Mesh
from armcell.model import load_robot
from armcell.perception import depth_render as D
from armcell.perception import look, pose_error
from armcell.perception.mesh_pose import known_mesh, start_poses
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, DepthNoise, SimWorld, look_at, take_image

STEREO = DepthNoise.for_stereo()
ABOVE, FRONT, BACK = (0.6, 0.01, 0.6), (0.25, 0.0, 0.4), (0.95, 0.0, 0.4)


def as_mesh(solid: Any) -> Mesh:
    return Mesh(solid.vertices, solid.faces.astype(np.int32))


def notched() -> Mesh:
    """A block that is the same from both ends, but for a notch in one of them, under an overhang."""
    parts = [
        trimesh.creation.box((0.09, 0.05, 0.02), SE3.from_xyz(0, 0, 0.04).matrix),
        trimesh.creation.box((0.055, 0.05, 0.03), SE3.from_xyz(-0.0175, 0, 0.015).matrix),
    ]
    return as_mesh(trimesh.util.concatenate(parts))


def inside_out() -> Any:
    box = trimesh.creation.box((0.02, 0.02, 0.02), SE3.from_xyz(0.2, 0, 0).matrix)
    box.invert()
    return box


def knob() -> Mesh:
    """A plate on a post, above a long bar: from above, the plate hides the middle of the bar."""
    boxes = (((0.06, 0.06, 0.012), 0.066), ((0.02, 0.02, 0.05), 0.035), ((0.13, 0.025, 0.014), 0.007))
    parts = [trimesh.creation.box(size, SE3.from_xyz(0, 0, z).matrix) for size, z in boxes]
    return as_mesh(trimesh.util.concatenate(parts))


def seen(
    mesh: Mesh, T: SE3, *eyes: tuple[float, float, float], noise: DepthNoise = STEREO,
    beside: tuple[CollisionObject, ...] = (),
):  # fmt: skip
    item = CollisionObject.single("thing", mesh, T, movable=True)
    scene = PlanningScene.of(load_robot("parallel_gripper"), objects=[TABLE, item, *beside])
    world = SimWorld(scene)
    images = [
        take_image(world, Camera(f"eye{k}", look_at(eye, [0.6, 0, 0.03]), 320, 240, noise=noise))
        for k, eye in enumerate(eyes)
    ]
    return item, scene, images


def whole_image(mesh: Mesh, T: SE3) -> D.DepthEvidence:
    _, _, (image,) = seen(mesh, T, FRONT, noise=DepthNoise())
    assert image.depth is not None
    kinds = np.full(image.depth.shape, D.OWN, np.uint8)
    return D.cut_out(image.depth, kinds, image.pinhole, image.T_world_camera.inverse(), 0.003, 0, 10**6)


def found(mesh: Mesh, T: SE3, *eyes: tuple[float, float, float]):
    """The object, the look, and the object's pose."""
    item, scene, images = seen(mesh, T, *eyes)
    sight = look(images, scene, (item.at(SE3.identity()),))
    pose = sight["thing"].T_world_object
    assert pose is not None
    return item, sight, pose


@pytest.mark.slow
def test_a_drawn_mesh_is_what_the_camera_sees():
    """The renderer of the simulation is the reference, at every pixel but those on edges."""
    T = SE3(SO3.exp([0.2, -0.4, 0.7]), np.array([0.6, 0.0, 0.1]))
    e = whole_image(bracket(), T)
    drawn = np.empty(len(e.depth))
    D.draw(*known_mesh(((bracket(), SE3.identity()),)).fine, T.rotation.matrix, T.translation, e, drawn)
    # the support plane of the evidence is z = 0, as the top of the table
    off = np.abs(np.minimum(drawn, e.floor) - e.depth)[e.depth > 0]
    assert np.mean(off < 1e-4) > 0.99 and (np.isfinite(drawn)).sum() > 500


def test_of_a_closed_mesh_only_the_front_is_drawn():
    """The picture is that of all triangles. A body with inward normals makes its mesh open."""
    T = SE3.from_xyz(0.6, 0, 0)
    ring = as_mesh(trimesh.creation.annulus(0.03, 0.04, 0.06))
    e = whole_image(ring, T)
    vertices, faces, closed = known_mesh(((ring, SE3.identity()),)).fine
    front, every = np.empty(len(e.depth)), np.empty(len(e.depth))
    for drawn, culled in ((front, True), (every, False)):
        D.draw(vertices, faces, culled, T.rotation.matrix, T.translation, e, drawn)
    assert closed and np.isfinite(front).sum() > 500
    assert np.mean((front == every)[np.isfinite(every)]) > 0.99  # a pixel exactly on an edge may differ
    inward = as_mesh(trimesh.util.concatenate([trimesh.creation.box((0.1, 0.1, 0.1)), inside_out()]))
    assert not known_mesh(((inward, SE3.identity()),)).fine[2]


@pytest.mark.slow
def test_no_pose_reaches_below_the_support():
    """The hidden flat of a ball is on the table: tilted, the ball would reach into the table."""
    ball = trimesh.creation.icosphere(4, 0.04)
    ball.vertices[:, 2] = np.maximum(ball.vertices[:, 2], -0.0325)
    item, sight, pose = found(as_mesh(ball), SE3.from_xyz(0.6, 0, 0.0325), ABOVE)
    assert sight.ok, sight.message
    assert np.arccos(pose.rotation.matrix[2, 2]) < np.deg2rad(3)
    assert pose.distance_to(item.T_world_object)[0] < 0.001


@pytest.mark.slow
@pytest.mark.parametrize("yaw", [0.4])
@pytest.mark.parametrize("eyes", [(ABOVE,), (FRONT, BACK)], ids=["above", "two"])
def test_a_mesh_seen_from_above_is_not_upside_down(eyes, yaw):
    for up in ([0, 0, 0], [np.pi / 2, 0, 0]):
        R = SO3.exp([0, 0, yaw]) @ SO3.exp(up)
        low = (bracket().vertices @ R.matrix.T)[:, 2].min()
        item, sight, pose = found(bracket(), SE3(R, np.array([0.6, 0, -low])), *eyes)
        thing = sight["thing"]
        assert thing.ok and not thing.symmetric, thing.message
        position, angle = pose.distance_to(item.T_world_object)
        assert position < 0.002 and np.rad2deg(angle) < 2.0


@pytest.mark.slow
def test_what_the_camera_cannot_tell_is_ambiguous_until_a_second_camera_sees_it():
    T = SE3.from_xyz(0.6, 0, 0)
    item, sight, pose = found(notched(), T, ABOVE)
    thing = sight["thing"]
    assert sight.code is ErrorCode.FAILURE and not thing.ok and sight.doubtful == ("thing",)
    assert "ambiguous" in thing.message and "second camera" in sight.message
    poses = (pose, *thing.alternatives)
    assert min(pose_error(item.shapes, one, item.T_world_object)[1] for one in poses) < np.deg2rad(3)
    item, sight, pose = found(notched(), T, ABOVE, BACK)
    assert sight.ok, sight.message
    assert pose.distance_to(item.T_world_object)[1] < np.deg2rad(2)


@pytest.mark.slow
def test_a_symmetric_mesh_is_reported_at_the_pose_nearest_to_the_prior():
    can = as_mesh(trimesh.creation.cylinder(0.03, 0.1, sections=48))
    T = SE3(SO3.exp([0, 0, 2.0]), np.array([0.6, 0.0, 0.05]))
    _, sight, pose = found(can, T, FRONT)
    thing = sight["thing"]
    assert sight.ok and thing.symmetric and not thing.alternatives
    position, angle = pose.distance_to(SE3.from_xyz(0.6, 0, 0.05))
    # rotations about the axis are multiples of 15 deg, and the last fit may turn the can between its facets
    assert position < 0.002 and np.rad2deg(angle) < 15.0


@pytest.mark.slow
def test_a_mesh_that_forms_several_clusters_is_one_object():
    item, sight, pose = found(knob(), SE3(SO3.exp([0, 0, 0.7]), np.array([0.6, 0, 0])), ABOVE)
    assert sight.ok and len(sight.objects) == 1, sight.message
    position, angle = pose_error(item.shapes, pose, item.T_world_object)
    assert position < 0.002 and np.rad2deg(angle) < 2.0


def test_the_corner_of_a_mesh_starts_the_search():
    """The cluster is the upper half of the mesh in the image: the center of the outline is elsewhere."""
    item, _, (image,) = seen(bracket(0.16), SE3.from_xyz(0.6, 0, 0), ABOVE, noise=DepthNoise())
    assert image.depth is not None
    known = known_mesh(item.shapes)
    T_camera = image.T_world_camera.inverse()
    kinds = np.full(image.depth.shape, D.FREE, np.uint8)
    every = D.cut_out(image.depth, np.full_like(kinds, D.OWN), image.pinhole, T_camera, 0.003, 0, 10**6)
    drawn = np.empty(len(every.depth))
    D.draw(*known.fine, item.T_world_object.rotation.matrix, item.T_world_object.translation, every, drawn)
    shown = np.isfinite(drawn).reshape(kinds.shape)
    shown[int(np.flatnonzero(shown.any(axis=1)).mean()) :] = False
    kinds[shown] = D.OWN
    e = D.cut_out(image.depth, kinds, image.pinhole, T_camera, 0.003, 8, 10**6)

    def nearest(partly: bool) -> float:
        poses = [SE3(SO3(R), t) for R, t in zip(*start_poses(e, known, partly), strict=True)]
        away = [item.T_world_object.distance_to(T) for T in poses]
        return min(position for position, angle in away if angle < np.deg2rad(6))

    assert nearest(False) > 0.03 and nearest(True) < 0.005


@pytest.mark.slow
def test_a_mesh_does_not_swallow_its_neighbor():
    """Both together would have a low cost, for the neighbor has few pixels."""
    small = CollisionObject.single(
        "small", Box(0.02, 0.02, 0.02), SE3.from_xyz(0.6, 0.05, 0.01), movable=True
    )
    item, scene, images = seen(bracket(0.16), SE3.from_xyz(0.6, 0, 0), FRONT, beside=(small,))
    sight = look(images, scene, (item.at(SE3.identity()),))
    assert sight.ok and sight["thing"].known and len(sight.objects) == 2, sight.message


def test_the_symmetries_of_meshes():
    block = known_mesh(((as_mesh(trimesh.creation.box((0.03, 0.05, 0.09))), SE3.identity()),))
    assert len(block.symmetries) == 4
    plate = known_mesh(((as_mesh(trimesh.creation.box((0.02, 0.08, 0.08))), SE3.identity()),))
    assert len(plate.symmetries) == 8
    assert len(known_mesh(((bracket(), SE3.identity()),)).symmetries) == 1


@pytest.mark.slow
def test_images_of_one_moment_are_one_look():
    _, scene, images = seen(bracket(), SE3.from_xyz(0.6, 0, 0), FRONT, BACK)
    assert all(isinstance(image, CameraImage) for image in images)
    sight = look(images, scene)
    assert len(sight.objects) == 1, "both cameras see the same thing"
    assert len(sight.objects[0].points) > max(len(look(image, scene).objects[0].points) for image in images)
