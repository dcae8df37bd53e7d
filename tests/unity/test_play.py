"""The package's behaviours, played under Mono: what goes over the wire, and what joints' drives are told."""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np
import pytest
from scipy.interpolate import BPoly

from armcell.cell import cell_names, load
from armcell.core import SE3, ArmcellError, JointTrajectory
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.ros import Bus, schema
from armcell.ros.convert import trajectory_from_message
from armcell.ros.nodes import CellNode
from armcell.ros.unity import export_unity

pytestmark = pytest.mark.slow
S = schema()
STEP = 0.005  # [s] of the exported cells
ARM = tuple(f"panda_joint{i}" for i in range(1, 8))


def message(trajectory, **fields):
    """trajectory_msgs/JointTrajectory of a JointTrajectory."""
    Duration = S.message("builtin_interfaces/Duration")
    points = []
    for i, t in enumerate(trajectory.times):
        rows = {
            name: row[i]
            for name, row in (
                ("positions", trajectory.positions),
                ("velocities", trajectory.velocities),
                ("accelerations", trajectory.accelerations),
            )
            if row is not None
        }
        points.append(
            S.new("trajectory_msgs/JointTrajectoryPoint", **rows, time_from_start=Duration.from_sec(float(t)))
        )
    return S.new(
        "trajectory_msgs/JointTrajectory", joint_names=list(trajectory.joint_names), points=points, **fields
    )


def to(names, q, seconds, velocities=True):
    """From wherever the arm is to q, at rest."""
    row = np.atleast_2d(q)
    return message(JointTrajectory(names, np.array([seconds]), row, row * 0 if velocities else None))


def drives(rows):
    """Commanded positions (k, n) [rad or m] after each step, by joint; drives speak degrees."""
    found = {}
    for _, (name, target, _) in rows["drive"]:
        value = float(target)
        found.setdefault(name, []).append(value if "finger" in name else np.deg2rad(value))
    return {name: np.array(values) for name, values in found.items()}


def test_links_are_where_armcell_has_them(player, exported, scene):
    """Forward kinematics through Unity's axes, anchors and degrees, against ours."""
    cell, _ = exported
    model = cell.model
    tree, rng = kinematic_tree(model), np.random.default_rng(3)
    for case in range(4):
        q = rng.uniform(model.lower + 0.01, model.upper - 0.01)
        lines = [
            player().message(0.1, "/planned_trajectory", to(ARM, q[model.columns(ARM)], 1.0)),
            "poses 1.5",
        ]
        rows = player().play(scene, lines, 1.6)
        assert player().said(rows)[-1].startswith("done"), player().said(rows)
        q[model.columns(("panda_finger_joint1",))] = cell.scene().state["panda_finger_joint1"]
        Ts, seen = tree.link_transforms(q), 0
        names = [model.root_link, *(j.child for j in model.joints.values())]
        for _, (name, *numbers) in rows["pose"]:
            if name in names:
                x, y, z, qx, qy, qz, qw = map(float, numbers)
                T = SE3.from_quat_xyzw((z, -x, y), (qz, -qx, qy, -qw))
                meters, radians = T.distance_to(SE3.from_matrix(Ts[names.index(name)]))
                assert meters < 2e-6 and radians < 2e-6, (case, name, meters, radians)
                seen += 1
        assert seen == len(names)


