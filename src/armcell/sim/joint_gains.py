"""PID gains of the arm joints: individual gains if given, else scaled default gains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import checked, settings_from
from armcell.model import RobotModel


@dataclass(frozen=True)
@checked()
class JointGains:
    """PID gains of one joint. The simulation uses these gains unchanged; the setting `full_gain_effort` does
    not scale them.

    Effort = p e + clamp(i ∫e) + d (target speed - speed) + ff_velocity_scale * target speed, with
    e = target - position. The control law and the names are those of ros_control's `control_toolbox::Pid`.

    Raises:
        InputError: a gain is negative or infinite.
    """

    p: float  # [Nm/rad or N/m]
    i: float = 0.0  # [Nm/(rad s) or N/(m s)]
    d: float = 0.0  # [Nm s/rad or N s/m]
    i_clamp: float = -1.0  # [Nm or N] largest effort of the integral; -1: 1/5 of the joint's effort limit
    i_clamp_min: float = -1.0  # [Nm or N] largest effort in the negative direction; -1: i_clamp
    i_clamp_max: float = -1.0  # [Nm or N] largest effort in the positive direction; -1: i_clamp
    antiwindup: bool = True  # False: only the integral's effort is clamped, the integral itself keeps growing
    ff_velocity_scale: float = 0.0  # [Nm s/rad or N s/m]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            unset = field.name.startswith("i_clamp") and value == -1.0
            if not unset and not (np.isfinite(value) and value >= 0):
                raise InputError(f"{field.name} is {value:g}, it must be a number >= 0")


class GainTable(Mapping[str, JointGains]):
    """Immutable and hashable table of PID gains by joint name.

    `PhysicsSettings` requires hashable fields.
    """

    def __init__(self, gains: Mapping[str, JointGains] | None = None):
        self._gains = dict(gains or {})

    def __getitem__(self, joint: str) -> JointGains:
        return self._gains[joint]

    def __iter__(self) -> Iterator[str]:
        return iter(self._gains)

    def __len__(self) -> int:
        return len(self._gains)

    def __hash__(self) -> int:
        return hash(frozenset(self._gains.items()))

    def __repr__(self) -> str:
        return repr(self._gains)

    @classmethod
    def from_setting(cls, value: Any, what: str) -> GainTable:
        """Create a table of joint gains from a mapping such as {JOINT: {p: 80, i: 0.5, d: 1.5, i_clamp: 10}}.

        Args:
            value: mapping from joint names to gains, or a `GainTable`.
            what: name of the setting for error messages.
        Raises:
            InputError: `value` is not a mapping of mappings, `p` is missing, or a gain is not a number >= 0.
            UnknownNameError: a gain has an unknown name.
        """
        if isinstance(value, GainTable):
            return value
        if not isinstance(value, Mapping):
            raise InputError(f"{what} is {value!r}, a mapping of joint names to gains is needed")
        return cls({str(joint): gains_of(entry, f"{what}/{joint}") for joint, entry in value.items()})

    def plain(self) -> dict[str, dict[str, Any]]:
        """Return the joint gains as a plain mapping by joint. Values that equal the default are omitted.

        `from_setting` reads this mapping.
        """
        return {
            joint: {f.name: v for f in fields(g) if (v := getattr(g, f.name)) != f.default}
            for joint, g in self._gains.items()
        }


def gains_of(entry: Any, what: str) -> JointGains:
    """Parse the PID gains of one joint from a mapping of numbers.

    Args:
        what: name of the setting; error messages begin with it.
    Raises:
        InputError: `p` is missing, or a gain is not a number >= 0.
        UnknownNameError: a gain has an unknown name.
    """
    try:
        return settings_from(JointGains, entry, what)
    except UnknownNameError as error:
        raise UnknownNameError("gain", error.name, error.known, element=what) from None
    except InputError as error:
        text = error.reason if error.reason.startswith(what) else f"{what}: {error.reason}"
        raise InputError(text, hint=error.hint) from None


def arm_joints(model: RobotModel) -> list[str]:
    """Return the names of the joints that have arm gains, in model order: all actuated joints of the robot
    except the gripper joints.
    """
    fingers = {name for gripper in model.grippers.values() for name in gripper.joint_names}
    return [name for name in model.joint_names if name not in fingers]


def check_joint_gains(gains: GainTable, model: RobotModel, **where: Any) -> None:
    """Raise an error if the setting `joint_gains` names a joint that does not belong to an arm.

    Raises:
        UnknownNameError: the robot's arms do not have a joint; the message lists the arm joints and suggests
            the most similar name.
    """
    known = arm_joints(model)
    for joint in gains:
        if joint not in known:
            raise UnknownNameError("arm joint", joint, known, **where)
