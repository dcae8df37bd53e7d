"""The allowed collision matrices of the library, checked by sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.model.helpers import collision, joint, link, model_of, random_positions
from tests.sizes import ROBOTS, sizes

from armcell.collision import ExactChecker, disabled_collision_pairs
from armcell.model import installed_robots, load_robot
from armcell.scene import PlanningScene


@pytest.mark.slow
@pytest.mark.cases("ur10_gripper-few", "panda-few", "dual_ur10-few", "scara-few", "palletizer-few", "ur5-few")
@pytest.mark.parametrize("samples", sizes(500, 5000))
@pytest.mark.parametrize("name", installed_robots())
def test_pairs_that_never_touch_do_not(name, samples):
    model = load_robot(name)
    never = {pair for pair, reason in model.disabled_collisions.items() if reason == "Never"}
    bodies = [n for n, link in model.links.items() if link.collisions]
    others = {frozenset((a, b)): "not asked" for i, a in enumerate(bodies) for b in bodies[:i]}
    only_never = replace(model, disabled_collisions={p: r for p, r in others.items() if p not in never})
    checker, rng = ExactChecker(PlanningScene.of(only_never)), np.random.default_rng(0)
    assert bool(len(checker.pairs)) == bool(never)
    for _ in range(samples if never else 1):
        q = random_positions(model, rng)
        assert checker.is_free(q), checker.contacts(q)


@pytest.mark.cases(*ROBOTS, "ur10_rail")
@pytest.mark.parametrize("name", installed_robots())
def test_the_default_state_is_free(name):
    model = load_robot(name)
    scene = PlanningScene.of(model)
    assert ExactChecker(scene).contacts(scene.positions) == []


@pytest.mark.cases(*ROBOTS, "ur10_rail")
@pytest.mark.parametrize("name", installed_robots())
def test_named_states_are_free(name):
    model = load_robot(name)
    for group, states in model.named_states.items():
        for state in states:
            scene = PlanningScene.of(model).with_state(model.named_state(group, state))
            assert ExactChecker(scene).contacts(scene.positions) == [], (group, state)


@pytest.mark.slow
@pytest.mark.cases("panda-few", "scara-few", "ur5-few")
@pytest.mark.parametrize("samples", sizes(60, 300))
@pytest.mark.parametrize("name", installed_robots())
def test_sampling_anew_finds_the_srdf_s_pairs(name, samples):
    """With few samples more pairs look like "Never" than are; those of the SRDF must be among them, except
    those that a user chose and those of fingertips, whose shapes are the finger's.
    """
    model = load_robot(name)
    solid = {n for n, link in model.links.items() if link.collisions}
    asked = {p: why for p, why in model.disabled_collisions.items() if why != "User" and p <= solid}
    found = disabled_collision_pairs(model, samples=samples, seed=1)
    missing = set(asked) - set(found)
    assert not missing
    for pair, reason in asked.items():
        assert (found[pair] == "Adjacent") == (reason == "Adjacent")


@pytest.mark.long
def test_the_same_seed_gives_the_same_pairs():
    model = load_robot("ur10")
    seen = []
    assert disabled_collision_pairs(model, 100, 3, seen.append) == disabled_collision_pairs(model, 100, 3)
    assert seen == [100]


def test_a_pair_that_always_touches_is_told():
    ball = collision('<sphere radius="0.2"/>')
    model = model_of(
        link("a", ball), link("b", collision('<sphere radius="0.05"/>')), link("c", ball),
        joint("j", "a", "b", inside='<origin xyz="0.2 0 0"/><axis xyz="0 0 1"/>'),
        joint("k", "b", "c", inside='<origin xyz="0.15 0 0"/><axis xyz="0 0 1"/>'),
    )  # fmt: skip
    apart = replace(model, named_states={})
    assert disabled_collision_pairs(apart, 50)[frozenset("ac")] in ("Always", "Default")


@pytest.mark.parametrize(("second", "nested"), [("1 0 0", True), ("0 1 0", False)])
def test_stages_of_a_telescope_are_adjacent(tmp_path, second, nested):
    links = "".join(
        f'<link name="{name}"><collision><geometry><box size="0.4 0.1 0.1"/></geometry></collision></link>'
        for name in ("base", "outer", "inner")
    )
    joints = "".join(
        f'<joint name="{child}_joint" type="prismatic"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit lower="0" upper="0.3" velocity="1" effort="1"/></joint>'
        for parent, child, axis in (("base", "outer", "1 0 0"), ("outer", "inner", second))
    )
    (tmp_path / "telescope.urdf").write_text(f'<robot name="telescope">{links}{joints}</robot>')
    found = disabled_collision_pairs(load_robot(tmp_path / "telescope.urdf"), samples=1000)
    assert (found.get(frozenset(("base", "inner"))) == "Adjacent") == nested
    assert found[frozenset(("outer", "inner"))] == "Adjacent"


@pytest.mark.parametrize(
    ("visual", "reason"),
    [
        ('<cylinder radius="0.05" length="0.02"/>', "Never"),
        ('<box size="0.1 0.1 0.02"/>', None),  # the collision shape is exact
        ('<sphere radius="0.02"/>', None),  # only a part of the wheel
        ("", None),
    ],
)
@pytest.mark.parametrize("between", (True, False))
def test_visual_meshes_decide_whether_coarse_neighbors_touch(visual, reason, between):
    """A wheel above a plate: in half of the states, a corner of the box around the wheel is in the plate."""
    plate = '<box size="0.2 0.2 0.02"/>'
    on_side = '<origin rpy="1.5707963267948966 0 0"/>'
    wheel = f'<collision>{on_side}<geometry><box size="0.1 0.1 0.02"/></geometry></collision>'
    drawn = f"<visual>{on_side}<geometry>{visual}</geometry></visual>" if visual else ""
    shown = f"<visual><geometry>{plate}</geometry></visual>"
    full = '<limit lower="-3" upper="3" velocity="1" effort="1"/>'
    model = model_of(
        link("plate", collision(plate) + shown), link("hub", collision('<sphere radius="0.002"/>')),
        link("wheel", wheel + drawn),
        joint("turn", "plate", "hub", "revolute" if between else "fixed",
              '<origin xyz="0 0 0.075"/><axis xyz="0 0 1"/>', full),
        joint("spin", "hub", "wheel", inside='<axis xyz="0 1 0"/>', limit=full),
    )  # fmt: skip
    found = disabled_collision_pairs(model, samples=1000)
    assert found.get(frozenset(("plate", "wheel"))) == reason
