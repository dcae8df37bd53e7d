"""Two arms at work at their own pace: never near each other, no deadlock, in turn; judged by coal."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.multi_arm.dual import LEFT, RIGHT, Judge, tip, with_tips
from tests.sizes import seeds

import armcell
from armcell.collision.inter_arm_checker import InterArmChecker
from armcell.core import ErrorCode, InputError, Outcome
from armcell.planning import goal_of
from armcell.tasks import checked
from armcell.tasks.arms.motion_coordinator import MotionCoordinator
from armcell.tasks.stages import Connect
from armcell.tasks.steps import CommandGripper, ParallelMotions
from armcell.tasks.task import plan_stages

pytestmark = pytest.mark.slow  # two arms: proofs, searches and physics by the second


@pytest.fixture(scope="module")
def cell():
    return armcell.load("dual_ur10")


class Watch:
    """Every sample of the joints that observers get."""

    def __init__(self):
        self.samples = []

    def on_state(self, sample):
        self.samples.append((sample.time, sample.joints))

    def on_event(self, event):
        pass

    def on_trajectory(self, time, trajectory):
        pass


def nearest(cell, watch, group="both_arms") -> float:
    """By coal, over all that was executed [m]."""
    judge, best = Judge(cell.scene(), group), 0.1
    for _, state in watch.samples:
        judge.checker.set_configuration(state.reindexed(judge.names).positions)
        for a, b in judge.pairs[judge.checker.pair_gaps(judge.pairs) < best]:
            best = min(best, judge.checker.pair_distance(int(a), int(b)))
    return best


def tour(points):
    def program(arm):
        for x, y in points:
            checked(arm.move_to(tip(x, y)))

    return program


SAME = [(-0.3, 0.0), (0.3, 0.0), (-0.1, 0.02), (0.15, -0.02)]
TOURS = {
    "the same points": (SAME, SAME),
    "against each other": (SAME, SAME[::-1]),
    "over the other's side": ([(0.4, -0.2), (-0.4, -0.2)], [(-0.4, 0.2), (0.4, 0.2)]),
}


@pytest.mark.cases("over the other's side")
@pytest.mark.parametrize("name", TOURS)
def test_tours_through_one_place_end_and_keep_apart(cell, name):
    watch = Watch()
    left, right = TOURS[name]
    with cell.connect("fake", seed=1, observers=[watch]) as live:
        result = live.side_by_side(left_arm=tour(left), right_arm=tour(right))
        state = live.driver.joint_state()
    assert result.ok, result.message
    assert nearest(cell, watch) >= 0.015  # 20 mm planned; making way may begin a little nearer
    assert len(watch.samples) > 100 and np.isfinite(state.positions).all()
    assert sum(result.waited.values()) + sum(result.yielded.values()) + sum(result.searched.values()) > 0


def test_who_stands_in_the_way_for_good_makes_way(cell):
    """Left's program is over, and it stands where right wants to go."""
    with cell.connect("fake") as live:
        result = live.side_by_side(left_arm=tour([(0.0, 0.0)]), right_arm=tour([(0.3, -0.2), (0.0, 0.0)]))
        assert result.ok, result.message
        assert result.yielded["left_arm"] >= 1
        home = live.model.named_state(LEFT, "home")
        np.testing.assert_allclose(
            live.driver.joint_state().reindexed(home.joint_names).positions, home.positions, atol=1e-6
        )


