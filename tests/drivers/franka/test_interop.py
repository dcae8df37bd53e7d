"""Franka's own client library against the emulated arm: the motions of its published examples.

`pylibfranka` and `franky` wrap libfranka; each client runs in a process of its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from importlib.util import find_spec

import numpy as np
import pytest
from tests.drivers.franka.emulated import emulator, operate

pytestmark = pytest.mark.interop
HOME = np.array([0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398])

PYLIBFRANKA = """
import json, sys
import numpy as np
from pylibfranka import *
robot = Robot(sys.argv[1], RealtimeConfig.kIgnore)
model = robot.load_model()
robot.set_collision_behavior([20.0] * 7, [40.0] * 7, [20.0] * 6, [40.0] * 6)
robot.set_joint_impedance([3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0])
robot.set_cartesian_impedance([3000.0] * 3 + [300.0] * 3)
def drive(control, answer, duration):
    t, rates, first = 0.0, [], None
    while True:
        state, step = control.readOnce()
        t += step.to_sec()
        first = first or state
        rates.append(state.control_command_success_rate)
        command = answer(first, state, t)
        command.motion_finished = t >= duration
        control.writeOnce(command)
        if command.motion_finished:
            break
    end = robot.read_once()
    print(json.dumps({"q": list(end.q), "start": list(first.q_d), "T": list(end.O_T_EE),
        "T0": list(first.O_T_EE_c), "rate": float(np.mean(rates[110:])), "gravity": list(model.gravity(end)),
        "tau": list(end.tau_J)}))
