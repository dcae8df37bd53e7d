"""The numbers of a URDF as pinocchio reads them: limits, masses, inertias. (FK: tests/kinematics.)"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tests.model.helpers import REFERENCES
from tests.sizes import ROBOTS

from armcell.core import SE3


@pytest.fixture(scope="module", params=REFERENCES)
def pair(request):
    return REFERENCES[request.param]()


@pytest.mark.slow
@pytest.mark.cases(*ROBOTS, "tiago_dual")
def test_same_joints(pair):
    model, reference = pair
    bodies = {f.name: f.parentJoint for f in reference.frames if f.type == pin.FrameType.BODY}
    assert set(model.links) <= set(bodies)
    # Links above the model's root are not part of it.
    moving = {bodies[n] for n in model.links} - {bodies[model.root_link]}
    assert set(model.movable_joint_names) == {reference.names[i] for i in moving}


def test_limits(pair):
    model, reference = pair
    for name in model.movable_joint_names:
        joint, i = model.joints[name], reference.getJointId(name)
        q, v = reference.idx_qs[i], reference.idx_vs[i]
        if joint.type != "continuous":
            assert joint.limits.lower == pytest.approx(reference.lowerPositionLimit[q])
            assert joint.limits.upper == pytest.approx(reference.upperPositionLimit[q])
        # The library may tighten a velocity or an effort, never widen one; 0 in a URDF means "not given".
        for mine, theirs in (
            (joint.limits.velocity, reference.velocityLimit[v]),
            (joint.limits.effort, reference.effortLimit[v]),
        ):
            assert theirs <= 0 or mine <= theirs * (1 + 1e-6)


def test_masses_and_inertias(pair):
    model, reference = pair
    for links in model.rigid_groups:
        base = next(n for n in model.links if n in links and _parent(model, n) not in links)
        if base == model.root_link:
            continue
        total = pin.Inertia.Zero()
        for name in links:
            inertial = model.links[name].inertial
            if inertial is None:
                continue
            T = _pose_in_group(model, base, name) @ inertial.T_link_com
            R = T.rotation.matrix
            total += pin.Inertia(inertial.mass, T.translation, R @ inertial.inertia @ R.T)
        theirs = reference.inertias[reference.getJointId(model.parent_joint[base].name)]
        assert total.mass == pytest.approx(theirs.mass, abs=1e-9)
        if total.mass > 0:
            np.testing.assert_allclose(total.lever, theirs.lever, atol=1e-9)
            np.testing.assert_allclose(total.inertia, theirs.inertia, atol=1e-8)


def _parent(model, link):
    return model.parent_joint[link].parent if link in model.parent_joint else None


def _pose_in_group(model, base, link):
    T = SE3.identity()
    for joint in model.chain(base, link):
        T = T @ joint.T_parent_joint
    return T
