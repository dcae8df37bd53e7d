"""Plans and lines from a start in resting contact: every planner leads out of it, or says why not."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from tests.planning.helpers import panda_wall, request
from tests.planning.resting import (
    ARM,
    FINGERS,
    REACH,
    SINK,
    brought_to,
    holding,
    in_a_corner,
    judge_from_rest,
    on_table,
    turned,
)
from tests.planning.test_plan import beyond_panda
from tests.scene.helpers import box, panda, ur10
from tests.sizes import seeds

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import resting_pairs
from armcell.core import (
    ADAPTERS,
    SE3,
    SO3,
    CartesianRequest,
    Constraints,
    ErrorCode,
    JointConstraint,
    JointGoal,
    JointState,
    NamedGoal,
    OrientationConstraint,
    PoseGoal,
    SequenceRequest,
)
from armcell.planning import plan, plan_around_moving_obstacles, plan_cartesian, plan_sequence
from armcell.planning.plan_library import PlanLibrary
from armcell.planning.planners.registry import pipelines
from armcell.scene import MovingObject

SEARCHING = [
    (pipeline, name) for pipeline in ("native", "ompl", "chomp", "stomp") for name in pipelines[pipeline]
]
SLOW = ("InformedRRTstar", "RRTstar", "SORRTstar")  # may find nothing in seven dimensions; they say so
SLOWLY = {"velocity_scaling": 0.3, "acceleration_scaling": 0.3}
ASIDE = JointGoal(JointState(("panda_joint1",), [0.8]))


def tip(scene):
    return scene.frame_pose("panda_hand_tcp")


def line(scene, *poses, **options):
    return plan_cartesian(scene, CartesianRequest("arm", poses, **options))


def with_a_post():
    """The held cube stands on the table; a post is across the straight motion: planners search."""
    scene = on_table(padding=0.0)
    goal = scene.positions[:7].copy()
    goal[:2] = (0.9, -0.2)
    middle = JointState(ARM, (goal + scene.positions[:7]) / 2)
    post = box("post", (0.02, 0.02, 0.02), tip(scene.with_state(middle)).translation)
    return scene.with_object(post), JointGoal(JointState(ARM, goal))


# --- free-space planning ---
@pytest.mark.slow
@pytest.mark.cases(
    "native-RRTConnect",
    "native-PRM",
    "native-EST",
    "ompl-RRTConnect",
    "ompl-FMT",
    "ompl-PRM",
    "chomp-CHOMP",
    "stomp-STOMP",
)
@pytest.mark.parametrize(("pipeline", "name"), SEARCHING)
def test_every_planner_leads_out_of_resting_contact(pipeline, name):
    scene, goal = with_a_post()
    result = plan(scene, request(goal, pipeline_id=pipeline, planner_id=name, planning_time=6.0, seed=1))
    if name in SLOW and result.code is ErrorCode.TIMED_OUT:
        return
    assert result.ok, result.message
    assert result.planner_id == name
    judge_from_rest(scene, result.trajectory)
    np.testing.assert_array_equal(result.path.waypoints[0], scene.positions[:7])
    assert result.evidence["start_repaired"]["begins_at"] == "actual start"


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(pipelines["pilz"]))
def test_industrial_motions_lead_out_of_resting_contact(name):
    scene = on_table()
    there = tip(scene).shifted(y=0.2, z=0.1)
    goals = {"PTP": ASIDE, "LIN": PoseGoal(there), "CIRC": PoseGoal(there)}
    options = {"parameters": {"interim": tuple(tip(scene).shifted(y=0.1, z=0.12).translation)}}
    result = plan(scene, request(goals[name], pipeline_id="pilz", planner_id=name, **SLOWLY,
                                 **(options if name == "CIRC" else {})))  # fmt: skip
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)


def test_a_sequence_begins_with_the_way_out():
    scene = on_table()
    straight = {"pipeline_id": "pilz", "planner_id": "LIN", **SLOWLY}
    steps = (
        (request(PoseGoal(tip(scene).shifted(z=0.15)), **straight), 0.05),
        (request(PoseGoal(tip(scene).shifted(y=0.2, z=0.15)), **straight), 0.0),
    )
    result = plan_sequence(scene, SequenceRequest(steps))
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)
    assert result.min_clearance > 0.009  # of fingers and table


@pytest.mark.slow
@pytest.mark.parametrize("sink", [0.0, 1e-4, 1e-3, 1.9e-3])
def test_the_way_out_is_short_and_straight_off_the_surface(sink):
    scene = on_table(sink)
    result = plan(scene, request(ASIDE))
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)
    left = tip(scene.with_state(JointState(ARM, result.evidence["start_repaired"]["to"])))
    meters, radians = tip(scene).distance_to(left)
    assert meters < 0.012 and radians < 0.02
    step = left.translation - tip(scene).translation
    assert step[2] > 0.99 * meters
    assert "first leaves contact: cube touches table" in result.message
    assert 0.0 < result.min_clearance < 0.01 + 1e-6


def test_two_contacts_are_left_at_once():
    scene = in_a_corner()
    result = plan(scene, request(NamedGoal("home")))
    assert result.ok, result.message
    assert len(result.evidence["start_repaired"]["contacts"]) == 2
    judge_from_rest(scene, result.trajectory)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"jerk_limits": True}, {"torque_limits": True}, {"max_cartesian_speed": 0.1}, {"velocity_scaling": 0.1}],
    ids=lambda options: next(iter(options)),
)
def test_limits_hold_on_the_way_out(options):
    scene = on_table()
    result = plan(scene, request(ASIDE, **options))
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)
    names, t = result.trajectory.joint_names, result.trajectory
    share = options.get("velocity_scaling", 1.0)
    assert np.all(np.abs(t.velocities) <= share * scene.model.limits(names, "velocity") * 1.001)


def test_a_held_cup_stays_upright_on_the_way_out():
    scene = on_table()
    R = scene.frame_pose("cube").rotation
    upright = Constraints(orientations=(OrientationConstraint(R, (0.05, 0.05, np.pi), link="cube"),))
    result = plan(scene, request(ASIDE, path_constraints=upright))
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)
    for t in np.linspace(0, result.trajectory.duration, 100):
        q = result.trajectory.sample(t)[0]
        now = scene.with_state(JointState(ARM, q)).frame_pose("cube").rotation
        assert now.matrix[2, 2] > np.cos(0.08)


def test_a_way_out_that_leaves_the_path_constraints_is_not_gone():
    scene = on_table()
    fixed = Constraints(
        joints=tuple(JointConstraint(n, float(q), 1e-4, 1e-4) for n, q in zip(ARM[1:], scene.positions[1:7]))
    )
    result = plan(scene, request(ASIDE, path_constraints=fixed))
    assert result.code is ErrorCode.START_STATE_IN_COLLISION
    assert "path constraints" in result.message and "table" in result.message


def test_obstacles_that_move_are_kept_off_from_a_resting_start_too():
    scene = on_table()
    ball = box("ball", (0.05, 0.05, 0.05), (0.3, 0.9, 0.4))
    item = MovingObject(
        ball, np.array([0.0, 3.0]), (SE3.from_xyz(0.3, 0.9, 0.4), SE3.from_xyz(0.6, 0.1, 0.4))
    )
    result = plan_around_moving_obstacles(scene, request(ASIDE), [item])
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)


def test_the_plan_library_passes_resting_starts_on(tmp_path):
    scene, library = on_table(), PlanLibrary(tmp_path)
    for _ in range(2):
        result = library.plan(scene, request(ASIDE))
        assert result.ok, result.message
        judge_from_rest(scene, result.trajectory)


def test_the_hand_may_open_off_what_its_fingers_touch():
    """A group of fingers alone: a post leans against one from outside, and the hand closes."""
    scene = panda(finger_joint1=0.02)
    post = box("post", (0.02, 0.02, 0.1), tip(scene).shifted(y=-0.3).translation)
    scene = brought_to(scene, post, np.array([0.0, 1.0, 0.0]), SINK, "hand")
    closer = JointGoal(JointState(("panda_finger_joint1",), [0.005]))
    result = plan(scene, replace(request(closer), group="hand"))
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)


# --- straight lines ---
@pytest.mark.parametrize("sink", [0.0, SINK, 1.5e-3])
def test_a_held_object_is_lifted_straight_off_the_table(sink):
    """Issue 20, item 2: today 0 %."""
    scene = on_table(sink)
    above = tip(scene).shifted(z=0.1)
    result = line(scene, above)
    assert result.ok and result.fraction == 1.0, result.message
    judge_from_rest(scene, result.trajectory)
    ends = tip(scene.with_state(JointState(ARM, result.trajectory.positions[-1])))
    assert ends.isclose(above, 1e-4, 1e-3)
    for t in np.linspace(0, result.trajectory.duration, 60):  # straight
        at = tip(scene.with_state(JointState(ARM, result.trajectory.sample(t)[0]))).translation
        assert np.linalg.norm((at - tip(scene).translation)[:2]) < 1e-3
    assert result.min_clearance > 0.005  # of fingers and table: the cube moves apart all along


def test_a_line_may_lead_out_at_an_angle_and_on():
    scene = on_table()
    result = line(scene, tip(scene).shifted(x=-0.05, z=0.03), tip(scene).shifted(x=-0.05, y=0.2, z=0.03))
    assert result.ok, result.message
    judge_from_rest(scene, result.trajectory)


@pytest.mark.parametrize("offset", [{"z": -0.05}, {"y": 0.1}, {"y": 0.1, "z": 0.001}], ids=str)
def test_a_line_that_presses_or_drags_stops_with_the_pair_and_a_hint(offset):
    scene = on_table()
    result = line(scene, tip(scene).shifted(**offset))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and result.fraction == 0.0
    assert result.path is None and result.trajectory is None
    assert "cube touches table" in result.message and "a few millimeters off" in result.message
    contact = result.evidence["contacts"][0]
    assert {contact.body_a, contact.body_b} == {"cube", "table"}


def test_a_line_that_comes_back_stops_where_it_does():
    scene = on_table()
    result = line(scene, tip(scene).shifted(z=0.05), tip(scene).shifted(y=0.1, z=-0.02))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and 0.5 < result.fraction < 1.0
    assert "table" in result.message and "does not lead out" not in result.message
    judge_from_rest(scene, result.trajectory)


def test_a_line_is_blocked_by_all_else_as_ever():
    x, y, z = tip(holding()).translation
    bar = box("cube", (0.3, 0.04, 0.04), (x, y, z))
    scene = on_table(item=bar).with_object(box("shelf", (0.02, 0.3, 0.02), (x + 0.13, y, z + 0.06)))
    result = line(scene, tip(scene).shifted(z=0.1))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and 0.0 < result.fraction < 1.0
    assert "shelf" in result.message
    judge_from_rest(scene, result.trajectory)


# --- refusals ---
def test_a_contact_that_is_too_deep_is_refused_with_pair_depth_and_remedy():
    scene = on_table(0.004)
    for result in (plan(scene, request(ASIDE)), line(scene, tip(scene).shifted(z=0.1))):
        assert result.code is ErrorCode.START_STATE_IN_COLLISION
        assert "cube touches table (4.0 mm deep)" in result.message and "up to 2 mm" in result.message
        assert "fix_start_state_collision" in result.message


def test_the_adapter_leaves_what_is_deeper_by_the_same_departure():
    scene = on_table(0.004)
    result = plan(scene, request(ASIDE, adapters=("fix_start_state_collision", *ADAPTERS)))
    assert result.ok, result.message
    report = result.evidence["start_repaired"]
    assert report["begins_at"] == "actual start"
    left = tip(scene.with_state(JointState(ARM, report["to"])))
    assert left.translation[2] - tip(scene).translation[2] == pytest.approx(0.012, abs=1e-3)


@pytest.mark.slow
def test_an_object_between_the_fingers_cannot_be_left_and_that_is_said():
    scene = panda(**REACH)
    x, y, z = tip(scene).translation
    width = 2 * scene.state["panda_finger_joint1"]
    scene = scene.with_object(box("block", (0.02, width + 4e-4, 0.02), (x, y, z)))
    checker = KernelChecker(scene, ARM)
    assert len(resting_pairs(checker.exact, scene.positions[:7])) == 2
    began = time.monotonic()
    result = plan(scene, request(NamedGoal("home")))
    assert result.code is ErrorCode.START_STATE_IN_COLLISION
    assert "block" in result.message and "Open the gripper" in result.message
    assert time.monotonic() - began < 20.0
    text = result.explain(20.0).text()
    assert "no motion of arm leads out" in text and "block" in text


def test_a_goal_in_contact_is_refused_as_ever():
    scene = on_table()
    above = plan(scene, request(NamedGoal("home"))).trajectory.positions[-1]
    result = plan(
        scene.with_state(JointState(ARM, above)), request(JointGoal(JointState(ARM, scene.positions[:7])))
    )
    assert result.code is ErrorCode.GOAL_IN_COLLISION


def test_free_starts_are_not_looked_at(monkeypatch):
    """Plans from them are as they were, and as fast: nothing of this is called."""
    import armcell.planning.pipeline as pipeline
    from armcell.planning.cartesian import plan as cartesian

    monkeypatch.setattr(pipeline, "leave_start_contact", None)
    monkeypatch.setattr(cartesian, "RestingStartRule", None)
    assert plan(panda_wall(), request(beyond_panda())).ok
    assert line(panda(), tip(panda()).shifted(z=-0.05)).ok


# --- properties ---
@pytest.mark.slow
@pytest.mark.cases("0", "2", "3")
@pytest.mark.parametrize("seed", seeds(6, range(24)))
def test_random_resting_contacts_are_left(seed):
    """A held box of any size and orientation on a slab of any slope; a second slab for every other seed; a
    finger against a block of any orientation for every third."""
    rng = np.random.default_rng(seed)
    kind = ("slab", "slab and wall", "finger")[seed % 3]
    left = 0
    for _ in range(3):
        scene = random_rest(rng, kind)
        result = plan(scene, request(NamedGoal("home"), seed=seed))
        if result.ok:
            left += 1
            judge_from_rest(scene, result.trajectory)
        else:
            assert result.code is not ErrorCode.START_STATE_IN_COLLISION or "touch" in result.message
    assert left >= 2


def random_rest(rng: np.random.Generator, kind: str):
    """Touching at the start: only what was brought there."""
    while True:
        base = panda(**{f"joint{k}": v for k, v in zip((1, 2, 4, 6), (rng.uniform(-1, 1), 0.3, -2.2, 2.5))})
        at = tip(base).translation
        sink = float(rng.choice([0.0, 1e-4, 5e-4, 1.5e-3]))
        scene = base
        if kind != "finger":
            cube = box("cube", rng.uniform(0.02, 0.08, 3), at)
            cube = cube.at(SE3(turned(rng), at + np.array([0, 0, -0.02])))
            scene = base.with_object(cube).with_attached("cube", "panda_hand", FINGERS)
        sides = [np.array([rng.normal(0, 0.3), rng.normal(0, 0.3), 1.0])]
        if kind == "slab and wall":
            angle = rng.uniform(0, 2 * np.pi)
            sides.append(np.array([np.cos(angle), np.sin(angle), rng.normal(0, 0.1)]))
        size = (0.5, 0.5, 0.02) if kind != "finger" else tuple(rng.uniform(0.02, 0.05, 3))
        for k, normal in enumerate(sides):
            normal = normal / np.linalg.norm(normal)
            across = np.cross([0.0, 0.0, 1.0], normal)
            turn = SO3.exp(across / max(np.linalg.norm(across), 1e-9) * np.arccos(np.clip(normal[2], -1, 1)))
            rotation = turn if kind != "finger" else turned(rng)
            extent = size if k == 0 else (0.06, 0.06, 0.02)
            slab = box(f"slab{k}", extent).at(SE3(rotation, at - 0.25 * normal))
            scene = brought_to(scene, slab, normal, sink)
        scene = scene.with_padding(float(rng.choice([0.0, 0.005])))
        touching = resting_pairs(KernelChecker(scene, ARM).exact, scene.positions[:7], 1e-5)
        wanted = [f"slab{k}" for k in range(len(sides))]
        if all(any(name in pair for pair in touching) for name in wanted) and all(
            c.distance >= -2e-3 and any(n.startswith("slab") for n in pair) for pair, c in touching.items()
        ):
            return scene


@pytest.mark.slow
@pytest.mark.cases("0", "1")
@pytest.mark.parametrize("seed", seeds(3, range(12)))
def test_links_that_are_not_convex_are_led_out_too(seed):
    """A UR10 among whose links meshes are split into pieces that reach beyond them; a block leans on one."""
    rng = np.random.default_rng(seed)
    scene = ur10().with_padding(0.003)
    names = scene.model.group("arm").joint_names
    while True:
        q = rng.uniform((-1, -1.6, 0.8, -2, -1.8, -1), (1, -0.8, 1.6, 0, -1.2, 1))
        at = scene.with_state(JointState(names, q))
        link = str(rng.choice(["forearm_link", "upper_arm_link", "wrist_2_link", "wrist_3_link"]))
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        place = at.frame_pose(link).translation + rng.normal(0, 0.05, 3) - 0.7 * way
        block = box("block", rng.uniform(0.03, 0.15, 3)).at(SE3(turned(rng), place))
        if not KernelChecker(at.with_object(block), names).touches(q):
            at = brought_to(at, block, way, float(rng.choice([0.0, 3e-4, 1e-3])))
            break
    goal = JointGoal(JointState(names, q + rng.uniform(-0.5, 0.5, 6)))
    result = plan(at, request(goal))
    if result.code is ErrorCode.GOAL_IN_COLLISION:
        return
    assert result.ok, result.message
    judge_from_rest(at, result.trajectory)


def test_replanning_from_the_middle_of_the_way_out_works():
    """A motion that is stopped on its way out can begin again from where it is."""
    scene = on_table()
    result = plan(scene, request(ASIDE))
    for share in (0.02, 0.05, 0.1):
        q = result.trajectory.sample(share * result.trajectory.duration)[0]
        again = plan(replace(scene, positions=scene.with_state(JointState(ARM, q)).positions), request(ASIDE))
        assert again.ok, again.message
