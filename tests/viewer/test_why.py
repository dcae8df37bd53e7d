"""show_explanation: what touches is red where it touches, the ghost stands at the nearest state."""

from __future__ import annotations

import pytest
from tests.scene.helpers import box, panda

from armcell.core import SE3, NamedGoal, PlanRequest
from armcell.kinematics import kinematic_tree
from armcell.planning import explain
from armcell.viewer import CellViewer, show_explanation


@pytest.fixture(scope="module")
def explained():
    scene = panda(box("block", (0.1, 0.1, 0.1), (0.307, 0.0, 0.62)))
    return scene, explain(scene, PlanRequest("arm", (NamedGoal("extended"),)))


@pytest.mark.slow
def test_red_and_ghost(explained):
    scene, explanation = explained
    with CellViewer(scene, port=0) as viewer:
        handles = {h.name: h for h in show_explanation(viewer, scene, explanation) if hasattr(h, "position")}
    blocking = {name.split("/")[3] for name in handles if name.startswith("/why/blocking/")}
    assert blocking == {n for c in explanation.contacts for n in (c.body_a, c.body_b)} >= {"block"}
    balls = [h for name, h in handles.items() if name.startswith("/why/contact/")]
    assert {tuple(h.position) for h in balls} == {c.position for c in explanation.contacts}
    ghost = {name.split("/")[3] for name in handles if name.startswith("/why/ghost/")}
    assert "panda_hand" in ghost and "block" not in ghost
    there = scene.state.updated(explanation.nearest).positions
    hand = scene.model.links["panda_hand"].collisions[0]
    expected = kinematic_tree(scene.model).link_pose(there, "panda_hand") @ hand.T_link_shape
    shown = handles["/why/ghost/panda_hand/0"]
    assert SE3.from_quat_wxyz(shown.position, shown.wxyz).isclose(expected, 1e-6, 1e-6)
    block = handles["/why/blocking/block/0"]
    assert tuple(block.position) == pytest.approx((0.307, 0.0, 0.62))
    assert block.color[0] > 200 and block.color[1] < 60
