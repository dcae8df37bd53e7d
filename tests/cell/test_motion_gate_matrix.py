"""The motion gate at every entry point and in every mode: nothing that is not proven moves an arm.

Plans that were good when they were made meet a world that has changed: the other arm is under way to the
same place, or rests there; an object stands in the way; a hand holds something long; a number is not finite.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.drivers.ur.emulated import emulator, free_hosts, free_port
from tests.ros.ros1.conftest import free_port as free_tcp_port
from tests.ros.ros2.conftest import reach  # noqa: F401  (a fixture)

from armcell.cell import LiveCell, load, with_values
from armcell.core import SE3, ArmcellError, Box, JointTrajectory, PlanRequest, PoseGoal
from armcell.moveit import Session
from armcell.moveit.run import shims_installed
from armcell.planning import plan, warm_up
from armcell.ros import ActionClient, Bus, Ros1Graph, Ros1Settings
from armcell.ros.convert import trajectory_message
from armcell.ros.tcp import ForwardedNames, RosTcpClient, RosTcpServer, ServerSettings
from armcell.scene import CollisionObject
from armcell.viewer import PlanningSession

pytestmark = pytest.mark.slow

MODES = ["sim", "fake", pytest.param("real", marks=pytest.mark.realtime)]
WIRES = ["script", "execute_trajectory", "follow_joint_trajectory", "topic", "ros_tcp", "ros1", "ros2"]
SCENARIOS = ["stale pair", "resting arm", "stale object", "held object", "nan"]
TIP = SE3.from_xyz_rpy((0.1, 0.0, 1.2), (np.pi, 0.0, 0.0))
EXECUTE = "moveit_msgs/ExecuteTrajectory"
FOLLOW = "control_msgs/FollowJointTrajectory"
SPEED = 0.5  # of the limits


@cache
def plans() -> dict[str, JointTrajectory]:
    """Both arms from home to one place, each planned with the other at home."""
    warm_up()
    scene, found = load("dual_ur10").scene(), {}
    for group in ("left_arm", "right_arm"):
        goal = PoseGoal(TIP, position_tolerance=0.02, orientation_tolerance=3.0)
        result = plan(scene, PlanRequest(group, (goal,), velocity_scaling=SPEED, acceleration_scaling=SPEED))
        assert result.ok and result.trajectory is not None, result.message
        found[group] = result.trajectory
    return found


def back(group: str) -> JointTrajectory:
    """The way home again."""
    there = plans()[group]
    assert there.velocities is not None and there.accelerations is not None
    return JointTrajectory(
        there.joint_names, there.duration - there.times[::-1], there.positions[::-1],
        -there.velocities[::-1], there.accelerations[::-1],
    )  # fmt: skip


@dataclass
class Answer:
    ok: bool
    text: str


def connected(mode: str, stack: ExitStack) -> LiveCell:
    """A cell of two arms; in mode real against two emulated controllers."""
    cell = load("dual_ur10")
    if mode == "real":
        hosts = free_hosts(2)
        values: dict[str, object] = {"real.max_state_age": 0.4, "real.watchdog": 0.8}
        for group, host in zip(("left_arm", "right_arm"), hosts, strict=True):
            values |= {f"real.arms.{group}.host": host, f"real.arms.{group}.port": free_port()}
        cell = with_values(cell, values)
        stack.enter_context(emulator("--cell", "dual_ur10", hosts=hosts))
    return cell.connect(mode, time_scale=None if mode == "real" else 20.0, watch=False)


class World:
    """What the tests do to a cell, whichever way its arms are moved."""

    def __init__(self, live: LiveCell, call: Callable[[Callable[[], Any]], Any]):
        self.live, self.call = live, call

    def joints(self, group: str) -> np.ndarray:
        names = self.live.model.group(group).joint_names
        return self.call(self.live.driver.joint_state).reindexed(names).positions

    def contacts(self) -> list[Any]:
        return self.call(self.live.driver.unwanted_contacts)

    def put(self, name: str) -> None:
        """Something in the way of the right arm's plan: on it in the world, or long in its hand."""
        scene = self.live.scene()
        if name == "wall":
            tip = scene.with_state(plans()["right_arm"].end).frame_pose("right_gripper_tcp")
            item = CollisionObject.single(name, Box(0.1, 0.1, 0.1), tip)
            self.live.change_scene(lambda s: s.with_object(item))
            return
        tcp, touch = "right_gripper_tcp", self.live.model.gripper(arm_group="right_arm").hand_links
        at = scene.frame_pose(tcp) @ SE3.from_xyz(0.0, 0.0, 0.3)  # beside the table while the arm is at home
        pole = CollisionObject.single(name, Box(0.02, 0.02, 0.6), at)
        self.live.change_scene(lambda s: s.with_object(pole).with_attached(name, tcp, touch))

    def take_away(self, name: str) -> None:
        self.live.change_scene(
            lambda s: (s.with_detached(name) if name in s.attached else s).without_object(name)
        )


