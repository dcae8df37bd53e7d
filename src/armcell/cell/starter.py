"""First cell file for a robot: a table, an object, a camera and a task, as commented YAML."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.core import SE3, Box
from armcell.core.geometry import local_bounds
from armcell.execution import ExecutionSettings
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, Group, RobotModel, SuctionGripper
from armcell.model.robot import SERVO_ERROR
from armcell.scene import CollisionObject, PlanningScene

SAMPLES = 2000  # random states that measure the arm's reach
G = 9.81  # [m/s^2]
SMALL = 0.6  # [m] arms with a smaller reach move less up and down
GAP = 0.002  # [m] between the robot's base and the table
THICK = 0.04  # [m] of the table top
HEIGHTS = (0.0, 0.1, 0.2, 0.4, 0.8)  # [m] tried heights of the robot's base above the table
DISTANCES = (0.5, 0.6, 0.4, 0.7, 0.3)  # tried distances of the object, as fractions of the reach
ANGLES = (-25.0, 25.0, 0.0, 60.0, -60.0, 90.0, -90.0, 180.0)  # [deg] tried directions from the base
HIGH = 0.55  # shoulder above the robot's lowest point, as a fraction of the reach: the robot works at a table
# in front of it. Arms that stand on their table have at most 0.53 (SCARA); Alex has 0.58, Baxter 0.88.
DROPS = (0.4, 0.3, 0.5)  # tried heights of the shoulder above that table, as fractions of the reach
AHEAD = (0.5, 0.6, 0.4)  # tried distances of its middle from the shoulder, as fractions of the reach
FRONTS = (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 180.0)  # [deg] tried directions of that table
WIDTH, APART = 0.5, 0.25  # side of that table, and distance from the cube to its goal, per reach
DOWN = 0.97  # least cosine between a gripper that points down and the vertical
DOWN_SAMPLES = 10000  # random states; a freely rotating gripper points down in 1.5 % of them
NEAR = 0.15  # horizontal distance from a cube to a sampled gripper that points down, per reach
LEVELS = (0.5, 0.35, 0.65, 0.2, 0.8)  # tried heights of a table where the gripper points down, as quantiles
LAYER = 0.1  # largest height of a gripper above or below that table, per reach

TEXT = """# A first cell: `armcell run FOLDER` runs it, `armcell view FOLDER` shows it in the browser.
# Lengths are in meters, angles in degrees; poses are [x, y, z] in the frame of the robot's base.
description: {name} {does}.
robot: {robot}
{xacro}start: {start}
padding: 0.005          # [m] kept between the robot and objects where possible
{settings}
objects:
  table:                # fixed, since it is not movable
    box: [{side}, {side}, {thick}]
    pose: [{table_x}, {table_y}, {table_z}]
    color: [0.62, 0.52, 0.42]
{objects}
cameras:
  overview: {{eye: {eye}, target: {target}, fovy_deg: 45}}

task:
{task}"""
OBJECTS = """  mat:                  # where the cube goes
    box: [{mat}, {mat}, 0.004]
    pose: [{goal_x}, {goal_y}, {mat_z}]
    color: [0.30, 0.55, 0.40]
  cube:
    box: [{edge}, {edge}, {edge}]
    pose: [{x}, {y}, {z}]
    color: [0.85, 0.33, 0.20]
    movable: true
    mass: {mass}           # [kg]
    friction: 0.8
"""
PICK = """  - pick: cube
  - place: {object: cube, on: mat}
"""
PICK_WITH = """  - {{pick: cube, arm: {arm}}}
  - {{place: {{object: cube, on: mat}}, arm: {arm}}}
