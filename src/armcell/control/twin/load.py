"""What a mass on the flange adds to the joints' efforts; which mass, told by nobody, explains the currents.

Least squares on the dynamics, which are linear in a mass (Atkeson, An and Hollerbach, "Estimation of inertial
parameters of manipulator loads and links", 1986): all joints together tell what no joint's band alone does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, JointTrajectory
from armcell.kinematics import InverseDynamics
from armcell.model import Inertial, RobotModel

Array = NDArray[np.float64]

UNTOLD = 1.0  # [kg] of masses, standard deviation: where an arm hardly feels one, none is claimed


@dataclass(frozen=True, eq=False)
class Demand:
    """Efforts along a motion by rigid-body dynamics: those of one kilogram, and of acceleration."""

    weight: Array  # (k, n) [Nm/kg] gravity of a mass at the flange
    inertia: Array  # (k, n) [Nm/kg] what its acceleration takes at full speed
    swing: Array  # (k, n) [Nm] what the arm's own acceleration takes at full speed


def demand(model: RobotModel, trajectory: JointTrajectory, times: Array) -> Demand:
    """Of a trajectory at some times (k,) [s]. The mass is a point at the origin of each arm's last link.

    What is held is not in `swing`.
    """
    names = trajectory.joint_names
    children = [model.joint(name).child for name in names]
    last = [link for link in children if not set(model.subtree(link)[1:]) & set(children)]
    rows = [trajectory.sample(t) for t in times]
    q, v, a = (np.array(column) for column in zip(*rows))
    still = np.zeros_like(q)
    rest, moving = [], []
    for mass in (1.0, 2.0):  # torques are linear in it; with none, a robot without masses has no dynamics
        loads = [(link, Inertial(mass, SE3.identity(), np.zeros((3, 3)))) for link in last]
        dynamics = InverseDynamics(model, names, payloads=loads)
        rest.append(dynamics.torques(q, still, still))
        moving.append(dynamics.torques(q, v, a))
    weight, inertia = rest[1] - rest[0], moving[1] - moving[0] - (rest[1] - rest[0])
    return Demand(weight, inertia, moving[0] - rest[0] - inertia)


def explaining(wrong: Array, kilo: Array, spread: Array) -> float:
    """Mass [kg] that explains currents best; its expected value if it was drawn with `UNTOLD`.

    Args:
        wrong: measured less expected currents of some looks (m, n) [A].
        kilo: what one kilogram adds to them (m, n) [A/kg].
        spread: of `wrong` in clean motions (n,) [A]. That errors of neighbouring looks are alike counts: the
            looks weigh as one.
    """
    seen, sure = np.mean(wrong * kilo / spread**2, axis=0).sum(), np.mean((kilo / spread) ** 2, axis=0).sum()
    return float(seen / (sure + 1.0 / UNTOLD**2))
