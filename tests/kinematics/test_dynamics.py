"""Inverse dynamics against pinocchio's rnea, and the torques of a held weight against statics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from tests.model.helpers import REFERENCES, PinRobot, random_positions
from tests.sizes import ROBOTS

from armcell.core import SE3, InputError, UnknownNameError
from armcell.kinematics import InverseDynamics, kinematic_tree
from armcell.model import Inertial, load_robot, parse_urdf

PAYLOAD = Inertial(1.7, SE3.from_xyz_rpy((0.05, -0.02, 0.1), (0.3, 0.2, -0.5)), np.diag([0.01, 0.02, 0.015]))


def pinocchio_torques(reference: PinRobot, q, dq, ddq) -> np.ndarray:
    """(dof,) of the actuated joints, mimic joints' torques added to those they follow."""
    model = reference.model
    at = lambda v: kinematic_tree(model).full_positions(v)  # noqa: E731
    zero = at(np.zeros(model.dof))
    full = []
    for values in (dq, ddq):
        vector = np.zeros(reference.pin.nv)
        for name, value in at(values).items():
            i = reference.pin.getJointId(name)
            vector[reference.pin.idx_vs[i]] = value - zero[name]
        full.append(vector)
    tau = pin.rnea(reference.pin, reference.data, reference.configuration(at(q)), *full)
    out = np.zeros(model.dof)
    for joint in model.joints.values():
        if joint.movable:
            factor, source = 1.0, joint
            while source.mimic is not None:
                factor, source = factor * source.mimic.multiplier, model.joints[source.mimic.joint]
            out[model.joint_names.index(source.name)] += (
                factor * tau[reference.pin.idx_vs[reference.pin.getJointId(joint.name)]]
            )
    return out


def random_states(model, rng, count=10):
    q = np.array([random_positions(model, rng) for _ in range(count)])
    return q, rng.normal(0, 2, q.shape), rng.normal(0, 5, q.shape)


@pytest.mark.slow
@pytest.mark.cases(*ROBOTS, "tiago_dual")
@pytest.mark.parametrize("name", REFERENCES)
def test_torques_are_pinocchio_s(name):
    model, reference = REFERENCES[name]()
    ours, theirs = InverseDynamics(model), PinRobot(reference, model)
    theirs.pin.gravity.linear = np.array([0.0, 0.0, -9.81])
    states = random_states(model, np.random.default_rng(0))
    expected = np.array([pinocchio_torques(theirs, *state) for state in zip(*states, strict=True)])
    np.testing.assert_allclose(ours.torques(*states), expected, rtol=1e-9, atol=1e-9)


def test_a_payload_is_pinocchio_s():
    model, reference = REFERENCES["panda"]()
    link = model.group("arm").tip_link
    T = PAYLOAD.T_link_com
    frame = reference.frames[reference.getFrameId(link, pin.FrameType.BODY)]
    inertia = T.rotation.matrix @ PAYLOAD.inertia @ T.rotation.matrix.T
    body = pin.Inertia(PAYLOAD.mass, T.translation, inertia)
    reference.inertias[frame.parentJoint] += frame.placement.act(body)
    theirs = PinRobot(reference, model)
    states = random_states(model, np.random.default_rng(1))
    expected = np.array([pinocchio_torques(theirs, *state) for state in zip(*states, strict=True)])
    ours = InverseDynamics(model, payloads=[(link, PAYLOAD)]).torques(*states)
    np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-9)
    assert np.abs(ours - InverseDynamics(model).torques(*states)).max() > 5.0  # it does weigh something


def test_some_joints_move_and_the_others_stand_still():
    model = load_robot("ur10_gripper")
    names = model.group("arm").joint_names
    q, dq, ddq = random_states(model, np.random.default_rng(2), 1)
    columns = model.columns(names)
    still = np.setdiff1d(np.arange(model.dof), columns)
    dq[:, still] = ddq[:, still] = 0.0
    whole = InverseDynamics(model).torques(q, dq, ddq)[:, columns]
    part = InverseDynamics(model, names, q[0]).torques(q[:, columns], dq[:, columns], ddq[:, columns])
    np.testing.assert_allclose(part, whole, atol=1e-12)


def test_rows_are_the_torques_of_a_motion_along_the_path():
    model = load_robot("panda")
    names = model.group("arm").joint_names
    dynamics, rng = InverseDynamics(model, names), np.random.default_rng(3)
    q, first, second = (rng.normal(0, 1, (5, 7)) for _ in range(3))
    a, b, c = np.moveaxis(dynamics.torque_coefficients(q, first, second), 1, 0)
    u, x = -1.3, 0.7
    torques = dynamics.torques(q, first * np.sqrt(x), first * u + second * x)
    np.testing.assert_allclose(a * u + b * x + c, torques, atol=1e-9)


def test_bad_input():
    model = load_robot("panda")
    with pytest.raises(UnknownNameError, match="unknown link 'hook'"):
        InverseDynamics(model, payloads=[("hook", PAYLOAD)])
    with pytest.raises(UnknownNameError, match="unknown actuated joint 'elbow'"):
        InverseDynamics(model, ("elbow",))
    with pytest.raises(InputError, match="mass of the payload on 'panda_hand' is 0"):
        InverseDynamics(model, payloads=[("panda_hand", Inertial(0.0, SE3.identity(), np.eye(3)))])
    text = """<robot name="ghost"><link name="a"/><link name="b"/>
      <joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>"""
    with pytest.raises(InputError, match="no link that j move has a mass"):
        InverseDynamics(parse_urdf(text, Path("ghost.urdf")))