"""


def starter_cells(model: RobotModel, robot: str, xacro_args: dict[str, str]) -> Iterator[str]:
    """Yield the texts of starter cell files for a new robot, in the order in which to try them. The robot's
    start state is collision-free, and is the named state "home" if possible.

    A robot with a gripper gets a cube to pick; other robots move between their named states. The positions of
    the cube differ from file to file; `armcell check` tells whether the robot reaches it.

    Args:
        model: the robot.
        robot: how the cell names it: a library name, or a path relative to the cell's folder.
        xacro_args: arguments of the robot's xacro file.
    """
    arms = _arms(model)
    bottom = base_bottom(model)
    shoulder = _shoulder(model, arms[0]) if arms else np.zeros(3)
    reach = _reach(model, arms[:1], shoulder)
    is_high = bool(shoulder[2] - bottom > HIGH * reach)
    if len(arms) == 1 and not is_high:
        shoulder = shoulder * [0.0, 0.0, 1.0]  # the only arm works around the robot's base
        reach = _reach(model, arms, shoulder)
    edge = round(min(map(_edge, model.grippers.values()), default=0.0), 3)
    sag = max((_sag(model, arm, 800 * edge**3) for arm in arms), default=0.0)
    common = {"name": model.name, "robot": robot, "settings": _settings(reach, sag), "thick": THICK,
              "xacro": f"xacro_args: {_inline(xacro_args)}\n" if xacro_args else ""}  # fmt: skip
    if model.grippers:
        pick = PICK_WITH.format(arm=arms[0].name) if len(arms) > 1 else PICK
        points = _pointing_down(model, arms[0]) if arms else np.zeros((0, 3))
        usual = _in_front(model, shoulder, reach) if is_high else _around(model, shoulder, reach, bottom)
        below = _below_gripper(model, points, reach, bottom)
        for layout in _reached_first(chain(usual, below), points[:, :2], NEAR * reach):
            goal_x, goal_y, x, y = (round(float(v), 3) for v in (*layout.goal, *layout.cube))
            objects = OBJECTS.format(
                mat=round(max(3 * edge, 0.1), 3), goal_x=goal_x, goal_y=goal_y, x=x, y=y, edge=edge,
                mat_z=round(layout.top + 0.002, 4), z=round(layout.top + edge / 2 + 0.0005, 4),
                mass=round(800 * edge**3, 3),
            )  # fmt: skip
            home = "".join(f"  - move: {s}\n" for s in _task_states(model, layout.table) if s == "home")
            words = layout.words(reach) | {"objects": objects, "task": pick + home}
            yield TEXT.format(**common, **words, does="picks a cube")
    layout = next(_around(model, shoulder, reach, bottom))
    states = _task_states(model, layout.table)
    moves = "".join(f"  - move: {state}\n" for state in states) or "  - hold: 1.0\n"
    yield TEXT.format(
        **common, **layout.words(reach), does="moves between its states", objects="", task=moves
    )


@dataclass(frozen=True, eq=False)
class _Layout:
    """Layout of a starter cell, in the frame of the robot's base.

    Attributes:
        start: name of the start state of each planning group.
        cube, goal: (2,) [m] positions of the cube and of the mat on which the task places it.
        raised: whether the table is beside a robot that stands on the floor, not below the robot.
    """

    table: CollisionObject
    start: dict[str, str]
    cube: NDArray[np.float64]
    goal: NDArray[np.float64]
    raised: bool = False

    @property
    def top(self) -> float:
        """Return the height [m] of the table's surface in a starter cell."""
        return float(self.table.T_world_object.translation[2]) + THICK / 2

    def words(self, reach: float) -> dict[str, object]:
        """Return the values that the layout of a starter cell inserts into the text of the cell file."""
        x, y, z = (round(float(v), 4) for v in self.table.T_world_object.translation)
        side = local_bounds(self.table.shapes[0][0])[1][0] * 2
        eye, target = np.array([1.8, -1.8, 1.3]) * reach, [0.0, 0.0, 0.2]
        if self.raised:
            target = [x, y, round(self.top, 2)]
            eye = np.array(target) + np.array([1.1, -1.1, 0.9]) * reach
        return {
            "start": _inline(self.start), "side": round(float(side), 2), "table_x": x, "table_y": y,
            "table_z": z, "eye": [round(float(v), 2) for v in eye], "target": target,
        }  # fmt: skip


def _around(
    model: RobotModel, shoulder: NDArray[np.float64], reach: float, bottom: float
) -> Iterator[_Layout]:
    """Yield layouts of a starter cell in which the robot stands on the table or, if its start states need it,
    above it.
    """
    side = round(2.4 * (reach + float(np.hypot(*shoulder[:2]))), 2)
    for height in HEIGHTS:
        table = _table(side, (0.0, 0.0), bottom - GAP - height)
        start = _free_start(model, table)
        if start is not None:
            break
    for distance in DISTANCES:
        for angle in ANGLES:
            cube, goal = (shoulder[:2] + distance * reach * _direction(a) for a in (angle, angle + 50.0))
            yield _Layout(table, start or {}, cube, goal)


def _in_front(model: RobotModel, shoulder: NDArray[np.float64], reach: float) -> Iterator[_Layout]:
    """Yield layouts of a starter cell with a raised table beside a robot that stands on the floor."""
    for drop in DROPS:
        for angle in FRONTS:
            for ahead in AHEAD:
                middle = shoulder[:2] + ahead * reach * _direction(angle)
                table = _table(round(WIDTH * reach, 2), middle, float(shoulder[2]) - drop * reach)
                start = _free_start(model, table)
                if start is not None:
                    aside = APART / 2 * reach * _direction(angle + 90.0)
                    yield _Layout(table, start, middle - aside, middle + aside, raised=True)


