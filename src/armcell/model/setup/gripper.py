"""Detection of grippers with two jaws: derives robot.yaml's gripper parameters from joints and meshes.

The jaws may slide, move on a coupled linkage (Robotiq, xArm), or be one moving and one fixed jaw. The closing
direction follows from the jaws' motion, the pads from the surfaces that face each other when the gripper is
closed, and the opening from the pads' distance at every position of the driven joint.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3
from armcell.model.robot import EndEffector, Gripper, Joint, Link, RobotModel
from armcell.model.setup.surface_points import surface_points

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

STEPS = 33  # positions of the driven joint at which the opening is measured
SPACING = 0.002  # [m] of the grid on which the jaws' facing surfaces are compared
FLAT = 0.0015  # [m] depth of the surface that counts as a pad, behind its foremost point
LONGEST_PAD = 0.024  # [m] of a longer pad, the outer end is used
STRAIGHT = 0.99  # cosine between the closing direction and the y axis of an existing tool frame
SNAP = 0.9986  # cosine of 3 degrees: directions nearer to an axis of the palm's frame are that axis
NEAR_ROLL = np.cos(np.deg2rad(20))  # largest angle between a single jaw's pad and the last joint's axis
CENTERED = 2e-4  # [m] a grip center that moves less is fixed
LINEAR = 2e-4  # [m] an opening that deviates less from a straight line is one
WIDEST_TURN = np.deg2rad(40)  # a jaw that turns farther does not hold an object between its pads
PALM_MARGIN = 0.005  # [m] minimum distance of a grasped object from the palm
FORCES = (1.0, 300.0)  # [N] per finger; other values of a description are not a gripper's


class NotRecognized(Exception):
    """Error for a gripper that robot setup cannot recognize; the text states the reason."""


def find_grippers(model: RobotModel, tips: bool = False) -> RobotModel:
    """Return the robot with a `Gripper` for each end effector with two jaws and one driven joint.

    If no frame of the robot is at the pads' center, the robot gets a link `<end effector>_tcp` there. Log
    messages state why an end effector has no gripper.

    Args:
        tips: whether the tool center becomes the tip of the arm's group.
    """
    for end in model.end_effectors.values():
        if end.name in model.grippers or end.parent_group is None:
            continue
        try:
            model = _with_gripper(model, end)
            gripper = model.grippers[end.name]
            if tips and model.groups[gripper.arm_group].tip_link != gripper.tcp_link:
                model = with_tip(model, gripper.arm_group, gripper.tcp_link)
        except NotRecognized as reason:
            logger.warning("end effector %s: no gripper found: %s", end.name, reason)
    return model


def reasons(model: RobotModel) -> dict[str, str]:
    """Return the reason why robot setup did not recognize a gripper, for each end effector by name."""
    found = {}
    for end in model.end_effectors.values():
        if end.name not in model.grippers:
            try:
                _with_gripper(model, end)
            except NotRecognized as reason:
                found[end.name] = str(reason)
    return found


@dataclass(frozen=True, eq=False)
class _Jaws:
    """The two jaws of a detected gripper, on the +y side and on the -y side, with the axes of the hand.

    Attributes:
        plus, minus: links of each jaw. Fixed joints connect the links of a jaw.
        axes: (3, 3) rows x, y (closing direction) and z (out of the hand) in the palm's frame.
        closed, opened: positions of the driven joint.
    """

    plus: tuple[str, ...]
    minus: tuple[str, ...]
    axes: Array
    closed: float
    opened: float


def _with_gripper(model: RobotModel, end: EndEffector) -> RobotModel:
    group = model.groups[end.group]
    if len(group.joint_names) != 1:
        raise NotRecognized(
            f"{len(group.joint_names)} driven joints ({', '.join(group.joint_names) or 'fixed jaws'}), "
            "but one must move the jaws and the others mimic it"
        )
    driver = model.joints[group.joint_names[0]]
    if not (np.isfinite(driver.limits.lower) and np.isfinite(driver.limits.upper)):
        raise NotRecognized(f"joint {driver.name} has no position limits")
    if driver.limits.upper - driver.limits.lower < 1e-6:
        raise NotRecognized(f"joint {driver.name} cannot move: lower and upper limit are equal")
    hand = _Hand(model, driver)
    jaws = hand.jaws()
    return hand.described(end, jaws)


class _Hand:
    """Robot hand that robot setup examines to decide whether it is a two-jaw gripper.

    The class samples points on the surfaces of the hand's links. It computes where these points are at any
    position of the driven joint.
    """

    def __init__(self, model: RobotModel, driver: Joint):
        self.model, self.driver = model, driver
        self.moving = [j for j in model.joints.values() if j.movable and _driver(model, j) == driver.name]
        self.palm = self.moving[0].parent
        self.rigid = {link: tuple(links) for links in model.rigid_groups for link in links}
        self.points = {
            name: surface_points(link, SPACING)
            for name, link in model.links.items()
            if name in model.subtree(self.palm)
        }

    def pose(self, link: str, q: float) -> SE3:
        """Return the pose T_palm_link of a link in the hand that robot setup examines.

        The driven joint is at `q`. Joints that mimic it follow, and all other joints are at zero.
        """
        T = SE3.identity()
        for joint in self.model.chain(self.palm, link):
            T = T @ joint.T_parent_joint @ _motion(joint, _value(self.model, joint, self.driver.name, q))
        return T

    def at(self, links: tuple[str, ...], q: float) -> Array:
        """Return points (n, 3) [m] on the surfaces of `links`, in the frame of the gripper's palm.
        The driven joint of the gripper is at `q`.
        """
        parts = [self.pose(n, q).apply(p) for n in links if len(p := self.points.get(n, np.zeros((0, 3))))]
        return np.concatenate(parts) if parts else np.zeros((0, 3))

    # --- the jaws ---
    def jaws(self) -> _Jaws:
        low, high = self.driver.limits.lower, self.driver.limits.upper
        mid, h = (low + high) / 2, (high - low) / 200
        parts = {self.rigid[j.child] for j in self.moving}
        solid = [p for p in dict.fromkeys(self.rigid[j.child] for j in self.moving) if len(self.at(p, mid))]
        if not solid:
            raise NotRecognized("its moving links have no collision geometry")
        branches = {self._branch(p) for p in solid}
        if len(branches) == 1 and len(parts) == 1:
            return self._single(solid[0], low, high)
        every = np.concatenate([self.at(p, mid) for p in solid])
        out = every.mean(0)
        if np.linalg.norm(out) < 1e-6:
            raise NotRecognized("its jaws surround the palm, so no direction is out of the hand")
        out = out / np.linalg.norm(out)
        speed = {p: (self.at(p, mid + h).mean(0) - self.at(p, mid - h).mean(0)) / (2 * h) for p in solid}
        best, least = None, 0.0
        fastest = max(float(np.linalg.norm(v)) for v in speed.values())
        for i, a in enumerate(solid):
            for b in solid[i + 1 :]:
                relative = speed[a] - speed[b]
                rate = float(np.linalg.norm(relative))
                if self._branch(a) == self._branch(b) or rate < 0.3 * fastest:
                    continue
                apart = self.at(a, mid).mean(0) - self.at(b, mid).mean(0)
                if abs(apart @ relative) < 0.5 * np.linalg.norm(apart) * rate:
                    continue  # they pass each other
                reach = min(float((self.at(p, mid) @ out).max()) for p in (a, b))
                if best is None or reach > least + 1e-3:
                    best, least = (a, b, relative / rate), reach
        if best is None:
            raise NotRecognized("no two of its moving links move toward each other")
        a, b, y = best
        if (self.at(a, mid).mean(0) - self.at(b, mid).mean(0)) @ y < 0:
            a, b = b, a
        return self._ordered(a, b, self._axes(y, out), low, high)

    def _single(self, jaw: tuple[str, ...], low: float, high: float) -> _Jaws:
        """Find the jaws of a gripper that has only one moving jaw.
        The links of the palm form the fixed jaw.
        """
        fixed = self.rigid[self.palm]
        if not len(self.at(fixed, low)):
            raise NotRecognized(f"the fixed jaw {self.palm} has no collision geometry")
        joint = self.moving[0]
        axis = joint.T_parent_joint.rotation.matrix @ np.asarray(joint.axis)
        if joint.type == "prismatic":
            out = self.at(jaw, (low + high) / 2).mean(0)
            y, ends = axis, None
        else:
            pivot = joint.T_parent_joint.translation
            closed = min((low, high), key=lambda q: self._nearest(fixed, jaw, q, pivot))
            ends = (closed, high if closed == low else low)
            points = self.at(jaw, closed) - pivot
            flat = points - np.outer(points @ axis, axis)
            out = flat[np.argmax(np.linalg.norm(flat, axis=1))]
            y = np.cross(axis, out)
            y = np.asarray(y / np.linalg.norm(y), dtype=float)
        a, b = jaw, fixed
        mid = (low + high) / 2
        # The jaw opens away from the fixed jaw: +y is the side to which its pads move.
        if ends is not None:
            small = ends[0] + 0.1 * (ends[1] - ends[0])
            if (self.at(jaw, small) - self.at(jaw, ends[0])).mean(0) @ y < 0:
                y = -y
        elif (self.at(jaw, mid).mean(0) - self.at(fixed, mid).mean(0)) @ y < 0:
            y = -y
        axes = self._axes(y, out)
        if ends is None:
            return self._ordered(a, b, axes, low, high)
        return _Jaws(a, b, self._along_pad(a, b, axes, ends[0]), *ends)

    def _along_pad(self, a: tuple[str, ...], b: tuple[str, ...], axes: Array, q: float) -> Array:
        """Turn the axes of a detected gripper about x such that z is parallel to the pad of the fixed jaw."""
        _, cells, _, minus = self._gap(a, b, axes, q)
        if not len(cells):
            return axes
        outer = cells[:, 1] > cells[:, 1].max() - LONGEST_PAD
        z, y = cells[outer, 1], minus[outer]
        slope = float(np.polyfit(z, y, 1)[0]) if np.ptp(z) > 2 * SPACING else 0.0
        z = axes[2] + (slope if abs(slope) < np.tan(WIDEST_TURN) else 0.0) * axes[1]
        z = z / np.linalg.norm(z)
        roll = self._last_axis()
        if roll is not None and abs(roll @ z) > NEAR_ROLL:  # an arm with five joints then reaches from above
            z = np.sign(roll @ z) * roll
        return self._axes(axes[1] - (axes[1] @ z) * z, z)

    def _last_axis(self) -> Array | None:
        """Return the axis of the last arm joint above a gripper, in the frame of the palm.
        It is None if there is no arm.
        """
        link = self.palm
        while (joint := self.model.parent_joint.get(link)) is not None and not joint.movable:
            link = joint.parent
        if joint is None:
            return None
        R = SE3.identity()
        for fixed in self.model.chain(joint.child, self.palm):
            R = R @ fixed.T_parent_joint
        return R.rotation.matrix.T @ np.asarray(joint.axis)

    def _nearest(self, fixed: tuple[str, ...], jaw: tuple[str, ...], q: float, pivot: Array) -> float:
        """Return the distance [m] from the end of a gripper's moving jaw to its fixed jaw."""
        points, others = self.at(jaw, q), self.at(fixed, q)
        tip = points[np.argmax(np.linalg.norm(points - pivot, axis=1))]
        return float(np.linalg.norm(others - tip, axis=1).min())

    def _branch(self, part: tuple[str, ...]) -> str:
        """Return the first movable joint on the path from the palm of a hand to the given links."""
        top = min(part, key=lambda n: len(self.model.chain(self.palm, n)))
        return next(j.name for j in self.model.chain(self.palm, top) if j.movable)

    @staticmethod
    def _axes(y: Array, out: Array) -> Array:
        """Return the axes (3, 3) of a gripper's frame as rows,
        given its closing direction and its outward direction.
        """
        y = _snapped(y / np.linalg.norm(y))
        z = out - (out @ y) * y
        if np.linalg.norm(z) < 1e-6:
            raise NotRecognized("its jaws move along the direction out of the hand")
        z = _snapped(z / np.linalg.norm(z))
        z = z - (z @ y) * y
        z /= np.linalg.norm(z)
        return np.stack([np.cross(y, z), y, z])

    def _ordered(self, a: tuple[str, ...], b: tuple[str, ...], axes: Array, low: float, high: float) -> _Jaws:
        gaps = [self._gap(a, b, axes, q)[0] for q in (low, high)]
        if not np.isfinite(gaps).any():
            raise NotRecognized("its jaws do not face each other in any position")
        closed, opened = (low, high) if not gaps[0] > gaps[1] else (high, low)
        return _Jaws(a, b, axes, closed, opened)

    def _gap(
        self, a: tuple[str, ...], b: tuple[str, ...], axes: Array, q: float
    ) -> tuple[float, Array, Array, Array]:
        """Compare the facing surfaces of two jaws on a grid in x and z,
        to decide whether they form a gripper.

        Returns:
            The smallest gap [m] (infinite if the jaws face each other nowhere), and the cells (n, 2), the
            inner y of the plus jaw and of the minus jaw in the cells [m].
        """
        cells: list[dict[tuple[int, int], float]] = []
        for part, sign in ((a, 1.0), (b, -1.0)):
            found = self.at(part, q) @ axes.T
            keys = np.round(found[:, [0, 2]] / SPACING).astype(int)
            inner: dict[tuple[int, int], float] = {}
            for (x, z), y in zip(keys.tolist(), (sign * found[:, 1]).tolist(), strict=True):
                if y < inner.get((x, z), np.inf):
                    inner[x, z] = y
            cells.append(inner)
        common = [key for key in cells[0] if key in cells[1]]
        if not common:
            return np.inf, np.zeros((0, 2)), np.zeros(0), np.zeros(0)
        plus = np.array([cells[0][key] for key in common])
        minus = -np.array([cells[1][key] for key in common])
        gap = plus - minus
        return float(gap.min()), SPACING * np.array(common, dtype=float), plus, minus

    # --- the description ---
    def described(self, end: EndEffector, jaws: _Jaws) -> RobotModel:
        model, axes = self.model, jaws.axes
        single = jaws.minus == self.rigid[self.palm]
        at = jaws.closed
        _, cells, plus, minus = self._gap(jaws.plus, jaws.minus, axes, at)
        if not len(cells):
            raise NotRecognized("its jaws do not face each other when it is closed")
        tip = float(min((self.at(p, at) @ axes[2]).max() for p in (jaws.plus, jaws.minus)))
        gaps = plus - minus
        outer = cells[:, 1] > tip - 2 * LONGEST_PAD
        if not outer.any():
            raise NotRecognized("its jaws do not face each other at their ends")
        near = gaps <= gaps[outer].min() + (3 * FLAT if single else FLAT)
        pad = cells[near & outer]
        top = pad[:, 1].max()
        pad = pad[pad[:, 1] > top - LONGEST_PAD]
        low, high = pad.min(0) - SPACING / 2, pad.max(0) + SPACING / 2
        inner = [self._pad_points(part, axes, at, low, high, sign)
                 for part, sign in ((jaws.plus, 1.0), (jaws.minus, -1.0))]  # fmt: skip
        curve = self._curve(jaws, inner)
        if abs(curve[0, 1]) < LINEAR:  # meshes that touch a little too early or too late
            curve[:, 1] -= curve[0, 1]
        reference = min(0.5 * curve[-1, 1], 0.04)
        y, z = (float(np.interp(reference, curve[:, 1], curve[:, k])) for k in (2, 3))
        facing = [
            np.concatenate([self.pose(n, at).apply(p) for n, p in pads.items()]) @ axes[0] for pads in inner
        ]
        low[0], high[0] = max(p.min() for p in facing), min(p.max() for p in facing)
        x = float((low[0] + high[0]) / 2)
        reach = self._reach(jaws, reference, curve, z)
        T_palm_tcp = SE3(SO3(axes.T), axes.T @ np.array([x, y, z]))
        curve = curve - [0.0, 0.0, y, z]
        tcp, T_frame_tcp, turned = self._existing(T_palm_tcp, reach)
        if tcp is None:
            tcp = f"{end.name}_tcp"
            model = with_frame(model, tcp, self.palm, T_palm_tcp)
        else:  # express the curve in the existing frame
            offset = T_frame_tcp.translation
            curve = curve * [1.0, 1.0, turned, 1.0] + [0.0, 0.0, offset[1], offset[2]]
            reach += float(offset[2])
        fingers = (jaws.plus, jaws.minus) if turned > 0 else (jaws.minus, jaws.plus)
        slope = (curve[-1, 1] - curve[0, 1]) / (curve[-1, 0] - curve[0, 0])
        line = np.interp(curve[:, 1], curve[[0, -1], 1], curve[[0, -1], 0])
        straight = bool(np.abs(line - curve[:, 0]).max() * abs(slope) < LINEAR)
        fixed = straight and bool(max(np.abs(curve[:, 2]).max(), np.ptp(curve[:, 3])) < CENTERED)
        offset = float(curve[0, 1] - slope * curve[0, 0])
        rows = np.concatenate([curve[:-1:2], curve[-1:]])
        corners = (low[0] - x, low[1] - z, high[0] - x, high[1] - z)
        gripper = Gripper(
            name=end.name,
            arm_group=str(end.parent_group),
            group=end.group,
            joint_name=self.driver.name,
            tcp_link=tcp,
            finger_links=tuple(max(part, key=lambda n: len(self.points.get(n, ()))) for part in fingers),
            hand_links=self._hand_links(),
            width_per_joint=round(float(slope), 6),
            width_offset=round(offset if abs(offset) > 1e-5 else 0.0, 6),
            max_width=round(float(curve[:, 1].max()), 6),
            max_force=self._force(slope),
            finger_depth=round(self._depth(jaws, axes, z), 6),
            pad_depth=round(reach, 6),
            curve=() if fixed else tuple(tuple(round(float(v), 6) for v in row) for row in rows),
            pad=() if fixed else tuple(round(float(v), 6) for v in corners),
        )
        return replace(model, grippers={**model.grippers, end.name: gripper})

    def _pad_points(
        self, part: tuple[str, ...], axes: Array, q: float, low: Array, high: Array, sign: float
    ) -> dict[str, Array]:
        """Return the points (n, 3) on the pads of a detected gripper by link, in the frame of the link."""
        found: dict[str, Array] = {}
        front = np.inf
        for name in part:
            points = self.points.get(name, np.zeros((0, 3)))
            if not len(points):
                continue
            there = self.pose(name, q).apply(points) @ axes.T
            inside = np.all((there[:, [0, 2]] >= low) & (there[:, [0, 2]] <= high), axis=1)
            if inside.any():
                found[name] = np.column_stack([points[inside], sign * there[inside, 1]])
                front = min(front, float(found[name][:, 3].min()))
        return {n: p[p[:, 3] < front + FLAT, :3] for n, p in found.items() if (p[:, 3] < front + FLAT).any()}

    def _curve(self, jaws: _Jaws, pads: list[dict[str, Array]]) -> Array:
        """Tabulate how the pads of a detected gripper move when its driven joint moves.

        Each row (k, 4) contains the joint position, the opening [m] between the pads, and y and z [m] of the
        center between the pads, in the axes of the hand.

        The rows begin at the closed end; they end where the opening stops growing, or a jaw has turned too
        far to hold an object.
        """
        rows: list[list[float]] = []
        single = jaws.minus == self.rigid[self.palm]
        before = [self.pose(p[0], jaws.closed).rotation for p in (jaws.plus, jaws.minus)]
        for q in np.linspace(jaws.closed, jaws.opened, STEPS):
            ends = [
                np.concatenate([self.pose(n, q).apply(p) for n, p in pad.items()]) @ jaws.axes.T
                for pad in pads
            ]
            width = float(ends[0][:, 1].min() - ends[1][:, 1].max())
            turns = [
                np.linalg.norm((b.inv() @ self.pose(p[0], q).rotation).log())
                for b, p in zip(before, (jaws.plus, jaws.minus), strict=True)
            ]
            if rows and (width <= rows[-1][1] + 1e-6 or max(turns) > WIDEST_TURN):
                break
            y = float(ends[0][:, 1].min() + ends[1][:, 1].max()) / 2
            z = float(ends[1][:, 2].mean() if single else (ends[0][:, 2].mean() + ends[1][:, 2].mean()) / 2)
            rows.append([float(q), width, y, z])
        if len(rows) < 3:
            raise NotRecognized(
                f"its jaws do not open: joint {self.driver.name} moves from {jaws.closed:g} to "
                f"{jaws.opened:g}, but the pads do not separate"
            )
        curve = np.array(rows)
        if curve[0, 1] < -LINEAR:  # the meshes overlap when it is closed: the opening is zero earlier
            start = [float(np.interp(0.0, curve[:, 1], curve[:, k])) for k in range(4)]
            curve = np.concatenate([[start], curve[curve[:, 1] > 1e-6]])
        return curve

    def _reach(self, jaws: _Jaws, width: float, curve: Array, z: float) -> float:
        q = float(np.interp(width, curve[:, 1], curve[:, 0]))
        return float(min((self.at(p, q) @ jaws.axes[2]).max() for p in (jaws.plus, jaws.minus))) - z

    def _existing(self, T_palm_tcp: SE3, reach: float) -> tuple[str | None, SE3, float]:
        """Find an existing frame of the robot that can serve as a gripper's tcp.

        Returns:
            The name of the frame (None if there is none), the pose T_frame_tcp, and a sign: -1 if the y axis
            of the frame is reversed, else 1.
        """
        model, rigid = self.model, self.rigid[self.palm]
        for name in rigid:
            if name == self.palm or model.links[name].collisions or name not in model.subtree(self.palm):
                continue
            T = self.pose(name, 0.0).inv() @ T_palm_tcp
            R, t = T.rotation.matrix, T.translation
            if (
                R[2, 2] > STRAIGHT
                and abs(R[1, 1]) > STRAIGHT
                and np.hypot(t[0], t[1]) < 0.002
                and abs(t[2]) < max(reach, 0.01)
            ):
                return name, T, float(np.sign(R[1, 1]))
        return None, SE3.identity(), 1.0

    def _hand_links(self) -> tuple[str, ...]:
        below = [n for n in self.model.subtree(self.palm) if self.model.links[n].collisions]
        return tuple(dict.fromkeys([self.palm, *below]))

    def _force(self, slope: float) -> float:
        effort = self.driver.limits.effort
        force = float(effort) / abs(slope) if self.driver.type != "prismatic" else float(effort)
        if FORCES[0] <= force <= FORCES[1]:
            return round(float(force), 1)
        return Gripper.max_force

    def _depth(self, jaws: _Jaws, axes: Array, z: float) -> float:
        """Return the length [m] of the jaws of a detected gripper, from the tcp to the palm."""
        moving = {n for j in self.moving for n in self.model.subtree(j.child)}
        body = [n for n in self._hand_links() if n not in moving]
        if jaws.minus == self.rigid[self.palm]:  # the palm is a jaw
            return LONGEST_PAD
        points = self.at(tuple(body), 0.0)
        depth = z - float((points @ axes[2]).max()) - PALM_MARGIN if len(points) else 0.02
        return max(depth, PALM_MARGIN)


