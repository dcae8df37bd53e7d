"""PlanningSceneInterface: objects, meshes, what is attached and what is refused."""

from __future__ import annotations

import time

import pytest
from tests.moveit.helpers import stamped

from armcell.ros.convert import pose_from_message


def test_objects(arm, scene):
    scene.add_box("box", stamped(0.0, 0.6, 0.3), size=(0.1, 0.2, 0.3))
    scene.add_sphere("ball", stamped(0.0, -0.6, 0.3), 0.1)
    scene.add_cylinder("can", stamped(0.3, -0.6, 0.3), 0.2, 0.05)
    scene.add_cone("hat", stamped(0.3, 0.6, 0.3), 0.2, 0.05)
    scene.add_plane("wall", stamped(0, 0, 0), normal=(1, 0, 0), offset=0.8)
    names = set(scene.get_known_object_names())  # at once
    assert {"table", "cube", "box", "ball", "can", "hat", "wall"} <= names
    box = scene.get_objects(["box"])["box"]
    assert list(box.primitives[0].dimensions) == [0.1, 0.2, 0.3]
    assert pose_from_message(scene.get_object_poses(["box"])["box"]).translation[1] == pytest.approx(0.6)
    assert scene.get_known_object_names_in_roi(-0.1, 0.5, 0.2, 0.1, 0.7, 0.4) == ["box"]
    assert scene.get_known_object_names(with_type=True) == []
    scene.remove_world_object("box")
    assert "box" not in scene.get_known_object_names()
    assert scene.get_planning_scene(8).world.collision_objects


def test_a_mesh(arm, scene, mc, tmp_path):
    import trimesh

    file = tmp_path / "block.stl"
    trimesh.creation.box((1, 1, 1)).export(file)
    scene.add_mesh("block", stamped(0.0, 0.7, 0.4), str(file), size=(0.1, 0.2, 0.3))
    vertices = scene.get_objects(["block"])["block"].meshes[0].vertices
    assert max(v.z for v in vertices) == pytest.approx(0.15) and max(v.y for v in vertices) == pytest.approx(
        0.1
    )
    with pytest.raises(mc.MoveItCommanderException):
        scene.add_mesh("none", stamped(0, 0, 0), str(tmp_path / "none.stl"))


def test_attaching(arm, scene):
    scene.attach_box("panda_hand", "tool", stamped(0, 0, 0.2, "panda_hand"), size=(0.02, 0.02, 0.1))
    tool = scene.get_attached_objects()["tool"]
    assert tool.link_name == "panda_hand" and tool.touch_links == ["panda_hand"]
    scene.remove_attached_object("panda_hand", "tool")
    assert "tool" in scene.get_known_object_names()  # it stays in the world
    scene.remove_world_object("tool")
    scene.add_box("part", stamped(0.4, -0.3, 0.3), size=(0.05, 0.05, 0.05))
    assert arm.attach_object("part") is True
    attached = scene.get_attached_objects(["part"])["part"]
    assert attached.link_name == "panda_hand_tcp" and "panda_leftfinger" in attached.touch_links
    assert arm.detach_object("part") is True and not scene.get_attached_objects()
    assert arm.detach_object("part") is True  # MoveIt's: it was asked for


def test_attaching_what_is_in_the_world_by_its_name(arm, scene, mc):
    scene.add_box("part", stamped(0.4, -0.3, 0.3), size=(0.05, 0.05, 0.05))
    scene.attach_object("part", "panda_hand")
    part = scene.get_attached_objects()["part"]
    assert part.link_name == "panda_hand" and part.touch_links == ["panda_hand"]
    scene.remove_attached_object(name="part")
    hand = mc.MoveGroupCommander("hand")  # has no end effector link: its first link
    assert hand.attach_object("part") is True
    assert scene.get_attached_objects()["part"].link_name in mc.RobotCommander().get_link_names("hand")
    assert hand.attach_object("part", "tail") is True and "part" in scene.get_attached_objects()


def test_the_matrix_of_allowed_collisions(arm, scene, session):
    from moveit_msgs.msg import AllowedCollisionMatrix, PlanningScene, PlanningSceneComponents

    def apply(matrix):
        diff = PlanningScene(is_diff=True, allowed_collision_matrix=matrix)
        diff.robot_state.is_diff = True
        assert scene.apply_planning_scene(diff)

    def now():
        wanted = PlanningSceneComponents.ALLOWED_COLLISION_MATRIX
        return scene.get_planning_scene(wanted).allowed_collision_matrix

    scene.add_box("box", stamped(0.0, 0.6, 0.3), size=(0.1, 0.1, 0.1))
    allowed = lambda other: session.served.cell.scene().is_allowed("box", other)  # noqa: E731
    matrix = now()
    matrix.set_allowed("box", "panda_hand")
    apply(matrix)
    assert allowed("panda_hand") and not allowed("panda_link7")
    matrix = now()
    matrix.set_allowed("box", "panda_hand", allow=False)
    matrix.set_allowed("box")  # by default
    assert matrix.default_entry_names == ["box"] and matrix.default_entry_values == [True]
    apply(matrix)
    assert allowed("panda_link7") and not allowed("panda_hand")
    matrix.set_default("box", False)
    apply(matrix)
    assert not allowed("panda_link7")
    with pytest.raises(ValueError, match="tail"):
        matrix.set_allowed("box", "tail")
    new = AllowedCollisionMatrix()
    new.entry_names, new.entry_values = ["a"], [type(matrix.entry_values[0])([False])]
    new.set_allowed("b", "a")
    assert new.entry_names == ["a", "b"] and [e.enabled for e in new.entry_values] == [
        [False, True], [True, False]
    ]  # fmt: skip


def test_what_the_planning_scene_refuses_is_said(scene, session):
    count = len(session.lines)
    scene.add_box("lost", stamped(0, 0, 0, "no_frame"))
    assert "lost" not in scene.get_known_object_names() and "lost" in " ".join(session.lines[count:])


def test_topics_instead_of_services(arm, mc, scene):
    mc.PlanningSceneInterface(synchronous=False).add_box("late", stamped(0.0, 0.6, 0.3), size=(0.1, 0.1, 0.1))
    end = time.monotonic() + 5
    while "late" not in scene.get_known_object_names() and time.monotonic() < end:
        time.sleep(0.01)
    assert "late" in scene.get_known_object_names()