def _below_gripper(
    model: RobotModel, points: NDArray[np.float64], reach: float, bottom: float
) -> Iterator[_Layout]:
    """Yield layouts of a starter cell with a raised table. The table is below the region in which the gripper
    most often points down in random states.

    Some arms reach only a narrow region: with a gripper that points down, the telescope of a Stretch reaches
    the points near a line beside its base. The cube and its goal are along the region's long side.

    Args:
        points: (n, 3) [m] positions of the gripper in which it points down.
    """
    for level in LEVELS if len(points) > 1 else ():
        top = float(np.quantile(points[:, 2], level))
        if top < bottom + THICK:
            continue
        layer = points[np.abs(points[:, 2] - top) < LAYER * reach, :2]
        near = np.linalg.norm(layer[:, None] - layer[None], axis=2) < APART / 2 * reach
        region = layer[near[near.sum(axis=1).argmax()]]
        middle = region.mean(axis=0)
        table = _table(round(WIDTH * reach, 2), middle, top)
        start = _free_start(model, table)
        if start is not None:
            along = APART / 2 * reach * np.linalg.eigh(np.cov(region.T, ddof=0))[1][:, -1]
            yield _Layout(table, start, middle - along, middle + along, raised=True)
            yield _Layout(table, start, middle + along, middle - along, raised=True)


def _reached_first(layouts: Iterable[_Layout], points: NDArray[np.float64], near: float) -> Iterator[_Layout]:
    """Yield the layouts of a starter cell in order of preference: first those in which the cube and the goal
    are each within `near` [m] of a point that the arm reaches (n, 2) [m], then the others.
    """
    far = []
    for layout in layouts:
        at = np.array([layout.cube, layout.goal])
        distances = np.linalg.norm(points[:, None] - at, axis=2).min(axis=0, initial=np.inf)
        if np.all(distances < near):
            yield layout
        else:
            far.append(layout)
    yield from far


def _pointing_down(model: RobotModel, arm: Group) -> NDArray[np.float64]:
    """Return the positions (n, 3) [m] of an arm's gripper in those random states in which it points down, to
    lay out a starter cell. The array is empty for an arm without a gripper.
    """
    gripper = next((g for g in model.grippers.values() if g.arm_group == arm.name), None)
    if gripper is None:
        return np.zeros((0, 3))
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    moved = model.columns(arm.joint_names)
    low, high = _range(model)
    q, found = model.default_positions(), []
    for values in rng.uniform(low[moved], high[moved], (DOWN_SAMPLES, len(moved))):
        q[moved] = values
        pose = tree.link_pose(q, gripper.tcp_link).matrix
        if pose[2, 2] < -DOWN:
            found.append(pose[:3, 3])
    return np.reshape(found, (-1, 3))


