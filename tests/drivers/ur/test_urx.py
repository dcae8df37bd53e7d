"""The emulated controller's secondary and real-time ports, as urx (PyPI, LGPL) uses them.

urx 0.11.0 knows controllers up to software 3.4: of newer ones it reads the state, but waits for no motion.
"""

import collections
import collections.abc
import time
import warnings

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts

from armcell.drivers.ur.wire.kinematics import forward
from armcell.drivers.ur.wire.models import ur_model

for name in ("Iterable", "Sequence"):  # math3d 3.4.1 is older than Python 3.10; urx does not work with 4.0
    if not hasattr(collections, name):
        setattr(collections, name, getattr(collections.abc, name))
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    urx = pytest.importorskip("urx", reason="urx and math3d are not installed")

pytestmark = [pytest.mark.interop, pytest.mark.filterwarnings("ignore")]  # it uses deprecated calls


@pytest.fixture(scope="module")
def arm():
    (host,) = free_hosts(1)
    with (
        emulator("--model", "UR10", "--software", "3.4", hosts=[host]),
        np.printoptions(legacy="1.25"),  # it sends repr(numpy's numbers)
    ):
        robot = urx.Robot(host, use_rt=True)
        yield robot, host, ur_model("UR10")
        robot.close()


@pytest.mark.parametrize("model", ["UR10", "UR10e"])
def test_newer_controllers_are_read_and_moved(model):
    (host,) = free_hosts(1)
    with emulator("--model", model, hosts=[host]):
        robot = urx.Robot(host)
        try:
            goal = np.add(robot.getj(), [0.2, -0.1, 0.1, 0.0, 0.1, 0.3])
            robot.movej(list(goal), acc=2.0, vel=1.0, wait=False)
            settled(robot)
            np.testing.assert_allclose(robot.getj(), goal, atol=1e-3)
            pose = robot.getl()
            pose[2] += 0.05
            robot.movel(pose, acc=1.0, vel=0.2, wait=False)
            settled(robot)
            np.testing.assert_allclose(robot.getl(), pose, atol=1e-3)
        finally:
            robot.close()


def settled(robot) -> None:
    time.sleep(0.3)  # a motion has begun by then
    before = np.array(robot.getj(wait=True))
    while np.abs(np.subtract(now := robot.getj(wait=True), before)).max() > 1e-4:
        before = now


def test_the_state_is_read(arm):
    robot, _, model = arm
    settled(robot)
    assert robot.is_running() and not robot.is_program_running()
    q = robot.getj()
    np.testing.assert_allclose(robot.getl()[:3], forward(model.dh, q, [0.0] * 6)[:3, 3], atol=1e-4)
    state = robot.secmon.get_all_data()
    assert state["MasterBoardData"]["robotVoltage48V"] == 48.0 and state["ToolData"]["toolMode"] == 253
    assert state["ForceModeData"]["z"] == pytest.approx(0.0, abs=1e-6) and "AdditionalInfo" in state
    assert state["MasterBoardData"]["digitalOutputBits"] == 0


def test_movej_and_movel(arm):
    robot, _, _ = arm
    goal = np.add(robot.getj(), [0.2, -0.1, 0.1, 0.0, 0.1, 0.3])
    robot.movej(list(goal), acc=2.0, vel=1.0)
    settled(robot)
    np.testing.assert_allclose(robot.getj(), goal, atol=1e-3)
    pose = robot.getl()
    pose[2] += 0.05
    robot.movel(pose, acc=1.0, vel=0.2)
    settled(robot)
    np.testing.assert_allclose(robot.getl(), pose, atol=1e-3)
    robot.movel((0.0, 0.03, -0.05, 0, 0, 0), acc=1.0, vel=0.2, relative=True)
    settled(robot)
    np.testing.assert_allclose(robot.getl()[:3], np.add(pose[:3], [0, 0.03, -0.05]), atol=1e-3)
    robot.movep(pose, acc=1.0, vel=0.2)
    settled(robot)
    np.testing.assert_allclose(robot.getl()[:3], pose[:3], atol=1e-3)


def test_an_arc_and_a_chain_of_lines(arm):
    robot, _, _ = arm
    start = robot.getl()
    via, end = list(start), list(start)
    via[1], via[2], end[2] = start[1] + 0.03, start[2] + 0.03, start[2] + 0.06
    robot.movec(via, end, acc=1.0, vel=0.2)
    settled(robot)
    np.testing.assert_allclose(robot.getl()[:3], end[:3], atol=1e-3)
    robot.movels([via, start], acc=1.0, vel=0.2, radius=0.005)
    settled(robot)
    np.testing.assert_allclose(robot.getl()[:3], start[:3], atol=1e-3)


def test_poses_as_matrices(arm):
    robot, _, _ = arm
    before = robot.get_pose()
    robot.translate((0.0, 0.0, 0.04), acc=1.0, vel=0.2)
    settled(robot)
    moved = robot.get_pose()
    assert moved.pos.z - before.pos.z == pytest.approx(0.04, abs=1e-3)
    robot.set_pose(before, acc=1.0, vel=0.2)
    settled(robot)
    np.testing.assert_allclose(robot.get_pose().pos.array, before.pos.array, atol=1e-3)


def test_outputs(arm):
    robot, _, _ = arm
    robot.set_digital_out(2, True)
    time.sleep(0.4)
    assert robot.secmon.get_digital_out(2, wait=True) == 1
    robot.send_program("set_standard_analog_out(0, 0.5)")
    time.sleep(0.4)
    assert robot.secmon.get_all_data(wait=True)["MasterBoardData"]["analogOutput0"] == pytest.approx(12.0)
    robot.set_tcp((0, 0, 0.1, 0, 0, 0))
    time.sleep(0.4)
    assert robot.secmon.get_cartesian_info(wait=True)["tcpOffsetZ"] == pytest.approx(0.1)
    robot.set_tcp((0, 0, 0, 0, 0, 0))
    robot.set_payload(1.5)
    time.sleep(0.2)


def test_the_realtime_port_has_every_value_every_control_step(arm):
    robot, _, model = arm
    settled(robot)
    np.testing.assert_allclose(robot.rtmon.getActual(wait=True), robot.getj(), atol=1e-3)
    np.testing.assert_allclose(robot.rtmon.getTarget(), robot.getj(), atol=1e-3)
    np.testing.assert_allclose(robot.rtmon.getTCF(), robot.getl(), atol=1e-3)
    assert len(robot.get_tcp_force()) == 6
    stamps = []
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        robot.rtmon.wait()
        stamps.append(float(robot.rtmon._ctrlTimestamp))
    steps = np.unique(stamps)
    assert np.median(np.diff(steps)) == pytest.approx(1.0 / model.frequency, rel=0.01)


def test_freedrive_and_stop(arm):
    robot, host, _ = arm
    settled(robot)
    before = robot.getl()
    robot.set_freedrive(True)
    time.sleep(0.3)
    dashboard(host, "armcell push 0 10 0")
    time.sleep(0.4)
    dashboard(host, "armcell push 0 0 0")
    robot.set_freedrive(False)
    settled(robot)
    assert robot.getl()[1] > before[1] + 0.02
    goal = list(robot.getj())
    goal[0] += 1.0
    robot.movej(goal, acc=1.0, vel=0.4, wait=False)
    time.sleep(0.7)
    robot.stop()
    settled(robot)
    assert robot.getj()[0] < goal[0] - 0.3
