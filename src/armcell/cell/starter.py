"""First cell file for a robot: a table, an object, a camera and a task, as commented YAML."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.core import SE3, Box
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, Group, RobotModel, SuctionGripper
from armcell.scene import CollisionObject, PlanningScene

SAMPLES = 2000  # random states that measure the arm's reach
SMALL = 0.6  # [m] arms with a smaller reach move less up and down
GAP = 0.002  # [m] between the robot's base and the table
HEIGHTS = (0.0, 0.1, 0.2, 0.4, 0.8)  # [m] tried heights of the robot's base above the table
DISTANCES = (0.5, 0.6, 0.4, 0.7, 0.3)  # tried distances of the object, as fractions of the reach
ANGLES = (-25.0, 25.0, 0.0, 60.0, -60.0, 90.0, -90.0, 180.0)  # [deg] tried directions from the base

TEXT = """# A first cell: `armcell run FOLDER` runs it, `armcell view FOLDER` shows it in the browser.
# Lengths are in meters, angles in degrees; poses are [x, y, z] in the frame of the robot's base.
description: {name} {does}.
robot: {robot}
{xacro}start: {start}
padding: 0.005          # [m] kept between the robot and objects where possible
{settings}
objects:
  table:                # fixed, since it is not movable
    box: [{side}, {side}, 0.04]
    pose: [0, 0, {table}]
    color: [0.62, 0.52, 0.42]
{objects}
cameras:
  overview: {{eye: [{eye}, -{eye}, {up}], target: [0.0, 0.0, 0.2], fovy_deg: 45}}

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
  - move: home
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
    reach = _reach(model)
    bottom = base_bottom(model)
    start, height = _free_start(model, bottom, 2.4 * reach)
    table = bottom - GAP - height
    states = _task_states(model, table, 2.4 * reach)
    common = {
        "name": model.name, "robot": robot, "start": _inline(start), "side": round(2.4 * reach, 2),
        "table": round(table - 0.02, 4), "eye": round(1.8 * reach, 2), "up": round(1.3 * reach, 2),
        "settings": _settings(reach),
        "xacro": f"xacro_args: {_inline(xacro_args)}\n" if xacro_args else "",
    }  # fmt: skip
    moves = "".join(f"  - move: {state}\n" for state in states) or "  - hold: 1.0\n"
    if model.grippers:
        edge = round(min(map(_edge, model.grippers.values())), 3)
        home = "".join(f"  - move: {s}\n" for s in states if s == "home")
        for distance in DISTANCES:
            for angle in ANGLES:
                x, y = _at(distance * reach, angle)
                goal_x, goal_y = _at(distance * reach, angle + 50.0)
                objects = OBJECTS.format(
                    mat=round(max(3 * edge, 0.1), 3), goal_x=goal_x, goal_y=goal_y, x=x, y=y, edge=edge,
                    mat_z=round(table + 0.002, 4), z=round(table + edge / 2 + 0.0005, 4),
                    mass=round(800 * edge**3, 3),
                )  # fmt: skip
                task = PICK.replace("  - move: home\n", home)
                yield TEXT.format(**common, does="picks a cube", objects=objects, task=task)
    yield TEXT.format(**common, does="moves between its states", objects="", task=moves)


def _edge(gripper: Gripper) -> float:
    """Return the edge length [m] of the cube in the starter cell, chosen so that the gripper can hold the
    cube.
    """
    if isinstance(gripper, SuctionGripper):
        return max(0.05, 2.5 * min(cup.radius for cup in gripper.cups) + 0.005)  # one cup seals on it
    return min(0.05, 0.6 * gripper.max_width)


def _settings(reach: float) -> str:
    """Return the block `settings` for the starter cell of a small arm.
    Straight approach and lift distances are a tenth of the reach.
    """
    if reach >= SMALL:
        return ""
    names = ("approach_distance", "lift_distance", "lower_distance", "retreat_distance")
    entries = ", ".join(f"{name}: {reach / 10:.3f}" for name in names)
    return f"settings: {{{entries}}}   # [m] of a small arm\n"


def _at(distance: float, angle_deg: float) -> tuple[float, float]:
    angle = np.radians(angle_deg)
    return round(float(distance * np.cos(angle)), 3), round(float(distance * np.sin(angle)), 3)


def _inline(values: dict[str, str]) -> str:
    return json.dumps(values)  # a flow mapping in YAML, too


def _arms(model: RobotModel) -> list[Group]:
    """Return the arms that the task of a starter cell uses: all arms with a gripper or,
    if there are none, all arms.
    """
    arms = [g for g in model.groups.values() if g.tip_link and g.joint_names]
    carrying = {g.arm_group for g in model.grippers.values()}
    return [g for g in arms if g.name in carrying] or arms


def _reach(model: RobotModel) -> float:
    """Return the horizontal reach [m] of an arm from the robot's base, which determines the layout of a
    starter cell.
    """
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    tips = [g.tip_link for g in _arms(model) if g.tip_link] or [list(model.links)[-1]]
    moved = model.columns(n for g in _arms(model) for n in g.joint_names)
    far, q = 0.0, model.default_positions()
    for values in rng.uniform(low, high, (SAMPLES, model.dof)):
        q[moved] = values[moved]
        far = max(far, *(float(np.hypot(*tree.link_pose(q, tip).translation[:2])) for tip in tips))
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


def _free(model: RobotModel, states: dict[str, str], table: float, side: float) -> bool:
    slab = ((Box(side, side, 0.04), SE3.identity()),)
    top = CollisionObject("table", slab, SE3.from_xyz(0.0, 0.0, table - 0.02))
    scene = PlanningScene(model, _positions(model, states)).with_object(top)
    return not ExactChecker(scene).contacts(scene.positions, padded=False)


def _free_start(model: RobotModel, bottom: float, side: float) -> tuple[dict[str, str], float]:
    """Return collision-free start states for a starter cell, and the height [m] of the robot's base above the
    table.
    """
    for height in HEIGHTS:
        for states in _choices(model):
            if _free(model, states, bottom - GAP - height, side):
                return states, height
    return {}, HEIGHTS[-1]


def _task_states(model: RobotModel, table: float, side: float) -> list[str]:
    """Return the collision-free named states that all arms have, for the task of a starter cell.
    The state "home" comes last.
    """
    tables = [model.named_states.get(arm.name, {}) for arm in _arms(model)]
    shared = [s for s in (tables[0] if tables else {}) if all(s in t for t in tables)]
    free = [s for s in shared if _free(model, {a.name: s for a in _arms(model)}, table, side)]
    return sorted(free, key=lambda s: (s == "home", s != "ready"))[-3:]
