"""Geometry of a hand for gripper recognition: surface points of its links at any driven position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Mesh
from armcell.core.geometry import local_bounds
from armcell.model.robot import Joint, Link, RobotModel
from armcell.model.setup.arm_detection import common_link

F64 = NDArray[np.float64]
SPACING = 0.002  # [m] of the grid on which the jaws' facing surfaces are compared


def surface_points(link: Link, spacing: float) -> F64:
    """Sample points (n, 3) [m] on the collision shapes of a hand's link, to measure the hand geometry: about
    three points per square of side `spacing` [m]. A bounding box replaces each shape that is not a mesh.
    """
    found = [np.zeros((0, 3))]
    for collision in link.collisions:
        shape = collision.shape
        if isinstance(shape, Mesh):
            corners = np.asarray(shape.vertices, dtype=float)[np.asarray(shape.faces)]
        else:
            center, half = local_bounds(shape)
            corners = _box(center, half)
        found.append(collision.T_link_shape.apply(_spread(corners, spacing)))
    return np.concatenate(found)


def _spread(corners: F64, spacing: float) -> F64:
    """Sample points on the geometry of a hand's link, given as triangles (n, 3, 3): all corners, and random
    points in large triangles.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    count = np.minimum(np.ceil(3 * area / spacing**2), 3000).astype(int)
    which = np.repeat(np.arange(len(corners)), count)
    u, v = np.random.default_rng(0).random((2, len(which)))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    inner = a[which] + u[:, None] * (b - a)[which] + v[:, None] * (c - a)[which]
    return np.concatenate([corners.reshape(-1, 3), inner])


def _box(center: F64, half: F64) -> F64:
    """Return the triangles (12, 3, 3) of a box that replaces a shape in the geometry of a hand."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    v = np.asarray(center) + signs * np.asarray(half)
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return np.array([v[list(t)] for q in quads for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])


class GripperNotRecognizedError(Exception):
    """Error for a hand that robot setup cannot recognize as a gripper, for example because of its geometry.
    The text states the reason.

    `hint` states the remedy, if there is one.
    """

    def __init__(self, reason: str, hint: str = ""):
        super().__init__(reason)
        self.hint = hint


class HandGeometry:
    """Geometry of a robot hand, from which robot setup decides whether the hand is a two-jaw gripper.

    The class samples points on the surfaces of the hand's links. It computes where these points are at any
    position of the driven joint.

    Attributes:
        palm: link that carries the moving joints.
        moving: joints that the driven joint moves.
        rigid: links below the palm that are fixed to each other, by link.
    """

    def __init__(self, model: RobotModel, driver: Joint):
        self.model, self.driver = model, driver
        self.moving = [
            j for j in model.joints.values() if j.movable and model.coupling(j.name)[0] == driver.name
        ]
        self.palm = common_link(model, [j.parent for j in self.moving])
        below = model.subtree(self.palm)  # the arm's last link may be fixed to the palm, but is above it
        sets = [tuple(n for n in below if n in links) for links in model.rigid_groups]
        self.rigid = {link: links for links in sets for link in links}
        self.points = {name: surface_points(model.links[name], SPACING) for name in below}

    def pose(self, link: str, q: float) -> SE3:
        """Return T_palm_link, the pose of a link in the geometry of a hand, relative to the palm.

        The driven joint is at `q`. Joints that mimic it follow, and all other joints are at zero.
        """
        T = SE3.identity()
        for joint in self.model.chain(self.palm, link):
            T = T @ joint.T_parent_joint @ _motion(joint, _value(self.model, joint, self.driver.name, q))
        return T

    def at(self, links: tuple[str, ...], q: float) -> F64:
        """Return points (n, 3) [m] on the surfaces of a hand's links, in the frame of the palm. The driven
        joint of the hand is at `q`.
        """
        parts = [self.pose(n, q).apply(p) for n in links if len(p := self.points.get(n, np.zeros((0, 3))))]
        return np.concatenate(parts) if parts else np.zeros((0, 3))

    def branch(self, part: tuple[str, ...]) -> str:
        """Return the first movable joint on the path from the palm of a hand, or from a slider that carries
        all fingers, to the given links.
        """
        top = min(part, key=lambda n: len(self.model.chain(self.palm, n)))
        root = common_link(self.model, [j.child for j in self.moving])
        return next((j.name for j in self.model.chain(root, top) if j.movable), "")

    def last_axis(self) -> F64 | None:
        """Return the axis of the last arm joint above a hand, in the frame of the hand's palm. It is None if
        there is no arm.
        """
        link = self.palm
        while (joint := self.model.parent_joint.get(link)) is not None and not joint.movable:
            link = joint.parent
        if joint is None:
            return None
        T_joint_palm = self.model.pose_at_zero(joint.child, self.palm)
        return T_joint_palm.rotation.matrix.T @ np.asarray(joint.axis)

    def arm_joints(self) -> int:
        """Return the number of movable joints in the arm that carries the hand, from the robot's root link to
        the palm.
        """
        return sum(j.movable for j in self.model.chain(self.model.root_link, self.palm))

    def gap(self, a: tuple[str, ...], b: tuple[str, ...], axes: F64, q: float) -> tuple[float, F64, F64, F64]:
        """Measure the gap [m] between two jaws in the geometry of a hand: compare the points on the jaws'
        facing surfaces, on a grid in x and z.

        Returns:
            The smallest gap [m] (infinite if the jaws face each other nowhere), and the cells (n, 2), the
            inner y of the plus jaw and of the minus jaw in the cells [m].
        """
        jaws = [self.at(part, q) @ axes.T for part in (a, b)]
        if not all(map(len, jaws)):
            return np.inf, np.zeros((0, 2)), np.zeros(0), np.zeros(0)
        cells = [np.round(points[:, [0, 2]] / SPACING).astype(int) for points in jaws]
        low = np.minimum(*(c.min(axis=0) for c in cells))
        shape = np.maximum(*(c.max(axis=0) for c in cells)) - low + 1
        inner = np.full((2, *shape), np.inf)
        for k, sign in enumerate((1.0, -1.0)):
            np.minimum.at(inner[k], tuple((cells[k] - low).T), sign * jaws[k][:, 1])
        common = np.argwhere(np.isfinite(inner).all(axis=0))
        plus, minus = inner[0][tuple(common.T)], -inner[1][tuple(common.T)]
        return float((plus - minus).min(initial=np.inf)), SPACING * (common + low), plus, minus

    def hand_links(self) -> tuple[str, ...]:
        below = [n for n in self.model.subtree(self.palm) if self.model.links[n].collisions]
        return tuple(dict.fromkeys([self.palm, *below]))


def _value(model: RobotModel, joint: Joint, driver: str, q: float) -> float:
    """Return the position of a joint in the geometry of a hand when the driving joint is at `q` and all other
    joints are at zero.
    """
    driven, multiplier, offset = model.coupling(joint.name)
    return (multiplier * q if driven == driver else 0.0) + offset


def _motion(joint: Joint, value: float) -> SE3:
    axis = np.asarray(joint.axis)
    if not joint.movable:
        return SE3.identity()
    if joint.type == "prismatic":
        return SE3.from_xyz(*(value * axis))
    return SE3(SO3.exp(value * axis), np.zeros(3))
