"""Arms and grippers found in the tree: by what is known of real robots, and of small ones made for a case."""

from __future__ import annotations

import pytest
from tests.model.helpers import EXAMPLES, collision, joint, link, mbm_file, mbm_robot, model_of

from armcell.core import InputError
from armcell.model import load_robot, load_urdf
from armcell.model.setup import find_chains, parse_srdf, srdf_of, srdf_text, with_groups
from armcell.model.srdf import with_srdf_text

BOX = collision('<box size="0.1 0.1 0.1"/>')


def arm(count: int, prefix: str = "", base: str = "base") -> list[str]:
    """Links and joints of a row hanging from `base`, the last link is {prefix}l{count}."""
    parts, parent = [], base
    for i in range(1, count + 1):
        parts += [link(f"{prefix}l{i}", BOX), joint(f"{prefix}j{i}", parent, f"{prefix}l{i}")]
        parent = f"{prefix}l{i}"
    return parts


def test_panda_and_ur10():
    panda = with_groups(load_robot("panda"))
    assert panda.groups["arm"].joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert (panda.groups["arm"].base_link, panda.groups["arm"].tip_link) == ("panda_link0", "panda_hand_tcp")
    assert panda.groups["gripper"].link_names == ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    end = panda.end_effectors["gripper"]
    assert (end.parent_link, end.parent_group) == ("panda_link8", "arm")
    ur10 = with_groups(load_robot("ur10"))
    assert list(ur10.groups) == ["arm"] and not ur10.end_effectors
    assert ur10.groups["arm"].tip_link == "tool0" and len(ur10.groups["arm"].joint_names) == 6


@pytest.mark.skipif(not EXAMPLES.exists(), reason="example-robot-data is not installed")
def test_two_arms_a_head_and_sliding_fingers():
    baxter = with_groups(load_urdf(EXAMPLES / "baxter_description/urdf/baxter.urdf"))
    assert set(baxter.groups) == {"right_arm", "right_gripper", "left_arm", "left_gripper", "both_arms"}
    assert baxter.groups["left_gripper"].joint_names == ("l_gripper_l_finger_joint",)
    assert len(baxter.groups["both_arms"].joint_names) == 14
    assert "head_pan" not in {n for g in baxter.groups.values() for n in g.joint_names}


@pytest.mark.skipif(not mbm_file("ur5").exists(), reason="MotionBenchMaker's robots are not there")
def test_a_gripper_whose_fingers_are_fixed():
    ur5 = with_groups(mbm_robot("ur5"))
    assert ur5.groups["arm"].tip_link == "robotiq_85_base_link"
    assert ur5.groups["gripper"].joint_names == () and len(ur5.groups["gripper"].link_names) == 9


def test_fingers_on_the_last_link():
    """No palm of its own: the last link of the arm is not moved by the gripper's group."""
    fingers = [part for n in ("a", "b") for part in (
        link(f"finger_{n}", BOX), joint(f"slide_{n}", "l4", f"finger_{n}", "prismatic"))]  # fmt: skip
    model = with_groups(model_of(link("base"), *arm(4), *fingers))
    assert model.groups["arm"].joint_names == ("j1", "j2", "j3", "j4")
    assert model.groups["gripper"].joint_names == ("slide_a", "slide_b")
    assert model.end_effectors["gripper"].parent_link == "l4"
    again = with_srdf_text(model_of(link("base"), *arm(4), *fingers), srdf_text(srdf_of(model)), "x.srdf")
    assert again.groups["gripper"].joint_names == ("slide_a", "slide_b")


def test_a_single_jaw_is_no_joint_of_the_arm():
    model = with_groups(model_of(link("base"), *arm(5), link("jaw", BOX), joint("gripper", "l5", "jaw")))
    assert model.groups["arm"].joint_names == ("j1", "j2", "j3", "j4", "j5")
    assert model.groups["gripper"].joint_names == ("gripper",)


def test_a_torso_belongs_to_no_arm():
    parts = [link("base"), link("chest"), joint("lift", "base", "chest", "prismatic")]
    model = with_groups(model_of(*parts, *arm(6, "left_", "chest"), *arm(6, "right_", "chest")))
    assert set(model.groups) == {"left_arm", "right_arm", "both_arms"}
    assert model.groups["left_arm"].base_link == "chest"


