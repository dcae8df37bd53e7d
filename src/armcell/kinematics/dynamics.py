"""Inverse dynamics: the joint torques that a motion requires, and the torque limits (Numba).

The recursive Newton-Euler algorithm (Luh, Walker and Paul 1980; Featherstone, "Rigid Body Dynamics
Algorithms", chapter 5) with all vectors in root axes. The model has no friction, damping or rotor inertia.
The tests compare the results with pinocchio's rnea.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import float_array
from armcell.kinematics.tree import FIXED, PRISMATIC, forward, kinematic_tree
from armcell.model import Inertial, RobotModel

Array = NDArray[np.float64]

GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2] in the root frame


class RigidBodies(NamedTuple):
    """Links of a robot as rigid bodies, bundled as one argument of the compiled inverse dynamics.

    Python passes it as a plain tuple: Numba takes 2 us longer to find the type of a named tuple.

    Attributes:
        parent, T_parent_joint, kind, axis, column, multiplier, offset: the tree, see `KinematicTree`.
        mass: (links,) [kg].
        center: (links, 3) center of mass [m, link frame].
        inertia: (links, 3, 3) about the center of mass [kg m^2, axes of the link frame].
        gravity: (3,) acceleration [m/s^2, root frame].
    """

    parent: Any
    T_parent_joint: Any
    kind: Any
    axis: Any
    column: Any
    multiplier: Any
    offset: Any
    mass: Any
    center: Any
    inertia: Any
    gravity: Any


@njit(cache=True)
def _cross(a, b, out):
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    out[0], out[1], out[2] = x, y, z


@njit(cache=True)
def newton_euler(bodies, q, dq, ddq, out):
    """Compute the inverse dynamics of a robot: write the joint torques for m states q, dq, ddq (m, dof) to
    `out` (m, dof).

    Args:
        bodies: the fields of `RigidBodies`.
    """
    parent, T_parent_joint, kind, axis, column, multiplier, offset, mass, center, inertia, gravity = bodies
    joints = len(parent)
    links = joints + 1
    Ts = np.empty((links, 4, 4))
    spin, turn, push = np.zeros((links, 3)), np.zeros((links, 3)), np.zeros((links, 3))
    force, moment = np.empty((links, 3)), np.empty((links, 3))
    a, r, c = np.empty(3), np.empty(3), np.empty(3)
    t1, t2 = np.empty(3), np.empty(3)
    for state in range(len(q)):
        forward(parent, T_parent_joint, kind, axis, column, multiplier, offset, q[state], Ts)
        for i in range(3):
            push[0, i] = -gravity[i]  # gravity as an acceleration of the root
        for link in range(links):
            T = Ts[link]
            if link > 0:
                j = link - 1
                p = parent[j]
                for i in range(3):
                    r[i] = T[i, 3] - Ts[p, i, 3]
                    spin[link, i], turn[link, i] = spin[p, i], turn[p, i]
                _cross(turn[p], r, t1)
                _cross(spin[p], r, t2)
                _cross(spin[p], t2, t2)
                for i in range(3):
                    push[link, i] = push[p, i] + t1[i] + t2[i]
                if kind[j] != FIXED:
                    for i in range(3):
                        a[i] = T[i, 0] * axis[j, 0] + T[i, 1] * axis[j, 1] + T[i, 2] * axis[j, 2]
                    v = multiplier[j] * dq[state, column[j]]
                    w = multiplier[j] * ddq[state, column[j]]
                    _cross(spin[p], a, t1)
                    for i in range(3):
                        if kind[j] == PRISMATIC:
                            push[link, i] += w * a[i] + 2.0 * v * t1[i]
                        else:
                            spin[link, i] += v * a[i]
                            turn[link, i] += w * a[i] + v * t1[i]
            # Force on the center of mass, moment about the link's origin.
            for i in range(3):
                force[link, i] = moment[link, i] = 0.0
            if mass[link] == 0.0 and np.all(inertia[link] == 0.0):
                continue
            for i in range(3):
                c[i] = T[i, 0] * center[link, 0] + T[i, 1] * center[link, 1] + T[i, 2] * center[link, 2]
            _cross(turn[link], c, t1)
            _cross(spin[link], c, t2)
            _cross(spin[link], t2, t2)
            for i in range(3):
                force[link, i] = mass[link] * (push[link, i] + t1[i] + t2[i])
            for i in range(3):  # angular velocity and acceleration in the link's axes
                t1[i] = T[0, i] * spin[link, 0] + T[1, i] * spin[link, 1] + T[2, i] * spin[link, 2]
                t2[i] = T[0, i] * turn[link, 0] + T[1, i] * turn[link, 1] + T[2, i] * turn[link, 2]
            I = inertia[link]
            for i in range(3):
                a[i] = I[i, 0] * t1[0] + I[i, 1] * t1[1] + I[i, 2] * t1[2]
                r[i] = I[i, 0] * t2[0] + I[i, 1] * t2[1] + I[i, 2] * t2[2]
            _cross(t1, a, t1)
            _cross(c, force[link], t2)
            for i in range(3):
                moment[link, i] = t2[i]
                for k in range(3):
                    moment[link, i] += T[i, k] * (r[k] + t1[k])
        for i in range(out.shape[1]):
            out[state, i] = 0.0
        for j in range(joints - 1, -1, -1):
            link, p = j + 1, parent[j]
            T = Ts[link]
            if kind[j] != FIXED:
                along = force[link] if kind[j] == PRISMATIC else moment[link]
                for i in range(3):
                    a[i] = T[i, 0] * axis[j, 0] + T[i, 1] * axis[j, 1] + T[i, 2] * axis[j, 2]
                out[state, column[j]] += multiplier[j] * (a[0] * along[0] + a[1] * along[1] + a[2] * along[2])
            for i in range(3):
                r[i] = T[i, 3] - Ts[p, i, 3]
            _cross(r, force[link], t1)
            for i in range(3):
                force[p, i] += force[link, i]
                moment[p, i] += moment[link, i] + t1[i]


class InverseDynamics:
    """Inverse dynamics for some joints of a robot, while its other joints rest at given positions.

    Args:
        joint_names: joints that move; all actuated joints by default.
        positions: positions (dof,) of all joints, used for resting joints; by default the model's default
            positions.
        payloads: loads on links besides the links' own mass: (link name, inertial in the link's frame).
        gravity: acceleration (3,) [m/s^2] in the root frame.
    Raises:
        UnknownNameError: a joint or link does not exist.
        InputError: no link that the joints move has a mass, or a payload's mass is not positive.
    """

    def __init__(
        self,
        model: RobotModel,
        joint_names: tuple[str, ...] | None = None,
        positions: ArrayLike | None = None,
        payloads: Iterable[tuple[str, Inertial]] = (),
        gravity: ArrayLike = GRAVITY,
    ):
        self.model = model
        self.joint_names = model.joint_names if joint_names is None else tuple(joint_names)
        self.columns = model.columns(self.joint_names)
        at = model.default_positions() if positions is None else model.check_positions(positions, margin=1e-3)
        self.positions = np.array(at, dtype=float)
        self.gravity = np.array(float_array(gravity, (3,), "gravity"))
        tree = kinematic_tree(model)
        links = len(tree.link_names)
        self.mass, self.center = np.zeros(links), np.zeros((links, 3))
        self.inertia = np.zeros((links, 3, 3))
        for i, name in enumerate(tree.link_names):
            inertial = model.links[name].inertial
            if inertial is not None:
                self._add(i, inertial)
        for name, inertial in payloads:
            if name not in tree.link_index:
                raise UnknownNameError("link", name, tree.link_index)
            if not (np.isfinite(inertial.mass) and inertial.mass > 0.0):
                raise InputError(f"mass of the payload on {name!r} is {inertial.mass:g} kg, not positive")
            self._add(tree.link_index[name], inertial)
        moved = set().union(*(model.subtree(model.joint(n).child) for n in self.joint_names))
        if not any(self.mass[tree.link_index[name]] > 0.0 for name in moved):
            raise InputError(
                f"no link that {', '.join(self.joint_names)} move has a mass",
                hint="torque limits need <inertial> elements in the URDF",
            )
        self._bodies = tuple(RigidBodies(
            tree.parent, tree.T_parent_joint, tree.kind, tree.axis, tree.column, tree.multiplier, tree.offset,
            self.mass, self.center, self.inertia, self.gravity,
        ))  # fmt: skip

    def _add(self, link: int, inertial: Inertial) -> None:
        """Add the mass and inertia of a body to a link, for inverse dynamics. The sum of the inertias refers
        to the common center of mass.
        """
        R = inertial.T_link_com.rotation.matrix
        m0, m1, c0, c1 = self.mass[link], inertial.mass, self.center[link], inertial.T_link_com.translation
        mass = m0 + m1
        # A link without mass may still have a moment of inertia in its URDF; pinocchio includes it too.
        center = (m0 * c0 + m1 * c1) / mass if mass > 0.0 else c1
        total = np.zeros((3, 3))
        for m, c, I in ((m0, c0, self.inertia[link]), (m1, c1, R @ inertial.inertia @ R.T)):
            d = c - center
            total += I + m * ((d @ d) * np.eye(3) - np.outer(d, d))
        self.mass[link], self.center[link], self.inertia[link] = mass, center, total

    def torques(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Compute the joint torques (m, n) [Nm or N] for given positions, velocities and accelerations by
        inverse dynamics.
        """
        at, speed, gain = self._whole(q, self.positions), self._whole(dq, 0.0), self._whole(ddq, 0.0)
        out = np.empty_like(at)
        newton_euler(self._bodies, at, speed, gain, out)
        return out[:, self.columns]

    def _whole(self, values: ArrayLike, others: float | Array) -> Array:
        """Expand values (m, n) for the moving joints to all joints of the robot (m, dof), as inverse dynamics
        requires.
        """
        values = np.atleast_2d(float_array(values, None, "joint values"))
        if values.shape[1:] != (len(self.columns),):
            raise InputError(f"joint values must have shape (m, {len(self.columns)}), not {values.shape}")
        whole = np.zeros((len(values), self.model.dof)) + others
        whole[:, self.columns] = values
        return whole

    @property
    def limits(self) -> Array:
        """Torque limits (n,) [Nm or N] from the URDF, for joints whose torque inverse dynamics computes."""
        return self.model.limits(self.joint_names, "effort")

    def torque_coefficients(self, positions: Array, first: Array, second: Array) -> Array:
        """Compute the joint torques along a path by inverse dynamics, as the coefficients of
        `tau = a u + b x + c`, with path acceleration u and squared path speed x.

        Args:
            positions, first, second: points of the path and its derivatives (m, n).
        Returns:
            a, b, c: (m, 3, n).
        """
        still = np.zeros_like(float_array(first, None, "first"))
        c = self.torques(positions, still, still)
        a = self.torques(positions, still, first) - c
        b = self.torques(positions, first, second) - c
        return np.stack([a, b, c], axis=1)