def check(world: World, scenario: str, move: Callable[[str, JointTrajectory], Callable[[], Answer]]) -> None:
    """Play one scenario; `move` begins a motion and returns what waits for its answer."""
    both = plans()
    right = both["right_arm"]
    before = world.joints("right_arm")
    if scenario == "nan":
        broken = right.positions.copy()
        broken[len(broken) // 2, 1] = np.nan
        bad = object.__new__(JointTrajectory)
        for field in ("joint_names", "times", "velocities", "accelerations"):
            object.__setattr__(bad, field, getattr(right, field))
        object.__setattr__(bad, "positions", broken)
        answer = move("right_arm", bad)()
        assert not answer.ok and "finite" in answer.text, answer
        assert np.allclose(world.joints("right_arm"), before, atol=2e-3)
        return
    if scenario in ("stale pair", "resting arm"):
        left = move("left_arm", both["left_arm"])
        if scenario == "resting arm":
            assert left().ok
        answer = move("right_arm", right)()
        if scenario == "stale pair":
            end = time.monotonic() + 10
            while np.abs(world.joints("left_arm") - both["left_arm"].positions[-1]).max() > 0.01:
                assert time.monotonic() < end, "the left arm did not arrive"
                time.sleep(0.02)
            left()
    else:
        world.put("wall" if scenario == "stale object" else "pole")
        try:
            answer = move("right_arm", right)()
        finally:
            world.take_away("wall" if scenario == "stale object" else "pole")
    try:
        assert not answer.ok, answer
        other = {"stale object": "wall", "held object": "pole"}.get(scenario, "left_")
        assert other in answer.text and "touch" in answer.text, answer  # the pair,
        assert " m, " in answer.text and " s " in answer.text, answer  # where and when
        assert np.allclose(world.joints("right_arm"), before, atol=2e-3)
        assert not world.contacts()
    finally:
        if scenario in ("stale pair", "resting arm"):
            assert move("left_arm", back("left_arm"))().ok


# --- through the bus and every wire ---
class Served(World):
    """A served cell, and clients of each kind."""

    def __init__(self, mode: str, stack: ExitStack, domain: Any):
        live = connected(mode, stack)
        self.session = stack.enter_context(Session(live, quiet=True))
        stack.enter_context(shims_installed(self.session.messages))
        super().__init__(live, self.session.served.call)
        self.bus = self.session.bus
        self.clients = {"bus": self.bus}
        self.actions: dict[tuple[int, str], ActionClient] = {}
        stack.callback(lambda: [client.close() for client in self.actions.values()])
        server = stack.enter_context(RosTcpServer(self.bus, ServerSettings(port=0)))
        tcp = Bus()
        bridge = ForwardedNames(
            publish={"/planned_trajectory": "trajectory_msgs/JointTrajectory"},
            subscribe={"/trajectory_status": "std_msgs/String"}, implement={}, use={},
        )  # fmt: skip
        client = stack.enter_context(RosTcpClient(tcp, *server.address, bridge))
        assert client.wait_connected(10)
        self.clients["ros_tcp"] = tcp
        uri = f"http://127.0.0.1:{free_tcp_port()}"
        for name, bus, own in (("armcell", self.bus, True), ("client", Bus(), False)):
            graph = Ros1Graph(bus, Ros1Settings(name=name, master=uri, own_master=own, timeout=5.0))
            stack.callback(graph.close)
            graph.start()
            if name == "client":
                self.clients["ros1"] = bus
        if domain is not None:
            from armcell.ros import Ros2Bridge, Ros2Settings

            stack.enter_context(Ros2Bridge(self.bus, Ros2Settings(domain, distro="jazzy")))
            self.clients["ros2"] = Bus()
            stack.enter_context(
                Ros2Bridge(self.clients["ros2"], Ros2Settings(domain, node="/client", distro="jazzy"))
            )

    def move(self, wire: str, group: str, trajectory: JointTrajectory) -> Callable[[], Answer]:
        bus = self.clients.get(wire, self.bus)
        message = trajectory_message(bus.schema, bus.header("world"), trajectory)
        if wire == "script":
            return self._script(group, trajectory)
        if wire in ("topic", "ros_tcp"):
            return self._topic(bus, message)
        if wire in ("follow_joint_trajectory", "ros2"):  # ROS 2's actions end with a code and no text
            goal = bus.schema.new(f"{FOLLOW}Goal", trajectory=message)
            return self._action(bus, f"/{group}_controller/follow_joint_trajectory", FOLLOW, goal)
        whole = bus.schema.new("moveit_msgs/RobotTrajectory", joint_trajectory=message)
        return self._action(bus, "/execute_trajectory", EXECUTE, bus.schema.new(f"{EXECUTE}Goal", whole))

    def _script(self, group: str, trajectory: JointTrajectory) -> Callable[[], Answer]:
        import moveit_commander

        commander = moveit_commander.MoveGroupCommander(group)
        schema = self.bus.schema
        message = trajectory_message(schema, self.bus.header("world"), trajectory)
        plan = schema.new("moveit_msgs/RobotTrajectory", joint_trajectory=message)
        said, found = len(self.session.lines), []
        thread = threading.Thread(target=lambda: found.append(commander.execute(plan, wait=True)))
        thread.start()
        self._begun(thread)

        def wait() -> Answer:
            thread.join(60)
            return Answer(bool(found and found[0]), "; ".join(self.session.lines[said:]))

        return wait

    def _begun(self, thread: threading.Thread) -> None:
        end = time.monotonic() + 5
        while time.monotonic() < end and thread.is_alive():
            if any(w.began is not None for w in self.session.served.cell.motions()):
                return
            time.sleep(0.005)

    def _topic(self, bus: Bus, message: Any) -> Callable[[], Answer]:
        status = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=50)
        publisher = bus.advertise("/planned_trajectory", "trajectory_msgs/JointTrajectory")
        end = time.monotonic() + 10
        while not publisher.subscribers and time.monotonic() < end:
            time.sleep(0.01)
        time.sleep(0.1)  # the latched status of the motion before
        while status.get(0) is not None:
            pass
        publisher.publish(message)
        begins, said = f"executing {len(message.points)} points", []

        def heard(*words: str) -> bool:
            while (one := status.get(0.0)) is not None:
                if one.data.startswith((begins, "refused")) or said:  # what comes before is of another motion
                    said.append(one.data)
            return any(s.startswith(words) for s in said)

        def until(seconds: float, *words: str) -> None:
            end = time.monotonic() + seconds
            while not heard(*words) and time.monotonic() < end:
                time.sleep(0.005)

        until(10, "executing", "refused")

        def wait() -> Answer:
            until(60, "done", "failed", "stopped", "refused")
            status.close()
            publisher.close()
            ended = [s for s in said if not s.startswith(("executing", "waits"))]
            return Answer(ended[:1] != [] and ended[0].startswith("done"), "; ".join(said))

        return wait

    def _action(self, bus: Bus, name: str, kind: str, goal: Any) -> Callable[[], Answer]:
        client = self._client(bus, name, kind)
        running = len(self.session.served.cell.motions())
        sent = client.send_goal(goal)
        end = time.monotonic() + 5
        while time.monotonic() < end and not sent.wait(0.0):
            if len(self.session.served.cell.motions()) > running:
                break
            time.sleep(0.005)

        def wait() -> Answer:
            assert sent.wait(60), f"{name} does not answer"
            result = sent.result
            text = f"{sent.text} {getattr(result, 'error_string', '')}"
            code = getattr(getattr(result, "error_code", None), "val", None)
            return Answer(sent.state.name == "SUCCEEDED" and code in (None, 1), text)

        return wait

    def _client(self, bus: Bus, name: str, kind: str) -> ActionClient:
        """One for all tests: its topics are joined over the wire by and by."""
        key = (id(bus), name)
        if key not in self.actions:
            self.actions[key] = ActionClient(bus, name, kind)
            end = time.monotonic() + 20
            while time.monotonic() < end and not any(
                t.name == f"{name}/goal" and t.subscribers for t in bus.topics()
            ):
                time.sleep(0.02)
            time.sleep(0.5)  # the results' way back
        return self.actions[key]


