"""A live cell's scene changed while the arm moves: from other threads, at any moment, all at once.

What a stopped arm did is looked at again by pinocchio and coal, which know nothing of our checkers.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import coal
import numpy as np
import pytest
from tests.collision.reference import BruteForce
from tests.tasks.helpers import live, notes

from armcell.cell import LiveCell
from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    ErrorCode,
    InputError,
    JointState,
    Mesh,
    Plane,
    Sphere,
)
from armcell.scene import AddObject, CollisionObject, MoveObject, PlanningScene, RemoveObject, SceneDiff

CHANGED = ErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
LEFT = [1.2, 0.3, 0, -1.9, 0, 2.2, 0.8]
RIGHT = [-0.6, 0.3, 0, -1.9, 0, 2.2, 0.8]
ACROSS, BESIDE = SE3.from_xyz(0.55, 0.1, 0.6), SE3.from_xyz(-0.5, 0.0, 0.6)


def post(name: str = "rod", pose: SE3 = ACROSS, size: float = 0.06) -> CollisionObject:
    return CollisionObject.single(name, Box(size, size, 0.5), pose)


def put(item: CollisionObject) -> Callable[[PlanningScene], PlanningScene]:
    return lambda scene: scene.with_object(item)


class Meanwhile:
    """Does something in another thread and waits for it, so long [s] after the next motion has begun.

    Attributes:
        states: of the joints, sampled since then.
    """

    def __init__(self, cell: LiveCell, after: float, act: Callable[[], object]):
        self.after, self.act, self.states = after, act, []
        self.began: float | None = None
        self.done = False
        self.error: BaseException | None = None
        cell.ctx.observers.append(self)

    def on_trajectory(self, time, trajectory) -> None:
        if self.began is None:
            self.began, self.trajectory = time, trajectory

    def on_event(self, event) -> None: ...

    def on_state(self, sample) -> None:
        self.states.append(sample.joints.positions)
        if not self.done and self.began is not None and sample.time >= self.began + self.after:
            self.done = True
            self.states.clear()
            thread = threading.Thread(target=self._run)
            thread.start()
            thread.join()

    def _run(self) -> None:
        try:
            self.act()
        except BaseException as error:
            self.error = error


def touched(cell: LiveCell, item: CollisionObject, states: list) -> bool:
    """Whether the robot met an object in one of some states, by pinocchio and coal."""
    reference = BruteForce(PlanningScene.of(cell.model, objects=[item]), "panda")
    return any(
        coal.collide(*pair, coal.CollisionRequest(), coal.CollisionResult())
        for q in states
        for a, b, *pair in reference.pairs_at(q)
        if item.name in (a, b)
    )


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["sim", "fake"])
def test_an_obstacle_across_the_rest_stops_the_arm_before_it(mode):
    with live(mode) as cell:
        assert cell.arm.move_to(LEFT)
        seen = Meanwhile(cell, 0.4, lambda: cell.change_scene(put(post())))
        outcome = cell.arm.move_to(RIGHT)
        assert seen.done and outcome.code is CHANGED, outcome.message
        assert outcome.evidence["object"] == "rod" and "would touch rod" in outcome.message
        assert notes(cell, "stop") == [outcome.message]
        cell.ctx.advance(0.5)  # it comes to rest
        assert cell.arm.move_to(RIGHT), "around it"
        assert len(seen.states) > 100 and not touched(cell, post(), seen.states[::10])
        assert cell.driver.unwanted_contacts() == []
        away = cell.change_scene(lambda scene: scene.without_object("rod"))
        assert "rod" not in away.objects and cell.arm.move_to(LEFT)


def test_one_beside_the_way_changes_nothing_of_the_motion():
    ends = []
    for item in (None, post(pose=BESIDE)):
        with live("sim") as cell:
            assert cell.arm.move_to(LEFT)
            act = (lambda: None) if item is None else lambda: cell.change_scene(put(post(pose=BESIDE)))
            seen = Meanwhile(cell, 0.8, act)
            assert cell.arm.move_to(RIGHT)
            assert seen.error is None and ("rod" in cell.scene().objects) == (item is not None)
            ends.append((cell.driver.now, seen.states))
    assert ends[0][0] == ends[1][0]
    np.testing.assert_array_equal(ends[0][1], ends[1][1])


TETRAHEDRON = Mesh(
    0.15 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]),
    np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32),
)
SHAPES = [
    Box(0.1, 0.1, 0.1), Sphere(0.08), Cylinder(0.05, 0.3), Cone(0.08, 0.3), Capsule(0.05, 0.2), TETRAHEDRON,
]  # fmt: skip


@pytest.mark.cases("*-new", "Box-*")
@pytest.mark.parametrize("way", ["new", "moved", "changed"])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_every_shape_counts_new_moved_or_changed(shape, way):
    item = CollisionObject.single("thing", shape, SE3.from_xyz(0.55, 0.1, 0.55))
    before, diff = {
        "new": (None, SceneDiff.of(AddObject(item))),
        "moved": (item.at(BESIDE), SceneDiff.of(MoveObject("thing", item.T_world_object))),
        "changed": (post("thing", BESIDE), SceneDiff.of(RemoveObject("thing"), AddObject(item))),
    }[way]
    with live("fake") as cell:
        if before is not None:
            cell.change_scene(put(before))
        assert cell.arm.move_to(LEFT)
        Meanwhile(cell, 0.8, lambda: cell.change_scene(diff.applied_to))
        outcome = cell.arm.move_to(RIGHT)
        assert outcome.code is CHANGED and outcome.evidence["object"] == "thing", outcome.message


def test_a_plane_across_the_way_stops_it_too():
    with live("fake") as cell:
        assert cell.arm.move_to(LEFT)
        facing_y = SE3.from_xyz_rpy((0.0, -0.2, 0.0), (-np.pi / 2, 0, 0))
        wall = CollisionObject.single("half", Plane(), facing_y)
        Meanwhile(cell, 0.8, lambda: cell.change_scene(put(wall)))
        assert cell.arm.move_to(RIGHT).evidence["object"] == "half"


@pytest.mark.slow
def test_what_is_removed_during_a_motion_is_not_in_the_next_plan():
    with live("sim") as cell:
        cell.change_scene(put(post(pose=SE3.from_xyz(0.5, -0.33, 0.5), size=0.12)))
        refused = cell.arm.move_to(RIGHT)
        assert refused.code is ErrorCode.GOAL_IN_COLLISION and "rod" in refused.message
        Meanwhile(cell, 0.3, lambda: cell.change_scene(lambda scene: scene.without_object("rod")))
        assert cell.arm.move_to(LEFT) and cell.arm.move_to(RIGHT)


@pytest.mark.slow
def test_what_comes_between_planning_and_a_later_motion_of_the_plan_stops_that_motion():
    """The whole pick is planned; while the arm is on its way a lid comes over the cube."""
    with live("sim") as cell:
        lid = CollisionObject.single(
            "lid", Box(0.3, 0.3, 0.02), cell.scene().object("cube").T_world_object.shifted(z=0.08)
        )
        seen = Meanwhile(cell, 0.2, lambda: cell.change_scene(put(lid)))
        outcome = cell.arm.pick("cube")
        assert not outcome.ok and "lid" in "".join(notes(cell, "stop"))
        assert not touched(cell, lid, seen.states[::10]) and cell.driver.unwanted_contacts() == []


@pytest.mark.slow
def test_no_change_of_many_threads_is_lost_and_no_scene_is_torn():
    threads, turns = 6, 30
    torn: list[float] = []

    def work(cell: LiveCell, k: int) -> None:
        def counted(scene: PlanningScene) -> PlanningScene:
            for name, sign in (("one", 1), ("two", -1)):
                scene = scene.with_object_pose(name, scene.object(name).T_world_object.shifted(x=sign * 1e-3))
            return scene.with_object(post(f"own {k}", BESIDE.shifted(z=0.01 * k)))

        for _ in range(turns):
            cell.change_scene(counted)
            now = cell.scene()
            both = sum(now.object(n).T_world_object.translation[0] for n in ("one", "two"))
            if abs(both - 2 * BESIDE.translation[0]) > 1e-9:
                torn.append(both)

    with live("sim") as cell:
        for name in ("one", "two"):
            cell.change_scene(put(CollisionObject.single(name, Box(0.02, 0.02, 0.02), BESIDE)))
        assert cell.arm.move_to(LEFT)
        workers = [threading.Thread(target=work, args=(cell, k)) for k in range(threads)]
        seen = Meanwhile(cell, 0.1, lambda: [w.start() for w in workers])
        assert cell.arm.move_to(RIGHT)
        for worker in workers:
            worker.join()
        scene = cell.scene()
        assert seen.error is None and torn == []
        assert {f"own {k}" for k in range(threads)} <= set(scene.objects)
        moved = scene.object("one").T_world_object.translation[0] - BESIDE.translation[0]
        assert moved == pytest.approx(threads * turns * 1e-3)
        changes = [e for e in cell.ctx.events if e.kind == "scene"]
        assert len(changes) == threads * turns  # each told, once


@pytest.mark.slow
def test_what_is_held_stays_in_the_hand_whatever_is_changed():
    errors: list[str] = []
    off: list[float] = []

    def meddle(cell: LiveCell, held_at: SE3) -> None:
        for make in (
            lambda scene: scene.with_detached("cube").without_object("cube"),
            lambda scene: scene.with_object(post("cube", BESIDE)),
            lambda scene: scene.without_object("cube"),
        ):
            try:
                cell.change_scene(make)
            except InputError as error:
                errors.append(str(error))
        cell.change_scene(lambda scene: scene.with_detached("cube").with_object_pose("cube", BESIDE))
        for _ in range(50):
            now = cell.change_scene(put(post(pose=BESIDE)))
            off.append(now.transform("panda_hand_tcp", "cube").distance_to(held_at)[0])

    with live("sim") as cell:
        assert cell.arm.pick("cube")
        tcp = cell.model.grippers["hand"].tcp_link
        held_at = cell.scene().transform(tcp, "cube")
        seen = Meanwhile(cell, 0.3, lambda: meddle(cell, held_at))
        assert cell.arm.move_to("home")
        assert seen.error is None and len(errors) == 3 and "let go of it first" in errors[0]
        assert len(off) == 50 and max(off) < 1e-3
        assert set(cell.scene().attached) == {"cube"}
        assert cell.arm.place("cube", on="tray")


def test_what_comes_before_the_held_object_alone_stops_the_arm():
    with live("sim") as cell:
        assert cell.arm.pick("cube") and cell.arm.move_to(LEFT)

        def come() -> None:
            """A plate that the cube's lower side will meet."""
            q = seen.trajectory.sample(0.6 * seen.trajectory.duration)[0]
            then = cell.scene().with_state(JointState(seen.trajectory.joint_names, q)).frame_pose("cube")
            at = SE3.from_xyz(*then.translation).shifted(z=-0.025)
            cell.change_scene(put(CollisionObject.single("plate", Box(0.2, 0.2, 0.02), at)))

        seen = Meanwhile(cell, 0.3, come)
        outcome = cell.arm.move_to(RIGHT)
        assert outcome.code is CHANGED and outcome.evidence["object"] == "plate", outcome.message
        contact = outcome.evidence["contact"]
        assert {contact.body_a, contact.body_b} == {"plate", "cube"}
        assert {"cube"} == set(cell.scene().attached)


