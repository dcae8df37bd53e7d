"""The contract of every arm that armcell knows by name: kinematics, inverse kinematics, a plan, a pick.

Robots whose descriptions no Python package ships are tested with their makers' files in shared/data, if the
files are on this machine. `pytest -m long tests/cell/test_arm_contract.py` measures 1000 poses per arm.
"""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from tests.model.helpers import PinRobot, pin_library, random_positions
from tests.sizes import ROBOTS

import armcell
from armcell.cell import load, run_task
from armcell.cli.new import write_starter
from armcell.core import InputError, PlanRequest, PoseGoal
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.model import RobotModel, load_robot, robot_names
from armcell.scene import PlanningScene

SHARED = Path(__file__).parents[3].joinpath("shared", "data", "robots").resolve()
POSES, MANY = 20, 1000
SOLVED = 0.995  # of random reachable poses


@pytest.fixture(autouse=True)
def _descriptions(monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(SHARED), prepend=os.pathsep)


@lru_cache
def loaded(name: str) -> RobotModel | None:
    try:
        return load_robot(name)
    except InputError as error:
        if "not found" not in str(error):
            raise
        return None


@pytest.fixture(params=robot_names())
def model(request) -> RobotModel:
    found = loaded(request.param)
    if found is None:
        pytest.skip("the maker's description is not on this machine")
    return found


def arms(model: RobotModel) -> list[str]:
    return [g.name for g in model.groups.values() if g.tip_link and g.joint_names]


def solved(model: RobotModel, group: str, count: int) -> float:
    """Share of random reachable poses for which forward kinematics confirms a solution within limits."""
    ik, rng, reference, found = (
        ik_solver(model, group), np.random.default_rng(0), model.default_positions(), 0,
    )  # fmt: skip
    for _ in range(count):
        q = reference.copy()
        q[ik.columns] = random_positions(model, rng)[ik.columns]
        target = ik.tree.link_pose(q, ik.tip_link)
        answer = ik.solve(target, reference)
        if answer.ok:
            q[ik.columns] = model.check_positions(answer.positions, ik.joint_names)
            found += max(ik.tree.link_pose(q, ik.tip_link).distance_to(target)) < 1e-5
    return found / count


@pytest.mark.slow
@pytest.mark.cases(*ROBOTS, "ur10_rail")
def test_forward_kinematics_is_pinocchio_s(model):
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    reference = PinRobot(pin_library(_folder(model)), model)
    for _ in range(3):
        q = random_positions(model, rng)
        reference.place(tree.full_positions(q))
        for name, T in zip(tree.link_names, tree.link_transforms(q), strict=True):
            np.testing.assert_allclose(T, reference.pose(name), atol=1e-10, err_msg=name)


@pytest.mark.slow
def test_inverse_kinematics_reaches_every_pose(model):
    for group in arms(model):
        assert solved(model, group, POSES) == 1.0, group


@pytest.mark.long
def test_inverse_kinematics_of_many_poses(model):
    for group in arms(model):
        assert solved(model, group, MANY) >= SOLVED, group


@pytest.mark.slow
@pytest.mark.cases(*ROBOTS, "ur10_rail")
def test_a_plan_reaches_a_pose(model):
    tree, rng = kinematic_tree(model), np.random.default_rng(1)
    scene = PlanningScene.of(model)
    checker = armcell.collision.ExactChecker(scene)
    for group in arms(model):
        columns, tip = model.columns(model.group(group).joint_names), model.group(group).tip_link
        q = model.default_positions()
        while np.array_equal(q, model.default_positions()) or not checker.is_free(q):
            q[columns] = random_positions(model, rng)[columns]
        target = tree.link_pose(q, tip)
        result = armcell.plan(scene, PlanRequest(group, [PoseGoal(target, tip)]))
        assert result.ok, result.message
        end = model.default_positions()
        end[columns] = result.trajectory.positions[-1]
        assert max(tree.link_pose(end, tip).distance_to(target)) < 1e-3
        assert checker.is_free(end)


@pytest.mark.slow
@pytest.mark.cases("panda", "ur10_suction", "ur10_rail", "scara", "parallel_gripper", "dual_ur10")
@pytest.mark.parametrize("name", robot_names())
def test_a_new_cell_runs(name, tmp_path):
    """The cell of `armcell new`: a pick and place in physics if an arm has a gripper, else moves."""
    model = loaded(name)
    if model is None or not arms(model):
        pytest.skip("no description on this machine, or no arm")
    assert write_starter(model, name, tmp_path) == bool(model.grippers)
    cell = load(tmp_path)
    with cell.connect("sim", seed=0) as live:
        result = run_task(cell, live, 0, "sim")
    assert result["success"], result["message"]
    assert result["unwanted_contacts"] == [] and result["welds"] == []


def _folder(model: RobotModel) -> str:
    return next(n for n in robot_names() if loaded(n) is model)
