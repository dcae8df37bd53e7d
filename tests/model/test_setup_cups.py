"""Suction cups that setup finds: center, axis, radius and lip of made cups, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.model.helpers import collision, joint, link, model_of
from tests.model.test_setup_gripper import ARM

from armcell.cell.gripper_proof import prove_gripper
from armcell.core import InputError, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel, SuctionGripper
from armcell.model.setup import with_groups
from armcell.model.setup.gripper_detection import GripperSpec, find_grippers, reasons

BODY = '<collision><origin xyz="0 0 0.03"/><geometry><box size="0.1 0.1 0.06"/></geometry></collision>'
CUP = '<collision><origin xyz="0 0 {}"/><geometry><cylinder radius="{}" length="{}"/></geometry></collision>'
TILTED = "0.3 -0.2 0.1"  # rpy of the hand on the arm's last link: no axis is an axis of the world


def placed(xyz: str, rpy: str = "0 0 0") -> str:
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def fixed(name: str, parent: str, xyz: str, rpy: str = "0 0 0") -> str:
    return joint(f"{name}_joint", parent, name, "fixed", placed(xyz, rpy))


def two_cups(second: str = "0 -0.03 0.06", rpy: str = "0 0 0", radius: float = 0.02) -> list[str]:
    """A body on the last link of an arm with two cups of 30 mm length, 60 mm apart along y."""
    return [
        *ARM, link("flange"), fixed("flange", "l4", "0 0 0.05", TILTED),
        link("body", BODY), fixed("body", "flange", "0 0 0"),
        link("left_cup", CUP.format(0.015, radius, 0.03)), fixed("left_cup", "body", "0 0.03 0.06"),
        link("right_cup", CUP.format(0.015, radius, 0.03)), fixed("right_cup", "body", second, rpy),
    ]  # fmt: skip


def mesh_cup(mesh, folder, name: str = "vacuum_gripper", rpy: str = "0 0 0") -> list[str]:
    mesh.export(folder / "cup.stl")
    shape = collision(f'<mesh filename="{folder / "cup.stl"}"/>')
    return [*ARM, link("flange"), fixed("flange", "l4", "0 0 0.05"), link(name, shape),
            fixed(name, "flange", "0 0 0", rpy)]  # fmt: skip


def hollow(depth: float, outer: float = 0.02, inner: float = 0.017, sections: int = 40):
    """A cup of 40 mm length along z with a conical lip and a flat hollow."""
    profile = [(0, 0), (0.008, 0), (0.008, 0.03), (outer, 0.04), (inner, 0.04), (0.006, 0.04 - depth),
               (0, 0.04 - depth)]  # fmt: skip
    return trimesh.creation.revolve(np.array(profile), sections=sections)


def found(parts: list[str], words: str = "suction") -> tuple[RobotModel, SuctionGripper]:
    fact = GripperSpec.parse(words)
    model = find_grippers(with_groups(model_of(*parts), cups=fact.cups), tips=True, stated=[fact])
    gripper = model.gripper()
    assert isinstance(gripper, SuctionGripper)
    return model, gripper


def poses(model: RobotModel, gripper: SuctionGripper, base: str):
    """Poses of the tcp and of the cups in the frame of a link."""
    tree, q = kinematic_tree(model), model.default_positions()
    into = tree.link_pose(q, base).inverse()
    cups = [into @ tree.link_pose(q, cup.link) @ cup.T_link_cup for cup in gripper.cups]
    return into @ tree.link_pose(q, gripper.tcp_link), cups


def test_two_cups_have_their_center_axis_radius_and_lip():
    model, gripper = found(two_cups())
    assert [cup.link for cup in gripper.cups] == ["left_cup", "right_cup"]
    assert [(cup.radius, cup.stroke) for cup in gripper.cups] == [(0.02, 0.002)] * 2
    assert gripper.hand_links == ("body", "left_cup", "right_cup")
    tcp, cups = poses(model, gripper, "body")
    # The lips end at 0.09 m; a held surface bends them by their stroke.
    np.testing.assert_allclose(
        [T.translation for T in cups], [[0, 0.03, 0.088], [0, -0.03, 0.088]], atol=1e-6
    )
    for T in (tcp, *cups):
        np.testing.assert_allclose(T.rotation.matrix[:, 2], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(tcp.translation, [0, 0, 0.088], atol=1e-6)
    np.testing.assert_allclose(np.abs(tcp.rotation.matrix[:, 1]), [0, 1, 0], atol=1e-6)
    assert model.groups["arm"].tip_link == gripper.tcp_link == "gripper_tcp"


@pytest.mark.parametrize("sections", [12, 40])
def test_a_hollow_mesh_holds_with_the_inside_of_its_lip(tmp_path, sections):
    model, gripper = found(mesh_cup(hollow(0.006, sections=sections), tmp_path))
    (cup,) = gripper.cups
    assert cup.radius == pytest.approx(0.017, rel=0.05) and cup.stroke == 0.002
    _, (T,) = poses(model, gripper, "flange")
    np.testing.assert_allclose(T.translation, [0, 0, 0.038], atol=1e-4)


def test_the_lip_is_not_longer_than_a_shallow_cup_is_deep(tmp_path):
    (cup,) = found(mesh_cup(hollow(0.0012), tmp_path))[1].cups
    assert cup.stroke == pytest.approx(0.0012, abs=1e-5)
    assert cup.xyz[2] == pytest.approx(0.0388, abs=1e-5)


@pytest.mark.parametrize("rpy", ["0 0 0", "1.5707963 0 0", "0 -1.5707963 0", TILTED])
def test_a_mesh_with_four_cups_in_any_frame(tmp_path, rpy):
    at = [(x, y) for x in (-0.03, 0.03) for y in (-0.03, 0.03)]
    cups = [hollow(0.006).apply_translation((x, y, 0.02)) for x, y in at]
    plate = trimesh.creation.box((0.1, 0.1, 0.02)).apply_translation((0, 0, 0.01))
    model, gripper = found(mesh_cup(trimesh.util.concatenate([plate, *cups]), tmp_path, rpy=rpy))
    assert len(gripper.cups) == 4
    tcp, measured = poses(model, gripper, "vacuum_gripper")
    centers = sorted(tuple(np.round(T.translation, 4)) for T in measured)
    np.testing.assert_allclose(centers, [(x, y, 0.058) for x, y in at], atol=2e-4)
    np.testing.assert_allclose(tcp.translation, [0, 0, 0.058], atol=2e-4)
    for T in (tcp, *measured):
        np.testing.assert_allclose(T.rotation.matrix[:, 2], [0, 0, 1], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cylinders", "mesh"])
def test_the_cups_lift_a_plate(tmp_path, kind):
    model, gripper = found(two_cups() if kind == "cylinders" else mesh_cup(hollow(0.006), tmp_path))
    proof = prove_gripper(model, gripper)
    assert proof.held, proof.text
    assert "lifted and shaken" in proof.text and proof.slip < 0.002


def test_cups_are_never_assumed(caplog):
    model = find_grippers(with_groups(model_of(*two_cups())))
    assert not model.grippers
    for text in (caplog.text, reasons(model)["gripper"]):
        assert "left_cup, right_cup may be suction cups by name" in text
    assert "pass --gripper suction" in reasons(model)["gripper"]


def test_a_cup_without_a_typical_name_is_stated():
    parts = [part.replace("left_cup", "tool_a").replace("right_cup", "tool_b") for part in two_cups()]
    with pytest.raises(InputError, match="none of its links is named like a suction cup"):
        found(parts)
    _, gripper = found(parts, "cups=tool_b")
    assert [cup.link for cup in gripper.cups] == ["tool_b"]
    single = [part for part in parts if "tool_a" not in part]  # nothing branches off: no end effector
    assert not with_groups(model_of(*single)).end_effectors
    with pytest.raises(InputError, match=r"no end effector.*cups=LINK,LINK"):
        found(single)
    assert found(single, "cups=tool_b")[1].cups[0].radius == 0.02


def test_an_existing_frame_in_the_middle_of_the_rings_is_the_tcp():
    frame = [link("center"), fixed("center", "body", "0 0 0.088")]
    assert found([*two_cups(), *frame])[1].tcp_link == "center"
    assert found([*two_cups(), *frame], "suction tcp=center")[1].tcp_link == "center"
    elsewhere = [link("center"), fixed("center", "body", "0 0 0.1")]
    assert found([*two_cups(), *elsewhere])[1].tcp_link == "gripper_tcp"
    with pytest.raises(InputError, match=r"tcp center is not in the middle of the cups' rings.*omit tcp="):
        found([*two_cups(), *elsewhere], "suction tcp=center")


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        (two_cups(rpy="0.5 0 0"), "do not point in one direction"),
        (two_cups(second="0 -0.03 0.07"), "do not end in one plane: their rings are 10 mm apart"),
        (two_cups(radius=0.0015), "link left_cup has no circle of 2 to 100 mm radius at its outer end"),
    ],
)
def test_links_that_are_no_cups_state_the_reason(parts, reason):
    with pytest.raises(InputError, match=reason):
        found(parts)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("cups=body", "link body has no circle"),
        ("cups=l3", "cup l3 is not fixed to"),
        ("suction drive=j4", "a suction gripper has no drive"),
        ("suction fingers=body,flange", "a suction gripper has no fingers"),
    ],
)
def test_stated_cups_that_the_robot_does_not_have_are_errors(words, reason):
    with pytest.raises(InputError, match=reason):
        found(two_cups(), words)


def test_unknown_cups_list_the_known_links():
    with pytest.raises(UnknownNameError, match="left_cup"):
        found(two_cups(), "cups=left_cap")
