"""Conversion of the block `disturbances` of a cell file to SI units, with checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armcell.cell.schema import CellSpec
from armcell.core import InputError, UnknownNameError
from armcell.drivers.disturbances import Displacement, Disturbances, Push
from armcell.model import RobotModel


def disturbances_of(spec: CellSpec, model: RobotModel, file: Path) -> Disturbances:
    """Return the disturbances of the simulated robot that a cell file defines, in SI units.

    Raises:
        UnknownNameError: a joint, link or object does not exist.
        InputError: a pushed object is fixed, or a moved object is screwed into another object.
    """
    given = spec.disturbances
    fingers = {name for g in model.grippers.values() for name in g.joint_names}
    turning = [n for n in model.joint_names if n not in fingers and model.joints[n].type != "prismatic"]
    for name in given.joint_offset_deg:
        if name not in turning:
            place = "disturbances/joint_offset_deg"
            raise UnknownNameError("turning joint of an arm", name, turning, file=file, element=place)
    movable = [name for name, item in spec.objects.items() if item.movable]
    for name, push in given.pushes.items():
        if push.on in model.links or push.on in movable:
            continue
        place = f"disturbances/pushes/{name}"
        if push.on in spec.objects:
            raise InputError(
                f"the object {push.on!r} is fixed", file=file, element=place, hint="give it 'movable: true'"
            )
        raise UnknownNameError("link or object", push.on, [*model.links, *movable], file=file, element=place)
    for name in given.moved:
        place = f"disturbances/moved/{name}"
        if name not in spec.objects:
            raise UnknownNameError("object", name, spec.objects, file=file, element=place)
        if (thread := spec.objects[name].thread) is not None:
            reason, hint = f"the object is screwed into {thread.into!r}", "move that, or push this"
            raise InputError(reason, file=file, element=place, hint=hint)
    return Disturbances(
        {name: float(np.deg2rad(value)) for name, value in given.joint_offset_deg.items()},
        float(np.deg2rad(given.joint_noise_deg)),
        given.latency,
        tuple(Push(push.on, push.at, push.duration, push.force) for push in given.pushes.values()),
        tuple(Displacement(n, m.at, m.by, float(np.deg2rad(m.turn_deg))) for n, m in given.moved.items()),
    )
