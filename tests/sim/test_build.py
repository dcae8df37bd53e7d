"""The MuJoCo model is the robot model: same kinematics, same masses, shapes that hold what they stand for."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.model import helpers

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    InputError,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Sphere,
    UnknownNameError,
)
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene, solid_inertia
from armcell.sim import PhysicsSettings, SimWorld, build, convex_pieces
from armcell.sim.objects import cone_mesh

ROBOTS = ("panda", "ur10", "ur10_gripper")


def _l_shape() -> Mesh:
    """Two unit-wide arms: a mesh whose hull is far from it."""
    import trimesh

    profile = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], float)
    bottom, top = np.c_[profile, np.zeros(6)], np.c_[profile, np.ones(6)]
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    side = [[i, (i + 1) % 6, i + 6] for i in range(6)] + [
        [(i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)
    ]
    faces = np.vstack([cap[:, ::-1], cap + 6, side])
    mesh = trimesh.Trimesh(np.vstack([bottom, top]), faces)
    assert mesh.is_watertight and mesh.volume == pytest.approx(5.0)
    return Mesh(mesh.vertices, mesh.faces.astype(np.int32))


@pytest.mark.parametrize("robot", ROBOTS)
def test_forward_kinematics_agree(robot):
    model = load_robot(robot)
    world = SimWorld(PlanningScene.of(model))
    tree, rng = kinematic_tree(model), np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(np.maximum(model.lower, -3), np.minimum(model.upper, 3))
        world.set_positions(q)
        for link, T in zip(tree.link_names, tree.link_transforms(q), strict=True):
            assert np.abs(world.link_pose(link).matrix - T).max() < 1e-6, link


@pytest.mark.parametrize("robot", ROBOTS)
def test_masses_and_names(robot):
    model = load_robot(robot)
    built = build(PlanningScene.of(model))
    for name, link in model.links.items():
        mass = link.inertial.mass if link.inertial else 0.0
        assert built.mj.body(name).mass[0] == pytest.approx(mass, abs=1e-9)
    owned = {built.owners[i] for i in built.geom_owner}
    assert owned == {name for name, link in model.links.items() if link.collisions}
    assert built.mj.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_sag(robot):
    world = SimWorld(PlanningScene.of(load_robot(robot)))
    before = world.joint_state().positions
    world.step(500)
    assert world.time == pytest.approx(1.0)
    assert np.abs(world.joint_state().positions - before).max() < 1e-4
    assert not world.monitor.unwanted


@pytest.mark.parametrize("robot", ("panda", "ur10"))
def test_convex_pieces_hold_the_link(robot):
    for link in load_robot(robot).links.values():
        for solid in link.collisions:
            if isinstance(solid.shape, Mesh):
                _check_pieces(solid.shape)


def test_convex_pieces_of_a_concave_mesh():
    pieces = convex_pieces(_l_shape())
    assert sum(ConvexHull(p.vertices).volume for p in pieces) < 5.5  # the hull has 7
    _check_pieces(_l_shape())


def _check_pieces(mesh: Mesh) -> None:
    """Every vertex and every point of the faces is in some piece, and the pieces are close to the mesh."""
    corners = mesh.vertices[mesh.faces]
    weights = np.random.default_rng(0).dirichlet(np.ones(3), len(corners))
    points = np.vstack([mesh.vertices, np.einsum("ik,ikj->ij", weights, corners)])
    pieces = convex_pieces(mesh)
    outside = np.full(len(points), np.inf)
    for piece in pieces:
        planes = ConvexHull(piece.vertices).equations
        outside = np.minimum(outside, (points @ planes[:, :3].T + planes[:, 3]).max(1))
    assert outside.max() < 1e-9
    assert convex_pieces(mesh) == pieces


def test_every_shape_becomes_a_body():
    shapes = {
        "box": Box(0.1, 0.2, 0.3),
        "sphere": Sphere(0.1),
        "cylinder": Cylinder(0.1, 0.3),
        "capsule": Capsule(0.1, 0.3),
        "cone": Cone(0.1, 0.3),
        "mesh": _l_shape(),
    }
    objects = [
        CollisionObject.single(name, shape, SE3.from_xyz(2 + 4 * i, 5, 2), movable=True, mass=2.0)
        for i, (name, shape) in enumerate(shapes.items())
    ]
    objects.append(CollisionObject.single("floor", Plane(), SE3.from_xyz(0, 0, -0.1)))
    world = SimWorld(PlanningScene.of(load_robot("ur10"), objects=objects))
    for name in shapes:
        assert world.mj_model.body(name).mass[0] == pytest.approx(2.0)
    world.step(1000)
    assert all(abs(world.object_twist(name)[2]) < 0.1 for name in shapes)  # all lie on the floor
    assert {c.body_a for c in world.contacts()} | {c.body_b for c in world.contacts()} == {*shapes, "floor"}


def test_physics_says_that_it_does_not_see_clouds(caplog):
    cloud = CollisionObject.single("scan", PointCloud(np.zeros((5, 3)), 0.01))
    map_ = CollisionObject.single("map", Octree(np.zeros((1, 3)), [0.1]))
    world = SimWorld(PlanningScene.of(load_robot("ur10"), objects=[cloud, map_]))
    world.step(10)
    assert "scan:0 is a PointCloud" in caplog.text and "map:0 is a Octree" in caplog.text


@pytest.mark.parametrize(
    "shape", [Box(0.1, 0.2, 0.3), Sphere(0.1), Cylinder(0.1, 0.3), Capsule(0.1, 0.3), Cone(0.1, 0.3)]
)
def test_inertia_against_a_fine_mesh(shape):
    import trimesh

    make = trimesh.creation
    mesh = {
        Box: lambda s: make.box((s.x, s.y, s.z)),
        Sphere: lambda s: make.icosphere(5, s.radius),
        Cylinder: lambda s: make.cylinder(s.radius, s.length, sections=256),
        Capsule: lambda s: make.capsule(s.length, s.radius, count=(128, 128)),
        Cone: lambda s: trimesh.Trimesh(cone_mesh(s, 256).vertices, cone_mesh(s, 256).faces),
    }[type(shape)](shape)
    T = SE3.from_xyz_rpy((0.1, -0.2, 0.3), (0.4, 0.5, 0.6))
    center, inertia = solid_inertia([(shape, T)], 3.0)
    R = T.rotation.matrix
    assert center == pytest.approx(T.apply(mesh.center_mass), abs=1e-3)
    assert inertia == pytest.approx(R @ mesh.moment_inertia @ R.T * 3.0 / mesh.volume, rel=5e-3, abs=1e-4)


def test_two_boxes_weigh_like_one():
    halves = [(Box(0.1, 0.1, 0.1), SE3.from_xyz(x, 0, 0)) for x in (-0.05, 0.05)]
    center, inertia = solid_inertia(halves, 2.0)
    _, whole = solid_inertia([(Box(0.2, 0.1, 0.1), SE3.identity())], 2.0)
    assert center == pytest.approx(np.zeros(3)) and inertia == pytest.approx(whole)


def test_neighbors_are_excluded_and_the_scene_may_add_pairs():
    model = load_robot("panda")
    scene = PlanningScene.of(model)
    names = {name for name, link in model.links.items() if link.collisions}
    pair = ("panda_link1", "panda_link6")
    assert set(pair) <= names
    plain, more = build(scene), build(scene.with_allowed(*pair))
    assert more.mj.nexclude == plain.mj.nexclude + (0 if scene.is_allowed(*pair) else 1)
    assert "panda_link0|panda_link1" in [plain.mj.exclude(i).name for i in range(plain.mj.nexclude)]


def test_bad_settings():
    with pytest.raises(UnknownNameError, match="implicitfast"):
        PhysicsSettings(integrator="implicit-fast")
    with pytest.raises(UnknownNameError, match="weld"):
        PhysicsSettings(grip_mode="glue")
    with pytest.raises(InputError, match="timestep"):
        PhysicsSettings(timestep=0.0)
    with pytest.raises(InputError, match="arm_kp"):
        PhysicsSettings(arm_kp=float("nan"))
    with pytest.raises(InputError, match="flat"):
        convex_pieces(Mesh(np.eye(3), np.array([[0, 1, 2]])))


def test_limits_that_contradict_a_coupling_do_not_block_the_driven_joint():
    """The PR2's grippers: a linkage joint with the multiplier -1 and the range of the driven joint."""
    limit = '<limit lower="0" upper="0.5" velocity="1" effort="1"/>'
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    body = f'<inertial><mass value="0.1"/>{inertia}</inertial>'
    follow = '<axis xyz="0 0 1"/><mimic joint="driven" multiplier="{}"/>'
    link, joint = helpers.link, helpers.joint
    model = helpers.model_of(
        link("base"), *(link(name, body) for name in ("a", "b", "c")),
        joint("driven", "base", "a", limit=limit),
        joint("reversed", "base", "b", inside=follow.format(-1), limit=limit),
        joint("same", "base", "c", inside=follow.format(1), limit=limit),
    )  # fmt: skip
    mj = build(PlanningScene.of(model), PhysicsSettings()).mj
    limited = {mj.joint(i).name: bool(mj.jnt_limited[i]) for i in range(mj.njnt)}
    assert limited == {"driven": True, "reversed": False, "same": True}
