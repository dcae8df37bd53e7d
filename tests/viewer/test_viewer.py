"""The viewer without a browser: what stands where, what the panel says, that nothing stays behind."""

import socket
import subprocess
import sys
import threading
import time
import urllib.parse
import urllib.request
from http.cookiejar import CookieJar

import numpy as np
import pytest

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    Event,
    InputError,
    JointState,
    JointTrajectory,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Sphere,
    StateSample,
)  # fmt: skip
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.model import installed_robots, load_robot
from armcell.model.mesh_decimation import decimated
from armcell.scene import CollisionObject, PlanningScene
from armcell.viewer import CellViewer
from armcell.viewer import geometry as g

POSE = [0.3, -0.4, 0.2, -1.9, 0.1, 1.7, 0.5, 0.03]


@pytest.fixture(scope="module")
def scene():
    cube = CollisionObject.single("cube", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.5, 0, 0.025), movable=True)
    slash = CollisionObject.single("tray/left", Sphere(0.1), SE3.from_xyz(0.4, 0.4, 0.1))
    floor = CollisionObject.single("floor", Plane())
    return PlanningScene.of(load_robot("panda"), POSE, [cube, slash, floor])


@pytest.fixture
def viewer(scene):
    with CellViewer(scene, port=0, title="panda_pick") as viewer:
        yield viewer


def until(condition, timeout=120.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.005)


def pose(handle):
    return SE3.from_quat_wxyz(handle.position, handle.wxyz)


def elsewhere(viewer, scene, q):
    """Links that are not drawn where they are at q."""
    tree = kinematic_tree(scene.model)
    return [
        link
        for link, T in zip(tree.link_names, tree.link_transforms(q))
        if not pose(viewer.link_frames[link]).isclose(SE3.from_matrix(T), 1e-6, 1e-6)
    ]


def visit(url):
    """What a browser gets of a page: the answer to the URL with the token leads on to the page itself."""
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))
    with browser.open(url, timeout=10) as answer:
        forth = answer.headers["Refresh"].partition("url=")[2]
    with browser.open(urllib.parse.urljoin(url, forth), timeout=10) as answer:
        return answer.status, answer.read()


def test_the_page_is_served_and_everything_stands_where_the_scene_says(viewer, scene):
    status, page = visit(viewer.url)
    assert status == 200 and b"<html" in page
    assert elsewhere(viewer, scene, scene.positions) == []
    assert set(viewer.object_frames) == {"cube", "tray/left", "floor"}
    assert pose(viewer.object_frames["cube"]).isclose(SE3.from_xyz(0.5, 0, 0.025))


def test_the_last_state_is_shown_even_of_many_and_calls_return_at_once(viewer, scene):
    model, q = scene.model, np.array(scene.positions)
    T = SE3.from_xyz_rpy((0.4, -0.1, 0.3), (0.1, 0.2, 0.3))
    took = []
    for k in range(500):
        q[0] = 0.001 * k
        sample = StateSample(0.002 * k, JointState(model.joint_names, q), {"cube": T, "stranger": T})
        begin = time.thread_time()  # not the wall clock: other programs may run
        viewer.on_state(sample)
        took.append(time.thread_time() - begin)
    until(lambda: pose(viewer.object_frames["cube"]).isclose(T))
    assert q[0] == 0.499
    until(lambda: not elsewhere(viewer, scene, q))  # they are drawn one after the other
    assert np.median(took) < 0.02  # the drawing is not done by the caller


def test_updates_are_throttled(viewer, scene, monkeypatch):
    shown = []
    monkeypatch.setattr(viewer, "_show", lambda sample, *_: shown.append(sample.time))
    begin = time.monotonic()
    while time.monotonic() - begin < 0.5:
        viewer.on_state(StateSample(time.monotonic() - begin, scene.state))
        time.sleep(0.001)
    until(lambda: shown[-1] > 0.48)
    assert len(shown) <= 0.6 * 30 + 2


