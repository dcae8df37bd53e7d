"""Objects screwed into others, and what a hand feels."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from tests.sim.helpers import Grasping

import armcell
from armcell.core import Box, InputError
from armcell.scene import CollisionObject, PlanningScene, ScrewThread
from armcell.sim import SimWorld

CELL = """
robot: parallel_gripper
objects:
  block: {{box: [0.1, 0.1, 0.1], pose: [0.5, 0, 0.05], movable: true, mass: 5}}
  floor: {{box: [2, 2, 0.1], pose: [0, 0, -0.0505]}}
  bolt: {{box: [0.03, 0.03, 0.04], pose: [0, 0, 0.08], movable: true, mass: 0.1, thread: {thread}}}
"""
GOOD = "{into: block, pitch: 0.002, travel: 0.01, torque: 0.2}"


@pytest.fixture
def world(tmp_path):
    (tmp_path / "cell.yaml").write_text(CELL.format(thread=GOOD))
    return SimWorld(armcell.load(tmp_path).scene())


def turned(world, torque, seconds=0.5):
    """Turn the bolt by a torque about its axis; (turns, meters) it has gone."""
    joint = world.mj_model.joint("bolt:turn").dofadr[0]
    for _ in range(round(seconds / world.timestep)):
        world.mj_data.qfrc_applied[joint] = torque
        world.step()
    world.mj_data.qfrc_applied[joint] = 0.0
    world.step(100)
    slide, turn = world.built.threaded["bolt"]
    return world.mj_data.qpos[turn] / (2 * np.pi), world.mj_data.qpos[slide]


def test_it_stays_where_it_is_and_its_pose_is_told(world):
    world.step(500)
    T = world.object_pose("block").inverse() @ world.object_pose("bolt")
    np.testing.assert_allclose(T.translation, (0, 0, 0.08), atol=2e-5)
    assert set(world.sample().object_poses) == {"block", "bolt"}


@pytest.mark.parametrize("torque", [-0.3, -0.5])
def test_clockwise_goes_in_by_the_pitch(world, torque):
    turns, meters = turned(world, torque, 0.4)
    assert turns < -0.05
    assert meters == pytest.approx(0.002 * turns, abs=3e-5)
    T = world.object_pose("block").inverse() @ world.object_pose("bolt")
    assert T.translation[2] == pytest.approx(0.08 + meters, abs=1e-6)


def test_less_than_its_friction_does_not_turn_it(world):
    turns, _ = turned(world, -0.15)
    assert abs(turns) < 0.03  # soft friction creeps


def test_it_ends_where_its_travel_does(world):
    turns, meters = turned(world, -1.5, 3.0)
    assert meters == pytest.approx(-0.01, abs=3e-4) and turns == pytest.approx(-5, abs=0.15)


def test_a_reset_brings_it_back(world):
    start = world.object_pose("bolt")
    turned(world, -1.0, 0.1)
    world.reset()
    assert world.object_pose("bolt").isclose(start, 1e-9, 1e-9)


WRONG = {
    "{into: nowhere, pitch: 0.002, travel: 0.01}": "has to stand before it",
    "{into: block, pitch: 0, travel: 0.01}": "pitch",
    "{into: block, pitch: 0.002}": "travel",
}


@pytest.mark.parametrize(("thread", "words"), WRONG.items())
def test_wrong_threads(tmp_path, thread, words):
    (tmp_path / "cell.yaml").write_text(CELL.format(thread=thread))
    with pytest.raises(InputError, match=words):
        armcell.load(tmp_path)
    with pytest.raises(InputError, match="pitch"):
        ScrewThread("block", -1.0, 0.1)


# --- the wrench ---
def test_a_hand_that_holds_an_object_feels_its_weight():
    """A cube on the upturned palm: the palm feels it press down, at the place where it lies."""
    from armcell.model import load_robot

    model = load_robot("parallel_gripper")
    cube = CollisionObject.single("cube", Box(0.04, 0.04, 0.04), pose=None, movable=True, mass=2.0)
    from armcell.core import SE3

    scene = PlanningScene.of(model, [0.05]).with_object(cube.at(SE3.from_xyz(0.0, 0.01, 0.1005)))
    world = SimWorld(scene)
    world.step(1000)
    wrench = world.wrench("gripper") if "gripper" in world.built.grippers else None
    if wrench is None:
        pytest.skip("the gripper alone is no gripper of an arm")
    np.testing.assert_allclose(wrench[:3], (0, 0, -2.0 * 9.81), atol=0.2)


def test_it_is_the_sum_of_the_contacts_on_the_hand():
    """A grasped cube that something pushes, against MuJoCo's contacts one by one."""
    grasping = Grasping()
    grasping.close()
    world, name = grasping.world, grasping.gripper.name
    world.mj_data.xfrc_applied[world.built.body["cube"], :3] = 1.0, 3.0, 0.5  # [N]
    world.step(100)
    model, data = world.mj_model, world.mj_data
    origin = data.body(grasping.gripper.tcp_link).xpos
    expected, contact, count = np.zeros(6), np.zeros(6), 0
    for i in range(data.ncon):
        bodies = [model.body(model.geom_bodyid[g]).name for g in data.contact[i].geom]
        mine = [body in grasping.gripper.hand_links for body in bodies]
        if mine[0] == mine[1]:
            continue
        mujoco.mj_contactForce(model, data, i, contact)
        axes, sign, count = data.contact[i].frame.reshape(3, 3).T, 1.0 if mine[1] else -1.0, count + 1
        force = sign * (axes @ contact[:3])
        expected[:3] += force
        expected[3:] += sign * (axes @ contact[3:]) + np.cross(data.contact[i].pos - origin, force)
    assert count >= 4 and np.abs(expected).max() > 0.1
    np.testing.assert_allclose(world.wrench(name), expected, rtol=1e-12, atol=1e-12)


def test_nothing_touched_is_nothing_felt():
    world = SimWorld(armcell.load("dual_ur10").scene())
    world.step(10)
    np.testing.assert_array_equal(world.wrench("left_gripper"), np.zeros(6))


@pytest.mark.slow
def test_a_lifted_rod_weighs_on_both_hands():
    """Both hands together feel the rod's weight and nothing else, whatever they do to each other."""
    from armcell.tasks import checked
    from armcell.tasks.arms import moved_object_pose

    cell = armcell.load("dual_ur10_rod")
    with cell.connect("sim") as live:
        rod = live.carry("rod", left_arm="front_end", right_arm="back_end")
        start = live.scene().object("rod").T_world_object
        checked(rod.grasp(route=[moved_object_pose(start, z=0.1)]))
        checked(rod.shift(z=0.1))
        live.driver.advance(0.5)
        hands = [live.driver.wrench(f"{side}_gripper") for side in ("left", "right")]
        np.testing.assert_allclose(sum(h[:3] for h in hands), (0, 0, -2.0 * 9.81), atol=0.15)
        tips = [live.scene().frame_pose(f"{side}_gripper_tcp").translation for side in ("left", "right")]
        middle = live.driver.object_poses()["rod"].translation
        about = sum(h[3:] + np.cross(p - middle, h[:3]) for h, p in zip(hands, tips, strict=True))
        np.testing.assert_allclose(about, 0, atol=0.15)  # no torque about the center of mass: it rests
        assert rod.record.off_m <= 5e-4 and rod.record.squeeze_n <= 30
