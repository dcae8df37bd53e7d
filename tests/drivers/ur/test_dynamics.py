"""Dynamics and motions of the emulated arm against physics' own identities."""

import selectors

import numpy as np
import pytest

from armcell.core import InputError
from armcell.drivers.ur.wire.kinematics import (
    ArmDynamics,
    forward,
    frames_of,
    inverse,
    jacobian_rate,
    pose_of,
    tool_jacobian,
)
from armcell.drivers.ur.wire.models import MODELS, ur_model
from armcell.emulators.network import Network
from armcell.emulators.ur.motion import BlendedMotion, MotionFault, MoveC, MoveJ, MoveL, Setpoint, TrackL
from armcell.emulators.ur.plant import KinematicPlant
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.script_server import run_script

Q = np.array([0.3, -1.4, 1.6, -1.7, -1.5, 0.2])


def kinetic_energy(model, q, v, payload=0.0) -> float:
    """Of the point masses, by differences of their positions, and of the rotors."""

    def centers(q):
        frames = frames_of(model.dh, q)
        points = [T[:3, :3] @ c + T[:3, 3] for T, c in zip(frames[1:], model.link_centers, strict=True)]
        return np.array([*points, frames[6][:3, 3]])

    speeds = (centers(q + 1e-6 * v) - centers(q - 1e-6 * v)) / 2e-6
    masses = np.array([*model.link_masses, payload])
    return 0.5 * float(masses @ (speeds**2).sum(axis=1)) + 0.5 * 0.1 * float(v @ v)


@pytest.mark.parametrize("name", MODELS)
def test_the_mass_matrix_gives_the_kinetic_energy(name):
    model, rng = ur_model(name), np.random.default_rng(0)
    dynamics = ArmDynamics(model, model.dh, 3.0)
    for _ in range(5):
        q, v = rng.uniform(-2, 2, 6), rng.uniform(-1, 1, 6)
        energy = 0.5 * v @ dynamics.mass_matrix(q) @ v
        assert energy == pytest.approx(kinetic_energy(model, q, v, 3.0), rel=1e-6)


def test_velocity_torques_do_no_work_beside_the_masses_change():
    """v . c = 1/2 v . dM/dt v (the passivity of rigid bodies)."""
    model, rng = ur_model("UR10e"), np.random.default_rng(1)
    dynamics = ArmDynamics(model, model.dh)
    for _ in range(5):
        q, v = rng.uniform(-2, 2, 6), rng.uniform(-1, 1, 6)
        rate = (dynamics.mass_matrix(q + 1e-6 * v) - dynamics.mass_matrix(q - 1e-6 * v)) / 2e-6
        assert v @ dynamics.velocity_torques(q, v) == pytest.approx(0.5 * v @ rate @ v, abs=1e-4)


def test_the_jacobian_s_rate_is_the_tool_s_acceleration_at_constant_joint_speeds():
    model, v = ur_model("UR10e"), np.array([0.3, -0.2, 0.5, 0.1, -0.4, 0.2])
    tcp = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    ends = [forward(model.dh, Q + s * 1e-4 * v, tcp)[:3, 3] for s in (-1, 0, 1)]
    acceleration = (ends[0] - 2 * ends[1] + ends[2]) / 1e-8
    np.testing.assert_allclose((jacobian_rate(model.dh, Q, v, tcp) @ v)[:3], acceleration, atol=1e-5)
    speed = (ends[2] - ends[0]) / 2e-4
    np.testing.assert_allclose((tool_jacobian(model.dh, Q, tcp) @ v)[:3], speed, atol=1e-7)


def play(s: Setpoint, motion, seconds: float = 20.0) -> np.ndarray:
    points, dt = [], 0.002
    while not motion.done and len(points) * dt < seconds:
        s.q, s.v = motion.step(s, dt)
        points.append(forward(s.dh, s.q, s.tcp)[:3, 3])
    assert motion.done
    return np.array(points)


def poses(*offsets):
    model = ur_model("UR10e")
    s, found = Setpoint(model, model.dh, Q), []
    for offset in offsets:
        T = forward(model.dh, Q, s.tcp)
        T[:3, 3] += offset
        found.append(T)
    return s, found


@pytest.mark.slow
@pytest.mark.cases("1.0")
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_arc_goes_through_its_point_at_a_constant_speed(side):
    s, (start, via, end) = poses((0, 0, 0), (0, 0.05 * side, 0.05), (0, 0, 0.1))
    path = play(s, MoveC(s, via, end, 1.0, 0.1))
    np.testing.assert_allclose(path[-1], end[:3, 3], atol=1e-6)
    assert np.linalg.norm(path - via[:3, 3], axis=1).min() < 3e-4
    radius = np.linalg.norm(path - (start[:3, 3] + [0, 0, 0.05]), axis=1)
    np.testing.assert_allclose(radius, 0.05, atol=1e-5)
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.002
    assert speeds.max() == pytest.approx(0.1, rel=0.01)