def test_a_cover_that_follows_the_torso_hides_no_arm():
    """Yaskawa's SDA10F: a joint that mimics the torso's joint starts at the same link."""
    mimic = '<axis xyz="0 0 1"/><mimic joint="turn"/>'
    torso = [link("base"), link("chest", BOX), joint("turn", "base", "chest")]
    cover = [link("cover", BOX), joint("follow", "base", "cover", inside=mimic)]
    arms = [*arm(7, "left_", "chest"), *arm(7, "right_", "chest")]
    model = with_groups(model_of(*torso, *cover, *arms))
    assert set(model.groups) == {"left_arm", "right_arm", "both_arms"}


def test_fingers_with_as_many_joints_as_the_arm_are_fingers():
    """TIAGo's hand: four fingers of seven joints and a thumb on an arm with seven joints."""
    fingers = [part for n in "abcd" for part in arm(7, f"{n}_", "palm")]
    parts = [link("base"), *arm(7), link("palm", BOX), joint("wrist", "l7", "palm", "fixed")]
    model = with_groups(model_of(*parts, *fingers, *arm(5, "thumb_", "palm")))
    assert set(model.groups) == {"arm", "gripper"}
    assert len(model.groups["arm"].joint_names) == 7 and len(model.groups["gripper"].joint_names) == 33


def test_a_torso_with_three_arms_is_no_hand():
    arms = [part for n in "abc" for part in arm(6, f"{n}_", "chest")]
    torso = [link("base"), *arm(3), link("chest", BOX), joint("neck", "l3", "chest", "fixed")]
    model = with_groups(model_of(*torso, *arms))
    assert sorted(len(g.joint_names) for g in model.groups.values() if g.tip_link) == [6, 6, 6]


def test_a_head_beside_the_arm_ends_no_arm():
    """Rethink's Sawyer carries its display on the first moving link."""
    head = [link("head", BOX), joint("head_pan", "l1", "head")]
    model = with_groups(model_of(link("base"), *arm(1), *head, *arm(6, "a", "l1")))
    assert model.groups["arm"].joint_names == ("j1", *(f"aj{i}" for i in range(1, 7)))
    assert list(model.groups) == ["arm"]


def test_arms_are_named_by_the_words_that_tell_them_apart():
    """Yaskawa's SDA10F: arm_left_joint_1_s."""
    model = with_groups(model_of(link("base"), *arm(4, "arm_left_x_"), *arm(4, "arm_right_x_")))
    assert set(model.groups) == {"left_x_arm", "right_x_arm", "both_arms"}
    parts = [*arm(4, "arm_left_"), *arm(4, "arm_right_")]
    assert set(with_groups(model_of(link("base"), *parts)).groups) == {"left_arm", "right_arm", "both_arms"}


def test_arms_without_telling_names_are_numbered():
    model = with_groups(model_of(link("base"), *arm(4, "a"), *arm(4, "b"), *arm(4, "c")))
    assert set(model.groups) == {"arm_1", "arm_2", "arm_3", "all_arms"}
    assert model.groups["all_arms"].joint_names == tuple(f"{arm}j{k}" for arm in "abc" for k in (1, 2, 3, 4))


def test_what_does_not_move_is_refused():
    with pytest.raises(InputError, match="has no joint that moves"):
        with_groups(model_of(link("base"), link("top"), joint("j", "base", "top", "fixed")))


def test_a_gripper_alone():
    model = with_groups(load_robot("parallel_gripper"))
    assert find_chains(model) == [] and model.groups["gripper"].joint_names == ("gripper_left_finger_joint",)


@pytest.mark.parametrize("name", ["panda", "ur10_gripper"])
def test_srdf_of_a_model_says_the_same_again(name):
    model = load_robot(name)
    text = srdf_text(srdf_of(model))
    bare = with_srdf_text(model, "<robot name='r'/>", "bare.srdf")
    assert not bare.groups and not bare.disabled_collisions
    again = with_srdf_text(bare, text, "again.srdf")
    for group, old in model.groups.items():
        assert again.groups[group].joint_names == old.joint_names
        assert again.groups[group].tip_link == old.tip_link
    assert again.end_effectors == model.end_effectors
    assert again.disabled_collisions == model.disabled_collisions
    for group, states in model.named_states.items():
        for state, values in states.items():
            assert again.named_states[group][state] == pytest.approx(values, abs=1e-5)
    assert srdf_text(parse_srdf(text, "x")) == text