def test_a_camera_waits_until_no_arm_hides_what_it_looks_at(cell):
    """Left rests over the middle of the table, where right's camera looks."""
    view = np.array([(0.0, 0.0, 1.9), *((x, y, 0.91) for x in (-0.1, 0.1) for y in (-0.1, 0.1))])
    waited, hidden = [], []

    def look(arm):
        arm.rendezvous("left is there")
        hidden.append(arm._ctx.is_hidden(view))
        waited.extend(arm._ctx.await_view(view) for _ in range(2))
        hidden.append(arm._ctx.is_hidden(view))

    def rest(arm):
        checked(arm.move_to(tip(0.0, 0.0)))
        arm.rendezvous("left is there")

    with cell.connect("fake") as live:
        assert not live.ctx.await_view(view) and not live.ctx.is_hidden(view)  # one arm does not wait
        result = live.side_by_side(left_arm=rest, right_arm=look)
        assert result.ok, result.message
        hand = live.scene().frame_pose("left_gripper_tcp").translation
    assert hidden == [True, False]
    assert waited == [True, False] and result.yielded[LEFT] == 1 and abs(hand[1]) > 0.2


def test_an_arm_that_cannot_yield_asks_the_arm_that_asked_it(cell, monkeypatch):
    """No path leads left home, so right goes home, although it asked first."""
    plan = MotionCoordinator._plan

    def stuck(self, ctx, *rest):
        return None if ctx.group == LEFT else plan(self, ctx, *rest)

    def rest(arm):
        checked(arm.move_to(tip(0.0, 0.2)))
        arm.rendezvous("both are there")

    def ask(arm):
        checked(arm.move_to(tip(0.0, -0.2)))
        arm.rendezvous("both are there")
        coordinator = arm._ctx.coordinator
        coordinator.asked[LEFT].add(RIGHT)
        coordinator.yield_to_others(coordinator.contexts[LEFT])
        assert coordinator.asked == {LEFT: set(), RIGHT: {LEFT}}
        coordinator._idle(arm._ctx)

    monkeypatch.setattr(MotionCoordinator, "_plan", stuck)
    with cell.connect("fake") as live:
        result = live.side_by_side(left_arm=rest, right_arm=ask)
        assert result.ok, result.message
    assert result.yielded == {LEFT: 0, RIGHT: 1}


def test_arms_that_rest_close_together_may_move_apart():
    """At rest with a distance just above the clearance, no motion could keep the whole clearance."""
    coordinator = MotionCoordinator((LEFT, RIGHT), 0.02, 30.0)
    seen = []
    for y in np.arange(0.05, 0.20, 0.001):
        scene = with_tips((0.0, y), (0.0, -y))
        arms = InterArmChecker(scene, (LEFT, RIGHT))
        near = arms.contact(scene.state.reindexed(arms.joint_names).positions)
        distance = np.inf if near is None else near.distance
        expected = 0.02 if distance >= 0.025 else max(distance - 0.005, 0.0)
        assert coordinator._clearance_now(arms, scene) == pytest.approx(expected)
        seen.append(distance)
    assert any(0.02 < distance < 0.025 for distance in seen)


def test_a_motion_during_which_the_fingers_move_waits_and_takes_no_detour(cell):
    """The moving fingers are proven free only along this motion."""

    def passes(arm):
        ctx, gripper = arm._ctx, arm._ctx.base.model.gripper(arm_group=arm.group)
        goal = goal_of(ctx.base.model, arm.group, tip(0.3, -0.1))
        solution, outcome = plan_stages(
            ctx, [Connect("pass", arm.group, ctx.settings.free, goal=goal)], "pass"
        )
        assert solution is not None, outcome.message
        (step,) = solution.steps
        grip = CommandGripper("close", gripper, 0.05, gripper.max_force)
        arm.rendezvous("left is there")
        return ParallelMotions(step, (grip,)).perform(ctx)

    def stays(arm):
        checked(arm.move_to(tip(0.3, -0.1)))
        arm.rendezvous("left is there")
        checked(arm.hold(1.0))
        return arm.move_to("home")

    with cell.connect("fake") as live:
        result = live.side_by_side(left_arm=stays, right_arm=passes)
        assert result.ok, result.message
    assert result.waited[RIGHT] > 0.9 and result.searched[RIGHT] == 0