def with_frame(model: RobotModel, name: str, parent: str, T_parent_frame: SE3) -> RobotModel:
    """Return the robot with an additional frame, such as a gripper's tcp.
    It is a link without geometry that is fixed to another link.
    """
    joint = Joint(f"{name}_joint", "fixed", parent, name, T_parent_frame)
    return replace(
        model,
        links={**model.links, name: Link(name)},
        joints={**model.joints, joint.name: joint},
        frames={**model.frames, name: joint},
    )


def with_tip(model: RobotModel, group: str, link: str) -> RobotModel:
    """Return the robot with a new tip link for a planning group (chain),
    such as the tcp of a detected gripper.
    """
    old = model.groups[group]
    chain = model.chain(str(old.base_link), link)
    new = replace(old, tip_link=link, link_names=tuple(j.child for j in chain))
    return replace(model, groups={**model.groups, group: new})


def _driver(model: RobotModel, joint: Joint) -> str:
    """Return the actuated joint that drives a joint of a gripper, directly or through mimic joints."""
    while joint.mimic is not None:
        joint = model.joints[joint.mimic.joint]
    return joint.name


def _value(model: RobotModel, joint: Joint, driver: str, q: float) -> float:
    """Return the position of a gripper's joint when the driving joint
    is at `q` and all other joints are at zero.
    """
    if joint.mimic is None:
        return q if joint.name == driver else 0.0
    return (
        joint.mimic.multiplier * _value(model, model.joints[joint.mimic.joint], driver, q)
        + joint.mimic.offset
    )


def _motion(joint: Joint, value: float) -> SE3:
    axis = np.asarray(joint.axis)
    if not joint.movable:
        return SE3.identity()
    if joint.type == "prismatic":
        return SE3.from_xyz(*(value * axis))
    return SE3(SO3.exp(value * axis), np.zeros(3))


def _snapped(direction: Array) -> Array:
    """Return the frame axis that is within 3 degrees of a gripper's direction,
    or else the direction itself.
    """
    k = int(np.argmax(np.abs(direction)))
    return np.sign(direction[k]) * np.eye(3)[k] if abs(direction[k]) > SNAP else direction