"""
MOTIONS = {
    # pylibfranka's joint_position_example, with half its amplitude
    "joint position": """
        control = robot.start_joint_position_control(ControllerMode.CartesianImpedance)
        def answer(first, state, t):
            d = np.pi / 16 * (1 - np.cos(np.pi / 2.5 * t))
            return JointPositions(list(np.array(first.q_d) + d * np.array([0, 0, 0, 1, 1, 0, 1])))
        drive(control, answer, 2.5)""",
    # joint_velocity_example
    "joint velocity": """
        control = robot.start_joint_velocity_control(ControllerMode.JointImpedance)
        def answer(first, state, t):
            v = 0.5 * (1 - np.cos(2 * np.pi * t)) * (1 if t < 1 else -1)
            return JointVelocities([0, 0, 0, v, v, v, v])
        drive(control, answer, 2.0)""",
    # cartesian_pose_example
    "Cartesian pose": """
        control = robot.start_cartesian_pose_control(ControllerMode.JointImpedance)
        def answer(first, state, t):
            angle = np.pi / 8 * (1 - np.cos(np.pi / 2.5 * t))
            T = np.array(first.O_T_EE_c)
            T[12] += 0.2 * np.sin(angle)
            T[14] += 0.2 * (np.cos(angle) - 1)
            return CartesianPose(T.tolist())
        drive(control, answer, 2.5)""",
    # cartesian_velocity_example
    "Cartesian velocity": """
        control = robot.start_cartesian_velocity_control(ControllerMode.CartesianImpedance)
        def answer(first, state, t):
            v = 0.05 * (1 - np.cos(np.pi * t)) * (1 if t < 2 else -1) * np.sqrt(0.5)
            return CartesianVelocities([v, 0, v, 0, 0, 0])
        drive(control, answer, 4.0)""",
    # joint_impedance_example: torques from the downloaded model
    "torque": """
        control = robot.start_torque_control()
        K = 50.0
        def answer(first, state, t):
            swing = 0.1 * (1 - np.cos(np.pi * min(t, 2.0)))
            goal = np.array(first.q_d) + swing * np.array([0, 0, 0, 0, 1, 0, 1])
            q, dq = np.array(state.q), np.array(state.dq)
            tau = K * (goal - q) - 2 * np.sqrt(K) * dq + np.array(model.coriolis(state))
            return Torques(tau.tolist())
        drive(control, answer, 4.0)""",
}
END = {  # where each motion ends: joint positions that change, or None if it returns to its start
    "joint position": np.array([0, 0, 0, 1, 1, 0, 1]) * np.pi / 8,
    "joint velocity": np.zeros(7),
    "Cartesian pose": None,
    "Cartesian velocity": np.zeros(7),
    "torque": np.zeros(7),
}


def need(package: str) -> None:
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install -r requirements-interop.txt")


def client(script: str, host: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script, host], capture_output=True, text=True, timeout=180, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def host() -> Iterator[str]:
    with emulator() as address:
        yield address


@pytest.fixture(autouse=True)
def _at_home(host: str) -> Iterator[None]:
    operate(host, "reset")
    yield


@pytest.mark.parametrize("motion", MOTIONS)
def test_pylibfranka_runs_the_motions_of_its_examples(host, motion):
    need("pylibfranka")
    out = client(PYLIBFRANKA + textwrap.dedent(MOTIONS[motion]), host)
    found = {k: np.array(v) for k, v in json.loads(out.splitlines()[-1]).items()}
    physics = np.array([float(x) for x in operate(host, "state").split()[2:]])
    assert operate(host, "state").split()[:2] == ["IDLE", "-"]
    assert np.abs(found["start"] - HOME).max() < 1e-4
    assert np.abs(found["q"] - physics).max() < 2e-3  # the state was read while the arm settled
    end = END[motion]
    tolerance = 5e-3 if motion == "torque" else 2e-3
    if end is not None:
        assert np.abs(physics - HOME - end).max() < tolerance
    else:
        moved = found["T"] - found["T0"]
        angle = np.pi / 4
        assert np.abs(moved[12:15] - (0.2 * np.sin(angle), 0, 0.2 * (np.cos(angle) - 1))).max() < 1e-3
    # the arm's gravity from the downloaded model is the measured torque, except for the hand's weight
    assert np.abs(found["gravity"] - found["tau"]).max() < 8.0
    print(f"{motion}: success rate {found['rate']:.3f}")


def test_pylibfranka_controls_asynchronously(host):
    need("pylibfranka")
    client(
        textwrap.dedent("""
        import sys, time
        import pylibfranka as franka
        robot = franka.Robot(sys.argv[1], franka.RealtimeConfig.kIgnore)
        A = franka.AsyncPositionControlHandler
        made = A.configure(robot, A.Configuration(maximum_joint_velocities=[0.655] * 7, goal_tolerance=0.01))
        assert made.error_message is None, made.error_message
        goal = [0.1, -0.685, 0.1, -2.256, 0.1, 1.67, 0.885]
        end = time.time() + 20
        while time.time() < end:
            feedback = made.handler.get_target_feedback()
            assert feedback.error_message is None, feedback.error_message
            made.handler.set_joint_position_target(A.JointPositionTarget(joint_positions=goal))
            if str(feedback.status).endswith("kTargetReached"):
                break
            time.sleep(0.02)
        made.handler.stop_control()
        """),
        host,
    )
    q = np.array([float(x) for x in operate(host, "state").split()[2:]])
    assert np.abs(q - (0.1, -0.685, 0.1, -2.256, 0.1, 1.67, 0.885)).max() < 0.011


def test_pylibfranka_moves_the_hand(host):
    need("pylibfranka")
    out = client(
        textwrap.dedent("""
        import sys, json
        from pylibfranka import Gripper
        hand = Gripper(sys.argv[1])
        done = [hand.homing(), hand.move(0.03, 0.1)]
        width = hand.read_once().width
        done.append(hand.grasp(0.02, 0.1, 40.0))
        print(json.dumps([done, width, hand.read_once().is_grasped]))
        """),
        host,
    )
    done, width, grasped = json.loads(out.splitlines()[-1])
    assert done == [True, True, False] and not grasped  # nothing to grasp
    assert abs(width - 0.03) < 2e-3


def test_franky_runs_its_examples(host):
    need("franky")
    out = client(
        textwrap.dedent("""
        import sys, json
        from franky import *
        robot = Robot(sys.argv[1], realtime_config=RealtimeConfig.Ignore)
        robot.recover_from_errors()
        robot.relative_dynamics_factor = 0.1
        found = []
        def move(motion):
            robot.move(motion)
            pose = robot.current_pose.end_effector_pose
            found.append([list(robot.current_joint_state.position), list(pose.translation)])
        move(JointMotion([0.0, 0.0, 0.0, -2.2, 0.0, 2.2, 0.7]))
        forward = Affine([0.0, 0.1, 0.0])
        move(CartesianMotion(forward, reference_type=ReferenceType.Relative))
        move(CartesianMotion(forward.inverse, reference_type=ReferenceType.Relative))
        move(JointWaypointMotion([JointWaypoint([0.0, 0.0, 0.0, -2.2, 0.0, 2.2, 0.7]),
                                  JointWaypoint([0.2, -0.1, 0.3, -2.0, 0.1, 1.9, 0.6])]))
        move(JointVelocityMotion([0.05] * 7, duration=Duration(1000)))
        move(CartesianVelocityMotion(Twist(linear_velocity=[-0.03, 0.03, 0.03]), duration=Duration(1000)))
        print(json.dumps(found))
        """),
        host,
    )
    joint, forward, back, waypoints, turned, _ = json.loads(out.splitlines()[-1])
    assert np.abs(np.array(joint[0]) - (0.0, 0.0, 0.0, -2.2, 0.0, 2.2, 0.7)).max() < 5e-3
    assert 0.095 < np.linalg.norm(np.subtract(forward[1], joint[1])) < 0.105
    assert np.linalg.norm(np.subtract(back[1], joint[1])) < 2e-3
    assert np.abs(np.array(waypoints[0]) - (0.2, -0.1, 0.3, -2.0, 0.1, 1.9, 0.6)).max() < 5e-3
    assert np.all(np.subtract(turned[0], waypoints[0]) > 0.03)


PANDA_PYTHON = """
import json, sys
import numpy as np
from panda_py import libfranka as lf
robot = lf.Robot(sys.argv[1], lf.RealtimeConfig.kIgnore)
assert robot.server_version() == 5
robot.set_collision_behavior([20.0] * 7, [40.0] * 7, [20.0] * 6, [40.0] * 6)
robot.set_joint_impedance([3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0])
robot.set_cartesian_impedance([3000.0] * 3 + [300.0] * 3)
def drive(control, answer, duration):
    t, first = 0.0, []
    def step(state, passed):
        nonlocal t
        t += passed.to_sec()
        if not first:
            first.append(state)
        command = answer(first[0], state, t)
        command.motion_finished = t >= duration
        return command
    control(step)
    end = robot.read_once()
    print(json.dumps({"q": list(end.q), "T": list(end.O_T_EE), "T0": list(first[0].O_T_EE_c)}))