@pytest.fixture(scope="module", params=MODES)
def served(request, reach) -> Iterator[Served]:  # noqa: F811
    with ExitStack() as stack:
        yield Served(request.param, stack, reach)


@pytest.mark.cases(
    "sim-*",
    "fake-execute_trajectory-*",
    "fake-follow_joint_trajectory-*",
    "fake-topic-*",
    "fake-ros_tcp-*",
    "*-resting arm",
    "*-stale object",
    "*-held object",
    "*-nan",
)
@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("wire", WIRES)
def test_no_wire_moves_an_arm_unproven(served, wire, scenario):
    check(served, scenario, lambda group, trajectory: served.move(wire, group, trajectory))


# --- in this program: the Python API, and the viewer ---
class Local(World):
    def __init__(self, mode: str, stack: ExitStack):
        live = connected(mode, stack)
        super().__init__(stack.enter_context(live), lambda function: function())

    def move(self, group: str, trajectory: JointTrajectory) -> Callable[[], Answer]:
        try:
            outcome = self.live[group].execute(trajectory)
        except ArmcellError as error:
            answer = Answer(False, str(error))
        else:
            answer = Answer(outcome.ok, outcome.message)
        return lambda: answer


@pytest.fixture(scope="module", params=MODES)
def local(request) -> Iterator[Local]:
    with ExitStack() as stack:
        yield Local(request.param, stack)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_python_moves_no_arm_unproven(local, scenario):
    check(local, scenario, local.move)


@pytest.mark.parametrize("scenario", ["resting arm", "stale object", "held object"])
def test_the_viewer_moves_no_arm_unproven(local, scenario):
    """Its plan is made in the session's scene; the cell that it is connected to has moved on."""
    live, both = local.live, plans()

    class Connected:
        """The cell stays connected when the session ends."""

        def __init__(self) -> None:
            self.driver, self.ctx, self.scene = live.driver, live.ctx, live.scene

        def __enter__(self):
            return self

        def __exit__(self, *exc: object) -> None:
            pass

    session = PlanningSession(live.scene(), lambda scene, observers: Connected())  # type: ignore[arg-type,return-value]
    session.set_group("right_arm")
    session.set_positions(both["right_arm"].end)
    session.plan()
    assert session.wait(120) and session.result is not None and session.result.ok

    def move(group: str, trajectory: JointTrajectory) -> Callable[[], Answer]:
        if group == "left_arm":
            return local.move(group, trajectory)
        session.execute()
        assert session.wait(60) and session.outcome is not None
        return lambda: Answer(session.outcome.ok, session.outcome.message)

    try:
        check(local, scenario, move)
    finally:
        session.close()
        live.ctx.cancel = threading.Event()