@pytest.mark.cases("3")
@pytest.mark.parametrize("order", [1, 3, 5])
def test_trajectories_are_armcells(player, exported, scene, order):
    """What the drives are told at each step is armcell's own sample, and scipy's polynomial, to 1e-6."""
    cell, _ = exported
    rng = np.random.default_rng(order)
    start = cell.scene().state.reindexed(ARM).positions
    times = np.array([0.0, 0.4, 1.0, 1.3, 2.1])
    q = start + np.vstack([np.zeros(7), rng.uniform(-0.2, 0.2, (4, 7))])
    v = np.vstack([np.zeros(7), rng.uniform(-0.2, 0.2, (3, 7)), np.zeros(7)])
    a = np.vstack([np.zeros(7), rng.uniform(-0.5, 0.5, (3, 7)), np.zeros(7)])
    trajectory = JointTrajectory(ARM, times, q, v if order > 1 else None, a if order > 3 else None)
    rows = player().play(
        scene, ["drives", player().message(0, "/planned_trajectory", message(trajectory))], 2.5
    )
    assert player().said(rows)[0] == "executing 5 points, 2.10 s"
    told = drives(rows)
    derivatives = [q, v, a][: (order + 1) // 2]
    polynomial = BPoly.from_derivatives(times, np.stack(derivatives, axis=1))
    # Unity's fixedDeltaTime is a float: its steps are 5 ms to 1e-10
    at = np.minimum((np.arange(len(told["panda_joint1"])) + 1) * float(np.float32(STEP)), 2.1)
    worst = 0.0
    for i, name in enumerate(ARM):
        for k in range(len(at)):
            worst = max(worst, abs(told[name][k] - trajectory.sample(at[k])[0][i]))
            assert abs(told[name][k] - polynomial(at[k])[i]) < 1e-6
    assert worst < 1e-6


def test_it_says_what_our_own_simulator_says(player, exported, scene):
    """The words on /trajectory_status, one by one, those of CellNode for the same messages."""
    cell, _ = exported
    start = cell.scene().state.reindexed(ARM).positions
    wrong = JointTrajectory(ARM, np.array([0.0, 1.0]), np.vstack([start + np.linspace(0.3, 0.4, 7), start]))
    nan = to(ARM, start, 0.5)
    nan.points[0].positions = start * np.nan
    high = start.copy()
    high[3] = 0.5
    cases = [
        to(ARM, start + 0.05, 0.5),
        to(("panda_joint1", "panda_jointX"), [0.1, 0.1], 0.5),
        to(("panda_joint1", "panda_joint1"), [0.1, 0.1], 0.5),
        to(ARM, high, 0.5),
        nan,
        message(wrong),
        S.new("trajectory_msgs/JointTrajectory"),
        to(ARM, start, 0.5, velocities=False),
    ]
    lines = [player().message(i * 1.0, "/planned_trajectory", m) for i, m in enumerate(cases)]
    mine = player().said(player().play(scene, lines, len(cases)))

    bus, live = Bus(), cell.connect("fake")
    told = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=50)
    node = CellNode(live, bus)
    thread = node.start()
    assert node.ready.wait(60)
    theirs = []
    for m in cases:
        node._on_trajectory(m)
        while True:
            theirs.append(told.get(20).data)
            if theirs[-1].split(":")[0] in ("done", "refused", "failed"):
                break
    node.close()
    thread.join(10)

    def plain(text):
        """Without how exactly it arrived, and without the guess which name was meant."""
        return text.split(" (did you mean")[0].split("done: final error")[0]

    assert [plain(t) for t in mine] == [plain(t) for t in theirs]
    assert len(mine) == 11


def test_bad_trajectories_are_refused_in_our_words(player, exported, scene):
    """Hundreds of trajectories with something wrong in them, against `trajectory_from_message`."""
    cell, _ = exported
    rng, state = np.random.default_rng(0), cell.scene().state
    start = state.reindexed(ARM).positions
    Duration = S.message("builtin_interfaces/Duration")
    lines, wanted = [], []
    for i in range(300):
        q = np.vstack([start + 0.01 * (k + 1) for k in range(3)])
        times = np.array([0.1, 0.2, 0.3])
        m = message(JointTrajectory(ARM, times, q, q * 0, q * 0))
        for _ in range(int(rng.integers(0, 3))):
            if not m.points or len(m.joint_names) < 7:
                break
            point, joint = m.points[int(rng.integers(len(m.points)))], int(rng.integers(7))
            match int(rng.integers(7)):
                case 0:
                    m.joint_names[joint] = str(rng.choice(["panda_joint1", "", "panda_finger_joint2", "x"]))
                case 1:
                    field = str(rng.choice(["positions", "velocities", "accelerations"]))
                    values = np.array(getattr(point, field))
                    if len(values):
                        values[joint % len(values)] = rng.choice([np.nan, np.inf, -np.inf, 7.0, -1e300])
                    setattr(point, field, values)
                case 2:
                    point.positions = np.array(point.positions)[: int(rng.integers(8))]
                case 3:
                    point.velocities = np.append(point.velocities, rng.uniform(size=int(rng.integers(3))))
                case 4:
                    point.time_from_start = Duration.from_sec(float(rng.choice([-0.5, 0.0, 0.2, 0.3])))
                case 5:
                    m.joint_names = m.joint_names[:joint]
                case 6:
                    m.points = m.points[: int(rng.integers(4))]
        try:
            trajectory_from_message(m, cell.model, state)
            wanted.append(None)
        except ArmcellError as error:
            wanted.append(f"refused: {str(error).split(' (did you mean')[0]}")
        lines.append(player().message(i * 0.05, "/planned_trajectory", m))
    rows = player().play(scene, lines, 300 * 0.05)
    said = {}
    for t, m in player().received(rows, "/trajectory_status"):
        if m.data.startswith("refused"):
            said[round(t / 0.05)] = m.data
    plain = lambda text: text and re.sub(r"limits \[.*", "", text)  # noqa: E731  (3.7525 is rounded up or down)
    assert [plain(said.get(i)) for i in range(300)] == [plain(text) for text in wanted]
    assert 100 < sum(w is not None for w in wanted) < 290


