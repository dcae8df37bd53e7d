"""Grippers that setup finds: opening, closing direction, tool center and force of real and of made hands."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from tests.model.helpers import collision, joint, link, model_of, robot

from armcell.cell.gripper_proof import prove_gripper
from armcell.core import InputError, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, Mimic, RobotModel, load_robot, parse_urdf
from armcell.model.setup import with_groups
from armcell.model.setup.follower import with_follower_text, with_limits_text
from armcell.model.setup.gripper_detection import GripperSpec, find_grippers, reasons

SHARED = Path(__file__).parents[3].joinpath("shared", "data", "robots").resolve()
GEN3 = {"arm": "gen3", "dof": "7", "gripper": "robotiq_2f_85", "name": "gen3", "vision": "false"}
XARM = {"dof": "6", "add_gripper": "true"}
HANDS = {  # file, xacro arguments, the maker's opening [m], its tolerance, driven joint when closed
    "2F-85": ("kortex_description/robots/kinova.urdf.xacro", GEN3, 0.085, 0.002, 0.8),
    "xArm": ("xarm_description/urdf/xarm_device.urdf.xacro", XARM, 0.086, 0.004, 0.85),
    "Franka": ("franka_description/robots/fr3/fr3.urdf.xacro", {}, 0.080, 0.001, 0.0),
    "SO-101": ("so101/Simulation/SO101/so101_new_calib.urdf", {}, 0.055, 0.010, -0.1745),
}  # fmt: skip


@lru_cache
def hand(name: str) -> RobotModel:
    file, args, *_ = HANDS[name]
    if not (SHARED / file).exists():
        pytest.skip("no shared data")
    return find_grippers(with_groups(load_robot(SHARED / file, xacro_args=args)))


def only(model: RobotModel) -> Gripper:
    return model.gripper()


@pytest.mark.slow
@pytest.mark.cases("2F-85", "xArm", "Franka")
@pytest.mark.parametrize("name", HANDS)
def test_opening_and_closed_end_are_the_maker_s(name, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(SHARED))
    gripper, (_, _, opening, tolerance, closed) = only(hand(name)), HANDS[name]
    assert gripper.max_width == pytest.approx(opening, abs=tolerance)
    assert gripper.joint_position(0.0) == pytest.approx(closed, abs=0.02)
    for width in np.linspace(0.1, 1.0, 5) * gripper.max_width:
        assert gripper.width(gripper.joint_position(width)) == pytest.approx(width, abs=1e-6)


@pytest.mark.parametrize("name", HANDS)
def test_the_jaws_close_along_y_around_the_grip_center(name, monkeypatch):
    """By forward kinematics of every jaw: symmetric about the center, z out of the hand."""
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(SHARED))
    model = hand(name)
    gripper, tree = only(model), kinematic_tree(model)
    column = model.columns((gripper.joint_name,))

    def jaws(width: float) -> list[np.ndarray]:
        q = model.default_positions()
        q[column] = gripper.joint_position(width)
        T = tree.link_pose(q, gripper.tcp_link) @ gripper.center(width)
        return [T.inverse().apply(tree.link_pose(q, n).translation) for n in gripper.finger_links]

    small, wide = jaws(0.3 * gripper.max_width), jaws(0.6 * gripper.max_width)
    opened = [b[1] - a[1] for a, b in zip(small, wide, strict=True)]
    if name != "SO-101":  # whose moving jaw turns about its link's origin
        assert opened[0] == pytest.approx(-opened[1], abs=1e-3)
        assert abs(opened[0]) == pytest.approx(0.15 * gripper.max_width, abs=1e-3)
    palm = tree.link_pose(model.default_positions(), gripper.hand_links[0])
    tcp = tree.link_pose(model.default_positions(), gripper.tcp_link)
    assert (tcp.translation - palm.translation) @ tcp.rotation.matrix[:, 2] > 0.02


@pytest.mark.slow
@pytest.mark.cases("2F-85", "Franka")
@pytest.mark.parametrize("name", HANDS)
def test_the_hand_holds_a_cube(name, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(SHARED))
    model = hand(name)
    proof = prove_gripper(model, only(model))
    assert proof.held, proof.text
    assert "holds a cube" in proof.text


def test_one_driven_joint_of_the_so101_is_the_gripper_s(monkeypatch):
    model = hand("SO-101")
    assert model.groups["arm"].joint_names[-1] == "wrist_roll"
    assert model.groups["gripper"].joint_names == ("gripper",)


# --- hands made for a case ---
BOX = collision('<box size="0.05 0.05 0.05"/>')
ARM = [link("base")] + [
    part
    for i in range(1, 5)
    for part in (link(f"l{i}", BOX),
                 joint(f"j{i}", "base" if i == 1 else f"l{i - 1}", f"l{i}"))
]  # fmt: skip
LIMIT = '<limit lower="{}" upper="{}" velocity="0.1" effort="50"/>'
JAW = '<collision><origin xyz="0 {} 0.04"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision>'


def jaw_parts(lower: float, upper: float, second: str, axis: str = "0 1 0", gap: float = 0.005) -> list[str]:
    """Two sliding jaws on the last link of an arm; `second` is the second jaw's <axis> and <mimic>."""
    inside, limit = '<origin xyz="0 0 0.03"/>', LIMIT.format(lower, upper)
    return [
        *ARM,
        link("left", JAW.format(gap)),
        link("right", JAW.format(-gap)),
        joint("left_finger", "l4", "left", "prismatic", f'{inside}<axis xyz="{axis}"/>', limit),
        joint("right_finger", "l4", "right", "prismatic", inside + second, limit),
    ]


