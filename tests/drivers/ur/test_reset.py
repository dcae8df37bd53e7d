"""The emulated world goes back to its start: by command, and between runs."""

import json
import time

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts, free_port
from tests.drivers.ur.test_real_cell import LIBRARY
from tests.drivers.ur.test_rtde_wire import Client, ask_outputs

from armcell.cell import load
from armcell.cli.main import main
from armcell.core import SE3
from armcell.drivers.ur.wire.models import ur_model
from armcell.emulators.rack import SharedWorld
from armcell.emulators.ur.plant import KinematicPlant, PhysicsPlant
from armcell.emulators.ur.robot import Robot
from armcell.sim import SimWorld


def step(robots: list[Robot], count: int) -> None:
    for _ in range(count):
        for robot in robots:
            robot.before_step()
            robot.plant.step(robot.period)
            robot.after_step()


def test_joints_without_physics_go_back():
    robot = Robot(ur_model("UR10"), KinematicPlant([0.1] * 6), "1")
    robot.displace([0.5] * 6)
    step([robot], 3)
    robot.plant.reset()
    step([robot], 20)
    np.testing.assert_allclose(robot.plant.read()[0], 0.1, atol=1e-9)
    np.testing.assert_allclose(robot.setpoint.q, 0.1, atol=1e-9)


@pytest.mark.slow
def test_both_arms_and_the_object_of_a_shared_world_go_back():
    cell = load("dual_ur10_rod")
    world = SimWorld(cell.scene(None), cell.physics)
    shared = SharedWorld(world)
    robots = [
        Robot(ur_model("UR10"), plant, str(i))
        for i, plant in enumerate(PhysicsPlant(shared, g, "UR10") for g in ("left_arm", "right_arm"))
    ]
    step(robots, 10)
    start = [robot.plant.read()[0].copy() for robot in robots]
    rod = world.object_pose("rod")
    world.set_object_pose("rod", SE3.from_xyz_rpy((0.0, 0.0, 0.05), (0.0, 0.0, 0.0)) @ rod)
    for robot in robots:
        robot.displace(robot.plant.read()[0] + 0.1)
        robot.protective_stop("a test")
    robots[0].plant.drive_gripper(0.0, 1.0)
    step(robots, 20)
    robots[1].plant.reset()  # over one arm's dashboard
    step(robots, 50)
    for robot, q in zip(robots, start, strict=True):
        np.testing.assert_allclose(robot.plant.read()[0], q, atol=2e-3)
        np.testing.assert_allclose(robot.setpoint.q, q, atol=2e-3)
        assert robot.safety.name == "NORMAL" and robot.machine is None
    assert world.object_pose("rod").distance_to(rod)[0] < 2e-3
    assert robots[0].plant.gripper()[0] > 0.9


@pytest.mark.realtime
@pytest.mark.slow
def test_it_resets_once_the_last_client_has_left_but_not_in_a_run():
    (host,) = free_hosts(1)

    def joint() -> float:
        with Client(host, 2) as client:
            ask_outputs(client, "actual_q")
            client.ask("S")
            return np.frombuffer(client.next("U")[1:], ">f8")[0]

    with emulator("--reset-between-runs", hosts=[host]):
        with Client(host, 2) as client:
            ask_outputs(client, "actual_q")
            dashboard(host, "armcell move joint 0 0.3")
            time.sleep(1.5)
            assert joint() == pytest.approx(0.3, abs=1e-3)
            assert client.ask("S") == b"\x01"
        time.sleep(1.5)
        assert joint() == pytest.approx(0.0, abs=1e-3)
        assert dashboard(host, "armcell move joint 0 0.2", "armcell reset")[1].endswith("at their start")
        time.sleep(0.2)
        assert joint() == pytest.approx(0.0, abs=1e-3)


@pytest.mark.realtime
@pytest.mark.slow
def test_a_run_that_grasps_beside_the_object_says_where_it_believes_it(tmp_path):
    (host,) = free_hosts(1)
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    text += "\nreal:\n  max_state_age: 0.3\n  watchdog: 0.5\n  arms:\n"
    text += f"    arm: {{host: {host}, port: {free_port()}, model: UR10, gripper: {{kind: socket}}}}\n"
    file, out = tmp_path / "cell.yaml", tmp_path / "result.json"
    file.write_text(text)
    x, y, *rest = (float(v) for v in load("six_axis_pick").spec.objects["cube"].pose[:3])
    elsewhere = f"objects.cube.pose=[{x}, {y + 0.15}, {rest[0]}]"
    with emulator("--cell", "six_axis_pick", hosts=[host]):
        real = ["--mode", "real", "--without-gate", "an emulator", "--headless", "--json", str(out)]
        assert main(["run", str(file), *real, "--set", elsewhere]) != 0
    message = json.loads(out.read_text())["message"]
    assert f"the scene has cube at {x:.3f} {y + 0.15:.3f}" in message
    assert "cell.look()" in message and "--set objects.cube.pose=" in message and "armcell reset" in message
