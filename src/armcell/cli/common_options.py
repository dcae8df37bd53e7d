"""Options that many commands share: `--xacro-arg`, `--package` (robot files) and the random `--seed`."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import typer

from armcell.model.command_line_options import set_packages, set_xacro_args

_OPTIONS = {
    "xacro_arg": typer.Option(
        [], "--xacro-arg", metavar="NAME:=VALUE", help="Argument of the robot's xacro file; may be repeated."
    ),
    "package": typer.Option(
        [],
        "--package",
        metavar="NAME=FOLDER",
        help="Folder of a ROS package that a robot uses; may be repeated.",
    ),
}
SEED = typer.Option(
    None, min=0, show_default=False,
    help="Draw of the randomised values, and seed of the planners. Default: 0; in mode real things are where "
    "the cell file says.",
)  # fmt: skip


def robot_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the options `--xacro-arg` and `--package` for robot files.

    An option that the command has already (`armcell import --package`) keeps the command's meaning.
    """
    signature = inspect.signature(command, eval_str=True)
    options = {name: option for name, option in _OPTIONS.items() if name not in signature.parameters}

    @functools.wraps(command)
    def with_options(*args: Any, **values: Any) -> Any:
        own = {name: values.pop(name) for name in options}
        set_xacro_args(own.get("xacro_arg", ()))
        set_packages(own.get("package", ()))
        return command(*args, **values)

    kind = inspect.Parameter.KEYWORD_ONLY
    more = [
        inspect.Parameter(name, kind, default=option, annotation=list[str])
        for name, option in options.items()
    ]
    with_options.__signature__ = signature.replace(  # type: ignore[attr-defined]  # typer reads it
        parameters=[*signature.parameters.values(), *more]
    )
    with_options.__annotations__ = {p.name: p.annotation for p in (*signature.parameters.values(), *more)}
    return with_options


def seed_or_default(seed: int | None, mode: str) -> int | None:
    """Return the random seed of a command: the value of the common option `--seed`, or else a default. The
    default is None in `real` mode and 0 in all other modes.
    """
    return 0 if seed is None and mode != "real" else seed