def test_joints_in_another_order_or_missing(viewer, scene):
    viewer.on_state(StateSample(0.0, JointState(("nobody", "panda_joint2"), np.array([9.0, -0.1]))))
    q = np.array(scene.positions)
    q[1] = -0.1
    tip = kinematic_tree(scene.model).link_pose(q, "panda_hand_tcp")
    until(lambda: pose(viewer.link_frames["panda_hand_tcp"]).isclose(tip, 1e-6, 1e-6))


def test_the_panel_tells_stage_event_and_gripper(viewer, scene):
    panel = viewer._panel
    assert panel.cell.value == "panda_pick"
    viewer.on_event(Event(1.0, "stage", "lift begins", {"name": "lift"}))
    viewer.on_event(Event(1.5, "grasp", "cube held"))
    viewer.on_state(StateSample(2.0, scene.state, {}, {"hand": 0.0502}, {"hand": 31.96}))
    until(lambda: panel.time.value == "2.00 s" and panel.event.value == "1.50 s  grasp: cube held")
    assert panel.stage.value == "lift"
    assert panel.grippers["hand"].value == "50.2 mm, 32.0 N"


def test_a_trajectory_becomes_the_line_of_the_tcp(viewer, scene):
    arm = scene.model.group("arm").joint_names
    start = np.array(POSE[:7])
    viewer.on_trajectory(0.0, JointTrajectory(arm, np.array([0.0, 1.0]), np.array([start, start + 0.3])))
    until(lambda: viewer._paths)
    points = np.asarray(viewer._paths[0].points)
    tree, end = kinematic_tree(scene.model), np.array(POSE)
    end[:7] += 0.3
    for point, q in ((points[0, 0], np.array(POSE)), (points[-1, 1], end)):
        np.testing.assert_allclose(point, tree.link_pose(q, "panda_hand_tcp").translation, atol=1e-5)
    finger = JointTrajectory(("panda_finger_joint1",), np.array([0.0, 1.0]), np.array([[0.04], [0.0]]))
    viewer.on_trajectory(1.0, finger)  # the tool stays where it is
    until(lambda: not viewer._paths)


def test_collision_shapes_are_hidden_until_asked_for(viewer):
    assert viewer._collisions and not any(h.visible for h in viewer._collisions)
    viewer._shown("collision", True)
    assert all(h.visible for h in viewer._collisions)


def test_an_update_that_fails_does_not_end_the_view(viewer, scene, monkeypatch, caplog):
    monkeypatch.setattr(viewer, "_place_links", lambda: 1 / 0)
    viewer.on_state(StateSample(0.0, scene.state))
    until(lambda: "could not show an update" in caplog.text)
    monkeypatch.undo()
    viewer.on_state(StateSample(3.0, scene.state))
    until(lambda: viewer._panel.time.value == "3.00 s")


def test_closing_frees_the_port_and_the_threads_and_says_nothing(scene, capfd):
    before = set(threading.enumerate())
    viewer = CellViewer(scene, port=0)
    port = viewer.port
    viewer.close()
    viewer.close()
    viewer.on_state(StateSample(0.0, scene.state))  # a late call does no harm
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", port))
    until(lambda: set(threading.enumerate()) <= before)
    assert capfd.readouterr().out == ""


def test_a_port_in_use_means_the_next_free_one(scene, viewer, caplog):
    with CellViewer(scene, port=viewer.port) as second:
        assert second.port > viewer.port
        assert f"port {viewer.port} is in use: the viewer is at port {second.port}" in caplog.text
        assert second.url not in caplog.text  # its token is not for logs
        assert urllib.request.urlopen(second.url, timeout=10).status == 200


@pytest.mark.parametrize(
    ("host", "port"), [("203.0.113.1", 8080), ("127.0.0.1", 70000), ("127.0.0.1", -5), ("no such host", 8080)]
)
def test_an_address_that_cannot_be_is_one_clear_line(scene, host, port):
    with pytest.raises(InputError, match="the viewer cannot listen on"):
        CellViewer(scene, host=host, port=port)


@pytest.mark.slow
def test_importing_is_light():
    code = "import sys, armcell.viewer; sys.exit('viser' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- geometry ---
