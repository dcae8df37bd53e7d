"""Diffs: all or nothing, and each change does what the scene's own method of that kind does."""

from __future__ import annotations

import numpy as np
import pytest
from tests.scene.helpers import box, panda

from armcell.core import SE3, Box, InputError, JointState, Octree, Sphere, UnknownNameError
from armcell.scene import (
    OCTOMAP,
    AddObject,
    AllowCollision,
    AllowCollisionByDefault,
    AppendShapes,
    AttachObject,
    CollisionObject,
    DetachObject,
    MoveObject,
    ObjectType,
    PlanningScene,
    RemoveAllObjects,
    RemoveObject,
    SceneDiff,
    SetColor,
    SetFixedFrame,
    SetOctomap,
    SetPadding,
    SetState,
    SetType,
    with_octomap,
)

CUBE = box("cube", (0.05, 0.05, 0.05), (0.4, 0.1, 0.3))
TABLE = box("table", (0.5, 0.8, 0.02), (0.5, 0.0, 0.2))
CELLS = Octree(np.array([[1.0, 0, 0]]), np.array([0.1]))


def everything(scene: PlanningScene) -> tuple:
    """All that a scene says, to be compared."""
    items = [*scene.objects.values(), *(body.object for body in scene.attached.values())]
    return (
        scene.positions.tolist(), {o.name: o.T_world_object.matrix.tolist() for o in items},
        [(o.name, o.color, o.type, len(o.shapes), sorted(o.subframes)) for o in items],
        {n: (b.link, b.touch_links) for n, b in scene.attached.items()}, dict(scene.allowed),
        scene.padding, dict(scene.link_padding), dict(scene.link_scale), sorted(scene.fixed_frames),
    )  # fmt: skip


def test_every_change():
    scene = panda(CUBE).apply(
        SceneDiff.of(
            AddObject(TABLE),
            SetFixedFrame("camera", SE3.from_xyz(0, 0, 1)),
            AddObject(box("seen", (0.1, 0.1, 0.1), (0.5, 0, 0)), frame="camera"),
            AppendShapes(
                "table", ((Sphere(0.1), SE3.from_xyz(0, 0, 0.1)),), {"middle": SE3.from_xyz(0, 0, 0.01)}
            ),
            MoveObject("cube", SE3.from_xyz(0, 0, 0.025), "table/middle"),
            SetColor("cube", (1.0, 0, 0, 1)),
            SetType("cube", ObjectType("dice", "toys")),
            AllowCollision("cube", "table"),
            AllowCollisionByDefault("seen"),
            AttachObject("cube", "panda_hand", ("panda_leftfinger",)),
            AttachObject("pen", "panda_link7", object=box("pen", (0.01, 0.01, 0.1), (0, 0, 0.1))),
            DetachObject("pen"),
            SetPadding(0.01, {"panda_hand": 0.0}, {"panda_link5": 1.1}),
            SetState(JointState(("panda_joint1",), [0.5])),
            SetOctomap(CELLS),
        )
    )  # fmt: skip
    assert list(scene.objects) == ["table", "seen", "pen", OCTOMAP] and list(scene.attached) == ["cube"]
    np.testing.assert_allclose(scene.frame_pose("seen").translation, [0.5, 0, 1])
    held = scene.attached["cube"]
    assert held.object.color == (1, 0, 0, 1) and held.object.type == ObjectType("dice", "toys")
    assert held.touch_links == {"panda_hand", "panda_leftfinger"}
    table = scene.object("table")
    assert len(table.shapes) == 2
    np.testing.assert_allclose(
        held.object.T_world_object.translation, [0.5, 0, 0.235]
    )  # where it was grasped
    before = scene.with_state(JointState(("panda_joint1",), [panda().state["panda_joint1"]]))
    np.testing.assert_allclose(before.frame_pose("cube").translation, [0.5, 0, 0.235], atol=1e-12)
    T_link_pen = before.transform("panda_link7", "pen")
    np.testing.assert_allclose(T_link_pen.translation, [0, 0, 0.1], atol=1e-9)
    assert scene.is_allowed("cube", "table") and scene.is_allowed("seen", "panda_link3")
    assert (scene.padding, scene.link_padding["panda_hand"], scene.link_scale["panda_link5"]) == (
        0.01,
        0,
        1.1,
    )
    assert scene.state["panda_joint1"] == 0.5


