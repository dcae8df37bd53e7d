"""A telescope on a lift, as in Hello Robot's Stretch: it reaches only points near a line beside its base."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.cell.starter import check_starter
from tests.model.helpers import joint, link, robot

from armcell.cell.setup import propose, write_cell
from armcell.cell.starter import starter_cells
from armcell.cli.new import write_starter
from armcell.collision import ExactChecker
from armcell.core import SE3
from armcell.kinematics import ik_solver
from armcell.model import RobotModel, load_robot
from armcell.model.setup import UrdfPart
from armcell.scene import PlanningScene

WHEEL = '<cylinder radius="0.03" length="0.03"/>'
BOX = '<box size="0.03 0.06 0.06"/>'  # around the wheel


def solid(size: tuple[float, float, float], at: tuple[float, float, float], mass: float) -> str:
    """<inertial> and <collision> of a box."""
    origin, moment = f'<origin xyz="{at[0]} {at[1]} {at[2]}"/>', mass * max(size) ** 2 / 6
    return (
        f'<inertial>{origin}<mass value="{mass}"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}" '
        f'ixy="0" ixz="0" iyz="0"/></inertial><collision>{origin}<geometry>'
        f'<box size="{size[0]} {size[1]} {size[2]}"/></geometry></collision>'
    )


def telescope() -> str:
    """URDF of a lift, a telescope of two stages, and a wrist with yaw, pitch and roll. The limit of the pitch
    is 1.57 for a quarter turn. The pitch link is a wheel. The box around it touches the arm in most states,
    also if all joints of the wrist are zero.
    """

    def limit(low: float, high: float) -> str:
        return f'<limit lower="{low}" upper="{high}" velocity="1" effort="100"/>'

    def pose(x: float, y: float, z: float, axis: str, rpy: str = "0 0 0") -> str:
        return f'<origin xyz="{x} {y} {z}" rpy="{rpy}"/><axis xyz="{axis}"/>'

    on_side = '<origin rpy="0 1.5707963267948966 0"/>'
    wheel = solid((0.02, 0.02, 0.02), (0, 0, 0), 0.1).split("<collision>")[0] + (
        f"<visual>{on_side}<geometry>{WHEEL}</geometry></visual>"
        f'<collision><origin rpy="0.7854 0 0"/><geometry>{BOX}</geometry></collision>'
    )
    arm = solid((0.05, 0.25, 0.05), (0, -0.125, 0), 0.5)
    shown = arm[arm.index("<collision>") :].replace("collision>", "visual>")
    finger = solid((0.02, 0.01, 0.06), (0, 0, 0.105), 0.05)
    grip = limit(0.0, 0.04)
    return robot(
        link("base", solid((0.3, 0.3, 0.1), (0, 0, 0.05), 20.0)),
        link("mast", solid((0.06, 0.06, 1.1), (0, 0.1, 0.65), 2.0)),
        link("lift", solid((0.1, 0.06, 0.1), (0, 0.03, 0), 1.0)),
        link("outer", solid((0.06, 0.2, 0.06), (0, -0.1, 0), 0.5)), link("inner", arm + shown),
        link("yaw", solid((0.02, 0.02, 0.04), (0, 0, -0.05), 0.1)), link("pitch", wheel),
        link("roll", solid((0.04, 0.1, 0.03), (0, 0, 0.06), 0.1)),
        link("left", finger), link("right", finger),
        joint("stands", "base", "mast", "fixed"),
        joint("lift_joint", "mast", "lift", "prismatic", pose(0, 0, 0, "0 0 1"), limit(0.2, 1.1)),
        joint("outer_joint", "lift", "outer", "prismatic", pose(0, 0, 0, "0 -1 0"), limit(0, 0.2)),
        joint("inner_joint", "outer", "inner", "prismatic", pose(0, 0, 0, "0 -1 0"), limit(0, 0.2)),
        joint("yaw_joint", "inner", "yaw", "revolute", pose(0, -0.24, 0, "0 0 1"), limit(-1.7, 4.0)),
        joint("pitch_joint", "yaw", "pitch", "revolute",
              pose(0.025, 0, -0.064, "-1 0 0", "1.5707963267948966 0 0"), limit(-1.57, 0.5)),
        joint("roll_joint", "pitch", "roll", "revolute", pose(0, 0, 0, "0 0 1"), limit(-3.1, 3.1)),
        joint("left_finger", "roll", "left", "prismatic", pose(0, 0.005, 0, "0 1 0"), grip),
        joint("right_finger", "roll", "right", "prismatic", pose(0, -0.005, 0, "0 -1 0"),
              grip + '<mimic joint="left_finger"/>'),
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("telescope")
    (made / "telescope.urdf").write_text(telescope())
    write_cell(propose([UrdfPart(made / "telescope.urdf")], 2000), made / "cell")
    return made / "cell"


@pytest.fixture(scope="module")
def model(folder) -> RobotModel:
    return load_robot(folder)


def test_its_joints_count_as_five_and_reach_the_vertical(model):
    """The limit of the pitch is 0.8 mrad short of a gripper that points down."""
    ik = ik_solver(model, "arm")
    assert len(ik.joint_names) == 6 and ik.independent_joints == 5
    down = SE3.from_xyz_rpy((0.0, -0.45, 0.4), (np.pi, 0.0, 0.3))
    result = ik.solve(down, model.default_positions())
    assert result.ok and result.rotation_error < 1e-3


def test_the_box_around_its_wheel_does_not_block_the_wrist(model):
    assert model.disabled_collisions[frozenset(("inner", "pitch"))] == "Never"
    assert frozenset(("inner", "roll")) not in model.disabled_collisions
    home = PlanningScene.of(model).with_state(model.named_state("arm", "home"))
    assert all(model.named_states["arm"]["home"][f"{name}_joint"] == 0.0 for name in ("yaw", "pitch", "roll"))
    free = []
    for pitch in np.linspace(-1.5, 0.0, 20):
        q = home.positions.copy()
        q[model.columns(("pitch_joint",))] = pitch
        free.append(ExactChecker(home).is_free(q))
    assert all(free)


def test_an_early_cell_has_cube_and_goal_on_the_line_in_its_reach(model):
    ik = ik_solver(model, "arm")

    def is_reached(objects: dict) -> bool:
        poses = [SE3.from_xyz_rpy(objects[name]["pose"], (np.pi, 0.0, 0.0)) for name in ("cube", "mat")]
        return all(ik.solve(pose, model.default_positions()).ok for pose in poses)

    texts = islice(starter_cells(model, "telescope", {}), 12)
    cells = [yaml.safe_load(text)["objects"] for text in texts]
    reached = [objects for objects in cells if is_reached(objects)]
    assert reached
    table, cube, goal = (np.array(reached[0][name]["pose"]) for name in ("table", "cube", "mat"))
    assert table[2] > 0.2  # beside the base, not below it
    assert np.linalg.norm(table[:2] - (cube + goal)[:2] / 2) < 0.01 and abs(cube[1] - goal[1]) > 0.15


@pytest.mark.slow
def test_it_picks_and_places(model, folder):
    assert write_starter(model, ".", folder)
    check_starter(folder)