def test_neither_arm_is_starved(cell):
    """Six visits each to one place: neither is served twice while the other waits, but for a turn at most."""
    served = []

    def program(name):
        def run(arm):
            for _ in range(4):
                with arm.reserve("the middle"):
                    checked(arm.move_to(tip(0.0, 0.0)))
                    served.append(name)
                checked(arm.move_to("home"))

        return run

    with cell.connect("fake") as live:
        assert live.side_by_side(left_arm=program("l"), right_arm=program("r")).ok
    assert "".join(served) in ("lrlrlrlr", "rlrlrlrl")


def test_a_zone_has_one_arm_at_a_time_and_nobody_has_two(cell):
    inside = []

    def program(arm):
        for _ in range(3):
            with arm.reserve("bin"):
                inside.append(1)
                assert sum(inside) == 1
                arm.hold(0.3)
                inside.append(-1)
            arm.hold(0.1)

    with cell.connect("fake") as live:
        assert live.side_by_side(left_arm=program, right_arm=program).ok

    def greedy(arm):
        with arm.reserve("a"), arm.reserve("b"):
            pass

    with cell.connect("fake") as live, pytest.raises(InputError, match="holds zone 'a'"):
        live.side_by_side(left_arm=greedy, right_arm=lambda arm: None)


def test_one_program_fails_and_the_other_ends(cell):
    after = []

    def fails(arm):
        arm.hold(0.5)
        return Outcome(ErrorCode.CONTROL_FAILED, "lost it")

    def goes_on(arm):
        for _ in range(100):
            if not arm.hold(0.2):
                return Outcome(ErrorCode.PREEMPTED)
            after.append(1)
        return None

    with cell.connect("fake") as live:
        result = live.side_by_side(left_arm=fails, right_arm=goes_on)
        assert result.code is ErrorCode.CONTROL_FAILED and "lost it" in result.message
        assert len(after) < 5 and result.outcomes[RIGHT].code is ErrorCode.PREEMPTED
        assert live[LEFT].move_to("up").ok  # the cell goes on


def test_an_error_in_a_program_is_raised_and_both_have_stopped(cell):
    def broken(arm):
        arm.hold(0.3)
        raise KeyError("mine")

    with cell.connect("fake") as live:
        with pytest.raises(KeyError, match="mine"):
            live.side_by_side(left_arm=broken, right_arm=tour(SAME))
        assert np.all(live.driver.joint_state().velocities == 0)


def test_meeting_points(cell):
    seen = []

    def program(name, pause):
        def run(arm):
            arm.hold(pause)
            arm.rendezvous("half")
            seen.append((name, arm._ctx.driver.now))

        return run

    with cell.connect("fake") as live:
        assert live.side_by_side(left_arm=program("l", 0.2), right_arm=program("r", 1.5)).ok
    assert abs(seen[0][1] - seen[1][1]) <= 0.11 and seen[0][1] >= 1.5


@pytest.mark.long
def test_the_same_seed_gives_the_same_run(cell):
    ends = []
    for _ in range(2):
        with cell.connect("sim", seed=3) as live:
            result = live.side_by_side(left_arm=tour(SAME[:2]), right_arm=tour(SAME[:2]))
            assert result.ok
            ends.append((result.makespan, live.driver.joint_state().positions.tobytes()))
    assert ends[0] == ends[1]


def test_misuse(cell):
    with cell.connect("fake") as live:
        with pytest.raises(InputError, match="two arms need one each"):
            live.side_by_side(left_arm=tour(SAME))
        with pytest.raises(InputError, match="unknown arm 'middle_arm'"):
            live.side_by_side(left_arm=tour(SAME), middle_arm=tour(SAME))


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(1, range(3)))
def test_sorting_in_physics(seed):
    from armcell.cell import run_task

    sorting = armcell.load("dual_ur10_sort")
    with sorting.connect("sim", seed=seed) as live:
        result = run_task(sorting, live, seed, "sim")
    assert result["success"], result["message"]
    assert not result["unwanted_contacts"] and not result["welds"]
