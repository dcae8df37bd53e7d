"""The cell of two UR10: one model with prefixes, apart at home, opened by every command."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cli.helpers import call

import armcell
from armcell.collision import ExactChecker
from armcell.core import InputError, UnknownNameError
from armcell.model import load_robot
from armcell.sim import SimWorld

LEFT, RIGHT = "left_", "right_"


@pytest.fixture(scope="module")
def cell():
    return armcell.load("dual_ur10")


def test_groups_and_names(cell):
    model = cell.model
    assert set(model.groups) >= {
        "left_arm",
        "right_arm",
        "both_arms",
        "left_gripper",
        "right_gripper",
        "grippers",
    }
    one = load_robot("ur10_gripper").group("arm").joint_names
    both = tuple(side + name for side in (LEFT, RIGHT) for name in one)
    assert model.group("both_arms").joint_names == both
    assert len({*model.links}) + len({*model.joints}) == len({*model.links, *model.joints})
    home = model.named_state("both_arms", "home").as_dict()
    assert set(home) == set(both)
    for side in (LEFT, RIGHT):
        assert model.named_state(f"{side}arm", "home").as_dict().items() <= home.items()


def test_where_things_stand(cell):
    scene = cell.scene()
    bases = [scene.frame_pose(f"{side}base_link").translation for side in (LEFT, RIGHT)]
    assert np.linalg.norm(bases[0] - bases[1]) == pytest.approx(1.5)
    assert [b[2] for b in bases] == pytest.approx([0.8, 0.8])
    assert scene.object("table").bounds()[1][2] + scene.object("table").T_world_object.translation[
        2
    ] == pytest.approx(0.9)


def test_home_is_folded_and_apart(cell):
    checker = ExactChecker(cell.scene())
    checker.set_configuration(cell.scene().positions)
    gaps = [
        checker.pair_distance(int(a), int(b))
        for a, b in checker.pairs
        if {checker.geometries[a].body.split("_")[0], checker.geometries[b].body.split("_")[0]}
        == {"left", "right"}
        and "pedestal" not in checker.geometries[b].body
    ]
    assert min(gaps) > 0.7
    for side in (LEFT, RIGHT):
        tip = cell.scene().frame_pose(f"{side}gripper_tcp").translation
        base = cell.scene().frame_pose(f"{side}base_link").translation
        assert np.linalg.norm((tip - base)[:2]) < 0.4


def test_no_sag_at_the_start(cell):
    world = SimWorld(cell.scene())
    world.step(500)
    assert np.max(np.abs(world.joint_state().positions - cell.scene().positions)) < 1e-5
    assert not world.monitor.unwanted


@pytest.mark.slow
def test_one_arm_and_both_are_planned(capsys):
    assert call(capsys, "check", "dual_ur10").status == 0
    assert call(capsys, "plan", "dual_ur10", "--to", "up", "--group", "right_arm").status == 0
    assert call(capsys, "plan", "dual_ur10", "--to", "up", "--group", "both_arms").status == 0


def test_the_view_opens_on_an_arm_and_offers_both(cell):
    from armcell.viewer import PlanningSession

    session = PlanningSession(cell.scene())
    assert session.group == "left_arm" and "both_arms" in session.groups
    session.set_group("both_arms")
    assert set(session.state_names) == {"home", "up"}


# --- the robot's file ---
def _robot(tmp_path, more: str):
    part = "  - {{robot: ur10_gripper, prefix: {}_, pose: [0, {}, 0]}}\n"
    text = "parts:\n" + part.format("a", 0) + part.format("b", 2)
    (tmp_path / "robot.yaml").write_text(text + more)
    return load_robot(tmp_path)


def test_composites_of_one_s_own(tmp_path):
    model = _robot(tmp_path, "groups: {all: [a_arm, b_arm, a_gripper]}\n")
    assert len(model.group("all").joint_names) == 13
    assert set(model.named_states["all"]) == set()  # no state is common to arms and gripper


WRONG = {
    "unknown member": ("groups: {all: [a_arm, c_arm]}", UnknownNameError, "c_arm"),
    "name taken": ("groups: {a_arm: [b_arm]}", InputError, "already"),
    "not a list": ("groups: {all: a_arm}", InputError, "not a list"),
    "a joint twice": ("groups: {all: [a_arm, a_arm_and_gripper]}", InputError, "is in two of its groups"),
    "unknown joint": ("states: {a_arm: {x: {b_elbow_joint: 0}}}", UnknownNameError, "b_elbow_joint"),
    "no number": ("states: {a_arm: {x: {a_elbow_joint: bent}}}", InputError, "not a number"),
    "out of limits": ("states: {a_arm: {x: {a_elbow_joint: 99}}}", InputError, "outside its limits"),
    "unknown group": ("states: {c_arm: {x: {a_elbow_joint: 0}}}", UnknownNameError, "c_arm"),
}


@pytest.mark.slow
@pytest.mark.parametrize(("more", "error", "words"), WRONG.values(), ids=WRONG)
def test_wrong_composites(tmp_path, more, error, words):
    with pytest.raises(error, match=words) as raised:
        _robot(tmp_path, more + "\n")
    assert "robot.yaml" in str(raised.value)


def test_two_parts_without_prefixes_are_refused(tmp_path):
    (tmp_path / "robot.yaml").write_text(
        "parts: [{robot: ur10_gripper}, {robot: ur10_gripper, pose: [0, 2, 0]}]\n"
    )
    with pytest.raises(InputError, match=r"two parts have .*prefix"):
        load_robot(tmp_path)
