"""`armcell setup --web` through viser's handles: what is shown, what a box and the buttons do."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cell.test_setup import small_arm

from armcell.cell.setup import propose, write_cell
from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.model.setup import UrdfPart
from armcell.viewer.setup_view import SetupView


@pytest.fixture
def proposal(tmp_path):
    return propose([UrdfPart(small_arm(tmp_path))], 500)


@pytest.fixture
def view(proposal):
    with SetupView(proposal, port=0) as view:
        yield view


def test_the_state_that_is_named_is_the_one_that_is_shown(view, proposal):
    model, tree = proposal.model, kinematic_tree(proposal.model)
    (group,) = view.states
    box = view.states[group]
    for name in ("ready", "home"):
        box.value = name
        q = model.default_positions()
        target = model.named_state(group, name)
        q[model.columns(target.joint_names)] = target.positions
        for link, T in zip(tree.link_names, tree.link_transforms(q), strict=True):
            frame = view._frames[link]
            assert SE3.from_quat_wxyz(frame.position, frame.wxyz).isclose(SE3.from_matrix(T), 1e-6, 1e-6)


def test_the_first_look_has_the_whole_robot_in_it(view, proposal):
    camera = view._server.initial_camera
    points = kinematic_tree(proposal.model).link_transforms(proposal.model.default_positions())[:, :3, 3]
    away = np.linalg.norm(np.asarray(camera.position) - np.asarray(camera.look_at))
    forward = (np.asarray(camera.look_at) - np.asarray(camera.position)) / away
    for point in points:
        way = point - np.asarray(camera.position)
        assert np.arccos(way @ forward / np.linalg.norm(way)) < camera.fov / 2
    assert away < 5 * max(0.3, np.linalg.norm(np.ptp(points, axis=0)) / 2)  # and large enough to be seen


def test_every_pair_can_be_decided_and_write_gives_the_answer(view, proposal, tmp_path):
    seen = set()
    for link in view.link.options:
        view.link.value = link
        assert all(link in pair for pair in view.boxes)
        for pair, box in view.boxes.items():
            assert box.value == (pair in proposal.model.disabled_collisions)
        seen |= set(view.boxes)
    assert seen == {p.links for p in proposal.pairs}
    pair, box = next(iter(view.boxes.items()))
    was = box.value
    box.value = not was
    assert (pair in view.answer.model.disabled_collisions) is not was
    view.link.value = view.link.options[0]
    view.link.value = next(n for n in view.link.options if n in pair)
    assert view.boxes[pair].value is not was  # the box remembers
    assert not view.done
    view.write.value = True
    assert view.done and view.answer is not proposal and "written" in view.note.content
    write_cell(view.answer, tmp_path / "cell")
    text = next((tmp_path / "cell" / "config").glob("*.srdf")).read_text()
    a, b = pair
    listed = f'link1="{a}" link2="{b}"' in text or f'link1="{b}" link2="{a}"' in text
    assert listed is not was


def test_cancel_gives_none(view):
    view.cancel.value = True
    assert view.done and view.answer is None
    view.write.value = True  # too late
    assert view.answer is None