def test_a_newer_trajectory_takes_over_and_nothing_jumps(player, exported, scene):
    cell, _ = exported
    start = cell.scene().state.reindexed(ARM).positions
    lines = [
        "drives",
        player().message(0, "/planned_trajectory", to(ARM, start + 0.4, 2.0)),
        player().message(1.0, "/planned_trajectory", to(ARM, start, 2.0)),
        player().message(2.0, "/planned_trajectory", S.new("trajectory_msgs/JointTrajectory")),
    ]
    rows = player().play(scene, lines, 3.0)
    words = [w.split(" at ")[0].split(",")[0] for w in player().said(rows)]
    assert words == [
        "executing 2 points", "stopped: cancelled", "executing 2 points", "stopped: cancelled", "stop",
        "done: empty trajectory: stopped",
    ]  # fmt: skip
    for name in ARM:
        q = drives(rows)[name]
        assert np.max(np.abs(np.diff(q))) < 0.4 * 1.5 / 2.0 * STEP * 1.1  # a cubic's top speed, and a little
        speed = np.diff(q[: int(1.95 / STEP)]) / STEP
        assert np.max(np.abs(np.diff(speed))) < 0.02  # [rad/s] from one step to the next
        assert np.ptp(q[int(2.02 / STEP) :]) == 0.0  # stands


def test_joint_states_and_clock(player, exported, scene):
    """30 a second of the simulation's time, stamped with it, with true velocities."""
    cell, _ = exported
    start = cell.scene().state.reindexed(ARM).positions
    goal = start + 0.3
    rows = player().play(scene, [player().message(0, "/planned_trajectory", to(ARM, goal, 2.0))], 2.5)
    states = player().received(rows, "/joint_states")
    clock = player().received(rows, "/clock")
    assert len(states) in (75, 76) and len(clock) == 250
    for at, m in (*states, *((t, c) for t, c in clock)):
        stamp = m.clock if hasattr(m, "clock") else m.header.stamp
        assert stamp.to_sec() == pytest.approx(at, abs=1e-8)
    assert states[0][1].name == list(cell.model.joint_names)
    reference = JointTrajectory(ARM, np.array([0.0, 2.0]), np.vstack([start, goal]), np.zeros((2, 7)))
    for at, m in states:
        q = np.array([m.position[m.name.index(n)] for n in ARM])
        v = np.array([m.velocity[m.name.index(n)] for n in ARM])
        q_true, v_true, _ = reference.sample(at)
        np.testing.assert_allclose(q, q_true, atol=2e-6)
        np.testing.assert_allclose(v, v_true, atol=2e-3)  # a step's mean speed


@lru_cache
def reach(cell, grasp_height=0.0):
    """Joint positions with the tcp at the cube, hand downwards."""
    scene = cell.scene()
    cube = scene.objects["cube"].T_world_object.translation
    T = SE3.from_xyz_rpy(cube + np.array([0, 0, grasp_height]), (np.pi, 0.0, 0.0))
    solver = ik_solver(cell.model, "panda_arm", "panda_hand_tcp")
    result = solver.solve(T, scene.positions, rng=np.random.default_rng(0))
    assert result.ok
    return result.positions