def test_an_arc_on_a_line_is_refused():
    s, (via, end) = poses((0, 0, 0.05), (0, 0, 0.1))
    with pytest.raises(MotionFault, match="on a line"):
        MoveC(s, via, end, 1.0, 0.1)


def test_a_tracked_pose_is_met_at_rest_and_a_blend_goes_on_at_speed():
    s, (goal, beside) = poses((0, 0, 0.1), (0, 0.1, 0.1))
    play(s, TrackL(s, goal, 1.0, 0.2))
    np.testing.assert_allclose(forward(s.dh, s.q, s.tcp), goal, atol=1e-4)
    motion = TrackL(s, beside, 1.0, 0.2, blend=0.02)
    while not motion.near:
        s.q, s.v = motion.step(s, 0.002)
    assert np.linalg.norm((tool_jacobian(s.dh, s.q, s.tcp) @ s.v)[:3]) == pytest.approx(0.2, rel=0.05)
    motion.settle()
    play(s, motion)
    np.testing.assert_allclose(forward(s.dh, s.q, s.tcp), beside, atol=1e-4)


def joints(s: Setpoint, T) -> np.ndarray:
    q = inverse(s.dh, T, s.q, s.tcp, iterations=100)
    assert q is not None
    return q


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["line", "joints"])
def test_a_blend_passes_the_corner_at_speed_and_without_a_jump(kind):
    s, (corner, beside) = poses((0, 0, 0.1), (0, 0.15, 0.1))
    ends = [joints(s, T) for T in (corner, beside)]
    if kind == "line":
        first, second = MoveL(s, corner, 1.0, 0.2), lambda at: MoveL(at, beside, 1.0, 0.2)
    else:
        first, second = MoveJ(s, ends[0], 3.0, 0.5), lambda at: MoveJ(at, ends[1], 3.0, 0.5)
    tool, speeds = [], [s.v]
    motion, radius = first, 0.03
    while not motion.done:
        s.q, s.v = motion.step(s, 0.002)
        tool.append(forward(s.dh, s.q, s.tcp)[:3, 3])
        speeds.append(s.v)
        if motion is first and np.linalg.norm(tool[-1] - corner[:3, 3]) < radius:
            motion = BlendedMotion(s, first, second)
    np.testing.assert_allclose(tool[-1], beside[:3, 3], atol=1e-5)
    from_corner = np.linalg.norm(np.array(tool) - corner[:3, 3], axis=1)
    nearest = int(np.argmin(from_corner))
    assert 1e-4 < from_corner[nearest] < radius
    assert np.linalg.norm(tool[nearest + 1] - tool[nearest]) / 0.002 > 0.05  # [m/s]
    jumps = np.abs(np.diff(speeds, axis=0)).max() / 0.002
    assert jumps < 10.0  # [rad/s^2]: continuous speeds


@pytest.mark.slow
@pytest.mark.cases("0.03")
@pytest.mark.parametrize("radius", [0.0, 0.03])
def test_a_program_s_points_are_blended_within_their_radius(radius):
    _, (corner, beside) = poses((0, 0, 0.1), (0, 0.15, 0.1))
    robot = Robot(ur_model("UR10e"), KinematicPlant(Q), "1")
    text = "".join(
        f"movel(p{np.array(pose_of(T)).tolist()}, a=1.0, v=0.2, r={r})\n"
        for T, r in ((corner, radius), (beside, 0.0))
    )
    tool, started = [], False
    for _ in range(10_000):
        robot.before_step()
        robot.plant.step(robot.period)
        robot.after_step()
        if not started:
            started = run_script(robot, Network(selectors.DefaultSelector()), text)
        elif started:
            tool.append(forward(robot.dh, robot.setpoint.q, robot.setpoint.tcp)[:3, 3])
            if robot.machine is None:
                break
    np.testing.assert_allclose(tool[-1], beside[:3, 3], atol=1e-4)
    from_corner = np.linalg.norm(np.array(tool) - corner[:3, 3], axis=1)
    nearest = int(np.argmin(from_corner))
    speed = np.linalg.norm(tool[nearest + 1] - tool[nearest]) / robot.period
    assert from_corner[nearest] < max(radius, 1e-4)
    assert speed > 0.05 if radius else speed < 0.01


def test_software_versions():
    assert ur_model("UR10").with_software("3.4").version[:3] == (3, 4, 0)
    assert ur_model("UR10e").with_software("5.11.1").cb3_version == (3, 16)
    for model, text in (("UR10", "5.11"), ("UR10e", "3.15"), ("UR10", "3.99"), ("UR10", "new")):
        with pytest.raises(InputError, match="software"):
            ur_model(model).with_software(text)
