"""Parameters of a detected gripper: pads, opening curve, tool center, force and finger length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3
from armcell.model.composition import with_frame
from armcell.model.robot import EndEffector, Gripper, RobotModel
from armcell.model.setup.hand_geometry import SPACING, GripperNotRecognizedError, HandGeometry
from armcell.model.setup.jaws import LONGEST_PAD, WIDEST_TURN, Jaws

Array = NDArray[np.float64]

DEEP = 0.01  # [m] overlap of jaws at the closed limit from which on the limit is not the closed position
OPENED = 0.25  # part of the driven joint's range after which the pads of a single jaw are apart
BISECTIONS = 12  # of the joint's range, to find the position at which jaws touch
NARROW = 0.002  # [m] a smaller opening is not a gripper's
STEPS = 33  # positions of the driven joint at which the opening is measured
LARGER = 3  # ratio of the areas from which on a flat surface is the pad, not a ridge
FLAT = 0.0015  # [m] depth of the surface that counts as a pad, behind its foremost point
STRAIGHT = 0.99  # cosine between the closing direction and the y axis of an existing tool frame
BESIDE = 0.002  # [m] distance of an existing tool frame from the line through the pads' center along z
CENTERED = 2e-4  # [m] a grip center that moves less is fixed
LINEAR = 2e-4  # [m] an opening that deviates less from a straight line is one
PALM_MARGIN = 0.005  # [m] minimum distance of a grasped object from the palm
FORCES = (1.0, 300.0)  # [N] per finger; other values of a description are not a gripper's


def with_measured_gripper(hand: HandGeometry, end: EndEffector, jaws: Jaws, tool: str = "") -> RobotModel:
    """Return the robot with a gripper whose parameters, such as the pads, are measured on the meshes of its
    jaws.

    Args:
        tool: link that must be the tcp; empty: a suitable frame of the hand, or a new link.
    Raises:
        GripperNotRecognizedError: the jaws have no facing pads, they do not open, or `tool` is not
            between them.
    """
    jaws = _touching(hand, jaws)
    model, axes = hand.model, jaws.axes
    single = jaws.single
    at = jaws.closed
    _, cells, plus, minus = hand.gap(jaws.plus, jaws.minus, axes, at)
    if not len(cells):
        raise GripperNotRecognizedError("its jaws do not face each other when it is closed")
    tip = float(min((hand.at(p, at) @ axes[2]).max() for p in (jaws.plus, jaws.minus)))
    gaps = plus - minus
    if jaws.single:
        apart = _opening_cells(hand, jaws, cells, gaps)
        cells, gaps = cells[apart], gaps[apart]
    outer = cells[:, 1] > tip - 2 * LONGEST_PAD
    if not outer.any():
        raise GripperNotRecognizedError("its jaws do not face each other at their ends")
    pad = _pad_cells(cells, gaps, tip, 3 * FLAT if single else FLAT)
    top = pad[:, 1].max()
    pad = pad[pad[:, 1] > top - LONGEST_PAD]
    low, high = pad.min(0) - SPACING / 2, pad.max(0) + SPACING / 2
    inner = [_pad_points(hand, part, axes, at, low, high, sign)
             for part, sign in ((jaws.plus, 1.0), (jaws.minus, -1.0))]  # fmt: skip
    curve = _curve(hand, jaws, inner)
    if abs(curve[0, 1]) < LINEAR:  # meshes that touch a little too early or too late
        curve[:, 1] -= curve[0, 1]
    reference = min(0.5 * curve[-1, 1], 0.04)
    y, z = (float(np.interp(reference, curve[:, 1], curve[:, k])) for k in (2, 3))
    facing = [
        np.concatenate([hand.pose(n, at).apply(p) for n, p in pads.items()]) @ axes[0] for pads in inner
    ]
    left, right = max(p.min() for p in facing), min(p.max() for p in facing)
    if right - left > SPACING:  # otherwise interlocking teeth, which face each other in all cells
        low[0], high[0] = left, right
    x = float((low[0] + high[0]) / 2)
    reach = _reach(hand, jaws, reference, curve, z)
    T_palm_tcp = SE3(SO3(axes.T), axes.T @ np.array([x, y, z]))
    curve = curve - [0.0, 0.0, y, z]
    tcp, T_frame_tcp, turned = _existing(hand, T_palm_tcp, reach, tool)
    if tcp is None:
        tcp = f"{end.name}_tcp"
        model = with_frame(model, tcp, hand.palm, T_palm_tcp)
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
    below = float(curve[0, 3]) if fixed else 0.0  # of the grip center, in the tcp frame
    corners = (low[0] - x, low[1] - z + below, high[0] - x, high[1] - z + below)
    gripper = Gripper(
        name=end.name,
        arm_group=str(end.parent_group),
        group=end.group,
        joint_name=hand.driver.name,
        tcp_link=tcp,
        finger_links=tuple(link for part in fingers for link in _finger_links(hand, part)),
        hand_links=hand.hand_links(),
        width_per_joint=round(float(slope), 6),
        width_offset=round(offset if abs(offset) > 1e-5 else 0.0, 6),
        max_width=round(float(curve[:, 1].max()), 6),
        max_force=_force(hand, slope),
        finger_depth=round(_depth(hand, jaws, axes, z), 6),
        pad_depth=round(reach, 6),
        curve=() if fixed else tuple(tuple(round(float(v), 6) for v in row) for row in rows),
        pad=tuple(round(float(v), 6) for v in corners),
    )
    return replace(model, grippers={**model.grippers, end.name: gripper})


def _touching(hand: HandGeometry, jaws: Jaws) -> Jaws:
    """Return the jaws with the closed position at which their pads first touch, if the jaws overlap deeply at
    the limit of the driven joint. The joint then stops before its limit.
    """

    def gap(q: float) -> float:
        return hand.gap(jaws.plus, jaws.minus, jaws.axes, q)[0]

    inside, outside = jaws.closed, jaws.opened
    if not gap(inside) < -DEEP or not gap(outside) > 0:
        return jaws
    for _ in range(BISECTIONS):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if gap(middle) < 0 else (inside, middle)
    return replace(jaws, closed=outside)


def _opening_cells(hand: HandGeometry, jaws: Jaws, cells: Array, gaps: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the grid cells that can belong to a gripper's pads: cells in which a turning jaw
    and the fixed jaw do not overlap, at least when the gripper is open.

    Around the jaw's joint, both links overlap in every position, so the gap there does not grow when the
    gripper opens.
    """
    q = jaws.closed + OPENED * (jaws.opened - jaws.closed)
    _, there, plus, minus = hand.gap(jaws.plus, jaws.minus, jaws.axes, q)
    opened = dict(zip(map(tuple, np.round(there / SPACING).astype(int)), plus - minus, strict=True))
    keys = map(tuple, np.round(cells / SPACING).astype(int))
    return np.array([gap > 0 or opened.get(k, np.inf) > 0 for k, gap in zip(keys, gaps, strict=True)])


