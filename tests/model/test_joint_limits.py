"""joint_limits.yaml tightens, never widens."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import InputError
from armcell.model import load_robot
from armcell.model.limits import with_joint_limits

PANDA = load_robot("panda")
JOINT = "panda_joint4"  # its limits, -3.0718 to -0.0698, are both negative
OLD = PANDA.joint(JOINT).limits


@pytest.fixture
def apply(tmp_path):
    def read(text: str, wrap: bool = True):
        file = tmp_path / "joint_limits.yaml"
        file.write_text(f"joint_limits:\n  {JOINT}: {{{text}}}\n" if wrap else text)
        return with_joint_limits(PANDA, file).joint(JOINT).limits

    return read


def test_tighter_limits_are_taken(apply):
    new = apply(
        "max_velocity: 1.0, max_acceleration: 2.0, max_jerk: 3.0, max_effort: 4, "
        "min_position: -2.0, max_position: -1.0, has_velocity_limits: true"
    )
    assert (new.velocity, new.acceleration, new.jerk, new.effort) == (1.0, 2.0, 3.0, 4.0)
    assert (new.lower, new.upper) == (-2.0, -1.0)
    assert PANDA.joint(JOINT).limits == OLD


def test_a_switched_off_limit_is_left_alone(apply):
    assert apply("has_velocity_limits: false, max_velocity: 1.0").velocity == OLD.velocity
    assert apply("has_velocity_limits: true, max_velocity: 1.0").velocity == 1.0


@pytest.mark.parametrize(
    "text",
    [
        "max_velocity: 2.5",
        "max_position: 0.0",
        "min_position: -3.1",
        "max_acceleration: 99",
        "max_effort: 1000",
    ],
)
def test_wider_limits_are_refused(apply, text):
    with pytest.raises(InputError, match="wider than the robot's own .*only be tightened"):
        apply(text)


@pytest.mark.parametrize(
    "text",
    [
        f"max_velocity: {OLD.velocity}",
        f"min_position: {OLD.lower}",
        f"max_position: {OLD.upper}",
    ],
)
def test_the_same_limit_is_not_wider(apply, text):
    assert apply(text) == OLD


BAD = {
    "text": ("max_velocity: fast", "max_velocity is 'fast', a number is needed"),
    "bool": ("max_velocity: true", "a number is needed"),
    "list": ("max_velocity: [1]", "a number is needed"),
    "null": ("max_velocity: null", "a number is needed"),
    "zero": ("max_velocity: 0", "must be positive"),
    "negative": ("max_acceleration: -1", "must be positive"),
    "key": ("max_speed: 1", "unknown key 'max_speed'.*known: .*max_velocity"),
}
BAD_TOO = {
    "nan": ("max_velocity: .nan", "max_velocity"),
    "nan position": ("max_position: .nan", "max_position"),
    "crossed": ("min_position: -1.0, max_position: -2.0", "position"),
}


@pytest.mark.parametrize(
    ("text", "words"),
    [*BAD.values(), *BAD_TOO.values()],
    ids=[*BAD, *BAD_TOO],
)
def test_wrong_values_name_file_joint_and_key(apply, text, words):
    with pytest.raises(InputError, match=words) as error:
        apply(text)
    assert f"joint_limits.yaml: joint_limits/{JOINT}: " in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joint_limits: [1, 2]", "no mapping 'joint_limits'"),
        ("limits: {}", "no mapping 'joint_limits'"),
        (f"joint_limits: {{{JOINT}: 3}}", "is not a mapping"),
        ("joint_limits: {panda_jiont4: {max_velocity: 1}}", r"unknown joint 'panda_jiont4'.*did you mean"),
    ],
)
def test_wrong_structure_is_named(apply, text, words):
    with pytest.raises(InputError, match=words):
        apply(text, wrap=False)


def test_unlimited_stays_unlimited(apply):
    assert np.isinf(PANDA.joint("panda_finger_joint1").limits.jerk)
