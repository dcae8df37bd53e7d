"""Validation of the block `real` of a cell file by the robot kinds that it names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from armcell.core import InputError, UnknownNameError
from armcell.drivers.real.robot_kind import check_distinct, kind_of, robot_kinds
from armcell.drivers.real.settings import DEFAULT_KIND, OWN, ArmSettings, RealSettings
from armcell.model import RobotModel

_NUMBERS = {6: "six", 7: "seven"}


def real_settings(values: dict[str, Any], model: RobotModel) -> RealSettings:
    """Validate the block `real` of a cell file, which describes the real arms.

    Raises:
        InputError: the block is invalid; the message states the cause and the remedy.
    """
    if not values:
        raise InputError(
            "the cell has no real arms",
            hint="add to the cell file 'real: {arms: {GROUP: {host: ADDRESS, model: UR10}}}'; "
            f"groups with six joints: {', '.join(_groups(model, 6)) or 'none'}",
        )
    arms = values.get("arms")
    defaults = {"kind": values.get("kind", DEFAULT_KIND), "backend": values.get("backend", OWN)}
    if isinstance(arms, Mapping):
        values = {**values, "arms": {name: _arm(name, block, defaults) for name, block in arms.items()}}
    settings = _validated(RealSettings, values)
    for name, arm in settings.arms.items():
        kind = kind_of(arm)
        if name not in (groups := _groups(model, kind.joints)):
            raise UnknownNameError(
                f"arm (a planning group with {_NUMBERS.get(kind.joints, kind.joints)} joints)",
                name, groups, element="real/arms",
            )  # fmt: skip
        if arm.backend not in kind.backends:
            place = _place("backend", name, arm.backend == settings.backend)
            raise UnknownNameError(f"backend of kind {arm.kind!r}", arm.backend, kind.backends, element=place)
    check_distinct(settings.arms, "address", "host")
    complete: dict[str, ArmSettings] = {}
    for kind in dict.fromkeys(arm.kind for arm in settings.arms.values()):
        mine = {name: arm for name, arm in settings.arms.items() if arm.kind == kind}
        complete |= robot_kinds[kind].complete_settings(mine, model)
    return settings.model_copy(update={"arms": {name: complete[name] for name in settings.arms}})


def _groups(model: RobotModel, joints: int) -> list[str]:
    return [g.name for g in model.groups.values() if g.tip_link and len(g.joint_names) == joints]


def _place(key: str, arm: str, default: bool) -> str:
    """Return the cell-file path of an arm's setting, for example `real/kind` for the default of all arms, or
    `real/arms/left/kind` for the arm's own value.
    """
    return f"real/{key}" if default else f"real/arms/{arm}/{key}"


def _arm(name: str, block: Any, defaults: dict[str, Any]) -> ArmSettings:
    values = {**defaults, **block} if isinstance(block, Mapping) else block
    kind = values["kind"] if isinstance(values, dict) else defaults["kind"]
    if not isinstance(kind, str) or kind not in robot_kinds:
        place = _place("kind", name, kind == defaults["kind"])
        raise UnknownNameError(robot_kinds.kind, str(kind), robot_kinds, element=place)
    return _validated(robot_kinds[kind].arm_settings, values, "arms", name)


def _validated(kind: type[Any], values: Any, *place: str) -> Any:
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = "/".join(["real", *place, *(str(p) for p in first["loc"])])
        raise InputError(first["msg"].removeprefix("Value error, "), element=where) from None
