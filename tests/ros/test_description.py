"""The descriptions on the parameter server, read again."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell import load
from armcell.kinematics import kinematic_tree
from armcell.model import load_urdf
from armcell.model.srdf import with_srdf_text
from armcell.ros import Bus
from armcell.ros.robot_description import publish_robot_description


@pytest.mark.parametrize("cell", ["panda_table", "dual_ur10"])
def test_a_robot_read_from_its_parameters_is_the_same(cell, tmp_path):
    model, bus = load(cell).scene().model, Bus()
    publish_robot_description(bus, model)
    file = tmp_path / "robot.urdf"
    file.write_text(bus.parameters.get("/robot_description"))
    again = with_srdf_text(load_urdf(file), bus.parameters.get("/robot_description_semantic"), file)
    assert again.joint_names == model.joint_names
    assert {n: g.joint_names for n, g in again.groups.items()} == {
        n: g.joint_names for n, g in model.groups.items()
    }
    q = np.random.default_rng(0).uniform(model.lower, model.upper)
    one, other = kinematic_tree(model), kinematic_tree(again)
    assert set(again.links) == set(model.links)
    for link in model.links:
        assert np.allclose(one.link_pose(q, link).matrix, other.link_pose(q, link).matrix, atol=1e-6)
    joint = model.joint_names[0]
    limits = bus.parameters.get("/robot_description_planning")["joint_limits"][joint]
    assert limits["max_velocity"] == model.joints[joint].limits.velocity
    assert "panda_arm" in bus.parameters.get("/robot_description_kinematics") or cell != "panda_table"
