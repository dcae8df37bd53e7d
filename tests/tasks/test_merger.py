"""Several motions at once: proven by an exact checker's samples, refused where they would meet."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tasks.helpers import live, nominal

import armcell
from armcell.collision import ExactChecker
from armcell.core import SE3, Box, InputError, JointGoal, JointState, NamedGoal
from armcell.planning import warm_up
from armcell.scene import CollisionObject
from armcell.tasks import (
    Fallbacks,
    Merger,
    PartialSolution,
    SearchState,
    Serial,
    Task,
    TaskSettings,
    perform_all,
)
from armcell.tasks.stages import Close, Connect, MoveGripper, MoveStraight
from armcell.tasks.stages.fingers import finger_collision, opened_in_transit
from armcell.tasks.steps import CommandGripper, ParallelMotions

S = TaskSettings()


def planned(stage, scene):
    warm_up()  # or compiling would use up the search's time
    return Task("t", (stage,)).plan(PartialSolution(scene), SearchState(S))


def touched(scene, trajectory, gripper=None, widths=(0.0,)) -> bool:
    """By coal, at samples: the motion with the fingers at each of some widths."""
    for width in widths:
        at = scene
        if gripper is not None:
            joint = gripper.joint_position(width)
            at = scene.with_state(JointState((gripper.joint_name,), np.array([joint])))
        checker = ExactChecker(at.with_padding(0.0), trajectory.joint_names)
        for t in np.arange(0.0, trajectory.duration, 0.02):
            if checker.contacts(trajectory.sample(float(t))[0], padded=False):
                return True
    return False


@pytest.fixture(scope="module")
def panda():
    scene = nominal()
    arm = scene.model.gripper().arm_group
    start = scene.state.reindexed(scene.model.group(arm).joint_names).positions
    return scene, scene.model.gripper(), start


def turn(start, angle):
    """A goal of the Panda: its base turned."""
    q = start.copy()
    q[0] += angle
    names = tuple(f"panda_joint{i}" for i in range(1, 8))
    return JointGoal(JointState(names, q))


def test_an_arm_and_its_fingers_at_once(panda):
    scene, hand, start = panda
    go = Connect("turn", hand.arm_group, S.free, goal=turn(start, -0.6))
    plan = planned(Merger("turn and close", (go, MoveGripper("narrow", hand, 0.02))), scene)
    (step,) = plan.best.steps
    assert isinstance(step, ParallelMotions) and step.motion.name == "turn" and step.grips[0].width == 0.02
    state = plan.best.scene.state
    assert state[hand.joint_name] == pytest.approx(hand.joint_position(0.02))
    assert state["panda_joint1"] == pytest.approx(start[0] - 0.6)
    assert not touched(scene, step.motion.trajectory, hand, widths=np.linspace(0.02, hand.max_width, 5))


def test_fingers_that_would_meet_something_are_refused_and_the_reserve_is_taken(panda):
    """Between two posts the hand fits through with its fingers together; before and after it may open."""
    scene, hand, _ = panda
    gate = scene.with_padding(0.0).with_state(
        JointState((hand.joint_name,), np.array([hand.joint_position(0.01)]))
    )
    tcp = gate.frame_pose(hand.tcp_link)
    for side in (-1, 1):
        at = tcp @ SE3.from_xyz(0.08, side * 0.035, 0.0)
        gate = gate.with_object(CollisionObject.single(f"post_{side}", Box(0.01, 0.01, 0.01), at))
    through = MoveStraight(
        "through", hand.arm_group, hand.tcp_link, S.near, (0.16, 0.0, 0.0), in_tip_frame=True
    )
    wide = MoveGripper("open", hand, 0.08)
    for stage in (through, wide, Serial("in turn", (through, wide))):
        assert planned(stage, gate).ok
    plan = planned(Merger("both", (through, wide)), gate)
    assert not plan.ok
    assert "1 x both: not proven free while the fingers move); the first: " in plan.message
    assert "finger touches post_" in plan.message
    way = Fallbacks("way", (Merger("both", (through, wide)), Serial("in turn", (through, wide))))
    assert [step.name for step in planned(way, gate).best.steps] == ["through", "open"]
    opened = planned(wide, gate).best.scene
    assert not planned(through, opened).ok  # so the proof was right to fail


def test_fingers_open_in_transit_where_they_touch_nothing(panda):
    """A gripper motion before an arm motion joins it; before a closing hand or beside a post it does not."""
    scene, hand, start = panda
    narrow = scene.with_state(JointState((hand.joint_name,), np.array([hand.joint_position(0.01)])))
    tcp = narrow.frame_pose(hand.tcp_link)
    at = tcp @ SE3.from_xyz(0.0, 0.04, 0.0)
    blocked = narrow.with_object(CollisionObject.single("post", Box(0.01, 0.01, 0.01), at))
    go = Connect("turn", hand.arm_group, S.free, goal=turn(start, -0.4))
    wide = CommandGripper("open", hand, 0.08, 20.0)
    (motion,) = planned(go, blocked).best.steps
    assert opened_in_transit(blocked, (wide, motion)) == (wide, motion)
    (motion,) = planned(go, narrow).best.steps
    (step,) = opened_in_transit(narrow, (wide, motion))
    assert isinstance(step, ParallelMotions) and step.grips == (wide,)
    closing = CommandGripper("close", hand, 0.0, 20.0), motion
    assert opened_in_transit(narrow, closing) == closing


def test_fingers_keep_the_padding_if_asked(panda):
    """A post 2 mm beside the open finger: free, but not with a padding of 3 mm."""
    scene, hand, _ = panda
    narrow = scene.with_state(JointState((hand.joint_name,), np.array([hand.joint_position(0.01)])))
    wide = CommandGripper("open", hand, 0.04, 20.0)

    def contact(y: float, padded: bool) -> str:
        at = narrow.frame_pose(hand.tcp_link) @ SE3.from_xyz(0.0, y, 0.0)
        post = CollisionObject.single("post", Box(0.01, 0.01, 0.01), at)
        return finger_collision(narrow.with_object(post).with_padding(0.003), [wide], padded=padded)

    free = next(y for y in np.arange(0.02, 0.08, 0.0005) if not contact(y, False))
    assert contact(free + 0.001, True) and not contact(free + 0.004, True)


def test_it_is_performed_at_once(panda):
    """In physics: fingers and arm are where they should be, in less time than one after another."""
    scene, hand, start = panda
    go, narrow = (
        Connect("turn", hand.arm_group, S.free, goal=turn(start, -0.4)),
        MoveGripper("narrow", hand, 0.02),
    )
    took = {}
    for name, stage in (("at once", Merger("both", (go, narrow))), ("in turn", Serial("both", (go, narrow)))):
        with live("sim", scene) as cell:
            plan = planned(stage, cell.scene())
            began = cell.driver.now
            assert perform_all(cell.ctx, plan.best.steps)
            took[name] = cell.driver.now - began
            assert cell.driver.gripper(hand.name).width == pytest.approx(0.02, abs=2e-3)
            assert cell.driver.joint_state()["panda_joint1"] == pytest.approx(start[0] - 0.4, abs=0.02)
    assert took["at once"] < took["in turn"] - 0.05


def test_misuse_is_told(panda):
    scene, hand, start = panda
    go = Connect("turn", hand.arm_group, S.free, goal=turn(start, -0.3))
    back = Connect("back", hand.arm_group, S.free, goal=turn(start, 0.3))
    with pytest.raises(InputError, match="merger 'm': two of its stages move the same joint"):
        planned(Merger("m", (go, back)), scene)
    with pytest.raises(InputError, match="merger 'm': each of its stages must be one arm motion"):
        planned(
            Merger("m", (go, Serial("s", (MoveGripper("a", hand, 0.02), MoveGripper("b", hand, 0.03))))),
            scene,
        )
    with pytest.raises(InputError, match="width is 0.0 mm"):
        MoveGripper("shut", hand, 0.0)
    with pytest.raises(InputError, match=r"requires 'grasp'"):
        planned(Merger("m", (go, Close("cube", hand, (), 0.1))), scene)


@pytest.fixture(scope="module")
def two():
    return armcell.load("dual_ur10").scene()


@pytest.mark.slow
def test_two_arms_at_once(two):
    """Both lift their tools; the pair is free at every sample by coal, and refused where they would meet."""
    hands = {g.arm_group: g for g in two.model.grippers.values()}
    left, right = hands["left_arm"], hands["right_arm"]
    up = [
        MoveStraight(g.arm_group, g.arm_group, g.tcp_link, S.near, (0.0, 0.0, -0.05)) for g in (left, right)
    ]
    plan = planned(Merger("both down", (*up, MoveGripper("narrow", left, 0.03))), two)
    (step,) = plan.best.steps
    assert set(step.motion.trajectory.joint_names) == {
        *two.model.group("left_arm").joint_names, *two.model.group("right_arm").joint_names
    }  # fmt: skip
    assert not touched(two, step.motion.trajectory)
    after = plan.best.scene
    for g in (left, right):
        fell = two.frame_pose(g.tcp_link).translation - after.frame_pose(g.tcp_link).translation
        np.testing.assert_allclose(fell, [0, 0, 0.05], atol=1e-4)


@pytest.mark.slow
def test_two_arms_that_would_meet_are_refused(two):
    """Each motion is free while the other arm stands; together both hands are at the middle of the table."""
    hands = {g.arm_group: g for g in two.model.grippers.values()}
    stages = []
    for g in hands.values():
        tcp = two.frame_pose(g.tcp_link).translation
        to_middle = np.array([0.0, 0.0, 1.2]) - tcp
        stages.append(MoveStraight(g.arm_group, g.arm_group, g.tcp_link, S.near, tuple(to_middle)))
    for stage in stages:
        assert planned(stage, two).ok
    plan = planned(Merger("both to the middle", tuple(stages)), two)
    assert not plan.ok and "the arms come within 20 mm after" in plan.message
    home = Connect("home", "left_arm", S.free, goal=NamedGoal("home"))
    assert planned(Fallbacks("way", (Merger("both", tuple(stages)), home)), two).best.steps[0].name == "home"