"""
PANDA_MOTIONS = {
    "joint position": """
        def answer(first, state, t):
            d = np.pi / 16 * (1 - np.cos(np.pi / 2.5 * t))
            return lf.JointPositions((np.array(first.q_d) + d * np.array([0, 0, 0, 1, 1, 0, 1])).tolist())
        drive(robot.control_joint_position, answer, 2.5)""",
    "joint velocity": """
        def answer(first, state, t):
            v = 0.5 * (1 - np.cos(2 * np.pi * t)) * (1 if t < 1 else -1)
            return lf.JointVelocities([0, 0, 0, v, v, v, v])
        drive(robot.control_joint_velocity, answer, 2.0)""",
    "Cartesian pose": """
        def answer(first, state, t):
            angle = np.pi / 8 * (1 - np.cos(np.pi / 2.5 * t))
            T = np.array(first.O_T_EE_c)
            T[12] += 0.2 * np.sin(angle)
            T[14] += 0.2 * (np.cos(angle) - 1)
            return lf.CartesianPose(T.tolist())
        drive(robot.control_cartesian_pose, answer, 2.5)""",
    "Cartesian velocity": """
        def answer(first, state, t):
            v = 0.05 * (1 - np.cos(np.pi * t)) * (1 if t < 2 else -1) * np.sqrt(0.5)
            return lf.CartesianVelocities([v, 0, v, 0, 0, 0])
        drive(robot.control_cartesian_velocity, answer, 4.0)""",
    "torque": """
        def answer(first, state, t):
            swing = 0.1 * (1 - np.cos(np.pi * min(t, 2.0)))
            goal = np.array(first.q_d) + swing * np.array([0, 0, 0, 0, 1, 0, 1])
            tau = 50.0 * (goal - np.array(state.q)) - 14.0 * np.array(state.dq)
            return lf.Torques(tau.tolist())
        drive(robot.control, answer, 4.0)""",
}


@pytest.fixture(scope="module")
def panda() -> Iterator[str]:
    """An emulated Panda, which speaks protocol 5."""
    need("panda_py")
    with emulator("--model", "panda") as address:
        yield address


@pytest.mark.parametrize("motion", PANDA_MOTIONS)
def test_panda_python_drives_a_panda(panda, motion):
    operate(panda, "reset")
    out = client(PANDA_PYTHON + textwrap.dedent(PANDA_MOTIONS[motion]), panda)
    found = {k: np.array(v) for k, v in json.loads(out.splitlines()[-1]).items()}
    said = operate(panda, "state").split()
    physics = np.array([float(x) for x in said[2:]])
    assert said[:2] == ["IDLE", "-"]
    assert np.abs(found["q"] - physics).max() < 2e-3
    if END[motion] is not None:
        assert np.abs(physics - HOME - END[motion]).max() < (5e-3 if motion == "torque" else 2e-3)
    else:
        moved = (found["T"] - found["T0"])[12:15]
        assert np.abs(moved - 0.2 * np.array([np.sin(np.pi / 4), 0, np.cos(np.pi / 4) - 1])).max() < 1e-3


def test_panda_python_meets_a_reflex_recovers_and_moves_the_hand(panda):
    operate(panda, "reset")
    out = client(
        PANDA_PYTHON
        + textwrap.dedent("""
        found, passed = [], [0.0]
        start = np.array(robot.read_once().q_d)
        def jump(state, step):
            passed[0] += step.to_sec()
            return lf.JointPositions((start + (0.05 if passed[0] > 0.1 else 0.0)).tolist())
        def expect_error(call, *arguments):
            try:
                call(*arguments)
            except Exception as error:
                found.append(str(error))
        unfiltered = lf.ControllerMode.kJointImpedance, False, 1000.0
        expect_error(robot.control_joint_position, jump, *unfiltered)
        found.append(str(robot.read_once().robot_mode))
        robot.automatic_error_recovery()
        found.append(str(robot.read_once().robot_mode))
        expect_error(robot.load_model)
        hand = lf.Gripper(sys.argv[1])
        found += [hand.homing(), hand.move(0.03, 0.1), hand.read_once().width]
        robot.set_load(0.2, [0.0, 0.0, 0.05], [1e-3, 0, 0, 0, 1e-3, 0, 0, 0, 1e-3])
        found.append(robot.read_once().m_load)
        print(json.dumps(found))
        """),
        panda,
    )
    error, stopped, recovered, model, homed, moved, width, load = json.loads(out.splitlines()[-1])
    assert "motion aborted by reflex" in error and "joint_motion_generator_velocity_limits" in error
    assert (stopped, recovered) == ("RobotMode.kReflex", "RobotMode.kIdle")
    assert "model library" in model and homed and moved and abs(width - 0.03) < 2e-3 and load == 0.2