def made(*jaws, **options) -> RobotModel:
    return with_groups(model_of(*jaw_parts(*jaws, **options)))


MIRRORED = '<axis xyz="0 -1 0"/><mimic joint="left_finger"/>'


def test_a_reversed_joint_is_not_inverted():
    """A joint whose lower limit is the open end: the gripper closes toward its upper limit."""
    opened = find_grippers(made(0.0, 0.03, MIRRORED))
    assert only(opened).width(0.03) == pytest.approx(0.06, abs=1e-4)
    turned = find_grippers(made(0.0, 0.03, MIRRORED.replace("-1 0", "1 0"), "0 -1 0", gap=0.035))
    assert only(turned).joint_position(0.0) == pytest.approx(0.03, abs=1e-3)
    assert only(turned).width(0.0) == pytest.approx(0.06, abs=1e-3)


@pytest.mark.parametrize(
    ("second", "limits", "reason"),
    [
        ('<axis xyz="0 1 0"/><mimic joint="left_finger"/>', (0.0, 0.03), "no two of its moving links"),
        ('<axis xyz="0 -1 0"/>', (0.0, 0.03), "2 driven joints (left_finger, right_finger)"),
        (MIRRORED, (0.02, 0.02), "cannot move: lower and upper limit are equal"),
    ],
)
def test_a_gripper_that_is_none_states_the_reason(second, limits, reason, caplog):
    model = find_grippers(made(*limits, second))
    assert not model.grippers
    assert reason in reasons(model)["gripper"] and reason in caplog.text


FINGERS = ("finger_a", "finger_b", "finger_c")


def test_jaws_that_would_overlap_at_the_limit_are_closed_where_they_touch():
    """Rotating jaws whose limits are wider than their motion, as in the description of a Stretch."""
    turning = '<origin xyz="0 {} 0.03"/><axis xyz="1 0 0"/>'
    jaw = '<collision><origin xyz="0 0 0.05"/><geometry><box size="0.02 0.01 0.1"/></geometry></collision>'
    parts = [
        *ARM,
        link("left", jaw),
        link("right", jaw),
        joint("left_finger", "l4", "left", "revolute", turning.format(0.02), LIMIT.format(-0.6, 0.6)),
        joint(
            "right_finger", "l4", "right", "revolute",
            turning.format(-0.02) + '<mimic joint="left_finger" multiplier="-1"/>', LIMIT.format(-0.6, 0.6),
        ),
    ]  # fmt: skip
    gripper = only(find_grippers(with_groups(model_of(*parts))))
    touch = 0.15  # 0.1 sin(q) = 0.02 - 0.005 cos(q): the inner edges of the ends meet
    assert gripper.joint_position(0.0) == pytest.approx(touch, abs=0.01)
    assert gripper.joint_position(gripper.max_width) == pytest.approx(touch - np.deg2rad(40), abs=0.03)
    assert gripper.max_width == pytest.approx(
        2 * 0.1 * (np.sin(np.deg2rad(40) - touch) + np.sin(touch)), abs=0.01
    )


