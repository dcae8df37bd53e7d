"""An arm with four joints and without a wrist roll: it picks and places objects whatever their turn."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.model.helpers import joint, link, model_of, with_limits
from tests.tasks.helpers import live

from armcell.core import SE3, Box, Cylinder
from armcell.grasping import Rejection, grasp_candidates, hand_of, place_candidates, turned_grasp
from armcell.kinematics import ik_solver
from armcell.model import Gripper, Group, RobotModel
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks import TaskSettings
from armcell.tasks.stages import few_joints
from armcell.tasks.stages.few_joints import TILT, grasps_in_reach, placements_in_reach

EDGE = 0.045  # [m] of the cube, and diameter of the can; the jaws open 80 mm
SETTINGS = TaskSettings(
    approach_distance=0.05, lift_distance=0.05, lower_distance=0.05, retreat_distance=0.05
)
SHAPES = {"cube": Box(EDGE, EDGE, EDGE), "can": Cylinder(EDGE / 2, 0.07)}


def solid(x: float, size: tuple[float, float, float], mass: float) -> str:
    """<inertial> and <collision> of a box whose center is at x."""
    box = f'<origin xyz="{x} 0 0"/>'
    moment = mass * max(size) ** 2 / 6
    return (
        f'<inertial>{box}<mass value="{mass}"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}" '
        f'ixy="0" ixz="0" iyz="0"/></inertial><collision>{box}<geometry>'
        f'<box size="{size[0]} {size[1]} {size[2]}"/></geometry></collision>'
    )


@cache
def planar_arm() -> RobotModel:
    """A turning base, then three parallel joints and two sliding jaws."""
    limit = '<limit lower="{}" upper="{}" velocity="2" effort="{}"/>'
    jaw, parts = solid(0.03, (0.06, 0.01, 0.05), 0.02), [link("l0", solid(0.0, (0.08, 0.08, 0.08), 1.0))]
    chain = [
        ("0 0 0.08", "z", 3.0, solid(0.0, (0.05, 0.05, 0.05), 0.3)),
        ("0 0 0.05", "y", 2.2, solid(0.1, (0.14, 0.04, 0.04), 0.3)),
        ("0.2 0 0", "y", 2.6, solid(0.1, (0.14, 0.04, 0.04), 0.2)),
        ("0.2 0 0", "y", 2.2, solid(0.05, (0.04, 0.1, 0.03), 0.1)),
    ]
    for k, (origin, axis, most, body) in enumerate(chain):
        turn = f'<origin xyz="{origin}"/><axis xyz="{"0 0 1" if axis == "z" else "0 1 0"}"/>'
        parts += [link(f"l{k + 1}", body)]
        parts += [joint(f"j{k + 1}", f"l{k}", f"l{k + 1}", inside=turn, limit=limit.format(-most, most, 50))]
    slide = '<origin xyz="0.07 {} 0"/><axis xyz="0 {} 0"/>'
    mimic = '<mimic joint="left_finger"/>'
    travel = limit.format(0.0, 0.04, 40)
    parts += [link("left", jaw), link("right", jaw)]
    parts += [joint("left_finger", "l4", "left", "prismatic", slide.format(0.005, 1), travel)]
    parts += [joint("right_finger", "l4", "right", "prismatic", slide.format(-0.005, -1) + mimic, travel)]
    parts += [
        link("tcp"),
        joint("tcp_joint", "l4", "tcp", "fixed", '<origin xyz="0.11 0 0" rpy="0 1.5707963 0"/>'),
    ]
    model = model_of(*parts)
    arm, links = tuple(f"j{k}" for k in (1, 2, 3, 4)), tuple(model.links)
    groups = {
        "arm": Group("arm", arm, (*links[:5], "tcp"), "l0", "tcp"),
        "hand": Group("hand", ("left_finger",), ("left", "right")),
    }
    touching = [*itertools.pairwise(links[:5]), ("l4", "left"), ("l4", "right"), ("left", "right")]
    gripper = Gripper(
        name="hand", arm_group="arm", group="hand", joint_name="left_finger", tcp_link="tcp",
        finger_links=("left", "right"), hand_links=("l4", "left", "right"), width_per_joint=2.0,
        max_width=0.08, finger_depth=0.03, pad_depth=0.015,
    )  # fmt: skip
    ready = dict(zip(arm, (0.0, -0.9, 1.4, 0.8), strict=True))
    return with_limits(
        replace(
            model,
            groups=groups,
            grippers={"hand": gripper},
            named_states={"arm": {"ready": ready}},
            disabled_collisions={frozenset(pair): "Adjacent" for pair in touching},
        )
    )


def scene_with(kind: str, yaw: float, x: float = 0.26, y: float = 0.05) -> PlanningScene:
    """The arm beside a turned object on a table, and a mat."""
    shape = SHAPES[kind]
    high = EDGE if kind == "cube" else 0.07
    table = CollisionObject.single("table", Box(1.2, 1.2, 0.04), SE3.from_xyz(0, 0, -0.062))
    mat = CollisionObject.single("mat", Box(0.14, 0.14, 0.004), SE3.from_xyz(0.1, 0.26, -0.04))
    pose = SE3.from_xyz_rpy((x, y, -0.0415 + high / 2), (0.0, 0.0, yaw))
    item = CollisionObject.single("item", shape, pose, movable=True, mass=0.05)
    scene = PlanningScene.of(planar_arm(), objects=[table, mat, item])
    return scene.with_state(planar_arm().named_state("arm", "ready"))


def gripper() -> Gripper:
    return planar_arm().gripper()


@pytest.mark.slow
@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("yaw", (0.0, 0.3, -0.7))
def test_some_grasp_is_in_reach_whatever_the_turn(kind, yaw):
    scene = scene_with(kind, yaw)
    item, ik = scene.object("item"), ik_solver(planar_arm(), gripper().arm_group, gripper().tcp_link)
    grasps, _ = grasp_candidates(item, hand_of(planar_arm(), gripper()))
    rejected: dict[str, str] = {}
    found = grasps_in_reach(scene, gripper(), item, grasps, 40, rejected.__setitem__)
    assert found and len({grasp.name for grasp in found}) == len(found)
    assert not rejected.keys() & {grasp.name for grasp in found} and all(rejected.values())
    assert [g.score for g in found] == sorted((g.score for g in found), reverse=True)
    for grasp in found:
        T_world_tcp = item.T_world_object @ grasp.T_object_tcp
        assert ik.solve(T_world_tcp, scene.positions).ok
        assert abs(T_world_tcp.rotation.matrix[2, 1]) < TILT  # this arm closes along the horizontal
        assert EDGE - 1e-3 < grasp.width <= grasp.opening <= gripper().max_width


def test_a_grasp_with_a_replacement_is_not_rejected(monkeypatch):
    """Of two rotations of one grasp, the gripper holds the object only at the first."""
    scene = scene_with("cube", 0.3)
    item = scene.object("item")
    grasp = grasp_candidates(item, hand_of(planar_arm(), gripper()))[0][0]
    answers = [replace(grasp, name="turned"), Rejection("turned", "too wide", 1, 0.0)]
    monkeypatch.setattr(few_joints, "_rotated_grasps", lambda *_: iter(answers))
    rejected: dict[str, str] = {}
    found = few_joints.grasps_in_reach(scene, gripper(), item, [grasp], 1, rejected.__setitem__)
    assert [g.name for g in found] == ["turned"] and not rejected


def turned(kind: str, degrees: float, item: CollisionObject | None = None, name: str = ""):
    """The best grasp from above or the grasp `name`, with the hand turned about the vertical."""
    item = item or scene_with(kind, 0.0).object("item")
    hand = hand_of(planar_arm(), gripper())
    grasp = next(g for g in grasp_candidates(item, hand)[0] if g.name == name or not name)
    axis = SE3.from_xyz(*grasp.T_object_tcp.translation)
    turn = axis @ SE3.from_xyz_rpy((0, 0, 0), (0, 0, np.deg2rad(degrees))) @ axis.inverse()
    return grasp, turned_grasp(item, hand, grasp, "turned", turn @ grasp.T_object_tcp, np.deg2rad(degrees))


@pytest.mark.parametrize("degrees", (15.0, 40.0))
@pytest.mark.parametrize("friction", (0.2, 0.8))
def test_jaws_turn_a_smooth_cube_and_hold_a_rough_one_by_its_edges(degrees, friction):
    """The line between the edges is in both friction cones if the friction is high enough."""
    item = scene_with("cube", 0.0).object("item")
    item = replace(item, material=replace(item.material, friction=friction))
    grasp, other = turned("cube", degrees, item)
    assert not isinstance(other, Rejection) and other.score < grasp.score
    across = EDGE * (np.cos(np.deg2rad(degrees)) + np.sin(np.deg2rad(degrees)))
    assert other.opening > across
    assert other.width == pytest.approx(grasp.width if friction == 0.2 else across, abs=2e-3)


@pytest.mark.parametrize(("name", "degrees", "holds"), [
    ("top across x", 8.0, True),  # its diagonal is at atan(20/60) = 18 deg
    ("top across x", 30.0, False),
    ("top across x", -40.0, False),
    ("top across y", 40.0, True),
])  # fmt: skip
def test_jaws_turn_a_long_box_to_its_narrow_side(name, degrees, holds):
    item = CollisionObject.single("item", Box(0.06, 0.02, 0.05), movable=True, mass=0.05)
    item = replace(item, material=replace(item.material, friction=0.1))
    grasp, other = turned("cube", degrees, item, name)
    assert grasp.width == pytest.approx(0.06 if name.endswith("x") else 0.02, abs=1e-3)
    if holds:
        assert not isinstance(other, Rejection) and other.width == grasp.width
    else:
        assert isinstance(other, Rejection) and "slips off" in other.reason


def test_a_can_is_held_alike_however_the_hand_turns_about_it():
    for degrees in (10.0, 45.0, 100.0):
        grasp, other = turned("can", degrees)
        assert not isinstance(other, Rejection)
        assert other.width == pytest.approx(grasp.width, abs=5e-4)
        assert other.score == pytest.approx(grasp.score, abs=0.05)


def test_a_turned_cube_that_is_too_wide_is_refused_with_its_width():
    wide = CollisionObject.single("item", Box(0.07, 0.07, 0.05), movable=True, mass=0.05)
    _, other = turned("cube", 30.0, wide)
    assert isinstance(other, Rejection) and "mm wide, the gripper opens 80 mm" in other.reason


@pytest.mark.parametrize("lean", (0.0, 0.01))
def test_placements_turn_to_what_the_arm_reaches_and_release_above_the_mat(lean):
    scene = scene_with("cube", 0.3)
    tcp = scene.frame_pose(gripper().tcp_link)
    down = SE3.from_xyz_rpy((0.0, 0.0, 0.0), (lean, -np.pi / 2, 0.3))  # the cube's z against the hand's z
    item = scene.object("item").at(tcp @ down)
    scene = scene.with_object(item).with_attached("item", gripper().tcp_link, gripper().hand_links)
    support, item = scene.object("mat"), scene.object("item")
    ik = ik_solver(planar_arm(), gripper().arm_group, gripper().tcp_link)
    T_tcp_item = scene.frame_pose(gripper().tcp_link).inverse() @ scene.frame_pose("item")
    placed = 0
    for placement in place_candidates(item, support)[:5]:
        for other, released, _ in placements_in_reach(scene, gripper(), item, support, placement):
            placed += 1
            assert ik.solve(released @ T_tcp_item.inverse(), scene.positions).ok
            rise = released.translation[2] - other.T_world_object.translation[2]
            assert 0 < rise < 0.006
            assert (
                np.arccos(min(1.0, released.rotation.matrix[2] @ other.T_world_object.rotation.matrix[2]))
                < 2 * TILT
            )
    assert placed


@pytest.mark.slow
@pytest.mark.parametrize("kind", SHAPES)
def test_a_turned_object_is_picked_and_placed(kind):
    with live("fake", scene_with(kind, 0.5), SETTINGS) as cell:
        picked = cell.arm.pick("item")
        assert picked.ok, picked.message
        placed = cell.arm.place("item", "mat")
        assert placed.ok, placed.message


@pytest.mark.slow
def test_a_given_pose_whose_turn_is_out_of_reach_is_refused_with_the_reason():
    with live("fake", scene_with("cube", 0.0), SETTINGS) as cell:
        was = cell.scene().object("item").T_world_object
        assert cell.arm.pick("item").ok
        pose = SE3.from_xyz_rpy(was.translation, (0.0, 0.0, 0.6))
        outcome = cell.arm.place("item", "table", pose=pose)
        assert not outcome.ok and "4 joints, in reach only with the object turned by" in outcome.message
        assert cell.arm.place("item", "table", pose=was).ok


@pytest.mark.long
@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("friction", (0.2, 0.8))
@pytest.mark.parametrize("seed", range(6))
def test_a_turned_object_is_picked_and_placed_in_physics(kind, friction, seed):
    rng = np.random.default_rng(seed)
    scene = scene_with(kind, float(rng.uniform(-np.pi, np.pi)), 0.26 + rng.uniform(-0.02, 0.02), 0.05)
    item = scene.object("item")
    scene = scene.with_object(replace(item, material=replace(item.material, friction=friction)))
    with live("sim", scene, SETTINGS) as cell:
        picked = cell.arm.pick("item")
        assert picked.ok, picked.message
        placed = cell.arm.place("item", "mat")
        assert placed.ok, placed.message
        goal, at = placed.evidence["placement"].T_world_object, cell.driver.object_poses()["item"]
        assert np.linalg.norm(at.translation - goal.translation) < SETTINGS.placement_tolerance