def _pad_cells(cells: Array, gaps: Array, tip: float, flat: float) -> Array:
    """Select the grid cells (n, 2) that belong to a gripper's pads: the cells near the ends of the jaws where
    the gap between the jaws is smallest.

    If the outer end of the jaws has a much larger flat surface than a ridge farther inside, it is the pad.

    Args:
        gaps: (k,) [m] gaps of the cells when the gripper is closed.
        tip: [m] z of the jaws' ends.
    """
    found = []
    for reach in (2 * LONGEST_PAD, LONGEST_PAD):
        outer = cells[:, 1] > tip - reach
        if outer.any():
            near = (gaps >= gaps[outer].min()) & (gaps <= gaps[outer].min() + flat)
            found.append(cells[near & (cells[:, 1] > tip - 2 * LONGEST_PAD)])
    return found[-1] if len(found[-1]) > LARGER * len(found[0]) else found[0]


def _pad_points(
    hand: HandGeometry, part: tuple[str, ...], axes: Array, q: float, low: Array, high: Array, sign: float
) -> dict[str, Array]:
    """Return the points (n, 3) on the pads of a detected gripper by link, in the frame of the link."""
    found: dict[str, Array] = {}
    front = np.inf
    for name in part:
        points = hand.points.get(name, np.zeros((0, 3)))
        if not len(points):
            continue
        there = hand.pose(name, q).apply(points) @ axes.T
        inside = np.all((there[:, [0, 2]] >= low) & (there[:, [0, 2]] <= high), axis=1)
        if inside.any():
            found[name] = np.column_stack([points[inside], sign * there[inside, 1]])
            front = min(front, float(found[name][:, 3].min()))
    return {n: p[p[:, 3] < front + FLAT, :3] for n, p in found.items() if (p[:, 3] < front + FLAT).any()}