@pytest.mark.parametrize(("axis", "multiplier"), (("0 -1 0", 1.0), ("0 1 0", -1.0)))
def test_a_follower_moves_its_jaw_toward_the_other(axis, multiplier):
    parts = jaw_parts(0.0, 0.03, f'<axis xyz="{axis}"/>')
    text = with_follower_text(robot(*parts), model_of(*parts), "left_finger", "right_finger")
    coupled = parse_urdf(text, Path("/tmp/r.urdf"))
    assert coupled.joints["right_finger"].mimic == Mimic("left_finger", multiplier)
    gripper = only(find_grippers(with_groups(coupled)))
    assert gripper.joint_name == "left_finger" and set(gripper.finger_links) == {"left", "right"}


def test_limits_of_fingers_that_the_file_sets_to_zero_can_be_stated():
    """As in the URDF of the Stretch 3: both finger joints have the limits 0 and 0, and no <mimic>."""
    parts = jaw_parts(0.0, 0.0, '<axis xyz="0 1 0"/>')
    why = reasons(with_groups(model_of(*parts)))["gripper"]
    assert "joint left_finger, right_finger cannot move" in why and "range=LOWER,UPPER" in why
    fact = GripperSpec.parse("drive=left_finger range=0,0.03 follower=right_finger")
    text = with_limits_text(robot(*parts), fact.drive, *fact.range)
    text = with_follower_text(text, parse_urdf(text, Path("/tmp/r.urdf")), fact.drive, fact.follower)
    coupled = parse_urdf(text, Path("/tmp/r.urdf"))
    limits = coupled.joints["right_finger"].limits
    assert (limits.lower, limits.upper) == (-0.03, 0.0)
    assert only(find_grippers(with_groups(coupled))).max_width > 0.05
    for text, reason in (
        ("range=0,1", "range needs drive"),
        ("drive=a range=1", "does not have the form"),
        ("drive=a range=1,0", "does not have the form"),
    ):
        with pytest.raises(InputError, match=reason):
            GripperSpec.parse(text)
    with pytest.raises(UnknownNameError, match="unknown joint 'x'"):
        with_limits_text(robot(*parts), "x", 0.0, 1.0)


def test_a_follower_must_be_another_driven_joint_of_a_jaw():
    parts = jaw_parts(0.0, 0.03, '<axis xyz="0 -1 0"/>')
    model, text = model_of(*parts), robot(*parts)
    for drive, follower, reason in (
        ("left_finger", "left_finger", "cannot follow itself"),
        ("left_finger", "right", "unknown driven joint 'right'"),
        ("left_finger", "j4", "j4 also moves the link that left_finger moves"),
    ):
        with pytest.raises(InputError, match=reason):
            with_follower_text(text, model, drive, follower)
    turning = [part.replace("prismatic", "revolute") if '"right_finger"' in part else part for part in parts]
    with pytest.raises(InputError, match="left_finger slides, and joint right_finger rotates"):
        with_follower_text(robot(*turning), model_of(*turning), "left_finger", "right_finger")
    with pytest.raises(InputError, match="follower needs drive"):
        GripperSpec.parse("follower=right_finger")


def three_fingers(spread: float = 120.0) -> RobotModel:
    """Three sliding fingers that close toward the hand's axis, one driven, the others coupled."""
    parts = []
    for k, (name, angle) in enumerate(zip(FINGERS, (0.0, spread, -spread), strict=True)):
        origin = f'<origin xyz="0 0 0.03" rpy="0 0 {np.radians(angle)}"/><axis xyz="1 0 0"/>'
        mimic = "" if k == 0 else f'<mimic joint="{FINGERS[0]}_joint"/>'
        box = '<geometry><box size="0.01 0.03 0.06"/></geometry>'
        parts += [
            link(name, f'<collision><origin xyz="0.005 0 0.04"/>{box}</collision>'),
            joint(f"{name}_joint", "l4", name, "prismatic", origin + mimic, LIMIT.format(0.0, 0.03)),
        ]
    return with_groups(model_of(*ARM, *parts))


