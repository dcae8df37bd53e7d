"""Several motions on one driver: which run, which wait, which end, and what a stop holds."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.execution.helpers import make
from tests.execution.ungated import execution_steps

from armcell.cell import load
from armcell.collision.motion_proof import ActiveMotion, first_conflict
from armcell.core import ErrorCode, ExecutionResult, InputError, JointTrajectory
from armcell.ros.nodes.cell_motions import SHIFT
from armcell.ros.nodes.motion_queue import MAX_WORKS, MotionHandle, MotionQueue
from armcell.scene import PlanningScene


@pytest.fixture(scope="module")
def scene() -> PlanningScene:
    return load("dual_ur10").scene()


@pytest.fixture
def driver(scene):
    with make("fake", scene) as connected:
        yield connected


def swing(driver, side, shift=0.3, duration=1.0):
    names = driver._model.group(f"{side}_arm").joint_names
    q = driver.joint_state().reindexed(names).positions
    end = q + shift * (np.arange(len(names)) == 0)
    return JointTrajectory(names, np.array([0.0, duration]), np.array([q, end]), np.zeros((2, len(names))))


def work(driver, side, **kwargs):
    motion = swing(driver, side, **kwargs)
    return MotionHandle(
        side, motion.joint_names, lambda d, c: execution_steps(d, motion, cancel=c), trajectory=motion
    )


def turn_until(conductor, condition, seconds=5.0):
    end = conductor.now + seconds
    while not condition() and conductor.now < end:
        conductor.step()
    assert condition()


def test_arms_move_at_once(driver):
    conductor = MotionQueue(driver)
    left, right = conductor.put(work(driver, "left")), conductor.put(work(driver, "right"))
    turn_until(conductor, lambda: left.is_over and right.is_over)
    assert left.outcome().ok and right.outcome().ok
    assert left.began == right.began and conductor.now < left.began + 1.2  # not one after the other


def test_a_newer_motion_of_the_same_joints_takes_over(driver):
    conductor = MotionQueue(driver)
    first, other = conductor.put(work(driver, "left")), conductor.put(work(driver, "right"))
    for _ in range(20):
        conductor.step()
    second = conductor.put(
        MotionHandle(
            "left", first.joints, lambda d, c: execution_steps(d, swing(driver, "left", 0.1), cancel=c)
        )
    )
    turn_until(conductor, lambda: second.is_over and other.is_over)
    assert first.outcome().code is ErrorCode.PREEMPTED and second.outcome().ok and other.outcome().ok


def test_an_arm_that_gets_a_newer_motion_does_not_stop_in_between(scene):
    """In physics, on the way to the same side: its speed never falls to that of an arm told to stop."""
    with make("sim", scene) as driver:
        conductor = MotionQueue(driver)
        names = scene.model.group("left_arm").joint_names
        q = driver.joint_state().reindexed(names).positions
        way = JointTrajectory(
            names, np.array([0.0, 1.0]), np.array([q, q + 0.6 * np.eye(len(q))[0]]), np.zeros((2, len(q)))
        )
        first = conductor.put(MotionHandle("left", names, lambda d, c: execution_steps(d, way, cancel=c)))
        turn_until(conductor, lambda: driver.now > 0.4)
        joint = names[0]

        def steps(d, cancel):
            state = d.joint_state().reindexed(names)
            far = state.positions + 0.6 * np.eye(len(state.joint_names))[0]
            q, v = np.array([state.positions, far]), np.array([state.velocities, 0 * far])
            return execution_steps(
                d, JointTrajectory(state.joint_names, np.array([0.0, 1.0]), q, v), cancel=cancel
            )

        before = driver.joint_state().reindexed([joint]).velocities[0]
        second = conductor.put(MotionHandle("left", first.joints, steps))
        speeds = []
        for _ in range(20):
            conductor.step()
            speeds.append(driver.joint_state().reindexed([joint]).velocities[0])
        assert first.outcome().code is ErrorCode.PREEMPTED
        assert before > 0.5 and min(speeds) > 0.8 * before
        turn_until(conductor, lambda: second.is_over)
        assert second.outcome().ok, second.outcome().message


def test_what_does_not_give_way_is_waited_for(driver):
    conductor = MotionQueue(driver)
    first = work(driver, "left")
    first.gives_way = False
    conductor.put(first)
    conductor.step()
    second = conductor.put(
        MotionHandle(
            "left", first.joints, lambda d, c: execution_steps(d, swing(driver, "left", 0.1), cancel=c)
        )
    )
    turn_until(conductor, lambda: second.is_over)
    assert first.outcome().ok and second.outcome().ok and second.began >= first.outcome().finished


def test_a_stop_of_one_arm_leaves_the_other_moving(driver):
    conductor = MotionQueue(driver)
    left, right = conductor.put(work(driver, "left")), conductor.put(work(driver, "right"))
    goal = right.trajectory.end.positions
    for _ in range(20):
        conductor.step()
    left.cancel.set()
    turn_until(conductor, lambda: left.is_over and right.is_over)
    assert left.outcome().code is ErrorCode.PREEMPTED and right.outcome().ok
    names = right.trajectory.joint_names
    assert np.allclose(driver.joint_state().reindexed(names).positions, goal, atol=1e-3)


def test_a_job_has_the_driver_to_itself_and_others_of_other_joints_go_on(driver):
    conductor = MotionQueue(driver)
    left = conductor.put(work(driver, "left"))
    ran = []

    def job(cancel):
        conductor.advance(0.5)
        ran.append(conductor.now)
        return ExecutionResult(ErrorCode.SUCCESS)

    right = conductor.put(MotionHandle("job", swing(driver, "right").joint_names, job=job))
    turn_until(conductor, lambda: left.is_over and right.is_over)
    assert ran and left.outcome().ok and right.outcome().ok and conductor.now < 1.3


def test_calls_from_other_threads_are_answered_between_steps(driver):
    conductor, answers = MotionQueue(driver), []

    def ask():
        answers.append(conductor.call(lambda: threading.current_thread().name))
        with pytest.raises(ZeroDivisionError):
            conductor.call(lambda: 1 / 0)
        answers.append("raised")

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    end = time.monotonic() + 30  # by the wall's clock: the other thread has to get its turn
    while thread.is_alive() and time.monotonic() < end:
        conductor.step()
    assert answers == [threading.current_thread().name, "raised"]


def test_what_is_told_soon_cannot_end_the_cell(driver, caplog):
    conductor, told = MotionQueue(driver), []
    conductor.call_soon(lambda: 1 / 0)
    conductor.call_soon(lambda: told.append(conductor.now))
    conductor.step()
    assert told and "could not be delivered" in caplog.text


def test_settling_ends_what_moves_and_nothing_can_be_put_any_more(driver):
    def steps(d, cancel):  # needs 0.3 s to come to rest
        while not cancel.is_set():
            yield
        until = driver.now + 0.3
        while driver.now < until:
            yield
        return ExecutionResult(ErrorCode.PREEMPTED, "rests")

    conductor = MotionQueue(driver)
    slow = conductor.put(MotionHandle("slow", ("left_shoulder_pan_joint",), steps))
    conductor.step()
    conductor.stop_and_drain()
    assert slow.is_over and slow.outcome().message == "rests" and not conductor.motions()
    with pytest.raises(InputError, match="closed"):
        conductor.put(work(driver, "right"))


def test_a_work_that_fails_ends_with_its_error_and_the_others_go_on(driver):
    conductor = MotionQueue(driver)

    def bad(d, cancel):
        yield
        raise InputError("broken")

    broken = conductor.put(MotionHandle("bad", ["right_elbow_joint"], bad))
    left = conductor.put(work(driver, "left"))
    turn_until(conductor, lambda: left.is_over)
    with pytest.raises(InputError, match="broken"):
        broken.outcome()
    assert left.outcome().ok


def test_too_many_are_refused_and_closing_answers_everybody(driver):
    conductor = MotionQueue(driver)
    works = []
    for _ in range(MAX_WORKS):
        each = work(driver, "left")
        each.gives_way = False
        works.append(conductor.put(each))
    with pytest.raises(InputError, match="wait already"):
        conductor.put(work(driver, "left"))
    conductor.close()
    assert all(w.outcome().code is ErrorCode.PREEMPTED for w in works)
    with pytest.raises(InputError, match="closed"):
        conductor.put(work(driver, "left"))


def test_motions_that_meet_are_told_from_those_that_do_not(driver, scene):
    """Two tips sent to one point: the arms stand opposite each other; coal's checker looks at the ends."""
    from armcell.collision import ExactChecker
    from armcell.planning import solve_ik

    at = scene.frame_pose("left_gripper_tcp")
    middle = type(at)(at.rotation, np.array([0.0, 0.0, 1.3]))
    motions = []
    for side in ("left", "right"):
        own = scene.frame_pose(f"{side}_gripper_tcp")
        found = solve_ik(scene, f"{side}_arm", type(own)(own.rotation, middle.translation))
        assert found.ok, found.message
        names = scene.model.group(f"{side}_arm").joint_names
        q = scene.state.reindexed(names).positions
        motions.append(
            JointTrajectory(names, np.array([0, 2.0]), np.array([q, found.positions]), np.zeros((2, 6)))
        )
    both = scene.with_state(motions[0].end).with_state(motions[1].end)
    assert ExactChecker(both).contacts(both.positions, padded=False)
    beside = first_conflict(scene, ActiveMotion(motions[1]), [ActiveMotion(motions[0])], SHIFT)
    assert beside is not None and beside.contact is not None
    apart = [ActiveMotion(swing(driver, side, 0.1)) for side in ("left", "right")]
    assert first_conflict(scene, apart[1], apart[:1], SHIFT) is None
