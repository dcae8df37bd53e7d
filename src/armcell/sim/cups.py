"""Suction cups in a MuJoCo model: a ring of small spheres and an adhesion actuator for each cup."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.model import RobotModel, SuctionCup, SuctionGripper
from armcell.model.grippers import RING_THICKNESS

Array = NDArray[np.float64]

RING = 8  # spheres per cup
BEAD = RING_THICKNESS  # [m] radius of the spheres


@dataclass(frozen=True, eq=False)
class CupIndex:
    """Indices of one suction cup in a MuJoCo model built from a scene."""

    cup: SuctionCup
    gripper: str
    body: int
    ctrl: int
    owner: int  # index of the cup's link among the owners


def add_cups(spec: mujoco.MjSpec, bodies: dict[str, Any], model: RobotModel, gripper: SuctionGripper) -> None:
    """Add the suction cups of a gripper to a MuJoCo spec: a ring of spheres and a vacuum actuator for each
    cup.

    Collision shapes that include a cup's flexible lip lose their contacts.
    """
    for k, cup in enumerate(gripper.cups):
        _soften(bodies[cup.link], model, cup)
        T, name = cup.T_link_cup, cup_name(gripper.name, k)
        body = bodies[cup.link].add_body(name=name, pos=T.translation, quat=T.quat_wxyz)
        body.explicitinertial = True
        for i, (x, y) in enumerate(ring_points(cup, RING)):
            body.add_geom(
                name=f"{name}:{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BEAD, 0, 0],
                pos=[x, y, -BEAD], gap=cup.stroke, density=0.0, group=4,
            )  # fmt: skip
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_BODY)
        actuator.set_to_adhesion(gain=gripper.force(cup))
        actuator.ctrllimited, actuator.ctrlrange = True, [0.0, 1.0]


def _soften(body: Any, model: RobotModel, cup: SuctionCup) -> None:
    """Disable the contacts of each geom that includes the lip of a suction cup. If the body comes from an
    MJCF file, disable the contacts of all its geoms.
    """
    solids = model.links[cup.link].collisions
    soft = [i for i, c in enumerate(solids) if cup.lip_reaches(c.shape, c.T_link_shape)]
    names = tuple(f"{cup.link}:{i}" for i in soft)
    own = any(cup.link in part.links for part in model.mjcf)
    for geom in body.geoms:
        if soft and (own or geom.name in names or geom.name.startswith(tuple(f"{n}." for n in names))):
            geom.contype = geom.conaffinity = 0


def ring_points(cup: SuctionCup, count: int) -> Array:
    """Return points (count, 2) [m] on the rim of a suction cup, in the cup's frame, for the ring of spheres
    that models the cup in MuJoCo.
    """
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return cup.radius * np.column_stack([np.cos(angle), np.sin(angle)])


def cup_name(gripper: str, number: int) -> str:
    return f"{gripper}:cup{number}"


def index_cups(mj: mujoco.MjModel, model: RobotModel, owners: dict[str, int]) -> tuple[CupIndex, ...]:
    return tuple(
        CupIndex(
            cup, gripper.name, mj.body(name := cup_name(gripper.name, k)).id,
            int(mj.actuator_ctrladr[mj.actuator(name).id]), owners[cup.link],
        )
        for gripper in model.grippers.values()
        if isinstance(gripper, SuctionGripper)
        for k, cup in enumerate(gripper.cups)
    )  # fmt: skip