def _range(model: RobotModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower and upper limits (dof,) between which joint states for a starter cell are sampled. A
    joint without limits gets the range of one turn.
    """
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    return low, np.where(np.isfinite(model.upper), model.upper, np.pi)


def _table(side: float, middle: Sequence[float] | NDArray[np.float64], top: float) -> CollisionObject:
    x, y, z = (round(float(v), 4) for v in (*middle, top - THICK / 2))
    return CollisionObject.single("table", Box(side, side, THICK), SE3.from_xyz(x, y, z))


def _edge(gripper: Gripper) -> float:
    """Return the edge length [m] of the cube in the starter cell, chosen so that the gripper can hold the
    cube.
    """
    if isinstance(gripper, SuctionGripper):
        return max(0.05, 2.5 * min(cup.radius for cup in gripper.cups) + 0.005)  # one cup seals on it
    return min(0.05, 0.6 * gripper.max_width)


def _settings(reach: float, sag: float) -> str:
    """Return the block `settings` of a starter cell whose arm is small or has soft servos. A small arm
    approaches and lifts by a tenth of its reach.
    """
    entries, why = [], []
    if reach < SMALL:
        names = ("approach_distance", "lift_distance", "lower_distance", "retreat_distance")
        entries += [f"{name}: {reach / 10:.3f}" for name in names]
        why.append("[m] of a small arm")
    if sag > ExecutionSettings.goal_tolerance:
        entries.append(f"execution: {{goal_tolerance: {sag:.3f}}}")
        why.append("[rad] the arm's servos are soft")
    return f"settings: {{{', '.join(entries)}}}   # {'; '.join(why)}\n" if entries else ""


def _sag(model: RobotModel, arm: Group, mass: float) -> float:
    """Estimate by how much [rad] a joint of a stretched-out arm may miss its target while the arm holds the
    cube of the starter cell, with a margin of 50 %. The result is 0 if no revolute joint has a servo from an
    MJCF file.

    A proportional servo gives way by load / stiffness.
    """
    found, lever = 0.0, 0.0
    for joint in reversed(model.chain(str(arm.base_link), str(arm.tip_link))):
        if joint.servo is not None and joint.type != "prismatic":
            found = max(found, mass * G * lever / joint.servo.kp + SERVO_ERROR)
        lever += float(np.linalg.norm(joint.T_parent_joint.translation))
    return 1.5 * found


def _direction(angle_deg: float) -> NDArray[np.float64]:
    angle = np.radians(angle_deg)
    return np.array([np.cos(angle), np.sin(angle)])


def _inline(values: dict[str, str]) -> str:
    return json.dumps(values)  # a flow mapping in YAML, too


def _arms(model: RobotModel) -> list[Group]:
    """Return the arms that the task of a starter cell uses."""
    return [model.groups[name] for name in model.arm_groups]


def _shoulder(model: RobotModel, arm: Group) -> NDArray[np.float64]:
    """Return the position (3,) [m] of an arm's first joint in the frame of the robot's base, for the layout
    of a starter cell.
    """
    joint = model.joints[arm.joint_names[0]]
    return kinematic_tree(model).link_pose(model.default_positions(), joint.child).translation


def _reach(model: RobotModel, arms: Sequence[Group], center: NDArray[np.float64]) -> float:
    """Return the horizontal reach [m] of the arms from a point `center` (3,) [m], for the layout of a starter
    cell. Without an arm, it is the reach of the last link.
    """
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    low, high = _range(model)
    tips = [g.tip_link for g in arms if g.tip_link] or [list(model.links)[-1]]
    moved = model.columns(n for g in arms for n in g.joint_names)
    far, q = 0.0, model.default_positions()
    for values in rng.uniform(low, high, (SAMPLES, model.dof)):
        q[moved] = values[moved]
        for tip in tips:
            far = max(far, float(np.hypot(*(tree.link_pose(q, tip).translation - center)[:2])))
    return far


def base_bottom(model: RobotModel) -> float:
    """Return the height [m] of the lowest point of all fixed links, to place the table of a starter cell.
    It is 0 without geometry.
    """
    fixed = next(links for links in model.rigid_groups if model.root_link in links)
    tree, q, lowest = kinematic_tree(model), model.default_positions(), [0.0]
    for name in fixed:
        for solid in model.links[name].collisions:
            center, half = local_bounds(solid.shape)
            corners = center + half * np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
            lowest.append(float((tree.link_pose(q, name) @ solid.T_link_shape).apply(corners)[:, 2].min()))
    return min(lowest)


def _choices(model: RobotModel) -> Iterator[dict[str, str]]:
    """Yield candidates for the start state of a starter cell. Each candidate maps planning groups to named
    states; the first candidate is "home" with open grippers.
    """
    arms = [arm.name for arm in _arms(model)]
    named = model.named_states
    others = [state for arm in arms for state in named.get(arm, {})]
    opened = {group: "open" for group, states in named.items() if "open" in states and group not in arms}
    for state in dict.fromkeys(["home", "ready", *others]):
        yield {**{arm: state for arm in arms if state in named.get(arm, {})}, **opened}
    yield {}


def _positions(model: RobotModel, states: dict[str, str]) -> NDArray[np.float64]:
    q = model.default_positions()
    for group, state in states.items():
        for joint, value in model.named_states[group][state].items():
            q[model.columns((joint,))[0]] = value
    return q


def _free(model: RobotModel, states: dict[str, str], table: CollisionObject) -> bool:
    scene = PlanningScene(model, _positions(model, states)).with_object(table)
    return not ExactChecker(scene).contacts(scene.positions, padded=False)


def _free_start(model: RobotModel, table: CollisionObject) -> dict[str, str] | None:
    """Return collision-free start states for a starter cell, or None if there are none."""
    return next((states for states in _choices(model) if _free(model, states, table)), None)


def _task_states(model: RobotModel, table: CollisionObject) -> list[str]:
    """Return the collision-free named states that all arms have, for the task of a starter cell.
    The state "home" comes last.
    """
    tables = [model.named_states.get(arm.name, {}) for arm in _arms(model)]
    shared = [s for s in (tables[0] if tables else {}) if all(s in t for t in tables)]
    free = [s for s in shared if _free(model, {a.name: s for a in _arms(model)}, table)]
    return sorted(free, key=lambda s: (s == "home", s != "ready"))[-3:]
