"""Markers in the MCAP, read back with the definitions in the file: what a 3D panel draws is where it is."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
import trimesh
from tests.records.synthetic import panda_scene
from tests.records.test_mcap import chained, read

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Contact,
    Cylinder,
    Event,
    JointState,
    Mesh,
    Plane,
    PointCloud,
    Sphere,
    StateSample,
)
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.model.assets import load_visual_parts
from armcell.records import RunRecorder
from armcell.records.scene_markers import MAX_FACES
from armcell.scene import CollisionObject, PlanningScene, scene_changes

T = SE3.from_xyz_rpy((0.3, -0.2, 0.5), (0.4, -0.3, 1.2))
CUBE = SE3.from_xyz(0.5, 0.1, 0.025)


def sample(scene, time=0.0, contacts=(), **poses):
    return StateSample(time, JointState(scene.model.joint_names, scene.positions), poses, contacts=contacts)


def recorded(folder, scene, *things):
    """Record states and events; the topics of the file."""
    with RunRecorder(folder, scene) as recorder:
        for thing in things:
            (recorder.on_event if isinstance(thing, Event) else recorder.on_state)(thing)
    return read(recorder.mcap_file)[0]


def change(time, before, after):
    return Event(time, "scene", "changed", scene_changes(before, after))


def pose_of(pose):
    p, q = pose.position, pose.orientation
    return SE3.from_quat_xyzw((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def entities(update):
    return {e.id: e for e in update.entities}


def in_world(topics, entity, primitive):
    """Pose of a primitive after the transforms that the file contains."""
    still = {t.child_frame_id: t for t in topics["/tf_static"][0][1].transforms}
    moving = {t.child_frame_id: t for t in topics["/tf"][-1][1].transforms}
    return chained({**still, **moving}, entity.frame_id) @ pose_of(primitive.pose)


def vertices(topics, entity):
    points = [np.array([[p.x, p.y, p.z] for p in t.points]) for t in entity.triangles]
    return np.concatenate([in_world(topics, entity, t).apply(p) for t, p in zip(entity.triangles, points)])


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene():
    return panda_scene()


def test_link_markers_are_at_the_links_of_the_last_state(scene, tmp_path):
    topics = recorded(tmp_path, scene, sample(scene))
    ((_, update),) = topics["/robot_links"]
    Ts = kinematic_tree(scene.model)
    Ts = dict(zip(Ts.link_names, Ts.link_transforms(scene.positions)))
    drawn = entities(update)
    assert set(drawn) == {n for n, link in scene.model.links.items() if link.visuals or link.collisions}
    for name, entity in drawn.items():
        assert entity.frame_locked and entity.frame_id == name
        meshes = [
            SE3.from_matrix(Ts[name]) @ v.T_link_visual
            for v in scene.model.links[name].visuals
            for _ in load_visual_parts(v.file, v.scale)
        ]
        parts = [m for v in scene.model.links[name].visuals for m, _ in load_visual_parts(v.file, v.scale)]
        exact = np.concatenate([T.apply(m.vertices) for T, m in zip(meshes, parts)])
        got = vertices(topics, entity)
        size = np.ptp(exact, axis=0).max()
        np.testing.assert_allclose([got.min(0), got.max(0)], [exact.min(0), exact.max(0)], atol=0.05 * size)
        for triangles in entity.triangles:
            assert 0 < len(triangles.indices) <= 3 * MAX_FACES and len(triangles.indices) % 3 == 0
            assert triangles.indices.max() < len(triangles.points)


@pytest.mark.parametrize(
    ("shape", "kind", "sizes"),
    [
        (Box(0.1, 0.2, 0.3), "cubes", [(0.1, 0.2, 0.3)]),
        (Sphere(0.1), "spheres", [(0.2, 0.2, 0.2)]),
        (Cylinder(0.1, 0.3), "cylinders", [(0.2, 0.2, 0.3)]),
        (Cone(0.1, 0.3), "cylinders", [(0.2, 0.2, 0.3)]),
        (Capsule(0.1, 0.3), "cylinders", [(0.2, 0.2, 0.3)]),
        (Plane(), "cubes", [(6.0, 6.0, 0.01)]),
    ],
)
@pytest.mark.parametrize("movable", [False, True])
def test_shapes_have_their_size_and_pose(shape, kind, sizes, movable, tmp_path):
    if movable and isinstance(shape, Plane):
        return  # a plane cannot move
    item = CollisionObject("thing", ((shape, T),), T, color=(0.1, 0.2, 0.3, 0.4), movable=movable)
    scene = PlanningScene.of(load_robot("panda"), objects=[item])
    moved = {"thing": CUBE @ T} if movable else {}
    topics = recorded(tmp_path, scene, sample(scene, **moved))
    ((_, update),) = topics["/scene_objects"]
    (entity,) = update.entities
    assert [(s.size.x, s.size.y, s.size.z) for s in getattr(entity, kind)] == sizes
    (drawn,) = getattr(entity, kind)
    assert (drawn.color.r, drawn.color.g, drawn.color.b, drawn.color.a) == (0.1, 0.2, 0.3, 0.4)
    expected = (CUBE @ T if movable else T) @ T
    if isinstance(shape, Plane):
        expected = expected @ SE3.from_xyz(0, 0, -0.005)  # its upper face is the plane
    assert in_world(topics, entity, drawn).isclose(expected, 1e-9, 1e-9)
    assert entity.frame_id == ("thing" if movable else "world")
    assert len(entity.spheres) == {Sphere: 1, Capsule: 2}.get(type(shape), 0)
    if kind == "cylinders":
        assert (drawn.bottom_scale, drawn.top_scale) == (1.0, 0.0 if isinstance(shape, Cone) else 1.0)


def test_meshes_are_triangles_and_clouds_are_left_out(tmp_path):
    ball = trimesh.creation.icosphere(5, 0.1)
    mesh = CollisionObject.single("ball", Mesh(ball.vertices, ball.faces), T)
    cloud = CollisionObject.single("cloud", PointCloud(np.zeros((3, 3)), 0.01))
    scene = PlanningScene.of(load_robot("panda"), objects=[mesh, cloud])
    topics = recorded(tmp_path, scene, sample(scene))
    ((_, update),) = topics["/scene_objects"]
    (entity,) = update.entities
    got = vertices(topics, entity)
    assert 300 < len(entity.triangles[0].indices) <= 3 * MAX_FACES
    np.testing.assert_allclose(np.linalg.norm(got - T.translation, axis=1), 0.1, atol=0.01)


def test_each_message_is_the_whole_scene(scene, tmp_path):
    """A panel that seeks draws the last message of a topic, so a message must not need an earlier one."""
    box = CollisionObject.single("box", Box(0.1, 0.1, 0.1), T)
    more = scene.with_object(box)
    moved = more.with_object_pose("box", CUBE)
    topics = recorded(
        tmp_path, scene,
        sample(scene, 0.0, cube=CUBE), sample(scene, 0.1, cube=CUBE), change(0.15, scene, more),
        sample(more, 0.2, cube=CUBE), change(0.25, more, moved), sample(more, 0.3, cube=CUBE),
        change(0.35, moved, scene), sample(scene, 0.4, cube=CUBE), sample(scene, 0.5, cube=T),
    )  # fmt: skip
    updates = [update for _, update in topics["/scene_objects"]]
    assert [set(entities(u)) - {"cube", "wall", "floor"} for u in updates] == [set(), {"box"}, {"box"}, set()]
    for update in updates:
        (clear,) = update.deletions
        assert clear.type == 1 and {"cube", "wall", "floor"} <= set(entities(update))  # 1: all entities
    (first,), (second,) = (entities(update)["box"].cubes for update in updates[1:3])
    assert pose_of(first.pose).isclose(T, 1e-9, 1e-9) and pose_of(second.pose).isclose(CUBE, 1e-9, 1e-9)


def test_an_object_is_in_its_own_frame_once_its_pose_is_measured(scene, tmp_path):
    topics = recorded(tmp_path, scene, sample(scene), sample(scene, 0.1, cube=T))
    before, after = (entities(update)["cube"] for _, update in topics["/scene_objects"])
    assert (before.frame_id, after.frame_id) == ("world", "cube")
    assert pose_of(before.cubes[0].pose).isclose(CUBE, 1e-9, 1e-9)
    assert in_world(topics, after, after.cubes[0]).isclose(T, 1e-9, 1e-9)


def test_a_busy_scene_is_written_at_a_lower_rate(tmp_path):
    """200 objects, one of which changes 100 times per second, and a cloud that changes each time, too."""
    shelf = [CollisionObject.single(f"box{i}", Box(0.1, 0.1, 0.1), T) for i in range(200)]
    scene = PlanningScene.of(load_robot("panda"), objects=shelf)
    cloud = CollisionObject.single("cloud", PointCloud(np.zeros((3, 3)), 0.01))
    things = []
    for k in range(100):
        things.append(sample(scene, k / 100))
        after = scene.with_object_pose("box0", SE3.from_xyz(k, 0, 0)) if k < 50 else scene.with_object(cloud)
        things.append(change(k / 100, scene, after))
        scene = after
    updates = [u for _, u in recorded(tmp_path, scene.without_object("cloud"), *things)["/scene_objects"]]
    assert 3 <= len(updates) <= 5  # every 0.2 s, until only the cloud changes
    assert pose_of(entities(updates[-1])["box0"].cubes[0].pose).translation[0] == 49


def test_contacts_are_spheres_until_they_end(scene, tmp_path):
    at = [(0.5, 0.1, 0.0), (0.4, 0.2, 0.0)]
    contacts = tuple(Contact("cube", "floor", -0.001, xyz) for xyz in at)
    states = [sample(scene, k / 100, contacts if 10 <= k < 20 else ()) for k in range(40)]
    topics = recorded(tmp_path, scene, *states)
    updates = [update for _, update in topics["/contact_markers"]]
    spheres = [[(p.x, p.y, p.z) for p in (s.pose.position for e in u.entities for s in e.spheres)]
               for u in updates]  # fmt: skip
    assert spheres == [at] * 3 + [[]]  # 25 messages per second, and one that clears them
    assert all(e.frame_id == "world" for u in updates for e in u.entities)
    assert updates[-1].deletions[0].type == 1


def test_a_robot_with_primitives_and_without_visuals_is_drawn(scene, tmp_path):
    hand = scene.model.links["panda_hand"]
    bare = replace(hand, visuals=(), collisions=(replace(hand.collisions[0], shape=Cylinder(0.05, 0.1)),))
    model = replace(scene.model, links=MappingProxyType({**scene.model.links, "panda_hand": bare}))
    only = PlanningScene.of(model)
    topics = recorded(tmp_path, only, sample(only))
    (drawn,) = entities(topics["/robot_links"][0][1])["panda_hand"].cylinders
    assert (drawn.size.x, drawn.size.z) == (0.1, 0.1)
    assert pose_of(drawn.pose).isclose(hand.collisions[0].T_link_shape, 1e-9, 1e-9)
