"""What every robot of the library must be."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.kinematics import kinematic_tree
from armcell.model import SuctionGripper, installed_robots, load_robot


@pytest.fixture(scope="module", params=installed_robots())
def model(request):
    return load_robot(request.param)


def test_the_library_has_the_promised_robots():
    ours = {"panda", "ur10", "ur10_gripper"}
    example_robot_data = {
        "ur3", "ur5", "xarm7", "z1", "jaco", "so100", "so101", "baxter", "pr2", "tiago", "tiago_hand",
        "tiago_dual", "tiago_pro", "talos", "talos_left_arm", "alex",
    }  # fmt: skip
    assert ours | example_robot_data <= set(installed_robots())


def test_links_without_collision_shapes_get_their_visual_ones():
    """The description of the SO-100 draws the gripper and the jaw without collision shapes."""
    model = load_robot("so100")
    for name in ("gripper", "jaw"):
        link = model.links[name]
        solids, drawn = link.collisions, link.visuals
        assert len(solids) == len(drawn) > 0
        assert all(c.T_link_shape == v.T_link_visual for c, v in zip(solids, drawn, strict=True))


@pytest.mark.slow
def test_limits_are_complete(model):
    """What planning and timing need: finite, positive, in order. Continuous joints have no bounds."""
    endless = [model.joints[name].type == "continuous" for name in model.joint_names]
    assert np.all(model.lower < model.upper)
    np.testing.assert_array_equal(np.isfinite([model.lower, model.upper]), [np.logical_not(endless)] * 2)
    for kind in ("velocity", "acceleration"):
        values = model.limits(model.joint_names, kind)
        assert np.all(np.isfinite(values)) and np.all(values > 0), kind


def test_groups_name_what_exists(model):
    assert model.groups
    jointless = {g.group for g in model.grippers.values() if isinstance(g, SuctionGripper)}
    for group in model.groups.values():
        assert bool(group.joint_names) == (group.name not in jointless)
        assert set(group.joint_names) <= set(model.joint_names)
        assert set(group.link_names) <= set(model.links)
        if group.tip_link:
            chain = model.chain(group.base_link, group.tip_link)
            assert [j.name for j in chain if j.actuated] == list(group.joint_names)


def test_named_states_are_of_their_group_and_within_limits(model):
    for group, states in model.named_states.items():
        for name in states:
            state = model.named_state(group, name)
            assert set(state.joint_names) <= set(model.group(group).joint_names)
            model.check_positions(state.positions, state.joint_names)
    model.check_positions(model.default_positions())


def test_disabled_pairs_are_links_with_a_reason(model):
    for pair, reason in model.disabled_collisions.items():
        assert pair <= set(model.links) and len(pair) == 2
        assert reason in ("Adjacent", "Never", "Default", "Always", "User")


def test_grippers_open_and_close(model):
    for gripper in model.grippers.values():
        assert gripper.contact_links and set(gripper.contact_links) <= set(gripper.hand_links)
        if isinstance(gripper, SuctionGripper):
            assert gripper.joint_names == () and gripper.tcp_link in model.links
            continue
        limits = model.joint(gripper.joint_name).limits
        assert gripper.width(gripper.joint_position(0.03)) == pytest.approx(0.03)
        closed, opened = sorted(gripper.width(q) for q in (limits.lower, limits.upper))
        assert -1e-9 <= closed < opened <= gripper.max_width + 1e-9
        assert len(gripper.finger_links) == 2 and set(gripper.finger_links) <= set(gripper.hand_links)
        for finger in gripper.finger_links:
            assert gripper.tcp_link in model.links and finger in model.subtree(model.root_link)


def test_inertias_are_those_of_real_bodies(model):
    """Of links that move as one: descriptions give sensors and frames on a link masses without inertia."""
    tree, q = kinematic_tree(model), model.default_positions()
    for rigid in model.rigid_groups:
        bodies = [(tree.link_pose(q, n) @ i.T_link_com, i) for n in rigid if (i := model.links[n].inertial)]
        if model.root_link in rigid or not (mass := sum(i.mass for _, i in bodies)):
            continue
        center = sum(i.mass * T.translation for T, i in bodies) / mass
        total = np.zeros((3, 3))
        for T, i in bodies:
            R, d = T.rotation.matrix, T.translation - center
            total += R @ i.inertia @ R.T + i.mass * (d @ d * np.eye(3) - np.outer(d, d))
        moments = np.linalg.eigvalsh(total)
        assert np.all(moments > 0), rigid
        assert moments[2] <= moments[0] + moments[1] + 1e-9, f"{rigid}: triangle inequality"


def test_positions_are_checked_by_name(model):
    from armcell.core import InputError

    q = model.default_positions()
    with pytest.raises(InputError, match="is not finite"):
        model.check_positions(np.full(model.dof, np.nan))
    with pytest.raises(InputError, match="positions given for"):
        model.check_positions(q[:-1])
    at = int(np.flatnonzero(np.isfinite(model.upper))[0])
    q[at] = model.upper[at] + 0.1
    with pytest.raises(InputError, match=f"joint '{model.joint_names[at]}' at .* is outside its limits"):
        model.check_positions(q)
