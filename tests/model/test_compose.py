"""Several robots as one: prefixes, mounting, clashes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.model.helpers import dual, joint, link, model_of
from tests.sizes import ROBOTS

from armcell.core import SE3, Box, InputError, UnknownNameError
from armcell.model import (
    Collision,
    Joint,
    Link,
    MountedRobot,
    RobotModel,
    compose,
    installed_robots,
    load_robot,
    prefixed,
)
from armcell.model.composition import with_whole_fingers


def test_two_arms_have_prefixed_names_throughout():
    single, both = load_robot("ur10_gripper"), dual()
    assert both.root_link == "world" and both.dof == 2 * single.dof
    for table in ("groups", "grippers", "named_states", "end_effectors"):
        expected = {p + name for p in ("left_", "right_") for name in getattr(single, table)}
        assert set(getattr(both, table)) == expected
    for prefix in ("left_", "right_"):
        group, gripper = both.group(prefix + "arm"), both.gripper(prefix + "gripper")
        assert group.joint_names == tuple(prefix + n for n in single.group("arm").joint_names)
        assert group.tip_link == prefix + "gripper_tcp" and group.base_link == prefix + "base_link"
        assert gripper.arm_group == prefix + "arm" and gripper.joint_name in both.joint_names
        assert {gripper.tcp_link, *gripper.finger_links, *gripper.hand_links} <= set(both.links)
        assert both.gripper(arm_group=prefix + "arm") is gripper
        home = both.named_state(prefix + "arm", "home").as_dict()
        assert home == {prefix + k: v for k, v in single.named_state("arm", "home").as_dict().items()}
        right = both.joints[prefix + "gripper_right_finger_joint"]
        assert right.mimic.joint == prefix + "gripper_left_finger_joint"
    assert len(both.disabled_collisions) == 2 * len(single.disabled_collisions)
    with pytest.raises(InputError, match="2 grippers"):
        both.gripper()


@pytest.mark.cases(*ROBOTS, "ur10_rail")
@pytest.mark.parametrize("name", installed_robots())
def test_a_prefix_changes_nothing_but_names(name):
    model = load_robot(name)
    other = prefixed(model, "x_")
    assert prefixed(model, "") is model
    assert other.joint_names == tuple("x_" + n for n in model.joint_names)
    assert list(other.links) == ["x_" + n for n in model.links]
    for old, new in zip(model.joints.values(), other.joints.values(), strict=True):
        assert (old.type, old.axis, old.limits) == (new.type, new.axis, new.limits)
        assert (new.parent, new.child) == ("x_" + old.parent, "x_" + old.child)
    assert other.default_positions() == pytest.approx(model.default_positions())


def test_names_clash_without_prefixes():
    arm = load_robot("ur10")
    with pytest.raises(InputError, match=r"two parts have 'base'.*prefix"):
        compose(
            "two",
            [MountedRobot(arm), MountedRobot(arm, parent_link="world", T_parent_root=SE3.from_xyz(1, 0, 0))],
        )


def test_groups_clash_too():
    a, b = (model_of(link(n + "0"), link(n + "1"), joint(n, n + "0", n + "1")) for n in "ab")
    from dataclasses import replace

    from armcell.model import Group

    a, b = (replace(m, groups={"arm": Group("arm", m.joint_names, ())}) for m in (a, b))
    with pytest.raises(InputError, match="two parts have group 'arm'"):
        compose("two", [MountedRobot(a), MountedRobot(b)])


def test_a_part_is_mounted_on_a_link():
    arm, hand = load_robot("ur10"), load_robot("parallel_gripper")
    T = SE3.from_xyz_rpy((0.0, 0.0, 0.1), (0.0, 0.0, 1.0))
    whole = compose("whole", [MountedRobot(arm), MountedRobot(hand, "g_", "tool0", T)])
    mount = whole.parent_joint["g_" + hand.root_link]
    assert (mount.type, mount.parent, whole.root_link) == ("fixed", "tool0", arm.root_link)
    assert mount.T_parent_joint.isclose(T)
    assert whole.joint_names == (*arm.joint_names, *("g_" + n for n in hand.joint_names))


def test_a_single_part_away_from_the_origin_gets_a_world():
    model = compose("one", [MountedRobot(load_robot("ur10"), T_parent_root=SE3.from_xyz(0, 0, 1))])
    assert model.root_link == "world"
    assert compose("one", [MountedRobot(load_robot("ur10"))]).root_link == "base_link"


def test_mistakes_are_named():
    arm, hand = load_robot("ur10"), load_robot("parallel_gripper")
    with pytest.raises(UnknownNameError, match=r"unknown link 'tool'.*did you mean 'tool0'"):
        compose("whole", [MountedRobot(arm), MountedRobot(hand, "", "tool")])
    with pytest.raises(InputError, match="no parts"):
        compose("nothing", [])


def _with_tips() -> RobotModel:
    """A UR10 whose gripper has a box of 10 mm fixed to the end of each finger."""
    model = load_robot("ur10_gripper")
    links, joints = dict(model.links), dict(model.joints)
    for side in ("left", "right"):
        finger, tip = f"gripper_{side}_finger", f"{side}_tip"
        links[tip] = Link(tip, collisions=(Collision(Box(0.01, 0.01, 0.01), SE3.identity()),))
        joints[tip] = Joint(tip, "fixed", finger, tip, SE3.from_xyz(0.0, 0.0, 0.1))
    return replace(model, links=links, joints=joints)


def test_a_finger_has_the_shapes_of_its_tip():
    model = with_whole_fingers(_with_tips())
    for side in ("left", "right"):
        *_, tip = model.links[f"gripper_{side}_finger"].collisions
        assert tip.T_link_shape.translation == pytest.approx((0.0, 0.0, 0.1))
        assert model.links[f"{side}_tip"].collisions == ()
    assert with_whole_fingers(model) is model  # nothing is left to move


@pytest.mark.parametrize(
    ("finger", "tip", "expected"),
    [
        ("Never", "Never", "Never"),
        ("Never", None, None),  # the tip can touch it
        ("Adjacent", None, "Adjacent"),
        (None, "Default", "Default"),
    ],
)
def test_the_pairs_of_a_finger_hold_for_its_tip(finger, tip, expected):
    links = {"gripper_left_finger": finger, "left_tip": tip}
    pairs = {frozenset((name, "gripper_base")): reason for name, reason in links.items() if reason}
    model = replace(_with_tips(), disabled_collisions=pairs)
    found = with_whole_fingers(model).disabled_collisions
    assert found.get(frozenset(("gripper_left_finger", "gripper_base"))) == expected
