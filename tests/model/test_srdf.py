"""Groups, named states, end effectors and allowed collisions."""

from __future__ import annotations

import pytest
from tests.model.helpers import joint, link, model_of

from armcell.core import InputError, UnknownNameError
from armcell.model.srdf import with_srdf

ROBOT = model_of(
    *(link(n) for n in ("base", "upper", "lower", "tool", "finger1", "finger2")),
    joint("shoulder", "base", "upper"),
    joint("elbow", "upper", "lower"),
    joint("flange", "lower", "tool", "fixed"),
    joint("grip1", "tool", "finger1", "prismatic"),
    joint("grip2", "tool", "finger2", "prismatic", '<mimic joint="grip1"/>'),
)


def state(name: str, group: str, **values: str) -> str:
    joints = "".join(f'<joint name="{k}" value="{v}"/>' for k, v in values.items())
    return f'<group_state name="{name}" group="{group}">{joints}</group_state>'


@pytest.fixture
def apply(tmp_path):
    def read(*elements: str):
        file = tmp_path / "r.srdf"
        file.write_text("\n".join(['<robot name="r">', *elements, "</robot>"]))
        return with_srdf(ROBOT, file)

    return read


def test_groups_by_joint_link_chain_and_group(apply):
    groups = apply(
        '<group name="all"><group name="arm"/><group name="hand"/></group>',
        '<group name="arm"><chain base_link="base" tip_link="tool"/></group>',
        '<group name="hand"><link name="finger1"/><joint name="grip2"/></group>',
        '<group name="one"><joint name="elbow"/></group>',
    ).groups
    arm = groups["arm"]
    assert (arm.joint_names, arm.base_link, arm.tip_link) == (("shoulder", "elbow"), "base", "tool")
    assert set(arm.link_names) >= {"upper", "lower", "tool"}
    assert groups["hand"].joint_names == ("grip1",)  # the mimic joint follows, nobody plans for it
    assert set(groups["hand"].link_names) == {"finger1", "finger2"} and groups["hand"].tip_link is None
    assert groups["one"].joint_names == ("elbow",)
    assert groups["all"].joint_names == ("shoulder", "elbow", "grip1")


def test_named_states_and_end_effectors(apply):
    model = apply(
        '<group name="arm"><chain base_link="base" tip_link="tool"/></group>',
        '<group name="hand"><joint name="grip1"/></group>',
        state("home", "arm", elbow="0.5", shoulder="-0.5"),
        state("open", "hand", grip1="0.2", grip2="0.2"),
        '<end_effector name="gripper" parent_link="tool" group="hand" parent_group="arm"/>',
    )  # fmt: skip
    assert model.named_state("arm", "home").as_dict() == {"elbow": 0.5, "shoulder": -0.5}
    assert model.named_state("hand", "open").as_dict() == {"grip1": 0.2}
    assert model.default_positions() == pytest.approx([-0.5, 0.5, 0.2])
    eef = model.end_effectors["gripper"]
    assert (eef.group, eef.parent_link, eef.parent_group) == ("hand", "tool", "arm")
    with pytest.raises(UnknownNameError, match="known: home"):
        model.named_state("arm", "hom")
    with pytest.raises(UnknownNameError, match="known: arm, hand"):
        model.named_state("legs", "home")


def test_disabled_collisions_keep_their_reason(apply):
    model = apply('<disable_collisions link1="base" link2="lower" reason="Never"/>')
    assert dict(model.disabled_collisions) == {frozenset(("base", "lower")): "Never"}
    assert not ROBOT.disabled_collisions  # the model it was applied to is as before


BAD = {
    "joint": ('<group name="g"><joint name="elbw"/></group>', "unknown joint 'elbw'.*did you mean 'elbow'"),
    "link": ('<group name="g"><link name="tol"/></group>', "unknown link 'tol'.*did you mean 'tool'"),
    "chain": ('<group name="g"><chain base_link="base" tip_link="x"/></group>', "unknown link 'x'"),
    "backwards": ('<group name="g"><chain base_link="tool" tip_link="base"/></group>', "not below"),
    "subgroup": ('<group name="g"><group name="h"/></group>', "unknown group 'h'"),
    "itself": ('<group name="g"><group name="g"/></group>', r"contains itself \(g -> g\)"),
    "circle": (
        '<group name="g"><group name="h"/></group><group name="h"><group name="g"/></group>',
        "contains itself",
    ),
    "empty": ('<group name="g"></group>', "is empty"),
    "nameless": ("<group></group>", "attribute 'name' is missing"),
    "state joint": (
        '<group_state name="s" group="g"><joint name="x" value="0"/></group_state>',
        "unknown joint 'x'",
    ),
    "state value": (
        '<group_state name="s" group="g"><joint name="elbow" value="half"/></group_state>',
        "'elbow' is not a number",
    ),
    "state nothing": (
        '<group_state name="s" group="g"><joint name="elbow"/></group_state>',
        "attribute 'value' is missing",
    ),
    "half a pair": ('<disable_collisions link1="base"/>', "attribute 'link2' is missing"),
}
BAD_TOO = {
    "state nan": (
        '<group name="g"><joint name="elbow"/></group>' + state("s", "g", elbow="nan"),
        "elbow",
    ),
    "state group": (
        '<group_state name="s" group="g"><joint name="elbow" value="0"/></group_state>',
        "unknown .*group 'g'",
    ),
    "eef group": ('<end_effector name="e" parent_link="tool" group="g"/>', "unknown .*group 'g'"),
    "eef link": (
        '<group name="g"><joint name="grip1"/></group><end_effector name="e" parent_link="x" group="g"/>',
        "unknown link 'x'",
    ),
}


@pytest.mark.parametrize(
    ("element", "words"),
    [*BAD.values(), *BAD_TOO.values()],
    ids=[*BAD, *BAD_TOO],
)
def test_bad_srdf_names_file_line_and_reason(apply, element, words):
    with pytest.raises(InputError, match=words) as error:
        apply("<!-- one line before -->", element)
    text = str(error.value)
    assert "r.srdf:3: " in text and "<" in text and "\n" not in text


def test_what_a_larger_robot_left_in_the_file_is_passed_over(apply, caplog):
    """As in MoveIt: a pair with an unknown link and a named state out of limits are said, and left out."""
    group = '<group name="g"><joint name="elbow"/></group>'
    model = apply(group, state("s", "g", elbow="9"), '<disable_collisions link1="base" link2="x" reason=""/>')
    assert model.named_states == {} and not any("x" in pair for pair in model.disabled_collisions)
    assert "'x'" in caplog.text and "'s'" in caplog.text


def test_the_root_must_be_robot(tmp_path):
    (tmp_path / "r.srdf").write_text("<semantics/>")
    with pytest.raises(InputError, match="root element is not <robot>"):
        with_srdf(ROBOT, tmp_path / "r.srdf")
