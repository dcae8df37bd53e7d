"""One object in two hands: the relative pose at every tick, force, refusal; and the screwing task."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sizes import seeds

import armcell
from armcell.cell import run_task
from armcell.core import SE3, ErrorCode, InputError
from armcell.kinematics import kinematic_tree
from armcell.planning.multi_arm.carry import plan_carry
from armcell.planning.multi_arm.closed_chain import CarriedObject
from armcell.tasks import checked
from armcell.tasks.arms import CarrySettings, moved_object_pose

pytestmark = pytest.mark.slow  # two arms: proofs, searches and physics by the second

ENDS = {"left_arm": "front_end", "right_arm": "back_end"}


@pytest.fixture(scope="module")
def cell():
    return armcell.load("dual_ur10_rod")


class Kept:
    """The trajectories that were announced, and the plans that were told with them."""

    def __init__(self):
        self.trajectories, self.plans = [], []

    def on_state(self, sample):
        pass

    def on_event(self, event):
        if event.kind == "plan" and "points" in event.data:
            self.plans.append(event)

    def on_trajectory(self, time, trajectory):
        self.trajectories.append(trajectory)


def test_the_hands_keep_their_relative_pose_within_microns_in_the_plan(cell):
    """By forward kinematics at every millisecond, and the object goes where it was told."""
    kept = Kept()
    with cell.connect("fake", observers=[kept]) as live:
        rod = live.carry("rod", **ENDS)
        start = live.scene().object("rod").T_world_object
        over = moved_object_pose(start, 0.05, -0.1, 0.2, turn_deg=15)
        checked(rod.grasp(route=[over]))
        checked(rod.move(over))
        assert live.driver.object_poses()["rod"].isclose(over, 1e-5, 1e-5)
    trajectory, tree = kept.trajectories[-1], kinematic_tree(cell.model)
    columns, full = cell.model.columns(trajectory.joint_names), cell.scene().positions.copy()
    first, worst = None, (0.0, 0.0)
    for t in np.arange(0, trajectory.duration, 1e-3):
        full[columns] = trajectory.sample(t)[0]
        hands = [tree.link_pose(full, f"{side}_gripper_tcp") for side in ("left", "right")]
        between = hands[0].inverse() @ hands[1]
        first = between if first is None else first
        worst = tuple(max(a, b) for a, b in zip(worst, first.distance_to(between), strict=True))
    assert worst[0] < 2e-5 and worst[1] < 2e-5
    for k, kind in ((1, "velocity"), (2, "acceleration")):
        most = np.abs([trajectory.sample(t)[k] for t in np.arange(0, trajectory.duration, 2e-3)]).max(axis=0)
        share = {"velocity": 0.3, "acceleration": 0.15}[kind]
        assert np.all(most <= share * cell.model.limits(trajectory.joint_names, kind) * 1.03)


def test_a_way_out_of_reach_or_blocked_says_who_and_where(cell):
    with cell.connect("fake") as live:
        rod = live.carry("rod", **ENDS)
        start = live.scene().object("rod").T_world_object
        checked(rod.grasp())
        far = rod.move(moved_object_pose(start, x=1.5))
        assert not far.ok and "_arm" in far.message and "%" in far.message
        blocked = rod.move(moved_object_pose(start, z=-0.3))
        assert not blocked.ok
        assert checked(rod.shift(z=0.1)).ok  # and it can still be carried


def test_more_squeeze_than_allowed_stops_both(cell):
    with cell.connect("sim") as live:
        rod = live.carry("rod", CarrySettings(max_squeeze=0.5), **ENDS)
        start = live.scene().object("rod").T_world_object
        checked(rod.grasp())
        result = rod.move(moved_object_pose(start, z=0.15))
        assert result.code is ErrorCode.CONTROL_FAILED and "squeeze" in result.message
        live.driver.advance(0.5)
        assert np.abs(live.driver.joint_state().velocities).max() < 5e-3


def test_admittance_takes_a_squeeze_away(cell):
    """The second hand's set points are put 0.3 mm wrong along the rod: the force fades, it does not stay."""
    forces = {}
    for damping in (1e9, 5e3):
        from armcell.execution import AdmittanceSettings

        settings = CarrySettings(
            max_off=1e-2, max_turn=1e-1, max_squeeze=500,
            admittance=AdmittanceSettings(damping=damping, max_offset=5e-4),
        )  # fmt: skip
        with cell.connect("sim") as live:
            rod = live.carry("rod", settings, **ENDS)
            start = live.scene().object("rod").T_world_object
            checked(rod.grasp())
            checked(rod.move(moved_object_pose(start, z=0.1)))
            rod._held.carried.grasps["right_arm"] = rod._held.carried.grasps["right_arm"] @ SE3.from_xyz(
                3e-4, 0, 0
            )
            rod._held.q = rod._corrected(rod._held.q, 3e-4 * start.rotation.matrix[:, 0])
            checked(rod.shift(x=0.002))
            checked(rod.shift(x=0.002))
            forces[damping] = float(np.linalg.norm(rod.squeeze()))
    assert forces[1e9] > 5.0 and forces[5e3] < 0.6 * forces[1e9]


