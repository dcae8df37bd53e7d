"""Hand and heap: release over the tray, a wall between the fingers, fingers that closed on nothing."""

from __future__ import annotations

import threading
from importlib import import_module
from types import SimpleNamespace

import pytest

from armcell.core import SE3, Box, ErrorCode, Outcome, PointCloud
from armcell.drivers import GripperReading
from armcell.grasping import HeapGrasp
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks import TaskSettings
from armcell.tasks.bin_clearing import BinClearingCounts, BinClearingSettings
from armcell.tasks.bin_clearing.clear_bin import _BinClearing
from armcell.tasks.bin_clearing.stages import FREE, HEAP, CloseOnHeap, Drop, held_object
from armcell.tasks.bin_clearing.work_regions import WorkRegion
from armcell.tasks.search import PartialSolution, SearchState
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import DONE, CommandGripper

clear_bin_file = import_module("armcell.tasks.bin_clearing.clear_bin")

HELD = 0.030  # [m]
WANTED = 0.050
SPEED = 0.1  # [m/s]


class Fingers:
    """A gripper whose fingers open at a constant speed up to an obstacle."""

    def __init__(self, blocked_at: float):
        self.now, self.width, self.target, self.blocked_at = 0.0, HELD, HELD, blocked_at

    def gripper(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(width=self.width, force_per_finger=0.0)

    def command_gripper(self, name: str, width: float, force: float) -> None:
        self.target = width

    def advance(self, seconds: float) -> None:
        self.now += seconds
        self.width = min(self.width + SPEED * seconds, self.target, self.blocked_at)


def drop(blocked_at: float):
    fingers = Fingers(blocked_at)
    scene = SimpleNamespace(attached={}, objects={})
    ctx = SimpleNamespace(
        driver=fingers, settings=TaskSettings(), cancel=threading.Event(), reports=[],
        advance=fingers.advance, emit=lambda *a, **k: None, change_scene=lambda make: make(scene),
    )  # fmt: skip
    gripper = SimpleNamespace(name="gripper")
    return Drop(CommandGripper("open", gripper, WANTED, 40.0, 0.1)).perform(ctx), fingers, ctx


@pytest.mark.parametrize("blocked_at", [1.0, HELD + FREE + 0.001])
def test_fingers_that_a_wall_stops_after_the_object_is_free_have_released_it(blocked_at):
    outcome, fingers, ctx = drop(blocked_at)
    assert outcome.ok and ctx.reports[0].ok
    assert fingers.width == pytest.approx(min(WANTED, blocked_at), abs=1e-3)
    assert fingers.now < (WANTED - HELD) / SPEED + 0.1 + 0.1 + 0.05


def test_fingers_that_do_not_open_have_not_released_it():
    outcome, fingers, _ = drop(HELD + 0.001)
    assert outcome.code is ErrorCode.CONTROL_FAILED and "wanted 50.0 mm" in outcome.message
    assert fingers.now >= TaskSettings().gripper_timeout


def at_grasp(wall: float | None) -> tuple[PlanningScene, HeapGrasp]:
    """The open hand around a piece of a heap, with a thin wall at a distance [m] from its middle."""
    model = load_robot("ur10_gripper")
    gripper, scene = model.gripper(), PlanningScene.of(model).with_state(model.named_state("arm", "home"))
    scene = scene.with_state(finger_state(gripper, 0.08))
    tcp = scene.frame_pose(gripper.tcp_link)
    heap = CollisionObject.single(HEAP, PointCloud([tcp.translation], 0.006))
    scene = scene.with_object(heap)
    if wall is not None:
        scene = scene.with_object(
            CollisionObject.single("bin", Box(0.1, 0.004, 0.03), tcp @ SE3.from_xyz(0, wall, 0))
        )
    z = float(tcp.translation[2])
    return scene, HeapGrasp("piece", tcp, 0.07, 0.08, 30.0, 1.0, top=z + 0.02)


@pytest.mark.parametrize("wall, rejected", [(None, False), (0.02, True), (-0.03, True), (0.12, False)])
def test_a_grasp_with_a_wall_between_the_fingers_is_rejected(wall, rejected):
    """The image does not show a wall below an object that leans over it."""
    scene, grasp = at_grasp(wall)
    planning = SearchState(TaskSettings(), 0)
    stage = CloseOnHeap(scene.model.gripper(), float(grasp.T_object_tcp.translation[2]) - 0.03, 0.1, 0.0005)
    found = list(stage.propose(PartialSolution(scene, data={"grasp": grasp}), planning))
    assert len(found) == (0 if rejected else 1)
    if rejected:
        assert "bin" in planning.rejections.summary()


@pytest.mark.parametrize(
    "reading, opens_to",
    [
        (GripperReading(-0.0001, 0.0, None), 0.012),  # nothing, or sheet metal that is thinner than the error
        (GripperReading(0.03, 30.0, None), 0.042),
        (GripperReading(0.08, 0.0, None), None),  # it has not closed
    ],
)
def test_after_a_failed_grasp_fingers_that_have_closed_open_a_little(reading, opens_to, monkeypatch):
    scene, grasp = at_grasp(None)
    opened: list[float] = []
    ctx = SimpleNamespace(
        driver=SimpleNamespace(gripper=lambda name: reading), settings=TaskSettings(release_margin=0.012),
        change_scene=lambda make: make(scene), scene=lambda: scene.with_state(scene.state),
    )  # fmt: skip
    monkeypatch.setattr(CommandGripper, "perform", lambda grip, ctx: opened.append(grip.width))
    monkeypatch.setattr(_BinClearing, "_try_straight", lambda *a: None)
    look = lambda: None  # noqa: E731
    clearing = _BinClearing(
        ctx,
        scene.model.gripper(),
        ("bin", "tray"),
        BinClearingSettings(),
        BinClearingCounts(),
        (),
        look,
        None,
    )
    clearing.retreat(grasp)
    assert opened == ([] if opens_to is None else [pytest.approx(opens_to)])


def test_fingers_inside_a_channel_close_half_way_and_have_released_it():
    """A finger inside a channel of sheet metal opens only until it meets the other side of the channel."""
    outcome, fingers, _ = drop(HELD + 0.004)
    assert outcome.ok
    assert fingers.target == pytest.approx(HELD + 0.002, abs=1e-4)
    assert fingers.now < TaskSettings().gripper_timeout


@pytest.mark.parametrize("is_over, force", [(True, 30.0), (False, 30.0), (True, 0.0)])
def test_an_object_that_touches_the_tray_before_the_arm_has_arrived_is_released_there(
    is_over, force, monkeypatch
):
    scene, grasp = at_grasp(None)
    gripper = scene.model.gripper()
    tcp = scene.frame_pose(gripper.tcp_link)
    item = CollisionObject.single(held_object(gripper), Box(0.02, 0.03, 0.02), tcp, movable=True)
    scene = scene.with_object(item).with_attached(item.name, gripper.tcp_link, gripper.hand_links)
    ctx = SimpleNamespace(
        driver=SimpleNamespace(gripper=lambda name: GripperReading(0.03, force, None)), scene=lambda: scene,
        settings=TaskSettings(release_margin=0.012), change_scene=lambda make: make(scene),
    )  # fmt: skip
    stopped = Outcome(ErrorCode.CONTROL_FAILED, "wrist_1_joint ended 0.01 from the goal")
    opened: list[float] = []
    monkeypatch.setattr(clear_bin_file, "perform_all", lambda ctx, steps: stopped)
    monkeypatch.setattr(CommandGripper, "perform", lambda grip, ctx: opened.append(grip.width))
    monkeypatch.setattr(Drop, "perform", lambda drop, ctx: opened.append(drop.grip.width) or DONE)
    monkeypatch.setattr(_BinClearing, "_try_straight", lambda *a: None)
    x, y = tcp.translation[:2] + (0.0 if is_over else 1.0)
    tray = WorkRegion("in tray", ((x - 0.1, y - 0.1), (x + 0.1, y + 0.1)), 0.0)
    counts = BinClearingCounts()
    clearing = _BinClearing(ctx, gripper, ("bin",), BinClearingSettings(), counts, (), lambda: None, tray)
    outcome = clearing._put(PartialSolution(scene), grasp)
    released = is_over and force > 0
    assert (outcome.ok, counts.put, counts.dropped) == (released, int(released), int(force == 0))
    assert opened == [pytest.approx(0.042 if released else grasp.opening)]
