"""Flange load estimation: the mass that explains the motor currents of all joints best.

Least squares on the dynamics, which are linear in the mass (Atkeson, An and Hollerbach, "Estimation of
inertial parameters of manipulator loads and links", 1986). Using all joints together reveals a load that no
single joint's band reveals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, JointTrajectory
from armcell.kinematics import InverseDynamics
from armcell.model import Inertial, RobotModel

Array = NDArray[np.float64]

UNTOLD = 1.0  # [kg] prior standard deviation of a mass: keeps poorly observable masses near 0


@dataclass(frozen=True, eq=False)
class LoadEfforts:
    """Joint efforts from which the load on the flange is estimated: efforts per kilogram of load, and efforts
    that accelerate the arm without a load.
    """

    weight: Array  # (k, n) [Nm/kg] gravity torque of a mass at the flange
    inertia: Array  # (k, n) [Nm/kg] torque to accelerate the mass at full speed
    swing: Array  # (k, n) [Nm] torque to accelerate the arm itself at full speed


def load_efforts(model: RobotModel, trajectory: JointTrajectory, times: Array) -> LoadEfforts:
    """Compute the joint efforts from which the flange load is estimated, at times (k,) [s] of a trajectory.
    The result contains efforts per kilogram of load and efforts that accelerate the arm without a load.

    The load is a point mass at the origin of each arm's last link. `swing` excludes held objects.
    """
    names = trajectory.joint_names
    children = [model.joint(name).child for name in names]
    last = [link for link in children if not set(model.subtree(link)[1:]) & set(children)]
    rows = [trajectory.sample(t) for t in times]
    q, v, a = (np.array(column) for column in zip(*rows))
    still = np.zeros_like(q)
    rest, moving = [], []
    for mass in (1.0, 2.0):  # torques are linear in it; 0 would fail for a robot without masses
        loads = [(link, Inertial(mass, SE3.identity(), np.zeros((3, 3)))) for link in last]
        dynamics = InverseDynamics(model, names, payloads=loads)
        rest.append(dynamics.torques(q, still, still))
        moving.append(dynamics.torques(q, v, a))
    weight, inertia = rest[1] - rest[0], moving[1] - moving[0] - (rest[1] - rest[0])
    return LoadEfforts(weight, inertia, moving[0] - rest[0] - inertia)


def estimate_load(wrong: Array, kilo: Array, spread: Array) -> float:
    """Estimate the load on the flange: return the additional mass [kg] that best explains the measured motor
    currents.

    The result is the expected value under a zero-mean normal prior with standard deviation `UNTOLD`.

    Args:
        wrong: measured minus expected currents of m samples (m, n) [A].
        kilo: current per kilogram of load (m, n) [A/kg].
        spread: standard deviation of `wrong` in fault-free motions (n,) [A]. Errors of successive samples are
            correlated, so all samples together weigh as one.
    """
    seen, sure = np.mean(wrong * kilo / spread**2, axis=0).sum(), np.mean((kilo / spread) ** 2, axis=0).sum()
    return float(seen / (sure + 1.0 / UNTOLD**2))
