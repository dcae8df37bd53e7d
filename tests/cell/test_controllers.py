"""The cell file's `controllers:` block."""

import pytest
import yaml

from armcell.cell import load
from armcell.core import InputError


def loaded(tmp_path, robot, text):
    file = tmp_path / "lab.yaml"
    file.write_text(f"robot: {robot}\ncontrollers:\n{text}")
    return load(file)


def test_names_as_ros_has_them_by_default(tmp_path):
    cell = loaded(
        tmp_path, "panda",
        "  panda_arm_controller: {}\n  /hand/hand_controller: {type: GripperCommand}\n",
    )  # fmt: skip
    arm, hand = cell.controllers
    assert arm.topic == "/panda_arm_controller/follow_joint_trajectory"
    assert arm.joints == cell.model.group("arm").joint_names  # the only arm
    assert hand.topic == "/hand/hand_controller/gripper_cmd" and not hand.gives_width
    assert hand.joints == (cell.model.grippers["hand"].joint_name,)


def test_two_arms_by_their_groups_and_by_joints(tmp_path):
    text = (
        "  right_arm_controller: {}\n"
        "  scaled_trajectory: {type: JointTrajectory, action_ns: command, joints: [JOINTS]}\n"
    )
    model = load("dual_ur10_rod").model
    left = model.group("left_arm").joint_names
    cell = loaded(tmp_path, "dual_ur10", text.replace("JOINTS", ", ".join(left)))
    right, scaled = cell.controllers
    assert right.joints == model.group("right_arm").joint_names
    assert (scaled.topic, scaled.joints) == ("/scaled_trajectory/command", left)


def test_the_block_of_a_moveit_controllers_file_fits(tmp_path):
    """One entry as MoveIt's setup assistant writes it."""
    joints = list(load("panda_pick").model.group("arm").joint_names)
    entry = {
        "type": "FollowJointTrajectory", "action_ns": "follow_joint_trajectory", "default": True,
        "joints": joints,
    }  # fmt: skip
    text = yaml.safe_dump({"panda_arm_controller": entry}, default_flow_style=True)
    assert loaded(tmp_path, "panda", f"  {text.strip()[1:-1]}\n").controllers[0].joints == tuple(joints)


@pytest.mark.parametrize(
    ("robot", "text", "words"),
    [
        ("panda", "  a_controller: {joints: [elbow]}", ("unknown joint 'elbow'", "controllers/a_controller")),
        ("panda", "  a_controller: {}\n  b_controller: {}", ("panda_joint1 also belongs to a_controller",)),
        ("dual_ur10", "  a_controller: {}", ("which joints", "name it <group>_controller")),
        ("panda", "  a_controller: {type: GripperCommand, joints: [panda_joint1]}", ("one gripper",)),
        ("ur10", "  a_controller: {type: GripperCommand}", ("which joints",)),
        ("panda", "  a_controller: {typ: GripperCommand}", ("unknown key 'typ'", "type")),
        ("panda", "  a_controller: {type: PositionController}", ("FollowJointTrajectory",)),
    ],
)
def test_what_is_wrong_with_it(tmp_path, robot, text, words):
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, robot, text + "\n")
    assert all(word in str(caught.value) for word in (*words, "lab.yaml"))