def test_three_fingers_that_close_toward_a_center_are_not_two_jaws():
    model = three_fingers()
    assert not find_grippers(model).grippers
    reason = reasons(model)["gripper"]
    assert "3 fingers close toward a common center (finger_a, finger_b, finger_c)" in reason
    assert "pass --gripper fingers=A,B+C" in reason


def test_stated_sides_of_three_fingers_are_jaws_if_they_face_each_other():
    model = three_fingers(spread=180.0 - 15.0)
    sides = GripperSpec.parse("fingers=finger_a,finger_b+finger_c")
    gripper = only(find_grippers(model, stated=[sides]))
    assert set(gripper.finger_links) == set(FINGERS)
    assert gripper.max_width == pytest.approx(0.056, abs=0.003)  # pads at an angle of 15 degrees
    assert gripper.joint_position(0.0) == pytest.approx(0.0, abs=0.005)


def test_three_driven_fingers_state_what_to_add_to_the_description():
    parts = [link(n, JAW.format(0)) for n in FINGERS]
    parts += [joint(f"{n}_joint", "l4", n, "revolute", inside='<axis xyz="1 0 0"/>') for n in FINGERS]
    model = with_groups(model_of(*ARM, *parts))
    assert "3 driven joints" in (text := reasons(model)["gripper"]) and "<mimic" in text
    with pytest.raises(
        InputError, match="moves finger finger_b by itself, but one joint must move both jaws"
    ):
        find_grippers(model, stated=[GripperSpec.parse("drive=finger_a_joint fingers=finger_a,finger_b")])


@pytest.mark.slow
def test_a_ridge_inside_the_jaws_is_not_the_pad():
    """Jaws that meet at a ridge in their middle hold an object between the flat surfaces at their ends."""
    parts = jaw_parts(0.0, 0.03, MIRRORED, gap=0.008)  # flat surfaces 6 mm apart when closed
    ridge = (
        '<collision><origin xyz="0 {} 0.026"/><geometry><box size="0.02 0.01 0.004"/></geometry></collision>'
    )
    for k, part in enumerate(parts):
        for side, y in (("left", 0.005), ("right", -0.005)):
            if part.startswith(f'<link name="{side}"'):
                parts[k] = part.replace("</link>", ridge.format(y) + "</link>")
    gripper = only(find_grippers(with_groups(model_of(*parts))))
    assert gripper.width(0.0) == pytest.approx(0.006, abs=2e-4)
    assert gripper.max_width == pytest.approx(0.066, abs=2e-4)
    low_x, low_z, high_x, high_z = gripper.pad
    assert (high_x - low_x, high_z - low_z) == pytest.approx((0.02, 0.024), abs=2e-3)
    assert gripper.pad_depth == pytest.approx(0.012, abs=2e-3)  # half of the pad is beyond the tcp


def test_of_several_driven_joints_the_one_that_moves_both_jaws_drives():
    """A motor's horn turns by itself (Interbotix): the jaws are coupled to another joint."""
    horn = [link("horn", BOX), joint("horn_joint", "l4", "horn")]
    model = with_groups(model_of(*jaw_parts(0.0, 0.03, MIRRORED), *horn))
    assert model.groups["gripper"].joint_names == ("left_finger", "horn_joint")
    assert only(find_grippers(model)).joint_name == "left_finger"


