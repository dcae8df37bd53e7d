"""Forward kinematics and Jacobians of a robot's whole kinematic tree on flat arrays (Numba)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3, InputError, UnknownNameError
from armcell.core.checks import float_array
from armcell.core.joints import all_finite
from armcell.model import RobotModel

Array = NDArray[np.float64]

ORIGIN = (0.0, 0.0, 0.0)
FIXED, REVOLUTE, PRISMATIC = 0, 1, 2
_KINDS = {"fixed": FIXED, "revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}


@njit(cache=True)
def forward(parent, T_parent_joint, kind, axis, column, multiplier, offset, q, out):
    """Compute forward kinematics: write the poses T_root_link of all links of a kinematic tree at q to `out`
    (links, 4, 4).

    Link 0 is the root, link i+1 the child of joint i.
    """
    for i in range(4):
        for j in range(4):
            out[0, i, j] = 1.0 if i == j else 0.0
    for joint in range(len(parent)):
        P = out[parent[joint]]
        F = T_parent_joint[joint]
        A = np.empty((3, 4))  # P @ F, the joint frame
        for i in range(3):
            for j in range(4):
                A[i, j] = P[i, 0] * F[0, j] + P[i, 1] * F[1, j] + P[i, 2] * F[2, j]
            A[i, 3] += P[i, 3]
        T = out[joint + 1]
        T[3, 0] = T[3, 1] = T[3, 2] = 0.0
        T[3, 3] = 1.0
        if kind[joint] == FIXED:
            for i in range(3):
                for j in range(4):
                    T[i, j] = A[i, j]
            continue
        value = multiplier[joint] * q[column[joint]] + offset[joint]
        x, y, z = axis[joint]
        if kind[joint] == PRISMATIC:
            for i in range(3):
                for j in range(3):
                    T[i, j] = A[i, j]
                T[i, 3] = A[i, 3] + value * (A[i, 0] * x + A[i, 1] * y + A[i, 2] * z)
            continue
        c, s = np.cos(value), np.sin(value)
        v = 1.0 - c  # Rodrigues
        r00, r01, r02 = c + x * x * v, x * y * v - z * s, x * z * v + y * s
        r10, r11, r12 = y * x * v + z * s, c + y * y * v, y * z * v - x * s
        r20, r21, r22 = z * x * v - y * s, z * y * v + x * s, c + z * z * v
        for i in range(3):
            a0, a1, a2 = A[i, 0], A[i, 1], A[i, 2]
            T[i, 0] = a0 * r00 + a1 * r10 + a2 * r20
            T[i, 1] = a0 * r01 + a1 * r11 + a2 * r21
            T[i, 2] = a0 * r02 + a1 * r12 + a2 * r22
            T[i, 3] = A[i, 3]


@njit(cache=True)
def chain_jacobian(Ts, point, joints, kind, axis, column, multiplier, group_column, out):
    """Compute the Jacobian of a point in a kinematic tree, and write it to `out` (6, n), one column per joint
    of the group.

    Rows: velocity of `point` (3,) [root frame], then angular velocity.
    """
    out[:] = 0.0
    for k in range(len(joints)):
        joint = joints[k]
        if kind[joint] == FIXED:
            continue
        target = group_column[column[joint]]
        if target < 0:
            continue
        T = Ts[joint + 1]
        ax, ay, az = axis[joint]
        m = multiplier[joint]
        wx = (T[0, 0] * ax + T[0, 1] * ay + T[0, 2] * az) * m
        wy = (T[1, 0] * ax + T[1, 1] * ay + T[1, 2] * az) * m
        wz = (T[2, 0] * ax + T[2, 1] * ay + T[2, 2] * az) * m
        if kind[joint] == PRISMATIC:
            out[0, target] += wx
            out[1, target] += wy
            out[2, target] += wz
        else:
            dx, dy, dz = point[0] - T[0, 3], point[1] - T[1, 3], point[2] - T[2, 3]
            out[0, target] += wy * dz - wz * dy
            out[1, target] += wz * dx - wx * dz
            out[2, target] += wx * dy - wy * dx
            out[3, target] += wx
            out[4, target] += wy
            out[5, target] += wz


class KinematicTree:
    """Kinematic tree of a robot model, stored as flat arrays for compiled functions.

    `kinematic_tree(model)` returns the one tree of a model.
    """

    def __init__(self, model: RobotModel):
        self.model = model
        joints = list(model.joints.values())
        self.link_names = (model.root_link, *(j.child for j in joints))
        self.link_index = {name: i for i, name in enumerate(self.link_names)}
        at = {name: i for i, name in enumerate(model.joint_names)}
        n = len(joints)
        self.parent = np.array([self.link_index[j.parent] for j in joints], dtype=np.int64)
        self.T_parent_joint = np.array([j.T_parent_joint.matrix for j in joints]).reshape(n, 4, 4)
        self.kind = np.array([_KINDS[j.type] for j in joints], dtype=np.int64)
        self.axis = np.array([j.axis for j in joints], dtype=float).reshape(n, 3)
        self.column = np.zeros(n, dtype=np.int64)
        self.multiplier = np.ones(n)
        self.offset = np.zeros(n)
        for i, joint in enumerate(joints):
            if joint.movable:
                driven, self.multiplier[i], self.offset[i] = model.coupling(joint.name)
                self.column[i] = at[driven]
        self.joint_index = {j.name: i for i, j in enumerate(joints)}
        self._paths: dict[str, NDArray[np.int64]] = {}
        self._group_columns: dict[tuple[str, ...], NDArray[np.int64]] = {}

    def link_transforms(self, q: ArrayLike) -> Array:
        """Return the poses T_root_link (links, 4, 4) of all links of a kinematic tree at joint positions q
        (dof,), in the order of `link_names`.
        """
        return self._forward(self.parent, q)

    def joint_transforms(self, q: ArrayLike) -> Array:
        """Return the pose of each joint's child link relative to its parent link in a kinematic tree, as
        matrices T_parent_child (joints, 4, 4), at joint positions q (dof,).
        """
        return self._forward(np.zeros_like(self.parent), q)[1:]

    def _forward(self, parent: NDArray[np.int64], q: ArrayLike) -> Array:
        """Compute the forward kinematics of a kinematic tree: return the poses (links, 4, 4) of all links,
        where parent[i] is the parent link of link i + 1.
        """
        out = np.empty((len(self.link_names), 4, 4))
        q = np.ascontiguousarray(float_array(q, (self.model.dof,), "positions", finite=False))
        forward(
            parent, self.T_parent_joint, self.kind, self.axis, self.column, self.multiplier, self.offset, q,
            out,
        )  # fmt: skip
        return out

    def full_positions(self, q: ArrayLike) -> dict[str, float]:
        """Return the positions of all movable joints of a kinematic tree by name, including mimic joints, for
        joint positions q (dof,).
        """
        q = float_array(q, (self.model.dof,), "positions")
        return {
            name: float(self.multiplier[i] * q[self.column[i]] + self.offset[i])
            for name, i in self.joint_index.items()
            if self.kind[i] != FIXED
        }

    def link_pose(self, q: ArrayLike, link: str) -> SE3:
        """Return the pose T_root_link of one link of a kinematic tree at joint positions q (dof,).

        Raises:
            UnknownNameError: no such link.
            InputError: positions that are not finite.
        """
        return self.link_poses(q, (link,))[0]

    def link_poses(self, q: ArrayLike, links: Sequence[str]) -> list[SE3]:
        """Return the poses T_root_link of several links of a kinematic tree, computed in one pass of forward
        kinematics.
        """
        for link in links:
            if link not in self.link_index:
                raise UnknownNameError("link", link, self.link_index)
        Ts, poses = self.link_transforms(q), []
        for link in links:
            T = Ts[self.link_index[link]]
            if not all_finite(T.ravel()):
                raise InputError(f"positions {np.asarray(q).tolist()} give {link!r} no pose")
            poses.append(SE3(SO3(T[:3, :3].copy()), T[:3, 3].copy()))
        return poses

    def path_to(self, link: str) -> NDArray[np.int64]:
        """Return the indices of the joints between the root of a kinematic tree and a link, beginning at the
        root.
        """
        if link not in self.link_index:
            raise UnknownNameError("link", link, self.link_index)
        return self._path_to(link).copy()

    def _path_to(self, link: str) -> NDArray[np.int64]:
        if link not in self._paths:
            found, i = [], self.link_index[link]
            while i > 0:
                found.append(i - 1)
                i = self.parent[i - 1]
            self._paths[link] = np.array(found[::-1], dtype=np.int64)
        return self._paths[link]

    def _group_column(self, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Return the index of each actuated joint of a kinematic tree in `names`, as an array (dof,). The
        index is -1 if `names` does not contain the joint.
        """
        if names not in self._group_columns:
            columns = np.full(self.model.dof, -1, dtype=np.int64)
            columns[self.model.columns(names)] = np.arange(len(names))
            self._group_columns[names] = columns
        return self._group_columns[names]

    def jacobian(
        self,
        q: ArrayLike,
        link: str,
        joint_names: tuple[str, ...] | None = None,
        point: ArrayLike = ORIGIN,
    ) -> Array:
        """Return the Jacobian (6, n) of a point on a link of a kinematic tree, in the root frame.

        Rows: linear velocity, then angular velocity.

        Args:
            q: positions (dof,).
            joint_names: joints of the columns; all actuated joints by default.
            point: (3,) [m] in the link's frame.
        """
        self.model.link(link)
        names = self.model.joint_names if joint_names is None else tuple(joint_names)
        group_column = self._group_column(names)
        Ts = self.link_transforms(q)
        T = Ts[self.link_index[link]]
        out = np.empty((6, len(names)))
        at = T[:3, 3] + 0.0
        if point is not ORIGIN:
            at += T[:3, :3] @ float_array(point, (3,), "a point")
        chain_jacobian(
            Ts, at, self._path_to(link), self.kind, self.axis, self.column, self.multiplier,
            group_column, out,
        )  # fmt: skip
        return out


@lru_cache(maxsize=64)
def kinematic_tree(model: RobotModel) -> KinematicTree:
    """Return the kinematic tree of a robot model. The tree of each model is built only once.

    Models are frozen and hash by identity.
    """
    return KinematicTree(model)