def _curve(hand: HandGeometry, jaws: Jaws, pads: list[dict[str, Array]]) -> Array:
    """Tabulate how the pads of a detected gripper move when its driven joint moves.

    Each row (k, 4) contains the joint position, the opening [m] between the pads, and y and z [m] of the
    center between the pads, in the axes of the hand.

    The rows begin at the closed end; they end where the opening stops growing, or a jaw has turned too
    far to hold an object.
    """
    rows: list[list[float]] = []
    single = jaws.single
    before = [hand.pose(p[0], jaws.closed).rotation for p in (jaws.plus, jaws.minus)]
    for q in np.linspace(jaws.closed, jaws.opened, STEPS):
        ends = [
            np.concatenate([hand.pose(n, q).apply(p) for n, p in pad.items()]) @ jaws.axes.T for pad in pads
        ]
        width = float(ends[0][:, 1].min() - ends[1][:, 1].max())
        turns = [
            np.linalg.norm((b.inverse() @ hand.pose(p[0], q).rotation).log())
            for b, p in zip(before, (jaws.plus, jaws.minus), strict=True)
        ]
        if rows and (width <= rows[-1][1] + 1e-6 or max(turns) > WIDEST_TURN):
            break
        y = float(ends[0][:, 1].min() + ends[1][:, 1].max()) / 2
        z = float(ends[1][:, 2].mean() if single else (ends[0][:, 2].mean() + ends[1][:, 2].mean()) / 2)
        rows.append([float(q), width, y, z])
    if len(rows) < 3:
        raise GripperNotRecognizedError(
            f"its jaws do not open: joint {hand.driver.name} moves from {jaws.closed:g} to "
            f"{jaws.opened:g}, but the pads do not separate"
        )
    curve = np.array(rows)
    if curve[0, 1] < -LINEAR:  # the meshes overlap when it is closed: the opening is zero earlier
        start = [float(np.interp(0.0, curve[:, 1], curve[:, k])) for k in range(4)]
        curve = np.concatenate([[start], curve[curve[:, 1] > 1e-6]])
    if curve[-1, 1] < NARROW:
        raise GripperNotRecognizedError(
            f"its pads open only {1000 * curve[-1, 1]:.1f} mm, until they turn by more than "
            f"{np.degrees(WIDEST_TURN):.0f} degrees or stop separating"
        )
    return curve


def _reach(hand: HandGeometry, jaws: Jaws, width: float, curve: Array, z: float) -> float:
    q = float(np.interp(width, curve[:, 1], curve[:, 0]))
    return float(min((hand.at(p, q) @ jaws.axes[2]).max() for p in (jaws.plus, jaws.minus))) - z


def _finger_links(hand: HandGeometry, part: tuple[str, ...]) -> list[str]:
    """Return the links of a jaw on which its pads are measured: in each rigid part of the jaw, the link with
    the most surface points.
    """
    rigid = dict.fromkeys(hand.rigid[name] for name in part)
    return [max(links, key=lambda n: len(hand.points[n])) for links in rigid]


def _existing(hand: HandGeometry, T_palm_tcp: SE3, reach: float, tool: str) -> tuple[str | None, SE3, float]:
    """Find an existing frame of the robot that is between the pads of a gripper and can serve as its tcp.

    Args:
        tool: the only link that may be the tcp; empty: any suitable frame.
    Returns:
        The name of the frame (None if there is none), the pose T_frame_tcp, and a sign: -1 if the y axis
        of the frame is reversed, else 1.
    Raises:
        GripperNotRecognizedError: `tool` is not between the pads.
    """
    if tool and tool not in hand.rigid[hand.palm]:
        fixed = ", ".join(hand.rigid[hand.palm])
        raise GripperNotRecognizedError(
            f"tcp {tool} is not fixed to the palm {hand.palm}; links that are: {fixed}"
        )
    for name in (tool,) if tool else hand.rigid[hand.palm]:
        if not tool and (name == hand.palm or hand.model.links[name].collisions):
            continue
        T = hand.pose(name, 0.0).inverse() @ T_palm_tcp
        R, t = T.rotation.matrix, T.translation
        aligned = R[2, 2] > STRAIGHT and abs(R[1, 1]) > STRAIGHT
        if aligned and np.hypot(t[0], t[1]) < BESIDE and abs(t[2]) < max(reach, 0.01):
            return name, T, float(np.sign(R[1, 1]))
        if tool:
            z, y = (np.degrees(np.arccos(np.clip(v, -1, 1))) for v in (R[2, 2], abs(R[1, 1])))
            x_mm, y_mm, z_mm = 1000 * t
            raise GripperNotRecognizedError(
                f"tcp {tool} is not between the pads: its z axis is {z:.0f} degrees from the direction out "
                f"of the hand, its y axis {y:.0f} degrees from the closing direction, and the pads' center "
                f"is at ({x_mm:.0f}, {y_mm:.0f}, {z_mm:.0f}) mm in its frame"
            )
    return None, SE3.identity(), 1.0


def _force(hand: HandGeometry, slope: float) -> float:
    effort = hand.driver.limits.effort
    force = float(effort) / abs(slope) if hand.driver.type != "prismatic" else float(effort)
    if FORCES[0] <= force <= FORCES[1]:
        return round(float(force), 1)
    return Gripper.max_force


def _depth(hand: HandGeometry, jaws: Jaws, axes: Array, z: float) -> float:
    """Return the distance [m] from the tcp between a gripper's pads to the palm, which is the length of the
    detected jaws.
    """
    moving = {n for j in hand.moving for n in hand.model.subtree(j.child)}
    body = [n for n in hand.hand_links() if n not in moving]
    if jaws.single:  # the palm is a jaw
        return LONGEST_PAD
    points = hand.at(tuple(body), 0.0)
    depth = z - float((points @ axes[2]).max()) - PALM_MARGIN if len(points) else 0.02
    return max(depth, PALM_MARGIN)
