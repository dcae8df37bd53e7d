"""The exact checker where the answer is known by hand: a 0.2 m cube on a slide against every shape."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.scene.helpers import box, floating, mesh_of, open_bin, panda, ur10

from armcell.collision import ExactChecker
from armcell.core import SE3, Box, Capsule, Cone, Contact, Cylinder, Plane, Sphere
from armcell.scene import CollisionObject

TIP_UP = (0.0, np.pi / 2, 0.0)  # turns local z to world x

# shape, T_world_object's rpy and position such that its nearest point to the cube is at x = 1
AT_ONE = {
    "box": (Box(0.2, 0.4, 0.4), (1.1, 0, 0), (0, 0, 0)),
    "box edge": (Box(0.2, 0.2, 0.4), (1 + 0.1 * np.sqrt(2), 0, 0), (0, 0, np.pi / 4)),
    "sphere": (Sphere(0.3), (1.3, 0, 0), (0, 0, 0)),
    "cylinder side": (Cylinder(0.3, 0.5), (1.3, 0, 0), (0, 0, 0)),
    "cylinder lid": (Cylinder(0.3, 0.5), (1.25, 0, 0), TIP_UP),
    "capsule end": (Capsule(0.3, 0.5), (1.55, 0, 0), TIP_UP),
    "cone base": (Cone(0.3, 0.5), (1.25, 0, 0), TIP_UP),
    "cone tip": (Cone(0.3, 0.5), (1.25, 0, 0), (0, -np.pi / 2, 0)),
    "plane": (Plane(), (1.0, 0, 0), (0, -np.pi / 2, 0)),
    "mesh": (mesh_of(trimesh.creation.box((0.2, 0.4, 0.4))), (1.1, 0, 0), (0, 0, 0)),
    "bin wall": (mesh_of(open_bin(0.4, 0.2)), (1.2, 0, -0.1), (0, 0, 0)),
}


def scene_with(name: str, **pads):
    shape, xyz, rpy = AT_ONE[name]
    return floating(CollisionObject.single("thing", shape, SE3.from_xyz_rpy(xyz, rpy)), **pads)


@pytest.mark.parametrize("name", AT_ONE)
def test_distance_and_contact_at_known_places(name):
    checker = ExactChecker(scene_with(name))
    for gap in (0.5, 0.05, 0.001):
        x = [1.0 - 0.1 - gap]
        assert checker.is_free(x) and checker.contacts(x) == []
        nearest = checker.nearest(x)
        assert {nearest.body_a, nearest.body_b} == {"cube", "thing"}
        assert nearest.distance == pytest.approx(gap, abs=1e-5)
        assert 1.0 - gap - 1e-4 <= nearest.position[0] <= 1.0 + 1e-4  # between the two
    x = [1.0 - 0.1 + 0.004]
    assert not checker.is_free(x)
    (contact,) = checker.contacts(x)
    assert {contact.body_a, contact.body_b} == {"cube", "thing"}
    if "bin" not in name:  # triangles have no depth of their own
        assert contact.distance == pytest.approx(-0.004, abs=1e-4)
    assert checker.nearest(x).distance <= 0.0


@pytest.mark.parametrize("name", AT_ONE)
@pytest.mark.parametrize(
    "pads", [{"padding": 0.02}, {"link_padding": {"cube": 0.02}}, {"link_scale": {"cube": 1.2}}]
)
def test_padding_and_scale_grow_the_robot(name, pads):
    """0.02 m of padding, or the cube's half edge of 0.1 m times 1.2: contact 0.02 m earlier."""
    checker = ExactChecker(scene_with(name, **pads))
    assert checker.is_free([1.0 - 0.1 - 0.0205]) and not checker.is_free([1.0 - 0.1 - 0.0195])
    assert len(checker.contacts([1.0 - 0.1 - 0.0195])) == 1
    if "link_scale" not in pads:
        (contact,) = checker.contacts([1.0 - 0.1 - 0.0195])
        assert contact.distance == pytest.approx(0.0195, abs=1e-5) and "19.5 mm" in contact.describe()
        assert checker.contacts([1.0 - 0.1 - 0.0195], padded=False) == []


def test_padding_of_a_link_replaces_the_general_one():
    checker = ExactChecker(scene_with("box", padding=0.1, link_padding={"cube": 0.0}))
    assert checker.is_free([1.0 - 0.1 - 0.001])


def test_padding_is_not_between_links():
    scene = panda()
    rng = np.random.default_rng(0)
    bare, padded = ExactChecker(scene), ExactChecker(scene.with_padding(0.05))
    for _ in range(50):
        q = rng.uniform(scene.model.lower, scene.model.upper)
        assert bare.is_free(q) == padded.is_free(q)


