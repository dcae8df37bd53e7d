"""Forward kinematics and Jacobians against pinocchio and against finite differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tests.model.helpers import EXAMPLES, REFERENCES, PinRobot, chain_of, dual, model_of, random_positions
from tests.model.helpers import joint as j
from tests.model.helpers import link as l
from tests.sizes import ROBOTS

from armcell.core import SE3, SO3, InputError, UnknownNameError
from armcell.kinematics import KinematicTree, kinematic_tree
from armcell.model import load_robot, load_urdf

ROUNDS = 20


@pytest.fixture(scope="module", params=REFERENCES)
def pair(request):
    model, reference = REFERENCES[request.param]()
    return model, PinRobot(reference, model)


@pytest.mark.slow
@pytest.mark.cases(*ROBOTS, "tiago_dual")
def test_every_link_pose_is_pinocchio_s(pair):
    model, reference = pair
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    for _ in range(ROUNDS):
        q = random_positions(model, rng)
        reference.place(tree.full_positions(q))
        for name, T in zip(tree.link_names, tree.link_transforms(q), strict=True):
            np.testing.assert_allclose(T, reference.pose(name), atol=1e-10, err_msg=name)


def test_jacobians_are_pinocchio_s(pair):
    model, reference = pair
    tree, rng = kinematic_tree(model), np.random.default_rng(1)
    links = [link for link in model.links if len(tree.path_to(link))]
    for link in rng.choice(links, 10):
        q = random_positions(model, rng)
        reference.place(tree.full_positions(q))
        np.testing.assert_allclose(tree.jacobian(q, link), reference.jacobian(link), atol=1e-10)


BROKEN = {
    "alex_psyonic_hands.urdf",
    "romeo_laas_small.urdf",
    "ur3.urdf",
}  # mimics nothing, lost mesh, no links


@pytest.mark.long
def test_every_robot_of_example_robot_data_is_pinocchio_s():
    files = [f for f in sorted(EXAMPLES.rglob("*.urdf")) if f.name not in BROKEN]
    assert len(files) > 50
    for file in files:
        model = load_urdf(file)
        reference = PinRobot(pin.buildModelFromUrdf(str(file)), model)
        tree, q = kinematic_tree(model), random_positions(model, np.random.default_rng(0))
        reference.place(tree.full_positions(q))
        for name, T in zip(tree.link_names, tree.link_transforms(q), strict=True):
            np.testing.assert_allclose(T, reference.pose(name), atol=1e-9, err_msg=f"{file.name}: {name}")


def numeric_jacobian(tree: KinematicTree, q: np.ndarray, link: str, h: float = 1e-6) -> np.ndarray:
    columns = []
    for k in range(len(q)):
        d = h * np.eye(len(q))[k]
        before, after = tree.link_pose(q - d, link), tree.link_pose(q + d, link)
        linear = (after.translation - before.translation) / (2 * h)
        columns.append(np.r_[linear, (after.rotation @ before.rotation.inverse()).log() / (2 * h)])
    return np.array(columns).T


def robots():
    up = '<origin xyz="0 0 0.4"/>'
    mimics = model_of(
        l("a"), l("b"), l("c"), l("d"),
        j("j1", "a", "b", inside='<origin xyz="0.1 0.2 0.3"/><axis xyz="0 1 0"/>'),
        j("j2", "b", "c", inside=f'{up}<axis xyz="1 0 0"/><mimic joint="j1" multiplier="-2" offset="0.3"/>'),
        j("j3", "c", "d", inside=f'{up}<axis xyz="0 0 1"/><mimic joint="j2" multiplier="0.5"/>'),
    )  # fmt: skip
    return {
        "panda": load_robot("panda"),
        "dual": dual(),
        "slides": chain_of("prismatic 0 1 1", "revolute 1 2 3", "prismatic 1 0 0", "continuous 0 0 1"),
        "floating": chain_of("floating 0 0 1", "revolute 0 1 0"),
        "planar": chain_of("planar 1 1 0", "revolute 0 1 0"),
        "mimics": mimics,
    }


@pytest.mark.parametrize("name", robots())
def test_jacobians_are_the_derivatives(name):
    model = robots()[name]
    tree, rng = kinematic_tree(model), np.random.default_rng(2)
    for link in rng.choice(tree.link_names[1:], 5):
        q = 0.5 * random_positions(model, rng)
        J = tree.jacobian(q, link)
        np.testing.assert_allclose(J, numeric_jacobian(tree, q, link), atol=1e-7)
        some = tuple(rng.permutation(model.joint_names)[:3])
        np.testing.assert_array_equal(tree.jacobian(q, link, some), J[:, model.columns(some)])


def test_a_mimic_follows_through_another_mimic():
    tree = kinematic_tree(robots()["mimics"])
    assert tree.model.joint_names == ("j1",)
    full = tree.full_positions([0.4])
    assert full == pytest.approx({"j1": 0.4, "j2": -0.5, "j3": -0.25})


def test_a_planar_joint_moves_in_its_plane_and_a_floating_one_everywhere():
    rng = np.random.default_rng(3)
    normal = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    planar, floating = kinematic_tree(robots()["planar"]), kinematic_tree(robots()["floating"])
    still = planar.link_pose(np.zeros(4), "l1")
    for _ in range(10):
        x, y, theta = rng.uniform(-1, 1, 3)
        moved = still.inverse() @ planar.link_pose([x, y, theta, 0.0], "l1")
        assert moved.translation @ normal == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(moved.translation) == pytest.approx(np.hypot(x, y))
        assert SE3(moved.rotation, np.zeros(3)).isclose(SE3(SO3.exp(theta * normal), np.zeros(3)), 1e-9, 1e-7)
        xyz, rpy = rng.uniform(-1, 1, (2, 3))
        moved = floating.link_pose(np.zeros(7), "l1").inverse() @ floating.link_pose(
            [*xyz, *rpy[::-1], 0.0], "l1"
        )
        np.testing.assert_allclose(moved.matrix, SE3.from_xyz_rpy(xyz, rpy).matrix, atol=1e-12)


def test_the_right_arm_of_two_is_the_left_one_shifted():
    model, single = dual(), load_robot("ur10_gripper")
    tree, alone, rng = kinematic_tree(model), kinematic_tree(single), np.random.default_rng(4)
    shift = SE3.from_xyz(0.0, -1.5, 0.0)
    left = model.columns(["left_" + n for n in single.joint_names])
    right = model.columns(["right_" + n for n in single.joint_names])
    for _ in range(10):
        ql, qr = random_positions(single, rng), random_positions(single, rng)
        q = np.empty(model.dof)
        q[left], q[right] = ql, qr
        for link in single.links:
            assert tree.link_pose(q, "left_" + link).isclose(alone.link_pose(ql, link), 1e-9, 1e-7)
            assert tree.link_pose(q, "right_" + link).isclose(shift @ alone.link_pose(qr, link), 1e-9, 1e-7)


def test_unknown_links_are_named():
    tree = kinematic_tree(load_robot("panda"))
    q = tree.model.neutral()
    for ask in (lambda: tree.link_pose(q, "panda_link99"), lambda: tree.path_to("panda_link99")):
        with pytest.raises(UnknownNameError, match="panda_link9"):
            ask()


def test_the_jacobian_of_an_unknown_link_names_it():
    tree = kinematic_tree(load_robot("panda"))
    with pytest.raises(UnknownNameError):
        tree.jacobian(tree.model.neutral(), "panda_link99")


def test_one_tree_per_model():
    model = load_robot("panda")
    assert kinematic_tree(model) is kinematic_tree(model)


def test_positions_that_are_not_finite_give_no_pose():
    model = load_robot("panda")
    with pytest.raises(InputError, match="no pose"):
        kinematic_tree(model).link_pose(np.full(model.dof, np.nan), "panda_hand")
