"""Validation of the cell file (cell.yaml); error messages name the file and the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from armcell.cell.schema import (
    CameraSpec,
    CellSpec,
    ControllerSpec,
    DisplacementSpec,
    DisturbanceSpec,
    DropSpec,
    FrictionSpec,
    MarkerSpec,
    ObjectSpec,
    PerceptionSpec,
    PlaceSpec,
    PushSpec,
    RandomSpec,
    RobotSpec,
    RosSpec,
    ShapeSpec,
    StepSpec,
)
from armcell.core import InputError, UnknownNameError


def validated(data: dict[str, Any], file: Path) -> CellSpec:
    """Validate a parsed cell file against the schema and return the cell's specification.

    Raises:
        InputError: the file is invalid; the error has the file, the key and the reason of the first fault.
    """
    try:
        return CellSpec.model_validate(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        # report a mistyped key first: it often causes the other errors
        first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
        parts = [str(part) for part in first["loc"]]
        place = "/".join(part for part in parts if not part.startswith("<")) or "top level"  # tags of unions
        if first["type"] == "extra_forbidden":
            known = _known_keys(first["loc"])
            if known:
                raise UnknownNameError("key", first["loc"][-1], known, file=file, element=place) from None
        more = len(errors) - 1
        reason = first["msg"].removeprefix("Value error, ") + (f" (and {more} more)" if more else "")
        hint = f"{first['input']} is not a finite number" if first["type"] == "finite_number" else None
        raise InputError(reason, file=file, element=place, hint=hint) from None


def _known_keys(location: tuple) -> list[str]:
    """Return the keys that the schema allows at the place in a cell file where an unknown key was found."""
    tables = {
        "randomize": RandomSpec,
        "cameras": CameraSpec,
        "markers": MarkerSpec,
        "controllers": ControllerSpec,
        "robot": RobotSpec,
        "ros": RosSpec,
        "task": StepSpec,
    }
    if len(location) == 1:
        return list(CellSpec.model_fields)
    if "<both>" in location:
        return list(FrictionSpec.model_fields)
    if "shapes" in location:
        return ShapeSpec.known_keys()
    if location[0] == "perception":
        return list(PerceptionSpec.model_fields)
    if location[0] == "drop":
        return list(DropSpec.model_fields)
    if location[0] == "disturbances":
        block = {"pushes": PushSpec, "moved": DisplacementSpec}.get(str(location[1]), DisturbanceSpec)
        return list(block.model_fields)
    if "place" in location:
        return list(PlaceSpec.model_fields)
    if location[0] == "objects":
        return ObjectSpec.known_keys()
    model = tables.get(str(location[0]))
    return list(model.model_fields) if model else []