SHAPES = [
    Box(0.1, 0.2, 0.3), Sphere(0.1), Cylinder(0.1, 0.3), Capsule(0.1, 0.3), Cone(0.1, 0.3),
    Mesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])),
]  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_triangles_fill_the_bounds_of_their_shape(shape):
    part = g.shape_part(shape, (1, 0, 0, 1))
    center, half = local_bounds(shape)
    np.testing.assert_allclose(part.vertices.min(axis=0), center - half, atol=2e-3)
    np.testing.assert_allclose(part.vertices.max(axis=0), center + half, atol=2e-3)


def test_a_cone_points_up_and_a_plane_lies_below_zero():
    cone = g.shape_part(Cone(0.1, 0.3), (1, 0, 0, 1)).vertices
    np.testing.assert_allclose(cone[cone[:, 2] > 0.149][:, :2], 0, atol=1e-9)
    assert g.shape_part(Plane(), (1, 0, 0, 1)).vertices[:, 2].max() == 0


def test_clouds_are_drawn(viewer):
    api, T = viewer._server.scene, SE3.from_xyz(1.0, 2.0, 3.0)
    points = np.random.default_rng(0).random((300_000, 3))
    drawn = g.add_object_shape(api, "/cloud", PointCloud(points, 0.01), T, (1.0, 0.5, 0.0, 1.0))
    assert len(drawn.points) <= g.MAX_POINTS * 1.5 and drawn.point_size == pytest.approx(0.02)
    cells = Octree([[0.0, 0, 0], [1.0, 0, 0]], [0.1, 0.2])
    drawn = g.add_object_shape(api, "/cells", cells, T, (1.0, 0.5, 0.0, 1.0))
    np.testing.assert_allclose(np.sort(drawn.batched_scales.ravel()), [0.1, 0.2])
    np.testing.assert_allclose(drawn.position, T.translation)


@pytest.mark.slow
def test_decimation_keeps_the_size_and_its_budget():
    sphere = g.trimesh.creation.icosphere(6, 0.2)
    vertices, faces = decimated(sphere.vertices, sphere.faces, 3000)
    assert 500 < len(faces) <= 3000
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.2, atol=0.001)
    box = g.trimesh.creation.box((0.2, 0.1, 0.05))
    for _ in range(4):
        box = box.subdivide()
    vertices, faces = decimated(box.vertices, box.faces, 1000)  # edges and corners remain sharp
    np.testing.assert_allclose(np.ptp(vertices, axis=0), (0.2, 0.1, 0.05), atol=1e-6)


@pytest.mark.slow
@pytest.mark.cases("panda", "scara", "palletizer", "parallel_gripper")
@pytest.mark.parametrize("robot", installed_robots())
def test_every_link_with_a_body_is_drawn(robot):
    for link in load_robot(robot).links.values():
        parts = [p for v in link.visuals for p in g.visual_parts(v)]
        assert bool(parts) == bool(link.visuals)
        assert all(len(p.faces) <= g.MAX_FACES and np.isfinite(p.vertices).all() for p in parts)


def test_the_panda_keeps_its_colors():
    link = load_robot("panda").links["panda_link6"]
    colors = {tuple(round(255 * c) for c in p.color[:3]) for v in link.visuals for p in g.visual_parts(v)}
    assert {(255, 255, 255), (64, 64, 64), (10, 138, 199)} <= colors


def test_a_broken_mesh_is_named(tmp_path):
    file = tmp_path / "broken.stl"
    file.write_text("solid nothing\nendsolid\n")
    with pytest.raises(InputError, match=r"broken\.stl"):
        g.file_parts(file)


def test_a_link_without_visuals_shows_its_collision_shapes(scene, tmp_path):
    from armcell.model import Collision, Link

    calls = []

    class Api:
        def add_mesh_simple(self, name, *_, **options):
            calls.append((name, options["visible"]))

    g.add_link(Api(), "/robot/x", Link("x", collisions=(Collision(Box(1, 1, 1), SE3.identity()),)))
    assert calls == [("/robot/x/visual/0", True), ("/robot/x/collision/0", False)]