def test_stated_facts_that_are_true_change_nothing():
    model = made(0.0, 0.03, MIRRORED)
    found = only(find_grippers(model))
    text = f"end=gripper drive=left_finger fingers=left,right closes=lower tcp={found.tcp_link}"
    stated = find_grippers(find_grippers(model), stated=[GripperSpec.parse(text)])
    assert only(stated) == found


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("closes=upper", "does not close toward the upper limit: its jaws are 0 mm apart at the lower limit"),
        ("drive=j2", "j2 is not a driven joint of it; those are left_finger"),
        ("fingers=left,l1", "finger l1 is not a link below the palm l4"),
        ("tcp=left", "tcp left is not fixed to the palm l4"),
        ("tcp=l4", "tcp l4 is not between the pads"),
        ("closes=up", "closes is 'lower' or 'upper'"),
        ("fingers=left", "fingers needs two sides"),
        ("closes", "'closes' is not KEY=VALUE"),
        ("closes=lower closes=lower", "is not KEY=VALUE, once per key"),
    ],
)
def test_stated_facts_that_the_meshes_contradict_are_errors(text, reason):
    with pytest.raises(InputError, match=re.escape(reason)):
        find_grippers(made(0.0, 0.03, MIRRORED), stated=[GripperSpec.parse(text)])


@pytest.mark.parametrize("text", ["closing=lower", "end=hand", "tcp=palm", "fingers=left,palm"])
def test_unknown_names_in_stated_facts_list_the_known_names(text):
    with pytest.raises(UnknownNameError):
        find_grippers(made(0.0, 0.03, MIRRORED), stated=[GripperSpec.parse(text)])


def test_a_closed_end_that_is_not_clear_is_asked_for():
    """A jaw that turns by a whole turn is closed at both limits."""
    limit = LIMIT.format(0.0, 2 * np.pi)
    box = (
        '<collision><origin xyz="0 0.01 0.04"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision>'
    )
    fixed = (
        '<collision><origin xyz="0 -0.01 0.06"/><geometry><box size="0.02 0.01 0.1"/></geometry></collision>'
    )
    jaw = [
        link("palm", fixed), joint("mount", "l4", "palm", "fixed"),
        link("jaw", box), joint("jaw_joint", "palm", "jaw", "revolute", '<axis xyz="1 0 0"/>', limit),
    ]  # fmt: skip
    model = with_groups(model_of(*ARM, *jaw))
    assert "its closed end is not clear" in (text := reasons(model)["gripper"])
    assert "pass --gripper closes=lower or closes=upper" in text


def test_a_jaw_with_an_untypical_name_is_found_if_its_joint_is_stated():
    jaw = [
        link("palm", JAW.format(-0.005)), joint("mount", "l4", "palm", "fixed"),
        link("l5", JAW.format(0.005)),
        joint("j5", "palm", "l5", "prismatic", '<axis xyz="0 1 0"/>', LIMIT.format(0.0, 0.04)),
    ]  # fmt: skip
    model = model_of(*ARM, *jaw)
    assert not with_groups(model).end_effectors
    gripper = only(find_grippers(with_groups(model, jaws=("j5",)), stated=[GripperSpec.parse("drive=j5")]))
    assert gripper.max_width == pytest.approx(0.04, abs=1e-3)
    assert gripper.finger_links == ("l5", "palm")


@pytest.mark.slow
def test_a_curve_is_checked(tmp_path):
    from tests.cell.test_setup import small_arm

    small_arm(tmp_path)
    (tmp_path / "robot.yaml").write_text(
        "urdf: small.urdf\nframes: {tool: {parent_link: l3, pose: [0, 0, 0.1]}}\n"
        "grippers: {g: {arm_group: a, group: a, joint_name: j3, tcp_link: tool, finger_links: [l2, l3],"
        " hand_links: [l3], curve: [[0, 0.1, 0, 0], [1, 0.0, 0, 0]]}}\n"
    )
    with pytest.raises(InputError, match="curve must go from closed to open"):
        load_robot(tmp_path)
    text = (tmp_path / "robot.yaml").read_text()
    text = text.replace("[0, 0.1, 0, 0], [1, 0.0", "[0, 0.0, 0, 0], [1, 0.06")
    (tmp_path / "robot.yaml").write_text(text)
    with pytest.raises(InputError, match=r"max_width is 0.08 m, but the curve ends at 0.06 m"):
        load_robot(tmp_path)
