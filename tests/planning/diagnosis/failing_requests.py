"""Thirty requests that fail, one for each cause: the scene, the request, and what must be said about them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from tests.planning.helpers import down, panda_wall, request, walled_in
from tests.scene.helpers import box, panda, ur10

from armcell.core import (
    SE3,
    SO3,
    CartesianRequest,
    ErrorCode,
    JointGoal,
    JointState,
    NamedGoal,
    PlanRequest,
    PoseGoal,
)
from armcell.scene import CollisionObject, PlanningScene

GeneratedMotion = tuple[PlanningScene, PlanRequest | CartesianRequest]


@dataclass(frozen=True)
class Failing:
    """A cause.

    Attributes:
        make: the scene and the request.
        names: each must be in the summary or the details: bodies, joints, parameters.
        pair: bodies, two of which some contact of the explanation must join.
    """

    code: ErrorCode
    make: Callable[[], GeneratedMotion]
    names: tuple[str, ...]
    pair: tuple[str, ...] = ()


def joints(**values: float) -> JointGoal:
    return JointGoal(JointState(tuple(f"panda_{k}" for k in values), list(values.values())))


def tip(scene: PlanningScene) -> SE3:
    return scene.frame_pose(scene.model.group("arm").tip_link)


def line(*waypoints: SE3, **options) -> CartesianRequest:
    return CartesianRequest("arm", waypoints, **options)


# --- starts ---
def start_in_itself() -> GeneratedMotion:
    return panda(joint2=-1.5, joint4=-3.0, joint6=0.5), request(NamedGoal("home"))


def start_in_an_object() -> GeneratedMotion:
    return panda(box("block", (0.1, 0.1, 0.1), (0.307, 0.0, 0.62))), request(NamedGoal("extended"))


def start_out_of_limits() -> GeneratedMotion:
    return panda_wall(), request(NamedGoal("home"), start=JointState(("panda_joint4",), [0.5]))


def start_not_a_number() -> GeneratedMotion:
    scene = panda()
    q = scene.positions.copy()
    q[2] = np.nan
    return replace(scene, positions=q), request(NamedGoal("extended"))


def held_in_the_table() -> GeneratedMotion:
    """A held cube that the gripper has pressed into the table it stood on, deeper than bodies rest."""
    scene = panda(joint2=0.55, joint4=-2.3, joint6=2.85)
    at = tip(scene).translation
    cube = box("cube", (0.04, 0.04, 0.06), at, movable=True)
    table = box("table", (0.6, 0.6, 0.04), (at[0], at[1], at[2] - 0.03 - 0.02 + 0.003))
    scene = PlanningScene.of(scene.model, scene.positions, [cube, table])
    fingers = ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    scene = scene.with_attached("cube", "panda_hand_tcp", touch_links=fingers)
    return scene, request(NamedGoal("home"))


# --- goals ---
def goal_in_an_object() -> GeneratedMotion:
    return panda_wall(), request(joints(joint1=0.0, joint2=0.6))


def goal_in_itself() -> GeneratedMotion:
    return panda(), request(joints(joint2=-1.5, joint4=-3.0, joint6=0.5))


def goal_out_of_limits() -> GeneratedMotion:
    return panda_wall(), request(joints(joint4=0.5))


def pose_out_of_reach() -> GeneratedMotion:
    return panda_wall(), request(PoseGoal(down(1.1, -0.3, 0.3)))


def pose_orientation_out_of_reach() -> GeneratedMotion:
    """The place can be reached, but not with the hand pointing back at the shoulder."""
    back = SO3.from_rpy((0.0, -np.pi / 2, 0.0))
    return panda(), request(PoseGoal(SE3(back, np.array([0.75, 0.0, 0.4]))))


def pose_in_an_object() -> GeneratedMotion:
    return panda_wall(), request(PoseGoal(down(0.55, 0.0, 0.2)))


def pose_beyond_limits() -> GeneratedMotion:
    """A UR10 that may turn its shoulder a quarter only: the pose is behind it."""
    scene = ur10()
    model = scene.model
    names = ("shoulder_pan_joint",)
    tight = {
        n: replace(j, limits=replace(j.limits, lower=-0.8, upper=0.8)) if n in names else j
        for n, j in model.joints.items()
    }
    q = np.array(scene.positions)
    q[model.columns(names)] = 0.0
    scene = PlanningScene(replace(model, joints=tight), q)
    here = tip(scene)
    turned = SE3(SO3.exp((0.0, 0.0, 1.6)), np.zeros(3)) @ here
    return scene, request(PoseGoal(turned))


def held_at_the_goal() -> GeneratedMotion:
    """A long bar in the hand that the goal puts into the wall."""
    scene = panda_wall()
    bar = box("bar", (0.02, 0.30, 0.02), tip(scene).shifted(z=-0.03).translation, movable=True)
    scene = scene.with_object(bar)
    fingers = ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    scene = scene.with_attached("bar", "panda_hand_tcp", touch_links=fingers)
    return scene, request(PoseGoal(down(0.5, -0.13, 0.25)))


def padding_at_the_goal() -> GeneratedMotion:
    """The wall is 30 mm from the hand at the goal, the padding 60 mm."""
    scene = panda_wall().with_padding(0.06)
    return scene, request(PoseGoal(down(0.5, -0.15, 0.25)))


def no_goal() -> GeneratedMotion:
    return panda_wall(), request(())


# --- motions ---
def _one(name: str, scene: PlanningScene, y: float = 0.0) -> CollisionObject:
    """All objects of a scene as one, moved along y [m]."""
    shapes = [
        (shape, i.T_world_object.shifted(y=y) @ T) for i in scene.objects.values() for shape, T in i.shapes
    ]
    return CollisionObject(name, tuple(shapes))


LAMP = box("lamp", (0.1, 0.1, 0.1), (1.2, 0.9, 1.2))


def behind_one_wall() -> GeneratedMotion:
    """A curtain all the way between start and goal; a lamp that is in nobody's way."""
    scene, goal = walled_in()
    scene = PlanningScene.of(scene.model, scene.positions, [_one("curtain", scene), LAMP])
    return scene, request(goal, planning_time=0.5)