def test_relaxed_margins_let_a_motion_leave_but_come_no_closer():
    for gap in (0.015, 0.003):
        checker = ExactChecker(scene_with("box", padding=0.02))
        at = [1.0 - 0.1 - gap]
        assert not checker.is_free(at)
        checker.relax_margins(at)
        assert checker.is_free(at) and checker.is_free([at[0] - 0.05])
        assert not checker.is_free([at[0] + 0.0005])
    checker = ExactChecker(scene_with("box", padding=0.02))
    checker.relax_margins([0.0])  # far away: nothing to relax
    assert not checker.is_free([1.0 - 0.1 - 0.0195])


def test_allowed_pairs_are_not_looked_at():
    scene = scene_with("box")
    inside = [1.05]
    assert ExactChecker(scene).contacts(inside)
    allowed = ExactChecker(scene.with_allowed("cube", "thing"))
    assert allowed.is_free(inside) and allowed.nearest(inside) is None
    forbidden = scene.with_allowed("cube", "thing").with_allowed("thing", "cube", allow=False)
    assert ExactChecker(forbidden).contacts(inside)


def test_nearest_measures_up_to_its_cutoff():
    checker = ExactChecker(scene_with("sphere"))
    assert checker.nearest([0.4], cutoff=0.4) is None
    assert checker.nearest([0.4], cutoff=0.6).distance == pytest.approx(0.5, abs=1e-5)


def test_attached_objects_count_with_their_link():
    cube = box("held", (0.1, 0.1, 0.1), (0.2, 0.0, 0.0))
    wall = box("wall", (0.2, 1.0, 1.0), (1.1, 0.0, 0.0))
    scene = floating(cube, wall).with_attached("held", "cube")
    checker = ExactChecker(scene)  # the held box ends 0.25 m before the link's middle
    assert checker.is_free([0.7]) and not checker.is_free([0.76])
    (contact,) = checker.contacts([0.76])
    assert {contact.body_a, contact.body_b} == {"held", "wall"}
    padded = ExactChecker(scene.with_padding(link_padding={"cube": 0.1}))
    assert not padded.is_free([0.7]) and padded.is_free([0.6])
    assert ExactChecker(floating(wall)).is_free([0.76])


def test_held_objects_touch_links_unless_told():
    T_hand = panda().frame_pose("panda_hand_tcp")
    cube = CollisionObject.single("held", Box(0.05, 0.2, 0.05), T_hand)
    fingers = ["panda_leftfinger", "panda_rightfinger"]
    scene = panda(cube)
    q = scene.positions
    touching = ExactChecker(scene.with_attached("held", "panda_hand")).contacts(q)
    assert {n for c in touching for n in (c.body_a, c.body_b)} == {"held", *fingers}
    assert ExactChecker(scene.with_attached("held", "panda_hand", fingers)).contacts(q) == []


def test_inside_a_bin_is_free():
    surface = open_bin(0.6, 0.5, wall=0.02)
    bin_ = CollisionObject.single("bin", mesh_of(surface), SE3.from_xyz(0.5, 0.0, -0.2))
    checker = ExactChecker(floating(bin_))
    assert checker.is_free([0.5])  # 0.08 m above the floor, 0.18 m from each wall
    assert checker.nearest([0.5]).distance == pytest.approx(0.08, abs=1e-5)
    for x in (0.5 - 0.185, 0.5 + 0.185, 0.11):
        assert not checker.is_free([x])
    assert checker.is_free([0.05]) and checker.is_free([1.0])


def test_inside_a_narrow_hole_is_free():
    """A block with a hole 0.32 m wide, 0.06 m more than the robot on each side."""
    block = mesh_of(open_bin(8.0, 8.0, wall=3.84))
    checker = ExactChecker(floating(CollisionObject.single("block", block, SE3.from_xyz(0.0, 0.0, -6.0))))
    assert not checker.is_free([0.07]) and checker.is_free([0.0])


def ell() -> trimesh.Trimesh:
    """A closed L, not convex: legs 0.6 m thick, the corner block around the origin."""
    profile = np.array([(-0.4, -0.4), (1.2, -0.4), (1.2, 0.2), (0.2, 0.2), (0.2, 1.2), (-0.4, 1.2)])
    low, high = (np.column_stack([profile, np.full(6, z)]) for z in (-0.4, 0.4))
    cap = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)])
    walls = [f for i in range(6) for j in [(i + 1) % 6] for f in ((i, j, j + 6), (i, j + 6, i + 6))]
    return trimesh.Trimesh(np.vstack([low, high]), np.vstack([cap[:, ::-1], cap + 6, walls]), process=False)