BAD = {
    "unknown object": (MoveObject("cup", SE3.identity()), "cup", UnknownNameError),
    "unknown frame": (AddObject(box("a", (1, 1, 1)), "camera_7"), "camera_7", InputError),
    "unknown link": (AttachObject("cube", "panda_foot"), "panda_foot", InputError),
    "unknown touch link": (AttachObject("cube", "panda_hand", ("panda_toe",)), "panda_toe", InputError),
    "a link's name": (AddObject(box("panda_hand", (1, 1, 1))), "name of a link", InputError),
    "nothing to detach": (DetachObject("cube"), "cube", InputError),
    "unknown body": (AllowCollision("cube", "ghost"), "ghost", InputError),
    "unknown default": (AllowCollisionByDefault("ghost"), "ghost", InputError),
    "negative padding": (SetPadding(-0.1), "padding", InputError),
    "scale of nothing": (SetPadding(scales={"panda_hand": 0.0}), "scale", InputError),
    "joint limit": (SetState(JointState(("panda_joint4",), [3.0])), "panda_joint4", InputError),
    "unknown joint": (SetState(JointState(("elbow",), [0.0])), "elbow", InputError),
    "color": (SetColor("cube", (2.0, 0, 0, 1)), "color", InputError),
    "a held cloud": (AttachObject(OCTOMAP, "panda_hand"), "cannot move", InputError),
    "a frame's name": (SetFixedFrame("cube", SE3.identity()), "cube", InputError),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_nothing_is_changed_by_a_diff_that_is_partly_wrong(name):
    change, text, _ = BAD[name]
    scene = with_octomap(panda(CUBE), CELLS)
    before = everything(scene)
    good = (AddObject(TABLE), MoveObject("cube", SE3.identity()), AllowCollision("cube", "table"))
    with pytest.raises(InputError, match=rf"diff/3 {type(change).__name__}.*nothing was changed") as error:
        scene.apply(SceneDiff((*good, change, RemoveObject("table"))))
    assert text in str(error.value)
    assert everything(scene) == before


def test_an_attached_object_is_not_removed_by_mistake():
    held = panda(CUBE).with_attached("cube", "panda_hand")
    with pytest.raises(InputError, match="attached.*detach it first"):
        held.apply(SceneDiff.of(RemoveObject("cube")))
    assert "cube" not in held.apply(SceneDiff.of(DetachObject("cube", remove=True))).objects


def test_four_objects_and_none():
    """As MoveIt's test of PlanningSceneInterface.clear()."""
    scene = panda().apply(
        SceneDiff(tuple(AddObject(box(f"box{i}", (0.1, 0.1, 0.1), (1, i, 0))) for i in range(4)))
    )
    assert len(scene.objects) == 4
    scene = with_octomap(scene, CELLS).apply(SceneDiff.of(RemoveAllObjects()))
    assert list(scene.objects) == [OCTOMAP]
    assert not with_octomap(scene, None).objects


def test_removing_forgets_what_was_allowed():
    scene = panda(CUBE).with_allowed("cube", "panda_hand").with_default_allowed("cube", True)
    again = scene.without_object("cube").with_object(CUBE)
    assert scene.is_allowed("cube", "panda_hand") and not again.is_allowed("cube", "panda_hand")
    held = scene.with_attached("cube", "panda_hand").with_detached("cube")  # the same cube: remembered
    assert held.is_allowed("cube", "panda_link3")


def test_the_octomap_may_be_allowed_and_replaced():
    scene = with_octomap(panda(), CELLS).with_allowed(OCTOMAP, "panda_hand")
    assert with_octomap(scene, CELLS).is_allowed(OCTOMAP, "panda_hand")
    assert with_octomap(with_octomap(scene, None), CELLS).is_allowed(OCTOMAP, "panda_hand")


def test_defaults_come_after_pairs_and_forbidding_wins():
    scene = panda(CUBE, TABLE).with_default_allowed("cube", True)
    assert scene.is_allowed("cube", "panda_hand") and scene.is_allowed("cube", "table")
    assert not scene.is_allowed("table", "panda_hand")
    assert not scene.with_allowed("cube", "panda_hand", False).is_allowed("cube", "panda_hand")
    assert not scene.with_default_allowed("panda_hand", False).is_allowed("panda_hand", "cube")
    later = scene.with_object(box("later", (0.1, 0.1, 0.1)))
    assert later.is_allowed("cube", "later")
    assert not later.with_default_allowed("cube", None).is_allowed("cube", "later")


def test_diffs_add_up():
    one, two = SceneDiff.of(AddObject(TABLE)), SceneDiff.of(AllowCollision("table", "panda_hand"))
    assert everything(panda().apply(one + two)) == everything(panda().apply(one).apply(two))


@pytest.mark.parametrize("color", [(1, 1, 1), (1, 1, 1, 2), (np.nan, 0, 0, 1)])
def test_colors_of_objects(color):
    with pytest.raises(InputError, match="color"):
        CollisionObject.single("a", Box(1, 1, 1), color=color)


def test_objects_placed_one_after_another_see_the_changes_before_them():
    first, second = box("a", (0.1, 0.1, 0.1), (1.0, 0.0, 0.0)), box("b", (0.1, 0.1, 0.1), (0.0, 0.0, 0.5))
    scene = panda().apply(
        SceneDiff.of(
            AddObject(first),
            MoveObject("a", SE3.from_xyz(0.0, 2.0, 0.0)),
            AddObject(second, "a"),  # in the frame of an object that this diff adds and moves
            RemoveObject("a"),
            AddObject(first),
            SetColor("a", (1.0, 0.0, 0.0, 1.0)),
        )
    )
    assert scene.objects["b"].T_world_object.translation == pytest.approx((0.0, 2.0, 0.5))
    assert scene.objects["a"].T_world_object.translation == pytest.approx((1.0, 0.0, 0.0))
    assert scene.objects["a"].color == (1.0, 0.0, 0.0, 1.0) and list(scene.objects) == ["b", "a"]


def test_a_wrong_object_among_many_is_reported_by_its_place():
    some = [AddObject(box(f"box{k}", (0.1, 0.1, 0.1))) for k in range(5)]
    for wrong in (AddObject(box("panda_link3", (0.1, 0.1, 0.1))), MoveObject("missing", SE3.identity())):
        with pytest.raises(InputError, match="diff/5"):
            panda().apply(SceneDiff.of(*some, wrong, *some))