def grip_lines(player, cell, slip):
    low, high = reach(cell), reach(cell, 0.2)
    F = lambda value: S.new("std_msgs/Float64", value)  # noqa: E731
    return [
        player().message(0.0, "/planned_trajectory", to(ARM, low, 1.0)),
        player().message(1.5, "/gripper_command", F(-30.0)),
        player().message(3.0, "/planned_trajectory", to(ARM, high, 1.0)),
        f"slip 3.0 {slip}",
        player().message(6.0, "/gripper_command", F(0.08)),
    ]


@pytest.mark.cases("weld-0.01*")
@pytest.mark.parametrize(
    ("mode", "slip", "words", "height"),
    [
        ("friction", 0.0, ["done: holds cube"], 0.225),
        ("friction", 0.01, ["done: holds cube"], 0.195),  # 3 s of slipping
        ("weld", 0.01, ["done: holds cube", "weld: cube is fixed to the hand (weld)"], 0.225),
        ("hybrid", 0.0, ["done: holds cube"], 0.225),
        ("hybrid", 0.01, ["done: holds cube", "weld: cube is fixed to the hand (hybrid)"], 0.223),
    ],
)
def test_grip_modes(player, exported, scene, mode, slip, words, height):
    cell, _ = exported
    rows = player().play(scene, [f"mode {mode}", *grip_lines(player, cell, slip)], 8.0)
    said = player().said(rows, "/gripper_status")
    welded = any(w.startswith("weld") for w in words)
    expected = [*words, *(["release: cube"] if welded else []), "done: stands at 79.0 mm"]
    assert [s.split("): ")[0] + (")" if "): " in s else "") for s in said] == expected
    poses = player().received(rows, "/object_pose")
    z = {round(t, 2): m.pose.position.z for t, m in poses}
    at = lambda t: z[min(z, key=lambda s: abs(s - t))]  # noqa: E731
    assert at(1.4) == pytest.approx(0.025, abs=1e-6)
    assert at(5.95) == pytest.approx(height, abs=0.0015)
    assert at(7.9) == pytest.approx(0.025, abs=1e-6)  # let go
    contacts = player().said(rows, "/contacts")
    assert {c.split()[2] for c in contacts} == {"panda_leftfinger", "panda_rightfinger"}
    assert all(c.startswith("begin cube ") for c in contacts)
    finger = [
        m.position[m.name.index("panda_finger_joint1")] for _, m in player().received(rows, "/joint_states")
    ]
    assert min(finger) == pytest.approx(0.025, abs=1e-4)  # stopped by the cube


def test_a_finger_trajectory_closes_the_gripper(player, exported, scene):
    """What is in the way is held, and that is no failure."""
    cell, _ = exported
    finger = to(("panda_finger_joint1",), [0.0], 0.5)
    lines = [
        player().message(0.0, "/planned_trajectory", to(ARM, reach(cell), 1.0)),
        player().message(1.5, "/planned_trajectory", finger),
    ]
    said = player().said(player().play(scene, lines, 3.5))
    assert said[2:] == ["executing 2 points, 0.50 s", "done: holds cube"]


def test_a_trajectory_of_arm_and_fingers(player, exported, scene):
    """One trajectory may move both; the gripper's controller stays where it was led to."""
    cell, _ = exported
    names = (*ARM, "panda_finger_joint1")
    goal = np.append(cell.scene().state.reindexed(ARM).positions + 0.1, 0.01)
    lines = ["drives", player().message(0, "/planned_trajectory", to(names, goal, 1.0))]
    rows = player().play(scene, lines, 2.0)
    assert player().said(rows)[-1].startswith("done")
    told = drives(rows)
    np.testing.assert_array_equal(told["panda_finger_joint1"], told["panda_finger_joint2"])
    half = told["panda_finger_joint1"][int(0.5 / STEP) - 1]
    assert half == pytest.approx(0.025, abs=1e-5) and told["panda_finger_joint1"][-1] == pytest.approx(0.01)


