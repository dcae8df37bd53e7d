"""The motion gate by itself: what it proves, when it proves it again, and that there is no way around it."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from tests.cell.test_motion_gate_matrix import back, plans
from tests.execution.helpers import make

import armcell
from armcell.cell import load
from armcell.collision import ExactChecker
from armcell.core import Box, ErrorCode, InputError, JointTrajectory, Outcome
from armcell.execution import SCENE_INVALIDATED, DriverWorld, MotionGate, execute, execution_steps
from armcell.scene import CollisionObject, PlanningScene

SOURCE = Path(armcell.__file__).parent
MOVERS = {  # what may give a driver commands, and why
    "execution": "the executor, which plays only what the gate has proven",
    "drivers": "drivers behind drivers",
    "emulators": "the emulated controllers' physics",
    "sim": "physics below the drivers",
    "ros/nodes/motion_queue.py": "a stop of some joints: they hold where they are",
}
COMMANDS = {"command", "follow", "play", "set_arm_target", "set_positions"}
OTHERS = {"cli/", "ros/tcp", "moveit/shims", "viewer/", "records/"}  # `command` of typer, TCP, tables


@pytest.fixture(scope="module")
def scene():
    return load("dual_ur10").scene()


@pytest.fixture
def driver(scene):
    with make("fake", scene) as connected:
        yield connected


def slowed(trajectory: JointTrajectory, factor: float) -> JointTrajectory:
    v, a = trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None
    return JointTrajectory(
        trajectory.joint_names, trajectory.times * factor, trajectory.positions, v / factor, a / factor**2
    )


def run(driver, works, until=60.0, during=None):
    """Step motions side by side until all have ended; their results."""
    results = [None] * len(works)
    while None in results and driver.now < until:
        for i, steps in enumerate(works):
            if results[i] is None:
                try:
                    next(steps)
                except StopIteration as end:
                    results[i] = end.value
        if during is not None:
            during(driver.now)
        driver.advance(driver.period)
    return results


def test_an_arm_waits_for_no_one_who_is_leaving(driver, scene):
    """Proven in time: one arm leaves the place that the other one reaches later."""
    gate = MotionGate(DriverWorld(driver, scene))
    assert execute(driver, gate.motion(plans()["left_arm"])).ok
    leaving, coming = back("left_arm"), slowed(plans()["right_arm"], 6.0)
    works = [execution_steps(driver, gate.motion(leaving)), execution_steps(driver, gate.motion(coming))]
    first, second = run(driver, works)
    assert first.ok and second.ok, (first, second)
    assert ExactChecker(scene.with_state(driver.joint_state())).is_free(driver.joint_state().positions)


def test_a_motion_is_proven_again_when_one_beside_it_ends_early(driver, scene):
    """The same, but the leaving arm is stopped half-way: the other one stops before it touches it."""
    gate = MotionGate(DriverWorld(driver, scene))
    assert execute(driver, gate.motion(plans()["left_arm"])).ok
    leaving, coming = gate.motion(back("left_arm")), gate.motion(slowed(plans()["right_arm"], 6.0))
    exact, began = ExactChecker(scene.with_padding(0.0)), driver.now

    def during(now: float) -> None:
        if now - began > 0.3:
            leaving.set()
        assert exact.is_free(driver.joint_state().positions), "the arms touch"

    first, second = run(
        driver, [execution_steps(driver, leaving), execution_steps(driver, coming)], during=during
    )
    assert first.code is ErrorCode.PREEMPTED
    assert second.code is SCENE_INVALIDATED, second
    assert "left_" in second.message and "stopped" in second.message
    assert second.evidence["pair"] and second.evidence["time_s"] > 0


def test_what_a_motion_beside_it_may_touch_does_not_stop_a_motion(driver, scene):
    """One hand moves into a box, as into a heap; the other arm starts meanwhile."""
    into, gate_scene = plans()["left_arm"], scene.with_state(plans()["left_arm"].end)
    box = CollisionObject.single("heap", Box(0.3, 0.3, 0.1), gate_scene.frame_pose("left_gripper_tcp"))
    beside, away = scene.with_object(box), back_off("right_arm", scene)
    allowed = beside.with_allowed("heap", [n for n in scene.model.links if n.startswith("left_")])
    gate = MotionGate(DriverWorld(driver, beside))
    touching, other = gate.motion(into, planned_in=allowed), gate.motion(away)
    assert touching.begin() is None
    assert other.begin() is None, other.conflict
    for motion in (other, touching):
        motion.end(Outcome(ErrorCode.SUCCESS))
    assert gate.motion(into).begin() is not None  # who is not allowed to touch it does not start


def test_a_motion_beside_it_allows_no_contact_of_what_a_motion_moves(driver, scene):
    """The scene of one arm's motion allows the other hand in a crate, but the other motion does not."""
    crate = CollisionObject.single("crate", Box(0.2, 0.2, 0.2), scene.frame_pose("right_gripper_tcp"))
    beside = scene.with_object(crate)
    allowed = beside.with_allowed("crate", list(scene.model.links))
    gate = MotionGate(DriverWorld(driver, beside))
    first, second = (
        gate.motion(plans()["left_arm"], planned_in=allowed),
        gate.motion(back_off("right_arm", scene)),
    )
    assert first.begin() is None
    assert second.begin() is not None and "crate" in str(second.conflict)
    first.end(Outcome(ErrorCode.SUCCESS))


def back_off(group: str, scene: PlanningScene) -> JointTrajectory:
    """A short motion of one joint of an arm at home, away from the other arm."""
    names = scene.model.group(group).joint_names
    start = scene.state.reindexed(names).positions
    end = start + 0.2 * np.eye(len(names))[names.index("right_wrist_3_joint")]
    zero = np.zeros((2, len(names)))
    return JointTrajectory(names, np.array([0.0, 1.0]), np.vstack([start, end]), zero, zero)


@pytest.mark.slow
def test_only_the_executor_commands_drivers():
    """Every other place that calls a driver's commands would be a way around the gate."""
    found = []
    for file in SOURCE.rglob("*.py"):
        name = file.relative_to(SOURCE).as_posix()
        if any(name.startswith(allowed) for allowed in (*MOVERS, *OTHERS)):
            continue
        text = file.read_text()
        if not any(f".{command}" in text for command in COMMANDS):
            continue  # parsing all files takes 2 s
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in COMMANDS
            ):
                owner = ast.unparse(node.func.value)
                if "driver" in owner or "world" in owner:
                    found.append(f"{name}:{node.lineno} {owner}.{node.func.attr}")
    assert not found, found


def test_ungated_motions_are_for_simulations_of_their_own():
    """`UngatedMotion` is what the dry run uses, and nothing else in the package."""
    users = [
        f.relative_to(SOURCE).as_posix() for f in SOURCE.rglob("*.py") if "UngatedMotion(" in f.read_text()
    ]
    assert sorted(users) == ["execution/motion_gate.py", "twin/dry_run.py"]


def test_the_executor_refuses_a_bare_trajectory(driver):
    with pytest.raises(InputError, match="MotionGate"):
        execute(driver, plans()["left_arm"])  # type: ignore[arg-type]