def test_misuse(cell):
    with cell.connect("fake") as live:
        with pytest.raises(InputError, match="no subframe 'middle'"):
            live.carry("rod", left_arm="middle", right_arm="back_end")
        with pytest.raises(InputError, match="two are needed"):
            live.carry("rod", left_arm="front_end")
        with pytest.raises(InputError, match="grasp it first"):
            live.carry("rod", **ENDS).move(SE3.identity())
        scene = live.scene()
        with pytest.raises(InputError, match="a pose to go to"):
            plan_carry(scene, "both_arms", CarriedObject("rod", {}, {}), SE3.identity(), [])
        with pytest.raises(InputError, match="max_speed is 0"):
            plan_carry(
                scene,
                "both_arms",
                CarriedObject("rod", {}, {}),
                SE3.identity(),
                [SE3.identity()],
                max_speed=0.0,
            )


WALL = """
  wall:
    box: [0.7, 0.02, 0.2]
    pose: [0, 0, 1.001]
"""


@pytest.mark.long
def test_the_rod_over_a_wall_in_physics(cell, tmp_path):
    """The straight way to the other side of the table is blocked; it goes round, and is put down there."""
    text = (cell.file.parent / "cell.yaml").read_text()
    (tmp_path / "cell.yaml").write_text(text.replace("\n  rod:\n    box", f"{WALL}  rod:\n    box", 1))
    (tmp_path / "task.py").write_text((cell.file.parent / "task.py").read_text())
    target = SE3.from_xyz_rpy((0.0, -0.1, 0.946), (0.0, 0.0, 0.1))
    with armcell.load(str(tmp_path)).connect("sim", seed=1) as live:
        rod = live.carry("rod", **ENDS)
        alone = live.carry("rod", CarrySettings(planning_time=0.0), **ENDS)
        refused = alone.grasp(route=[target])
        assert not refused.ok and "wall" in refused.message
        checked(rod.grasp(route=[target]))
        checked(rod.move(target, name="to the other side"))
        checked(rod.release())
        assert live.scene().object("rod").T_world_object.distance_to(target)[0] < 2e-3
        assert not live.driver.unwanted_contacts() and not live.driver.welds()
    m = rod.record
    assert m.ticks > 1000
    assert m.off_m <= 0.5e-3 and m.turn_rad <= np.deg2rad(0.1)
    assert m.squeeze_n <= 30 and m.slip_m <= 1e-3


@pytest.mark.parametrize("seed", seeds(1, range(3)))
def test_the_rod_in_physics(cell, seed):
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    assert result["success"], result["message"]
    assert not result["unwanted_contacts"] and not result["welds"]
    m = result["measures"]
    assert m["relative_error_mm"] <= 0.5 and m["relative_error_deg"] <= 0.1
    assert m["squeeze_N"] <= 30 and m["slip_mm"] <= 1.0 and m["placed_off_mm"] <= 2.0


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(1, range(3)))
def test_screwing_in_physics(seed):
    cell = armcell.load("dual_ur10_screw")
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    assert result["success"], result["message"]
    assert not result["unwanted_contacts"]
    m = result["measures"]
    assert m["turned"] == pytest.approx(1.5, rel=0.03) and m["went_in_mm"] == pytest.approx(2.25, rel=0.03)
    assert 5.0 < m["force_mean_N"] < 9.0 and m["force_max_N"] < 12.0


@pytest.mark.cases("dual_ur10_rod")
@pytest.mark.parametrize("name", ["dual_ur10_rod", "dual_ur10_sort", "dual_ur10_screw"])
def test_the_same_scripts_run_without_physics(name):
    task = armcell.load(name)
    assert len((task.file.parent / task.spec.script).read_text().splitlines()) <= 60
    kept = Kept()
    with task.connect("fake", observers=[kept]) as live:
        result = run_task(task, live, 0, "fake")
    assert result["success"], result["message"]
    assert [(p.data["points"], p.data["duration_s"]) for p in kept.plans] == [
        (len(t.times), t.duration) for t in kept.trajectories
    ]
    assert all(p.text and p.data["planner"] and "evidence" in p.data for p in kept.plans)
    by_name = {plan.text: plan.data["evidence"] for plan in kept.plans}
    if name == "dual_ur10_rod":
        carried = next(e for e in by_name.values() if "poses" in e)
        assert list(carried["ways"]) == ["straight"] * len(carried["poses"])
        assert set(by_name["both to the ends"]["goals"]) == set(ENDS)
    if name == "dual_ur10_screw":
        assert by_name["screw"]["turns"] == 0.75  # twice
