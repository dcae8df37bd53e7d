"""Visibility constraints: MoveIt's rule, against rays through trimesh and angles told by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from tests.planning.helpers import request
from tests.scene.helpers import box, panda

from armcell.core import (
    SE3,
    SO3,
    Box,
    CartesianRequest,
    ConstraintGoal,
    Constraints,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    PoseGoal,
    UnknownNameError,
    VisibilityConstraint,
)
from armcell.kinematics import kinematic_tree
from armcell.planning import constraint_errors, plan, plan_cartesian, satisfies_constraints
from armcell.planning.constraints.visibility import visibility

FACING = SO3.from_rpy((np.pi, 0.0, 0.0))  # of a disc before a sensor: its z looks back at it


def seen_from(eye: SE3, distance: float, tilt=(0.0, 0.0, 0.0), **options) -> VisibilityConstraint:
    """A sensor that stands in the world (as a camera frame would) and a disc ahead of it."""
    target = eye @ SE3.from_xyz(0, 0, distance) @ SE3(FACING @ SO3.exp(tilt), np.zeros(3))
    return VisibilityConstraint("world", target, 0.05, T_link_sensor=eye, **options)


LOOKING_UP = SE3.from_xyz(1.5, 1.5, 0.0)  # far from the robot


def test_angles():
    scene = panda()
    error, excess, words = visibility(scene, seen_from(LOOKING_UP, 1.0, (0.3, 0, 0), max_view_angle=0.4))
    assert error == pytest.approx([0.3, 0.0, 0.0], abs=1e-9) and not excess.any() and not words
    _, excess, words = visibility(scene, seen_from(LOOKING_UP, 1.0, (0.3, 0, 0), max_view_angle=0.1))
    assert excess[0] == pytest.approx(0.2) and "17.2 deg past the target's axis, 11.5 too far" in words
    aside = VisibilityConstraint(
        "world", SE3.from_xyz(0.2, 0.0, 1.0) @ SE3(FACING, LOOKING_UP.translation), 0.05,
        T_link_sensor=LOOKING_UP, max_range_angle=0.1,
    )  # fmt: skip
    _, excess, _ = visibility(scene, aside)
    assert excess[1] == pytest.approx(np.arctan(0.2) - 0.1)


def test_the_wrong_side_and_the_edge():
    scene = panda()
    for limit, wrong in ((None, 0.0), (np.pi, 0.7)):
        _, excess, _ = visibility(
            scene, seen_from(LOOKING_UP, 1.0, (np.pi / 2 + 0.7, 0, 0), max_view_angle=limit)
        )
        assert excess[0] == pytest.approx(wrong)
    _, excess, words = visibility(scene, seen_from(LOOKING_UP, 1.0, (np.pi / 2, 0, 0)))
    assert excess[0] > 1 and "from its edge" in words


def test_the_axis_a_sensor_looks_along():
    scene = panda()
    c = seen_from(LOOKING_UP, 1.0, max_range_angle=0.1, view_axis="x")
    assert visibility(scene, c)[0][1] == pytest.approx(np.pi / 2)


def hit(eye, ends, triangles) -> bool:
    """Whether a segment from eye (3,) to one of ends (r, 3) meets a triangle (t, 3, 3): Moeller-Trumbore."""
    v0, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    way = (ends - eye)[:, None]
    p = np.cross(way, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.einsum("rtk,tk->rt", p, e1)
        u = np.einsum("rtk,tk->rt", p, eye - v0) * inverse
        q = np.cross(eye - v0, e1)
        v = np.einsum("rtk,tk->rt", np.broadcast_to(way, p.shape), q) * inverse
        t = np.einsum("tk,tk->t", q, e2) * inverse
        return bool(np.any((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)))


def surfaces(scene) -> dict[str, np.ndarray]:
    """Triangles (t, 3, 3) of each link, where the scene has it."""
    tree = kinematic_tree(scene.model)
    Ts, found = tree.link_transforms(scene.positions), {}
    for link in scene.model.links.values():
        parts = []
        for c in link.collisions:
            T = SE3.from_matrix(Ts[tree.link_index[link.name]]) @ c.T_link_shape
            extents = 2 * c.shape.half_extents if isinstance(c.shape, Box) else None
            surface = c.shape if extents is None else trimesh.creation.box(extents)
            parts.append(T.apply(surface.vertices)[surface.faces])
        if parts:
            found[link.name] = np.concatenate(parts)
    return found


@pytest.mark.slow
def test_links_in_the_view_are_those_that_rays_meet():
    """Cones past and through the Panda from random places, beside 300 segments within each."""
    scene, rng = panda(), np.random.default_rng(0)
    solids = surfaces(scene)
    assert len(solids) >= 9
    met_some = clear = 0
    for _ in range(25):
        eye = rng.uniform((0.4, -0.8, 0.0), (1.2, -0.5, 1.0))
        end = rng.uniform((-0.4, 0.5, 0.0), (0.4, 0.9, 1.0))
        z = (end - eye) / np.linalg.norm(end - eye)
        x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
        y = np.cross(z, x)
        sensor = SE3.from_matrix(np.vstack([np.column_stack([x, y, z, eye]), [0, 0, 0, 1]]))
        c = VisibilityConstraint(
            "world", SE3(sensor.rotation @ FACING, end), 0.06, T_link_sensor=sensor, cone_sides=12
        )
        _, excess, words = visibility(scene, c)
        r, turn = 0.06 * np.cos(np.pi / 12) * np.sqrt(rng.random(300)), rng.uniform(0, 2 * np.pi, 300)
        ends = end + np.outer(r * np.cos(turn), x) + np.outer(r * np.sin(turn), y)
        met = {name for name, triangles in solids.items() if hit(eye, ends, triangles)}
        told = set(words.split(" in the view of ")[0].split(", ")) if words else set()
        assert met <= told  # a link that a segment meets is in the cone
        if excess[2] > 5e-3:  # and one that is deep in it is met by some
            assert met
        met_some, clear = met_some + bool(met), clear + (not excess[2])
    assert met_some >= 5 and clear >= 5


def test_the_sensor_s_own_link_does_not_count():
    """A camera inside the hand, looking out of it: the fingers are in its view."""
    scene = panda()
    target = SE3.from_xyz(0, 0, 0.4) @ SE3(FACING, np.zeros(3))
    c = VisibilityConstraint("panda_hand", target, 0.2, frame="panda_hand")
    _, excess, words = visibility(scene, c)
    assert excess[2] > 0
    assert words.split(" in the view of ")[0] == "panda_leftfinger, panda_rightfinger"
    held = scene.with_object(box("part", (0.3, 0.3, 0.02), scene.frame_pose("panda_hand").translation))
    assert visibility(held.with_attached("part", "panda_hand"), c)[2] == words  # attached: not looked at


@pytest.mark.slow
def test_as_a_goal():
    """A camera on the wrist finds a pose from which it sees a disc on the floor."""
    scene = panda()
    view = VisibilityConstraint(
        "panda_link8", SE3.from_xyz(0.6, 0.1, 0.0), 0.03, T_link_sensor=SE3.from_xyz(0.08, 0.0, 0.0),
        max_view_angle=0.5, max_range_angle=0.5,
    )  # fmt: skip
    wanted = Constraints(visibilities=(view,))
    names = scene.model.group("arm").joint_names
    here = scene.with_state(scene.model.named_state("arm", "extended"))
    assert not satisfies_constraints(here, "arm", wanted, here.state.reindexed(names).positions)
    result = plan(here, request(ConstraintGoal(wanted)))
    assert result.ok, result.message
    (error,) = constraint_errors(here, "arm", wanted, result.trajectory.positions[-1])
    assert error.ok and error.error[0] <= 0.5 and error.error[1] <= 0.5 and error.error[2] == 0.0


def test_what_is_refused():
    scene, good = panda(), seen_from(LOOKING_UP, 1.0)

    def goal(**changes):
        return plan(scene, request(ConstraintGoal(Constraints(visibilities=(replace(good, **changes),)))))

    for changes, error, said in (
        ({"sensor": "camra"}, UnknownNameError, "panda_hand"),
        ({"view_axis": "y"}, UnknownNameError, "x, z"),
        ({"target_radius": 0.0}, InputError, "must be positive"),
        ({"cone_sides": 2}, InputError, "at least 3"),
        ({"max_view_angle": -0.1}, InputError, "max_view_angle"),
    ):
        with pytest.raises(error, match=said):
            goal(**changes)


def unseen(scene, trajectory, c: VisibilityConstraint, step: float = 0.02) -> tuple[float, float, int]:
    """Largest view and range angle [rad] along a motion; at how many moments rays to the disc meet a link."""
    rng, view, range_, met = np.random.default_rng(1), 0.0, 0.0, 0
    for t in np.append(np.arange(0.0, trajectory.duration, step), trajectory.duration):
        at = scene.with_state(JointState(trajectory.joint_names, trajectory.sample(t)[0]))
        sensor, disc = at.frame_pose(c.sensor) @ c.T_link_sensor, at.frame_pose(c.frame) @ c.T_frame_target
        looks, way = sensor.rotation.matrix[:, 2], disc.translation - sensor.translation
        ahead, at_it = -looks @ disc.rotation.matrix[:, 2], looks @ way / np.linalg.norm(way)
        view, range_ = max(view, np.arccos(min(ahead, 1.0))), max(range_, np.arccos(min(at_it, 1.0)))
        r = c.target_radius * np.cos(np.pi / c.cone_sides) * np.sqrt(rng.random(60))
        turn = rng.uniform(0, 2 * np.pi, 60)
        ends = disc.apply(np.column_stack([r * np.cos(turn), r * np.sin(turn), np.zeros(60)]))
        links = {n: s for n, s in surfaces(at).items() if n != c.sensor}
        met += any(hit(sensor.translation, ends, triangles) for triangles in links.values())
    return view, range_, met


def looking(eye, end) -> SE3:
    z = np.subtract(end, eye) / np.linalg.norm(np.subtract(end, eye))
    x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
    return SE3.from_matrix(np.vstack([np.column_stack([x, np.cross(z, x), z, eye]), [0, 0, 0, 1]]))


@pytest.mark.long
def test_along_a_path_the_arm_stays_out_of_a_camera_s_view():
    """A camera that stands before the robot watches the table; the arm does not go through the view."""
    scene = panda(joint1=-0.8, joint2=0.3, joint4=-2.2, joint6=2.5)
    q = scene.state.reindexed(scene.model.group("arm").joint_names)
    goal = JointGoal(q.updated(JointState(("panda_joint1",), [0.8])))
    sensor = looking([1.2, 0.0, 0.9], [0.45, 0.0, 0.0])
    target = SE3(sensor.rotation @ FACING, np.array([0.45, 0.0, 0.0]))
    view = VisibilityConstraint("world", target, 0.05, T_link_sensor=sensor)
    through = plan(scene, request(goal))
    assert through.ok and unseen(scene, through.trajectory, view)[2] > 3
    kept = request(goal, path_constraints=Constraints(visibilities=(view,)), planning_time=60.0)
    result = plan(scene, kept)
    assert result.ok, result.message
    assert unseen(scene, result.trajectory, view)[2] == 0
    # A line into the view ends at its edge, and says so.
    middle = scene.with_state(JointState(("panda_joint1",), [0.0])).frame_pose("panda_hand")
    into = CartesianRequest("arm", (middle,), link="panda_hand", path_constraints=kept.path_constraints)
    line = plan_cartesian(scene, into)
    assert not line.ok and 0 < line.fraction < 1 and "in the view of world" in line.message
    assert unseen(scene, line.trajectory, view)[2] == 0


@pytest.mark.slow
def test_along_a_path_the_hand_keeps_looking():
    """A camera on the wrist looks at a disc on the floor while the hand passes over it."""
    down, free = SO3.from_rpy((np.pi, 0.0, 0.0)), panda()
    first = plan(free, request(PoseGoal(SE3(down, np.array([0.5, -0.25, 0.5])))))
    scene = free.with_state(JointState(first.trajectory.joint_names, first.trajectory.positions[-1]))
    view = VisibilityConstraint(
        "panda_link8", SE3.from_xyz(0.6, 0.0, 0.0), 0.03, T_link_sensor=SE3.from_xyz(0.08, 0.0, 0.0),
        max_view_angle=0.8, max_range_angle=0.6,
    )  # fmt: skip
    over = PoseGoal(SE3(down, np.array([0.5, 0.25, 0.5])))
    result = plan(
        scene, request(over, path_constraints=Constraints(visibilities=(view,)), planning_time=60.0)
    )
    assert result.ok, result.message
    angle, range_, met = unseen(scene, result.trajectory, view)
    assert angle <= 0.8 and range_ <= 0.6 and met == 0
    tight = replace(view, max_range_angle=0.1)
    refused = plan(scene, request(over, path_constraints=Constraints(visibilities=(tight,))))
    assert refused.code is ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS and "too far" in refused.message