class ComesBeforeTheHand(Meanwhile):
    """A small box where the hand will be at the end of a stage's motion, at one of its broad sides."""

    def __init__(self, cell: LiveCell, stage: str):
        super().__init__(cell, 0.2, self.come)
        self.cell, self.stage, self.waits = cell, stage, False
        self.box: CollisionObject | None = None

    def on_event(self, event) -> None:
        self.waits |= event.kind == "stage" and event.text == self.stage

    def on_trajectory(self, time, trajectory) -> None:
        if self.waits:
            super().on_trajectory(time, trajectory)

    def come(self) -> None:
        then = self.cell.scene().with_state(self.trajectory.end)
        hand = then.frame_pose("panda_hand")
        wrist = (hand.inverse() @ then.frame_pose("panda_link6")).translation
        side = np.array([0.0, -np.copysign(0.09, wrist[1]), 0.04])  # where the wrist is not
        self.box = CollisionObject.single("box", Box(0.03, 0.03, 0.03), SE3.from_xyz(*hand.apply(side)))
        self.cell.change_scene(put(self.box))


@pytest.mark.slow
@pytest.mark.cases("lift")
@pytest.mark.parametrize("stage", ["move to pre-grasp", "approach", "lift", "move to pre-place", "lower"])
def test_transfer_goes_around_what_comes_during_any_of_its_motions(stage):
    with live("sim") as cell:
        coming = ComesBeforeTheHand(cell, stage)
        outcome = cell.arm.transfer("cube", on="tray")
        assert outcome, outcome.message
        assert coming.error is None and len(notes(cell, "stop")) == 1, cell.ctx.events
        assert outcome.evidence["error_m"] < 0.01
        assert coming.box is not None and not touched(cell, coming.box, coming.states[::10])
        assert [c for c in cell.driver.unwanted_contacts() if "panda" in c.body_a + c.body_b] == []
