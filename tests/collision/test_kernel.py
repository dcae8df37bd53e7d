"""The kernel answers as the exact checker does: every shape, padding, scale, allowed pair and held object.

It takes a link whose mesh is not convex as convex pieces around it, so it may call a near miss a contact;
never a contact a miss.
"""

from __future__ import annotations

import copy
import pickle
import time

import numpy as np
import pytest
from tests.collision.test_exact import AT_ONE, ell, scene_with
from tests.model.helpers import dual, random_positions
from tests.scene.helpers import box, floating, mesh_of, open_bin, panda, ur10

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, Sphere
from armcell.scene import CollisionObject, PlanningScene

TOLERANCE = 2e-4  # [m] from touching, within which the two may differ
PIECES = 0.015  # [m] by which the convex pieces of the UR10's links may reach beyond these
PADS = [{}, {"padding": 0.02}, {"link_padding": {"cube": 0.02}}, {"link_scale": {"cube": 1.2}}]


def compare(scene: PlanningScene, configurations, names=None, excess: float = 0.0) -> set[bool]:
    """Answers of both where they must be the same; returns which answers there were."""
    exact, kernel, seen = ExactChecker(scene, names), KernelChecker(scene, names), set()
    for q in configurations:
        nearest = exact.nearest(q)
        margins = {0.0, *exact.margins.tolist()}
        if nearest is not None and min(abs(nearest.distance - m) for m in margins) <= TOLERANCE:
            continue
        seen.add(exact.is_free(q))
        near_miss = exact.is_free(q) and nearest is not None and nearest.distance <= max(margins) + excess
        assert kernel.is_free(q) == exact.is_free(q) or near_miss, (q, nearest)
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("pads", PADS, ids=str)
@pytest.mark.parametrize("name", AT_ONE)
def test_every_shape(name, pads):
    near = 0.9 + np.array([-0.5, -0.05, -0.0205, -0.0195, -0.001, 0.001, 0.004, 0.05])
    assert compare(scene_with(name, **pads), near[:, None]) == {True, False}


def test_in_and_around_a_bin():
    bin_ = CollisionObject.single("bin", mesh_of(open_bin(0.6, 0.5, 0.02)), SE3.from_xyz(0.5, 0.0, -0.2))
    assert compare(floating(bin_), np.linspace(-1, 2, 61)[:, None]) == {True, False}


def test_inside_a_closed_mesh_is_not_free():
    kernel = KernelChecker(floating(CollisionObject.single("L", mesh_of(ell()))))
    assert kernel.is_free([2.0]) and not kernel.is_free([1.2])
    assert not kernel.is_free([0.0])


HELD = box("held", (0.05, 0.2, 0.05), (0.307, 0.0, 0.45))


def scenes():
    both = PlanningScene.of(dual())
    return {
        "alone": (panda(), None),
        "holding": (panda(HELD).with_attached("held", "panda_hand", ["panda_leftfinger"]), None),
        "allowed": (
            panda(box("crate", (0.4, 0.4, 0.4), (0.5, 0, 0.2))).with_allowed("crate", "panda_hand"),
            None,
        ),
        "padded": (ur10(box("crate", (0.4, 0.4, 0.4), (0.7, 0, 0.2))).with_padding(0.03), None),
        "forbidden": (panda().with_allowed("panda_link0", "panda_link2", allow=False), None),
        "one of two arms": (both, both.model.group("left_arm").joint_names),
    }


@pytest.mark.slow
@pytest.mark.cases("alone", "holding", "allowed", "one of two arms")
@pytest.mark.parametrize("name", scenes())
def test_random_configurations(name):
    scene, names = scenes()[name]
    rng = np.random.default_rng(0)
    columns = scene.model.columns(names or scene.model.joint_names)
    excess = 0.0 if scene.model.name == "panda" else PIECES
    seen = compare(scene, (random_positions(scene.model, rng)[columns] for _ in range(200)), names, excess)
    assert True in seen


def test_relaxed_margins():
    for gap in (0.015, 0.003):
        kernel = KernelChecker(scene_with("box", padding=0.02))
        at = np.array([0.9 - gap])
        assert not kernel.is_free(at)
        kernel.relax_margins(at)
        assert kernel.is_free(at) and kernel.is_free(at - 0.05) and not kernel.is_free(at + 0.0005)


def test_edges_at_samples():
    kernel = KernelChecker(floating(CollisionObject.single("ball", Sphere(0.1), SE3.from_xyz(1, 0, 0))))
    assert not kernel.edge_is_free([0.0], [2.0]) and kernel.edge_is_free([0.0], [0.7])
    assert not kernel.edge_is_free([0.0], [0.81])  # the end counts


@pytest.mark.long
def test_a_held_crate_is_ready_in_time(tmp_path, monkeypatch):
    """A planner asked for an answer in 5 s has none to spare for covers."""
    crate = box("crate", (0.3, 0.25, 0.2), (0.307, 0.0, 0.35))
    held = panda(crate).with_attached("crate", "panda_hand", ["panda_leftfinger", "panda_rightfinger"])
    KernelChecker(panda())  # compiled and with its links covered
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))  # as the first time that it is held
    began = time.monotonic()
    KernelChecker(held)
    assert time.monotonic() - began < 20.0


@pytest.mark.parametrize("made", [copy.deepcopy, lambda checker: pickle.loads(pickle.dumps(checker))])
def test_a_copy_is_a_checker_of_its_own(made):
    """Addresses of the first one's memory must not travel."""
    there = made(KernelChecker(scene_with("box")))
    assert not there.is_free([0.95]) and there.is_free([0.8])
    assert there.clearance([[0.7], [0.8]]) == pytest.approx(0.1, abs=1e-3)