def test_inside_a_closed_mesh_is_not_free():
    surface = ell()
    assert surface.is_watertight and surface.volume > 0
    checker = ExactChecker(floating(CollisionObject.single("L", mesh_of(surface))))
    assert checker.is_free([2.0]) and not checker.is_free([1.2])
    assert not checker.is_free([0.0])


def test_a_small_thing_inside_an_arm_is_in_collision():
    bare = ur10()
    middle = bare.frame_pose("forearm_link") @ SE3.from_xyz(0.0, 0.0, 0.3)
    checker = ExactChecker(ur10(CollisionObject.single("pea", Sphere(0.01), middle)))
    (contact,) = checker.contacts(bare.positions)
    assert {contact.body_a, contact.body_b} == {"forearm_link", "pea"}


def test_what_the_group_cannot_move_is_told_but_not_asked():
    """The Panda's shoulder in a wall: planning the hand cannot help that."""
    scene = panda(box("wall", (0.2, 0.2, 0.2), (0.0, 0.0, 0.3)))
    hand = ExactChecker(scene, scene.model.group("hand").joint_names)
    q = scene.positions[hand.columns]
    assert hand.is_free(q) and hand.contacts(q)
    assert not ExactChecker(scene).is_free(scene.positions)


def test_the_base_may_stand_in_the_table():
    scene = panda(box("table", (1.0, 1.0, 0.1), (0.0, 0.0, -0.04)))
    assert ExactChecker(scene).contacts(scene.positions) == []


def test_the_other_joints_stay_where_the_scene_has_them():
    wall = box("wall", (0.2, 0.4, 0.4), (0.4, 0.0, 0.6))
    for turned in (0.0, 1.5):
        scene = panda(wall, joint1=turned)
        checker = ExactChecker(scene, ("panda_joint7",))
        whole = ExactChecker(scene)
        assert bool(checker.contacts([0.3])) == bool(whole.contacts(scene.positions)) == (turned == 0.0)


def test_contacts_are_sorted_and_one_per_pair():
    scene = panda(box("block", (0.4, 0.4, 0.4), (0.3, 0.0, 0.5)))
    found = ExactChecker(scene).contacts(scene.positions)
    assert len(found) > 2 and found == sorted(found, key=lambda c: c.distance)
    assert len({frozenset((c.body_a, c.body_b)) for c in found}) == len(found)
    assert all(isinstance(c, Contact) and c.distance <= 0 for c in found)


@pytest.mark.slow
@pytest.mark.cases("0.3-*")
@pytest.mark.parametrize("depth", [1e-4, 5e-4, 1e-3, 2e-3, 4e-3])
@pytest.mark.parametrize("turn", [0.0, 0.3, 0.7])
def test_a_mesh_is_as_deep_as_its_deepest_triangle(depth, turn):
    """A ball of 5120 triangles with a dent at its back, so that it is not convex."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    dented = np.array(ball.vertices)
    dented[np.argmax(dented[:, 0])] *= 0.8
    mesh = mesh_of(trimesh.Trimesh(dented, ball.faces, process=False))
    T = SE3.from_xyz_rpy((1.3, 0.0, 0.0), (0.0, 0.0, turn))
    nearest = T.apply(dented)[:, 0].min()
    checker = ExactChecker(floating(CollisionObject.single("ball", mesh, T)))
    (contact,) = checker.contacts([nearest - 0.1 + depth])
    assert contact.distance == pytest.approx(-depth, abs=1e-6)


def test_a_round_lid_of_many_corners_is_no_box():
    """A vertex of the lid can get more neighbors than coal's convex shapes allow."""
    lid = trimesh.creation.cylinder(radius=0.3, height=0.1, sections=720)
    T = SE3.from_xyz_rpy((1.3, 0.0, 0.0), (0.0, 0.0, np.pi / 4))  # the bounding box begins at x = 0.876
    checker = ExactChecker(floating(CollisionObject.single("lid", mesh_of(lid), T)))
    assert checker.is_free([0.85])  # the cube ends at x = 0.95
    near = checker.nearest([0.85])
    assert near is not None and near.distance == pytest.approx(0.05, abs=1e-4)
    assert not checker.is_free([0.901])


def test_a_distance_below_a_bound_is_the_distance_itself():
    checker = ExactChecker(ur10())
    for q in np.random.default_rng(0).uniform(-1, 1, (5, checker.model.dof)):
        checker.set_configuration(q)
        for a, b in checker.pairs.tolist():
            distance = checker.pair_distance(a, b)
            assert checker.pair_distance(a, b, below=distance + 0.01) == distance
            assert checker.pair_distance(a, b, below=distance - 0.01) >= distance - 0.01