def behind_two_walls() -> GeneratedMotion:
    """Two such curtains, 20 mm apart: neither of them alone opens the way."""
    scene, goal = walled_in()
    two = [_one("first", scene, 0.01), _one("second", scene, -0.01), LAMP]
    return PlanningScene.of(scene.model, scene.positions, two), request(goal, planning_time=0.5)


def padding_closes_the_way() -> GeneratedMotion:
    """The curtain has a window, wide enough for the hand, but not with 250 mm around it."""
    scene, goal = walled_in()
    scene = scene.without_object("front")
    above = box("above", (1.4, 0.02, 1.0), (0.85, 0.0, 1.2))
    below = box("below", (1.4, 0.02, 0.2), (0.85, 0.0, 0.05))
    padding = {f"panda_{name}": 0.25 for name in ("hand", "link6", "link7", "leftfinger", "rightfinger")}
    scene = scene.with_object(above).with_object(below).with_padding(link_padding=padding)
    return scene, request(goal, planning_time=0.5)


def too_little_time() -> GeneratedMotion:
    """A millisecond for OMPL's RRT in the wall scene."""
    return panda_wall(), request(
        PoseGoal(down(0.5, 0.25, 0.2)), planning_time=1e-3, planner_id="RRT", pipeline_id="ompl"
    )


def too_heavy() -> GeneratedMotion:
    """A lump of 12 kg in a Panda's hand, the arm stretched out."""
    scene = panda()
    lump = box("lump", (0.05, 0.05, 0.05), tip(scene).translation, movable=True, mass=12.0)
    scene = scene.with_object(lump)
    fingers = ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    scene = scene.with_attached("lump", "panda_hand_tcp", touch_links=fingers)
    return scene, request(NamedGoal("extended"), torque_limits=True)


# --- straight lines ---
def line_jumps() -> GeneratedMotion:
    scene = panda()
    return scene, line(tip(scene).shifted(z=-0.2), jump_threshold=3e-3)


def line_at_a_limit() -> GeneratedMotion:
    scene = ur10()
    upper = scene.model.joint("wrist_3_joint").limits.upper
    scene = scene.with_state(JointState(("wrist_3_joint",), [upper - 0.2]))
    T = tip(scene)
    return scene, line(SE3(T.rotation @ SO3.from_rpy((0, 0, 0.9)), T.translation))


def line_into_an_object() -> GeneratedMotion:
    start = tip(panda())
    plate = box("plate", (0.3, 0.3, 0.02), (start.translation[0], 0.0, start.translation[2] - 0.25))
    return panda(plate), line(start.shifted(z=-0.3))


def line_out_of_reach() -> GeneratedMotion:
    scene = panda()
    return scene, line(tip(scene).shifted(x=0.8))


def line_through_a_singularity() -> GeneratedMotion:
    """A UR10 passes straight over its own base: the shoulder would have to turn half round at once."""
    scene = ur10()
    T = tip(scene)
    over = SE3(T.rotation, T.translation * np.array([-1.0, -1.0, 1.0]))
    return scene, line(over)