def test_mimic_fingers_follow(player, scene):
    lines = ["drives", player().message(0, "/gripper_command", S.new("std_msgs/Float64", 0.03))]
    rows = player().play(scene, lines, 2.0)
    told = drives(rows)
    np.testing.assert_array_equal(told["panda_finger_joint1"], told["panda_finger_joint2"])
    assert told["panda_finger_joint1"][-1] == pytest.approx(0.015, abs=1e-7)
    assert (
        np.max(np.abs(np.diff(told["panda_finger_joint1"]))) <= 0.05 * STEP * 1.001
    )  # at the fingers' speed


def test_materials_have_both_frictions(player, tmp_path):
    """PhysX takes the larger coefficients of two bodies, and only movable objects have any."""
    file = tmp_path / "cell.yaml"
    file.write_text(
        "robot: panda\nobjects:\n"
        "  table: {box: [1, 1, 0.1], pose: [0.9, 0, -0.2], friction: 0.4}\n"
        "  two: {box: [0.1, 0.1, 0.1], pose: [0.9, 0, -0.1], movable: true, "
        "friction: {static: 0.8, dynamic: 0.5}}\n"
        "  one: {sphere: 0.1, pose: [0.9, 0.3, 0], movable: true, friction: 0.6}\n"
    )
    export = export_unity(load(file), tmp_path / "project")
    rows = player().play(export.cell / "scene.json", ["frictions 0.1"], 0.2)
    found = {}
    for _, (name, static, dynamic, combine) in rows["friction"]:
        assert combine == "Maximum"
        found.setdefault(name, set()).add((round(float(static), 6), round(float(dynamic), 6)))
    assert found["two"] == {(0.8, 0.5)} and found["one"] == {(0.6, 0.6)} and found["table"] == {(0.0, 0.0)}
    assert found["panda_link3"] == {(0.0, 0.0)}


@pytest.mark.cases("panda_pick", "dual_ur10_sort")
@pytest.mark.parametrize("name", cell_names())
def test_every_cell_can_be_played(player, tmp_path, name):
    """All joints are published where the cell starts; all jaws and movable objects have their topics."""
    cell = load(name)
    export = export_unity(cell, tmp_path)
    lines, jaws = [], [g for g in cell.model.grippers.values() if g.joint_name]
    for g in jaws:
        topic = "/gripper_command" if len(cell.model.grippers) == 1 else f"/{g.name}/gripper_command"
        lines.append(player().message(0.1, topic, S.new("std_msgs/Float64", g.max_width / 2)))
    rows = player().play(export.cell / "scene.json", lines, 1.5)
    states = player().received(rows, "/joint_states")
    assert states[0][1].name == list(cell.model.joint_names)
    np.testing.assert_allclose(states[0][1].position, cell.scene().positions, atol=1e-6)
    last = dict(zip(states[-1][1].name, states[-1][1].position))
    for g in jaws:
        assert g.width(last[g.joint_name]) == pytest.approx(g.max_width / 2, abs=1e-4)
    movable = [o for o in cell.scene().objects.values() if o.movable]
    topics = {words[0] for _, words in rows["out"] if words[0].startswith("/object_pose")}
    assert topics == ({"/object_pose"} if len(movable) == 1 else {f"/object_pose/{o.name}" for o in movable})


@pytest.mark.cases("True")
@pytest.mark.parametrize("ros2", [False, True])
def test_obstacles_reach_the_planner(player, exported, scene, ros2):
    """A box put into Unity's scene is at the same place in armcell's, follows, and is told but once."""
    from armcell.ros.moveit_convert import object_changes
    from armcell.scene import SceneDiff

    cell, _ = exported
    p = player(ros2)
    rows = p.play(scene, ["block 0.1 pillar -0.3 0.2 0.5", "shift 2 pillar -0.1"], 4.0)
    told = p.received(rows, "/collision_object")
    assert len(told) == 2
    planning = cell.scene()
    for (_, m), y in zip(told, (0.3, 0.4)):
        planning = planning.apply(SceneDiff(tuple(object_changes(m, planning))))
        low, high = planning.object("pillar").bounds()
        T = planning.object("pillar").T_world_object
        np.testing.assert_allclose(T.apply((low + high) / 2), [0.5, y, 0.2], atol=1e-6)
        np.testing.assert_allclose(high - low, [0.6, 0.2, 0.4], atol=1e-6)
