"""Stepping, targets, records and time travel."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sim.helpers import Grasping, down, solve_ik

from armcell.core import SE3, ArmcellError, Box, InputError, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.model import MountedRobot, compose, load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import SimWorld


def _bytes(world: SimWorld) -> bytes:
    data = world.mj_data
    return data.qpos.tobytes() + data.qvel.tobytes() + data.ctrl.tobytes() + data.qacc_warmstart.tobytes()


@pytest.mark.parametrize("robot", ("panda", "ur10_gripper"))
def test_tracking_a_sinusoid(robot):
    model = load_robot(robot)
    world = SimWorld(PlanningScene.of(model))
    arm = model.group("arm").joint_names
    start = world.joint_state().reindexed(arm).positions
    w = 2 * np.pi * 0.5
    size = 0.45 * np.minimum(model.limits(arm, "velocity") / w, model.limits(arm, "acceleration") / w**2)
    worst = 0.0
    for i in range(1, 1001):
        t = i * world.timestep
        # 1 - cos starts at rest, so the target is one a real controller would send
        world.set_arm_target(arm, start + size * (1 - np.cos(w * t)) / 2, size * w * np.sin(w * t) / 2)
        world.step()
        error = world.joint_state().reindexed(arm).positions - (start + size * (1 - np.cos(w * t)) / 2)
        worst = max(worst, np.abs(error).max())
    assert worst < 0.010


def test_same_calls_same_bits():
    def run() -> bytes:
        grasp = Grasping()
        grasp.close(seconds=0.5)
        grasp.lift(seconds=0.3, settle=0.0)
        return _bytes(grasp.world)

    assert run() == run()


def test_steps_at_once_or_one_by_one():
    one, many = Grasping(), Grasping()
    for world in (one.world, many.world):
        world.set_gripper_target("hand", 0.0, 20.0)
    one.world.step(300)
    for _ in range(300):
        many.world.step()
    assert _bytes(one.world) == _bytes(many.world)


def test_snapshot_and_restore():
    grasp = Grasping()
    world = grasp.world
    grasp.close(seconds=0.45)  # in the middle of the force ramp
    world.watch_slip("cube", "hand")
    snapshot = world.snapshot()

    def go_on() -> tuple:
        grasp.lift(seconds=0.4, settle=0.1)
        return _bytes(world), world.slip(), world.gripper_state("hand"), world.monitor.unwanted

    first = go_on()
    world.monitor.forbid("panda_leftfinger", "cube")
    grasp.open(seconds=0.2)
    world.restore(snapshot)
    assert world.time == pytest.approx(0.45)
    assert go_on() == first
    with pytest.raises(InputError, match="another world"):
        Grasping().world.restore(snapshot)


def test_reset_reuses_or_rebuilds():
    grasp = Grasping()
    world, scene = grasp.world, grasp.world.scene()
    fresh = _bytes(world)
    model = world.mj_model
    grasp.close(seconds=0.3)
    world.reset(scene.with_object_pose("cube", SE3.from_xyz(0.55, 0.1, 0.025)))
    assert world.mj_model is model and world.time == 0.0
    assert world.object_pose("cube").translation == pytest.approx([0.55, 0.1, 0.025])
    world.reset(scene)
    assert _bytes(world) == fresh
    world.reset(scene.with_object_pose("table", SE3.from_xyz(0.8, 0.0, -0.06)))
    assert world.mj_model is not model


def test_scene_round_trip_and_sample():
    grasp = Grasping()
    world = grasp.world
    grasp.close()
    grasp.lift(seconds=0.5)
    scene = world.scene()
    assert scene.positions == pytest.approx(world.joint_state().positions, abs=1e-4)
    assert scene.objects["cube"].T_world_object.isclose(world.object_pose("cube"), 1e-12, 1e-7)
    again = SimWorld(scene.with_attached("cube", "panda_hand_tcp", grasp.gripper.finger_links))
    assert again.object_pose("cube").isclose(world.object_pose("cube"), 1e-9, 1e-6)  # free, where it was held
    sample = world.sample()
    assert sample.time == world.time and set(sample.object_poses) == {"cube"}
    assert sample.gripper_force["hand"] == pytest.approx(32.0, rel=1e-3)
    assert sample.gripper_width["hand"] == pytest.approx(0.05, abs=5e-4)
    assert sample.joints.velocities is not None and sample.joints.efforts is not None


def test_efforts_hold_the_arm_up():
    model = load_robot("ur10")
    world = SimWorld(PlanningScene.of(model))
    world.step(10)

    def energy(q) -> float:
        tree = kinematic_tree(model)
        inertials = {name: link.inertial for name, link in model.links.items() if link.inertial}
        heights = {n: tree.link_pose(q, n).apply(i.T_link_com.translation)[2] for n, i in inertials.items()}
        return sum(9.81 * inertials[name].mass * z for name, z in heights.items())

    state = world.joint_state()
    slope = [
        (energy(state.positions + h) - energy(state.positions - h)) / 2e-5 for h in 1e-5 * np.eye(model.dof)
    ]
    assert state.efforts == pytest.approx(slope, abs=0.01)


def test_twist_is_the_rate_of_the_pose():
    item = CollisionObject.single("box", Box(0.1, 0.2, 0.3), SE3.from_xyz(1, 1, 5), movable=True, mass=1.0)
    world = SimWorld(PlanningScene.of(load_robot("ur10"), objects=[item]))
    start = world.built.object_dof["box"]
    world.mj_data.qvel[start : start + 6] = [0.3, -0.2, 1.0, 1.0, 2.0, 0.5]
    world.step(20)
    before, twist = world.object_pose("box"), world.object_twist("box")
    world.step()
    after, h = world.object_pose("box"), world.timestep
    assert (after.translation - before.translation) / h == pytest.approx(twist[:3], abs=0.03)
    assert (after.rotation @ before.rotation.inverse()).log() / h == pytest.approx(twist[3:], abs=0.03)


def test_the_monitor_counts_every_step_that_a_look_at_each_list_of_contacts_finds():
    """It remembers lists of contacts it has looked at; here each list is read anew, by name."""
    world = Grasping().world
    world.set_gripper_target("hand", 0.0)
    found: dict[frozenset[str], int] = {}
    allow, forbid = world.monitor.allow, world.monitor.forbid
    left, right = "panda_leftfinger", "panda_rightfinger"
    changes = {150: (forbid, left), 200: (forbid, right), 250: (allow, left)}
    for i in range(300):
        if i in changes:
            rule, finger = changes[i]
            rule("cube", finger)
        world.step()
        allowed = world.monitor.allowed
        pairs = {frozenset((c.body_a, c.body_b)) for c in world.contacts()}
        for pair in pairs - allowed - {frozenset(("cube", "table"))}:  # neither is a link, nor watched
            found[pair] = found.get(pair, 0) + 1
    seen = {frozenset((c.body_a, c.body_b)): c.count for c in world.monitor.unwanted}
    assert seen == found and len(found) == 2


def test_the_monitor_sees_the_arm_hit_the_table():
    model = load_robot("panda")
    table = CollisionObject.single("table", Box(1.0, 1.0, 0.1), SE3.from_xyz(0.8, 0.0, -0.05))
    scene = PlanningScene.of(model, objects=[table])
    arm = model.group("arm").joint_names
    above = solve_ik(model, arm, "panda_hand_tcp", down(0.5, 0.0, 0.02), scene.positions)
    below = solve_ik(model, arm, "panda_hand_tcp", down(0.5, 0.0, -0.02), above)
    world = SimWorld(scene.with_positions(above))
    world.step(50)
    assert not world.monitor.unwanted
    world.set_arm_target(arm, below[model.columns(arm)])
    world.step(200)
    pairs = {frozenset((c.body_a, c.body_b)) for c in world.monitor.unwanted}
    assert pairs == {frozenset((f, "table")) for f in ("panda_leftfinger", "panda_rightfinger")}
    first = world.monitor.unwanted[0]
    assert 0.1 < first.time < 0.3 and first.depth > 1e-4 and first.count > 50
    world.monitor.clear()
    world.monitor.allow("table", ("panda_leftfinger", "panda_rightfinger"))
    world.step(50)
    assert not world.monitor.unwanted


def test_two_robots_in_one_world():
    arm = load_robot("ur10_gripper")
    sides = {"left_": 0.6, "right_": -0.6}
    model = compose(
        "dual", [MountedRobot(arm, side, "world", SE3.from_xyz(0, y, 0)) for side, y in sides.items()]
    )
    world = SimWorld(PlanningScene.of(model))
    mass = sum(link.inertial.mass for link in arm.links.values() if link.inertial)
    assert world.mj_model.body_mass.sum() == pytest.approx(2 * mass)
    before = world.joint_state().positions
    world.set_gripper_target("left_gripper", 0.02)
    world.step(700)
    change = dict(zip(model.joint_names, world.joint_state().positions - before, strict=True))
    assert change.pop("left_gripper_left_finger_joint") == pytest.approx(-0.04, abs=1e-4)
    assert max(map(abs, change.values())) < 1e-4


def test_divergence_is_an_error_and_leaves_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    world = Grasping().world
    world.mj_data.qvel[:3] = 1e12
    with pytest.raises(ArmcellError, match="diverged"):
        world.step(5)
    assert not list(tmp_path.iterdir()) and capfd.readouterr().out == ""


def test_wrong_names_and_values():
    world = Grasping().world
    for call in (
        lambda: world.gripper_state("claw"),
        lambda: world.object_pose("tube"),
        lambda: world.set_object_pose("tube", SE3.identity()),
        lambda: world.set_arm_target(["elbow"], [0.0]),
        lambda: world.monitor.allow("cube", "tube"),
        lambda: world.link_pose("claw"),
        lambda: world.slip(),
    ):
        with pytest.raises(UnknownNameError):
            call()
    for call in (
        lambda: world.set_arm_target(["panda_joint1"], [np.nan]),
        lambda: world.set_arm_target(["panda_joint1"], [0.0, 1.0]),
        lambda: world.set_gripper_target("hand", 0.0, -1.0),
        lambda: world.set_positions(np.full(8, 9.0)),
    ):
        with pytest.raises(InputError):
            call()


@pytest.mark.slow
def test_a_fixed_object_that_is_put_elsewhere_is_felt_there_until_a_reset():
    found = []
    for compiled in (True, False):
        world = Grasping().world
        if not compiled:
            world._stepper.compiled = None
        start = world.object_pose("table")
        world.step(300)  # all that is far apart is not compared any more
        kept = world.snapshot()
        world.set_object_pose("table", start.shifted(x=-0.3, z=0.5))  # into the hand and the forearm
        assert world.scene().objects["table"].T_world_object.isclose(start.shifted(x=-0.3, z=0.5))
        world.step(3)
        touched = [(c.body_a, c.body_b, c.depth) for c in world.contacts()]
        assert any("table" in pair and "panda_" in "".join(pair) for *pair, _ in touched)
        found.append(touched)
        world.restore(kept)
        assert world.object_pose("table").isclose(start, 0.0, 0.0)
        world.set_object_pose("table", start.shifted(z=-1.0))
        world.step(200)  # so the cube falls
        assert world.object_pose("cube").translation[2] < -0.1
        world.reset()
        assert world.object_pose("table").isclose(start, 0.0, 0.0)
        assert world.scene().objects["table"] is world.built.objects["table"]
    assert found[0] == found[1]