# --- misuse ---
def unknown_group() -> GeneratedMotion:
    return panda_wall(), replace(request(NamedGoal("home")), group="arms")


def unknown_link() -> GeneratedMotion:
    return panda_wall(), request(PoseGoal(down(0.5, 0.25, 0.2), link="hand_tcp"))


def unknown_planner() -> GeneratedMotion:
    return panda_wall(), request(NamedGoal("home"), planner_id="RTTConnect")


def scaling_in_percent() -> GeneratedMotion:
    return panda_wall(), request(NamedGoal("home"), velocity_scaling=30)


def contradictory_limits() -> GeneratedMotion:
    return panda_wall(), request(NamedGoal("home"), torque_limits=True, jerk_limits=True)


E = ErrorCode
REQUESTS: dict[str, Failing] = {
    "start in self-collision": Failing(
        E.START_STATE_IN_COLLISION, start_in_itself, ("panda_link2",), ("panda_hand", "panda_link2")),
    "start in an object": Failing(
        E.START_STATE_IN_COLLISION, start_in_an_object, ("block",), ("panda_hand", "block")),
    "start out of limits": Failing(E.START_STATE_INVALID, start_out_of_limits, ("panda_joint4",)),
    "start not a number": Failing(E.START_STATE_INVALID, start_not_a_number, ("panda_joint3",)),
    "held object in collision at the start": Failing(
        E.START_STATE_IN_COLLISION, held_in_the_table, ("cube", "table"), ("cube", "table")),
    "goal in an object": Failing(E.GOAL_IN_COLLISION, goal_in_an_object, ("wall",), ("wall", "panda_hand")),
    "goal in self-collision": Failing(
        E.GOAL_IN_COLLISION, goal_in_itself, ("panda_link2",), ("panda_hand", "panda_link2")),
    "goal out of limits": Failing(E.GOAL_STATE_INVALID, goal_out_of_limits, ("panda_joint4",)),
    "pose out of reach": Failing(E.NO_IK_SOLUTION, pose_out_of_reach, ("beyond the arm's reach",)),
    "orientation out of reach": Failing(E.NO_IK_SOLUTION, pose_orientation_out_of_reach, ("closest",)),
    "pose in an object": Failing(E.GOAL_IN_COLLISION, pose_in_an_object, ("wall",), ("wall",)),
    "pose beyond joint limits": Failing(E.NO_IK_SOLUTION, pose_beyond_limits, ("shoulder_pan_joint",)),
    "held object in collision at the goal": Failing(
        E.GOAL_IN_COLLISION, held_at_the_goal, ("bar", "wall"), ("bar", "wall")),
    "padding too large at the goal": Failing(E.GOAL_IN_COLLISION, padding_at_the_goal, ("padding", "wall")),
    "no goal": Failing(E.INVALID_GOAL_CONSTRAINTS, no_goal, ("home", "extended")),
    "one object blocks the way": Failing(E.TIMED_OUT, behind_one_wall, ("without curtain",)),
    "two objects block the way": Failing(
        E.TIMED_OUT, behind_two_walls, ("no single object", "first and second")),
    "padding closes the way": Failing(E.TIMED_OUT, padding_closes_the_way, ("padding",)),
    "too little time": Failing(E.TIMED_OUT, too_little_time, ("planning_time",)),
    "too heavy": Failing(E.PLANNING_FAILED, too_heavy, ("panda_joint", "lump")),
    "line jumps": Failing(E.PLANNING_FAILED, line_jumps, ("panda_joint", "jump")),
    "line at a joint limit": Failing(E.NO_IK_SOLUTION, line_at_a_limit, ("wrist_3_joint",)),
    "line into an object": Failing(E.INVALID_MOTION_PLAN, line_into_an_object, ("plate",), ("plate",)),
    "line out of reach": Failing(E.NO_IK_SOLUTION, line_out_of_reach, ("the last waypoint is out of reach",)),
    "line through a singularity": Failing(
        E.NO_IK_SOLUTION, line_through_a_singularity, ("singularity",)),
    "unknown group": Failing(E.INVALID_GROUP_NAME, unknown_group, ("arms", "arm_and_hand")),
    "unknown link": Failing(E.INVALID_LINK_NAME, unknown_link, ("hand_tcp", "panda_hand_tcp")),
    "unknown planner": Failing(E.FAILURE, unknown_planner, ("RTTConnect", "RRTConnect", "AORRTC")),
    "scaling in percent": Failing(E.FAILURE, scaling_in_percent, ("velocity scaling", "30 percent are 0.3")),
    "contradictory limits": Failing(E.FAILURE, contradictory_limits, ("torque", "jerk")),
}  # fmt: skip
