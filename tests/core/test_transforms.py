"""SO3 and SE3: group axioms, conversions against SciPy, interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from armcell.core import SE3, SO3, InputError
from armcell.core.transforms import skew

number = st.floats(-10.0, 10.0, allow_subnormal=False)
vectors = st.tuples(number, number, number).map(np.array)
angles = st.floats(-np.pi, np.pi, allow_subnormal=False)
rotvecs = st.tuples(vectors, angles).map(lambda va: va[1] * va[0] / max(np.linalg.norm(va[0]), 1e-9))
rotations = rotvecs.map(SO3.exp)
poses = st.builds(SE3, rotations, vectors)


def assert_same(a: SE3, b: SE3, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(a.matrix, b.matrix, atol=tolerance)


@pytest.mark.slow
@given(poses, poses, poses)
def test_group_axioms(a, b, c):
    assert_same((a @ b) @ c, a @ (b @ c), 1e-8)
    assert_same(a @ SE3.identity(), a)
    assert_same(SE3.identity() @ a, a)
    assert_same(a @ a.inverse(), SE3.identity())
    assert_same(a.inverse() @ a, SE3.identity())
    assert_same((a @ b).inverse(), b.inverse() @ a.inverse(), 1e-8)


@pytest.mark.parametrize("count", [(1 << 14) - 1, 1 << 14, (1 << 14) + 1, 100_000])
def test_many_points(count):
    rng = np.random.default_rng(0)
    T, points = SE3(SO3.exp(rng.normal(size=3)), rng.normal(size=3)), rng.normal(size=(count, 3))
    moved, few = T.apply(points), rng.integers(0, count, 50)
    np.testing.assert_allclose(moved[few], [T.apply(p) for p in points[few]], atol=1e-12)
    np.testing.assert_allclose(T.inverse().apply(moved), points, atol=1e-12)


@given(poses, poses, vectors)
def test_a_product_maps_points_one_after_the_other(a, b, point):
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-8)
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-9)
    np.testing.assert_allclose(a.apply([point, -point])[1], a.apply(-point), atol=1e-12)


@given(rotations)
def test_rotations_are_orthonormal_and_right_handed(R):
    np.testing.assert_allclose(R.matrix @ R.matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R.matrix) == pytest.approx(1.0)


@given(rotvecs)
@example(np.array([np.pi, 0.0, 0.0]))
@example(np.array([0.0, -np.pi, 0.0]))
@example(np.array([0.0, 0.0, np.pi - 1e-9]))
@example(np.array([1e-9, -1e-9, 1e-10]))
@example(np.zeros(3))
def test_conversions_agree_with_scipy(v):
    R, reference = SO3.exp(v), Rotation.from_rotvec(v)
    np.testing.assert_allclose(R.matrix, reference.as_matrix(), atol=1e-12)
    for mine, theirs in ((R.quat_xyzw, reference.as_quat()), (np.roll(R.quat_wxyz, -1), reference.as_quat())):
        assert abs(mine @ theirs) == pytest.approx(1.0, abs=1e-12)  # modulo sign
    assert R.quat_wxyz[0] >= 0
    assert np.linalg.norm(R.log()) <= np.pi + 1e-12
    np.testing.assert_allclose(Rotation.from_rotvec(R.log()).as_matrix(), R.matrix, atol=1e-9)
    np.testing.assert_allclose(SO3.from_quat_wxyz(R.quat_wxyz).matrix, R.matrix, atol=1e-12)
    np.testing.assert_allclose(SO3.from_quat_xyzw(-R.quat_xyzw).matrix, R.matrix, atol=1e-12)


@given(angles, st.floats(-np.pi / 2, np.pi / 2), angles)
@example(0.4, np.pi / 2, -0.3)
@example(2.0, -np.pi / 2, 1.0)
def test_rpy_is_urdf_s_and_round_trips(roll, pitch, yaw):
    R = SO3.from_rpy((roll, pitch, yaw))
    np.testing.assert_allclose(
        R.matrix, Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix(), atol=1e-12
    )
    # Near the singularity roll and yaw are poorly determined, the rotation they give is not.
    np.testing.assert_allclose(SO3.from_rpy(R.rpy).matrix, R.matrix, atol=1e-7)


@given(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3), vectors.filter(lambda v: np.linalg.norm(v) > 1e-3))
@example(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -2.0]))
@example(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]))
def test_between_is_the_shortest_turn(a, b):
    u, v = a / np.linalg.norm(a), b / np.linalg.norm(b)
    R = SO3.between(a, b)
    np.testing.assert_allclose(R.matrix @ u, v, atol=1e-7)
    angle = np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)
    assert np.linalg.norm(R.log()) == pytest.approx(angle, abs=1e-6)


@given(vectors, vectors)
def test_skew_is_the_cross_product(v, w):
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-9)


@given(poses, poses, st.floats(0.0, 1.0))
def test_interpolation_is_straight_and_uniform(a, b, t):
    assert_same(a.interpolate(b, 0.0), a)
    middle = a.interpolate(b, t)
    meters, radians = a.distance_to(b)
    if radians < np.pi - 1e-3:  # at half a turn the way round is not unique
        assert_same(a.interpolate(b, 1.0), b, 1e-7)
        assert a.distance_to(middle)[1] == pytest.approx(t * radians, abs=1e-6)
        assert middle.distance_to(b)[1] == pytest.approx((1 - t) * radians, abs=1e-6)
    assert a.distance_to(middle)[0] == pytest.approx(t * meters, abs=1e-9)
    assert middle.distance_to(b)[0] == pytest.approx((1 - t) * meters, abs=1e-9)


@given(poses, poses, poses)
def test_distance_is_symmetric_and_independent_of_the_frame(a, b, frame):
    assert a.distance_to(b) == pytest.approx(b.distance_to(a), abs=1e-6)
    assert (frame @ a).distance_to(frame @ b) == pytest.approx(a.distance_to(b), abs=1e-6)
    assert a.isclose(a) and (a.isclose(b) == (max(a.distance_to(b)) <= 1e-9))


@given(poses)
def test_every_way_in_gives_the_same_pose(T):
    xyz, rpy = T.translation, T.rotation.rpy
    assert_same(SE3.from_matrix(T.matrix), T)
    assert_same(SE3.from_quat_wxyz(xyz, T.quat_wxyz), T)
    assert_same(SE3.from_quat_xyzw(xyz, T.quat_xyzw), T)
    for form in (
        [*xyz, *rpy],
        {"xyz": list(xyz), "rpy": list(rpy)},
        {"xyz": list(xyz), "rpy_deg": list(np.rad2deg(rpy))},
        {"xyz": list(xyz), "quat_xyzw": list(T.quat_xyzw)},
    ):
        assert_same(SE3.from_mapping(form), T, 1e-7)
    assert_same(SE3.from_mapping(list(xyz)), SE3.from_xyz(*xyz))
    assert_same(T.shifted(0.1, 0.2, 0.3), SE3.from_xyz(0.1, 0.2, 0.3) @ T)


NAN = float("nan")


@pytest.mark.parametrize(
    "make",
    [
        lambda: SO3.from_quat_wxyz((1.0, 0.0, 0.0, NAN)),
        lambda: SO3.from_quat_xyzw((NAN, 0.0, 0.0, 1.0)),
        lambda: SO3.from_rpy((0.0, np.inf, 0.0)),
        lambda: SO3.exp((0.0, 0.0, NAN)),
        lambda: SE3.from_xyz(0.0, NAN, 0.0),
        lambda: SE3.from_xyz_rpy((0.0, 0.0, -np.inf)),
        lambda: SE3.from_quat_xyzw((0.0, 0.0, NAN), (0.0, 0.0, 0.0, 1.0)),
        lambda: SE3.from_mapping([0.0, 0.0, NAN]),
        lambda: SE3.from_matrix(np.full((4, 4), NAN)),
    ],
)
def test_numbers_that_are_not_finite_are_refused(make):
    with pytest.raises(InputError, match="not finite"):
        make()


@pytest.mark.parametrize("quat", [(0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (0.99, 0.0, 0.0, 0.0)])
def test_a_quaternion_that_is_not_unit_is_refused(quat):
    for make in (SO3.from_quat_wxyz, SO3.from_quat_xyzw):
        with pytest.raises(InputError, match="norm"):
            make(quat)


def test_rounding_in_a_quaternion_is_forgiven():
    R = SO3.from_quat_wxyz(np.array([0.7071, 0.7071, 0.0, 0.0]))
    np.testing.assert_allclose(R.matrix @ R.matrix.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("matrix", [np.diag([2.0, 2.0, 2.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0])])
def test_a_matrix_that_is_no_rotation_is_refused(matrix):
    with pytest.raises(InputError):
        SE3.from_matrix(matrix)


@pytest.mark.parametrize(
    "value",
    [None, 3, "0 0 0", [], [1, 2], [1, 2, 3, 4], ["a", 0, 0], {"xyz": [1, 2]}, {"pos": [1, 2, 3]},
     {"xyz": [0, 0, 0], "quat_xyzw": [0, 0, 0, 2]}, {"rpy": "left"}],
)  # fmt: skip
def test_what_is_no_pose_is_refused_by_name(value):
    with pytest.raises(InputError, match="^target: ") as error:
        SE3.from_mapping(value, "target")
    assert "\n" not in str(error.value)
