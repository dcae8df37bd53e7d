"""PlanningScene: a value that is never changed in place; names, frames, padding."""

from __future__ import annotations

import numpy as np
import pytest
from tests.scene.helpers import box, panda

from armcell.core import SE3, InputError, JointState, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene

CUBE = box("cube", (0.05, 0.05, 0.05), (0.5, 0.0, 0.025))


def snapshot(scene: PlanningScene) -> tuple:
    return (
        scene.positions.tolist(),
        {k: v.T_world_object.matrix.tolist() for k, v in scene.objects.items()},
        {k: (v.link, v.touch_links) for k, v in scene.attached.items()},
        dict(scene.allowed),
        (scene.padding, dict(scene.link_padding), dict(scene.link_scale)),
    )


CHANGES = {
    "positions": lambda s: s.with_positions(s.positions + 0.1 * (s.model.upper > s.positions + 0.1)),
    "state": lambda s: s.with_state(JointState(("panda_joint1",), [0.5])),
    "object": lambda s: s.with_object(box("more", (1, 1, 1))),
    "replaced": lambda s: s.with_object(box("cube", (1, 1, 1), (3, 3, 3))),
    "moved": lambda s: s.with_object_pose("cube", SE3.from_xyz(1, 1, 1)),
    "removed": lambda s: s.without_object("cube"),
    "attached": lambda s: s.with_attached("cube", "panda_hand", ["panda_leftfinger"]),
    "allowed": lambda s: s.with_allowed("cube", "panda_hand"),
    "padding": lambda s: s.with_padding(0.01, {"panda_hand": 0.02}, {"panda_hand": 1.1}),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_a_copy(change):
    scene = panda(CUBE)
    before = snapshot(scene)
    after = CHANGES[change](scene)
    assert snapshot(scene) == before and snapshot(after) != before
    assert isinstance(after, PlanningScene) and after.model is scene.model


def test_detaching_leaves_the_old_value():
    held = panda(CUBE).with_attached("cube", "panda_hand")
    before = snapshot(held)
    assert "cube" in held.with_detached("cube").objects
    assert snapshot(held) == before


def test_the_numbers_cannot_be_written_to():
    scene = panda()
    with pytest.raises(ValueError):
        scene.positions[0] = 1.0


def test_it_owns_its_numbers():
    model = panda().model
    q = model.default_positions()
    scene = PlanningScene.of(model, q)
    q[:] = 0.0
    np.testing.assert_array_equal(scene.positions, model.default_positions())


def test_state_and_positions_agree():
    scene = panda().with_state(JointState(("panda_joint3", "panda_joint1"), [0.3, 0.1]))
    assert scene.state["panda_joint3"] == 0.3 and scene.state["panda_joint1"] == 0.1
    np.testing.assert_array_equal(scene.state.reindexed(scene.model.joint_names).positions, scene.positions)


def test_states_are_checked():
    scene = panda()
    with pytest.raises(InputError, match="'panda_joint4' at 1 is outside its limits"):
        scene.with_state(JointState(("panda_joint4",), [1.0]))
    with pytest.raises(UnknownNameError, match="panda_joint44"):
        scene.with_state(JointState(("panda_joint44",), [1.0]))
    with pytest.raises(InputError, match="not finite"):
        scene.with_positions(np.full(scene.model.dof, np.nan))
    with pytest.raises(InputError):
        PlanningScene.of(scene.model, np.full(scene.model.dof, 99.0))


@pytest.mark.parametrize("name", ["panda_hand", "world"])
def test_an_object_may_not_have_a_link_s_name(name):
    with pytest.raises(InputError, match=f"object '{name}' has the name of a link"):
        panda(box(name, (1, 1, 1)))


def test_an_attached_object_cannot_be_replaced():
    with pytest.raises(InputError, match="is attached to the robot"):
        panda(CUBE).with_attached("cube", "panda_hand").with_object(CUBE)


UNKNOWN = {
    "object": lambda s: s.object("cub"),
    "pose": lambda s: s.with_object_pose("cub", SE3.identity()),
    "remove": lambda s: s.without_object("cub"),
    "attach": lambda s: s.with_attached("cub", "panda_hand"),
    "attach link": lambda s: s.with_attached("cube", "panda_hnd"),
    "touch link": lambda s: s.with_attached("cube", "panda_hand", ["panda_hnd"]),
    "detach": lambda s: s.with_detached("cube"),
    "allow": lambda s: s.with_allowed("cube", "panda_hnd"),
    "allow first": lambda s: s.with_allowed("cub", "panda_hand"),
    "frame": lambda s: s.frame_pose("panda_hnd"),
    "transform": lambda s: s.transform("world", "cub"),
    "padding": lambda s: s.with_padding(link_padding={"panda_hnd": 0.1}),
    "scale": lambda s: s.with_padding(link_scale={"panda_hnd": 1.1}),
}


@pytest.mark.parametrize("use", UNKNOWN.values(), ids=UNKNOWN)
def test_unknown_names_list_the_known(use):
    with pytest.raises(UnknownNameError, match="known: "):
        use(panda(CUBE))


@pytest.mark.parametrize("bad", [-0.01, float("nan"), float("inf")])
def test_padding_and_scale_are_checked(bad):
    scene = panda()
    for arguments in ((bad,), (None, {"panda_hand": bad}), (None, None, {"panda_hand": bad})):
        with pytest.raises(InputError, match="padding must be|scale must be"):
            scene.with_padding(*arguments)
    with pytest.raises(InputError, match="scale"):
        scene.with_padding(link_scale={"panda_hand": 0.0})


def test_what_is_not_given_stays_padded():
    scene = panda().with_padding(0.01, {"panda_hand": 0.02}).with_padding(link_scale={"panda_hand": 1.5})
    assert (scene.padding, scene.link_padding["panda_hand"], scene.link_scale["panda_hand"]) == (
        0.01,
        0.02,
        1.5,
    )
    assert scene.with_padding(0.0).padding == 0.0


def test_frames_are_consistent():
    scene = panda(CUBE).with_attached("cube", "panda_hand").with_object(box("wall", (1, 1, 1), (2, 0, 0)))
    tree = kinematic_tree(scene.model)
    names = ["world", "panda_link0", "panda_link5", "panda_hand", "cube", "wall"]
    assert scene.frame_pose("world").isclose(SE3.identity())
    assert scene.frame_pose("panda_hand").isclose(tree.link_pose(scene.positions, "panda_hand"))
    assert scene.frame_pose("wall").isclose(SE3.from_xyz(2, 0, 0))
    for a in names:
        assert scene.transform(a, a).isclose(SE3.identity(), 1e-9, 1e-7)
        assert scene.transform("world", a).isclose(scene.frame_pose(a), 1e-9, 1e-7)
        for b in names:
            assert (scene.transform(a, b) @ scene.transform(b, a)).isclose(SE3.identity(), 1e-9, 1e-7)
            chained = scene.transform(a, "panda_link5") @ scene.transform("panda_link5", b)
            assert chained.isclose(scene.transform(a, b), 1e-9, 1e-7)
