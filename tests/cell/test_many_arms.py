"""The cells of three and of four arms: they open with every command, and their tasks succeed apart."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cli.helpers import call
from tests.planning.multi_arm.dual import Judge
from tests.tasks.arms.test_side_by_side import Watch

from armcell.cell import load, run_task
from armcell.ros.bus import Bus
from armcell.ros.nodes import CellNode

CELLS = {"three_ur5_table": "abc", "four_ur5_square": "abcd"}


@pytest.fixture(scope="module", params=CELLS)
def name(request):
    return request.param


def nearest(cell, states) -> float:
    """Smallest distance [m] between two arms in the executed states; at most 0.1."""
    judge, best = Judge(cell.scene(), "all_arms"), 0.1
    for state in states:
        judge.checker.set_configuration(state.reindexed(judge.names).positions)
        for a, b in judge.pairs[judge.checker.pair_gaps(judge.pairs) < best]:
            best = min(best, judge.checker.pair_distance(int(a), int(b)))
    return best


def test_its_arms_are_apart_at_home(name):
    cell = load(name)
    assert list(cell.connect("fake", 0).arms) == [f"{arm}_arm" for arm in CELLS[name]]
    assert nearest(cell, [cell.scene().state]) == 0.1


@pytest.mark.slow
@pytest.mark.cases("three_ur5_table")
def test_it_is_checked_and_planned(name, capsys):
    assert call(capsys, "check", name).status == 0
    for group in (f"{CELLS[name][-1]}_arm", "all_arms"):
        assert call(capsys, "plan", name, "--to", "up", "--group", group).status == 0


def test_the_view_offers_each_arm_and_all(name):
    from armcell.viewer import PlanningSession

    session = PlanningSession(load(name).scene())
    assert {*(f"{arm}_arm" for arm in CELLS[name]), "all_arms"} <= set(session.groups)
    session.set_group("all_arms")
    assert set(session.state_names) == {"home", "up"}


@pytest.mark.long
@pytest.mark.parametrize("mode", ["fake", "sim"])
def test_its_task_succeeds(name, mode):
    cell, watch = load(name), Watch()
    with cell.connect(mode, 0, observers=[watch]) as live:
        result = run_task(cell, live, 0, mode)
    assert result["success"], result["message"]
    assert not result["unwanted_contacts"] and not result["welds"]
    assert nearest(cell, [state for _, state in watch.samples[::5]]) > 5e-3


@pytest.mark.slow
def test_a_bar_is_handed_on_around_the_table(tmp_path):
    """From A to B and from B to C, each time with a third arm beside them."""
    file = tmp_path / "cell.yaml"
    file.write_text("""
robot: three_ur5
start: {all_arms: home, grippers: open}
physics: {full_gain_effort: 150}
settings: {planning_budget: 200}  # [s], for machines that other programs fill
objects:
  table: {box: [0.78, 0.78, 0.05], pose: [0, 0, 0.875]}
  bar: {box: [0.04, 0.3, 0.04], pose: [0.2, 0, 0.9205], movable: true, mass: 0.3, friction: 0.8}
""")
    with load(file).connect("sim", 0) as live:
        assert live["a_arm"].pick("bar")
        for receiver in ("b", "c"):
            given = live.hand_over("bar", to=f"{receiver}_arm")
            assert given, given.message
            assert live.ctx.holding["bar"].gripper.name == f"{receiver}_gripper"
            giver = live["a_arm" if receiver == "b" else "b_arm"]
            assert giver.move_to("home")
        assert live["c_arm"].place("bar", on="table")
        assert live.driver.unwanted_contacts() == []


@pytest.mark.slow
def test_each_arm_has_its_own_topics():
    bus = Bus()
    node = CellNode(load("three_ur5_table").connect("fake", 0, time_scale=10.0), bus)
    thread = node.start()
    try:
        assert node.ready.wait(300)
        whole = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1).get(5)
        at = dict(zip(whole.name, whole.position))
        for arm in "abc":
            mine = bus.subscribe(f"/{arm}_arm/joint_states", "sensor_msgs/JointState", queue_size=1).get(5)
            assert len(mine.name) == 8 and all(joint.startswith(f"{arm}_") for joint in mine.name)
            assert [at[joint] for joint in mine.name] == pytest.approx(list(mine.position), abs=1e-6)
            mode = bus.subscribe(f"/{arm}_arm/robot_mode", "ur_dashboard_msgs/RobotMode").get(5)
            assert mode.mode == 7
        assert np.isfinite(whole.position).all()
    finally:
        node.close()
        thread.join(10)
