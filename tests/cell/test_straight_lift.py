"""A held object is lifted on a straight line, all of it, off what it stands on: in every built-in cell."""

from __future__ import annotations

import pytest

from armcell.cell import load
from armcell.core import SE3, CartesianRequest
from armcell.kinematics import kinematic_tree
from armcell.planning import plan_cartesian

CELLS = {  # an object of each cell whose objects rest on a surface; on a belt nothing is grasped at rest
    "panda_pick": "cube", "panda_table": "cube", "six_axis_camera": "cube", "six_axis_pick": "cube",
    "six_axis_sort": "red_box", "six_axis_table": "object", "dual_ur10_rod": "rod", "dual_ur10_screw": "beam",
    "dual_ur10_sort": "left_red_1", "suction_pick": "carton",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.cases("panda_pick", "panda_table", "dual_ur10_rod")
@pytest.mark.parametrize(("name", "item"), CELLS.items(), ids=CELLS)
def test_the_whole_line_is_planned_and_executed(name, item):
    cell = load(name)
    with cell.connect("sim", 0) as live:
        if cell.spec.perception is not None:
            live.look(cell.spec.perception.camera)
        arm = next(iter(live.arms.values()), None) or live.arm
        assert (grasped := arm.grasp(item)).ok, grasped.message
        scene = live.scene()
        tip = kinematic_tree(cell.model).link_pose(scene.positions, cell.model.group(arm.group).tip_link)
        result = plan_cartesian(scene, CartesianRequest(arm.group, (SE3.from_xyz(0.0, 0.0, 0.1) @ tip,)))
        assert result.ok and result.fraction == 1.0, result.message
        assert (done := arm.execute(result)).ok, done.message
        assert not live.driver.unwanted_contacts()
