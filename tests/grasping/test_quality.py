"""Epsilon and volume against linear programs and closed forms; robustness falls with noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from scipy.stats import norm
from tests.grasping.solids import solid

from armcell.core import SE3, Box, Cylinder
from armcell.grasping import (
    Noise,
    PadContact,
    contact_wrenches,
    grasp_candidates,
    grasp_quality,
    hand_of,
    hull_quality,
    robustness,
)
from armcell.model import load_robot
from armcell.scene import Material


@pytest.fixture(scope="module")
def hand():
    model = load_robot("panda")
    return hand_of(model, model.gripper())


def reach(wrenches: np.ndarray, direction: np.ndarray) -> float:
    """Largest t with t * direction in the hull of the wrenches: a linear program over the hull's weights."""
    n = len(wrenches)
    result = linprog(
        np.r_[np.zeros(n), -1.0],
        A_eq=np.vstack([np.hstack([wrenches.T, -direction[:, None]]), np.r_[np.ones(n), 0.0]]),
        b_eq=np.r_[np.zeros(6), 1.0], bounds=[(0, None)] * (n + 1),
    )  # fmt: skip
    return result.x[-1] if result.success else 0.0


def pinch(tilt: float = 0.0, radius: float = 0.005, along: float = 0.01) -> tuple[PadContact, ...]:
    normal = np.array([np.sin(tilt), np.cos(tilt), 0.0])
    return (
        PadContact(np.array([along, 0.02, 0.0]), normal, radius),
        PadContact(np.array([along, -0.02, 0.0]), normal * [1, -1, 1], radius),
    )


@pytest.mark.slow
@pytest.mark.cases("0.35")
@pytest.mark.parametrize("tilt", [0.0, 0.2, 0.35])
def test_epsilon_is_the_least_wrench_by_linear_programs(tilt):
    wrenches = contact_wrenches(pinch(tilt), np.zeros(3), 0.04, Material(0.5))
    quality = hull_quality(wrenches)
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(60, 6))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    reached = np.array([reach(wrenches, way) for way in ways])
    assert quality.force_closure and np.all(reached >= quality.epsilon - 1e-9)
    best = min(
        minimize(lambda w: reach(wrenches, w / np.linalg.norm(w)), way, method="Nelder-Mead",
                 options={"maxiter": 350, "xatol": 1e-4, "fatol": 1e-6}).fun
        for way in ways[np.argsort(reached)[:2]]
    )  # fmt: skip
    assert quality.epsilon <= best + 1e-9 and best == pytest.approx(quality.epsilon, rel=0.1)


def test_a_hull_known_in_closed_form():
    corners = np.vstack([np.eye(6), -np.eye(6)])  # a cross-polytope: radius 1 / sqrt 6, volume 2^6 / 6!
    quality = hull_quality(corners)
    assert quality.epsilon == pytest.approx(1 / np.sqrt(6)) and quality.volume == pytest.approx(64 / 720)
    assert not hull_quality(corners + 2 * np.eye(6)[0]).force_closure


@pytest.mark.slow
def test_force_closure_ends_at_the_friction_cone():
    """Two opposite contacts whose normals lean the same way hold while the lean is within friction."""
    mu = 0.5
    for lean, holds in ((0.9, True), (1.1, False)):
        contacts = pinch(np.arctan(lean * mu))
        wrenches = contact_wrenches(contacts, np.zeros(3), 0.04, Material(mu), edges=64)
        assert hull_quality(wrenches).force_closure == holds
    assert not hull_quality(contact_wrenches(pinch()[:1], np.zeros(3), 0.04, Material(mu))).force_closure


def test_a_point_without_torsion_is_no_force_closure():
    frictionless = Material(0.5, torsional_friction=0.0)
    assert not hull_quality(
        contact_wrenches(pinch(radius=0.0), np.zeros(3), 0.04, frictionless)
    ).force_closure


def test_held_at_its_middle_is_better_than_at_its_end(hand):
    rod = solid(Cylinder(0.01, 0.2), mass=0.3)
    grasps = {g.name: g for g in grasp_candidates(rod, hand, on_support=False)[0]}
    middle, end = next((grasps[n], grasps[f"{n} +60 mm"]) for n in grasps if f"{n} +60 mm" in grasps)
    assert grasp_quality(rod, middle).epsilon > 1.05 * grasp_quality(rod, end).epsilon
    assert middle.score > end.score and middle.force < end.force


def test_a_few_noisy_samples_cover_the_distribution_evenly():
    """A Latin hypercube: one of n samples is in each n-quantile. The first object is nominal."""
    item, noise = solid(Box(0.06, 0.04, 0.08), mass=0.5, material=Material(0.5)), Noise()
    first, *others = noise.materials(item, 9, np.random.default_rng(1))
    assert (first.mass, first.material) == (item.mass, item.material)
    logs = np.log([[o.material.friction / 0.5, o.mass_kg / 0.5] for o in others])
    assert noise.poses(1, np.random.default_rng(1))[0].distance_to(SE3.identity()) == (0.0, 0.0)
    shifts = [T.translation for T in noise.poses(9, np.random.default_rng(1))[1:]]
    for samples in [*(logs / [noise.friction, noise.mass]).T, *np.array(shifts).T / noise.position]:
        assert sorted(np.floor(8 * norm.cdf(samples))) == list(range(8))


def test_robustness_falls_with_noise_and_rises_with_force(hand):
    box = solid(Box(0.06, 0.04, 0.08), mass=0.5, material=Material(0.5))
    grasp = grasp_candidates(box, hand)[0][0]
    calm, rough = (
        robustness(box, hand, grasp, Noise(0.001 * k, 0.02 * k, 0.1 * k, 0.1 * k), trials=100) for k in (0, 8)
    )
    assert calm == 1.0 and 0.0 < rough < 0.9
    slippery = solid(Box(0.06, 0.04, 0.08), mass=2.15, material=Material(0.2))
    assert robustness(slippery, hand, grasp_candidates(slippery, hand)[0][0]) < 0.5
