"""tf.transformations against SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from armcell.moveit.shims import transformations as t

AXES = [frame + axes for axes in t._AXES for frame in "sr"]


def scipy_of(axes, angles):
    """Fixed axes are SciPy's lower case, turning ones its upper case."""
    return Rotation.from_euler(axes[1:] if axes[0] == "s" else axes[1:].upper(), angles)


@pytest.mark.slow
@pytest.mark.parametrize("axes", AXES)
def test_euler_angles_about_any_axes(axes):
    for angles in np.random.default_rng(0).uniform(-3, 3, (20, 3)):
        R = scipy_of(axes, angles)
        assert np.allclose(t.euler_matrix(*angles, axes)[:3, :3], R.as_matrix())
        q = t.quaternion_from_euler(*angles, axes)
        assert np.allclose(np.abs(q @ R.as_quat()), 1.0)
        for back in (t.euler_from_matrix(R.as_matrix(), axes), t.euler_from_quaternion(q, axes)):
            assert np.allclose(scipy_of(axes, back).as_matrix(), R.as_matrix())


@pytest.mark.parametrize("axes", AXES)
def test_euler_angles_where_two_axes_fall_together(axes):
    middle = 0.0 if axes[1] == axes[3] else np.pi / 2
    R = scipy_of(axes, (0.3, middle, 0.4)).as_matrix()
    assert np.allclose(t.euler_matrix(*t.euler_from_matrix(R, axes), axes)[:3, :3], R, atol=1e-6)


def test_the_usual_call_is_roll_pitch_yaw():
    assert np.allclose(t.quaternion_from_euler(np.pi, 0, 0), (1, 0, 0, 0))
    assert np.allclose(t.euler_from_quaternion((0, 0, np.sin(0.25), np.cos(0.25))), (0, 0, 0.5))


def test_quaternions():
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b = Rotation.random(rng=rng), Rotation.random(rng=rng)
        qa, qb = a.as_quat(), b.as_quat()
        assert np.allclose(t.quaternion_matrix(qa)[:3, :3], a.as_matrix())
        assert np.isclose(abs(t.quaternion_from_matrix(a.as_matrix()) @ qa), 1.0)
        assert np.isclose(abs(t.quaternion_multiply(qa, qb) @ (a * b).as_quat()), 1.0)
        assert np.isclose(abs(t.quaternion_inverse(qa) @ a.inv().as_quat()), 1.0)
        halfway = Slerp([0, 1], Rotation.concatenate([a, b]))(0.3).as_quat()
        assert np.isclose(abs(t.quaternion_slerp(qa, qb, 0.3) @ halfway), 1.0)
        v = rng.normal(size=3)
        angle = float(np.linalg.norm(v))
        assert np.isclose(abs(t.quaternion_about_axis(angle, v) @ Rotation.from_rotvec(v).as_quat()), 1.0)
        found, direction, _ = t.rotation_from_matrix(t.rotation_matrix(angle, v))
        assert np.allclose(
            Rotation.from_rotvec(found * direction).as_matrix(), Rotation.from_rotvec(v).as_matrix()
        )
    assert np.isclose(np.linalg.norm(t.random_quaternion()), 1.0)


def test_matrices():
    M = t.concatenate_matrices(t.translation_matrix((1, 2, 3)), t.euler_matrix(0.1, 0.2, 0.3))
    assert np.allclose(t.translation_from_matrix(M), (1, 2, 3))
    assert np.allclose(t.inverse_matrix(M) @ M, t.identity_matrix())
    R = t.rotation_matrix(0.7, (0, 0, 1), point=(1, 1, 0))
    assert np.allclose(R @ (1, 1, 5, 1), (1, 1, 5, 1))  # the axis stays
    composed = t.compose_matrix(angles=(0.1, 0.2, 0.3), translate=(1, 2, 3))
    assert t.is_same_transform(composed, M)
    assert np.allclose(t.scale_matrix(2.0, (1, 0, 0)) @ (2, 0, 0, 1), (3, 0, 0, 1))
    assert t.vector_norm((3, 4)) == 5.0 and np.allclose(t.unit_vector((3, 4)), (0.6, 0.8))
