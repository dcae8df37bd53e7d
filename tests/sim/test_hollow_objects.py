"""Meshes with cavities hold other objects in physics."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.collision.test_decompose import bin_of, cup, mesh_of

from armcell.collision.winding import WindingNumbers
from armcell.core import SE3, Box, Sphere
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import SimWorld

AT = (0.5, 0.0)


def _world(solid: trimesh.Trimesh, movable: bool, content: Box | Sphere, height: float) -> SimWorld:
    x, y = AT
    table = CollisionObject.single("table", Box(1.0, 1.0, 0.1), SE3.from_xyz(x, y, -0.05))
    hollow = CollisionObject.single(
        "hollow", mesh_of(solid), SE3.from_xyz(x, y, 0.0), movable=movable, mass=0.2
    )
    item = CollisionObject.single("item", content, SE3.from_xyz(x, y, height), movable=True, mass=0.05)
    model = load_robot("panda")
    scene = PlanningScene.of(model, objects=[table, hollow, item])
    return SimWorld(scene.with_positions(model.default_positions()))


@pytest.mark.parametrize("movable", (False, True))
def test_a_cube_falls_to_the_floor_of_a_bin(movable):
    world = _world(bin_of(wall=0.004), movable, Box(0.04, 0.04, 0.04), 0.2)
    world.step(round(1.0 / world.timestep))
    assert world.object_pose("item").translation[2] == pytest.approx(0.024, abs=1e-3)


def test_a_ball_falls_into_a_cup():
    world = _world(cup(wall=0.003), True, Sphere(0.02), 0.15)
    world.step(round(1.0 / world.timestep))
    assert world.object_pose("item").translation[2] == pytest.approx(0.023, abs=1e-3)
    assert world.object_pose("hollow").translation[2] == pytest.approx(0.0, abs=1e-3)


def test_many_pieces_in_contact_fit_into_physics_memory(caplog):
    """Without memory for its contacts, MuJoCo drops all of them, and everything falls through the table."""
    table = CollisionObject.single("table", Box(1.0, 1.0, 0.1), SE3.from_xyz(0.5, 0.0, -0.05))
    shape, places = mesh_of(cup()), [(0.5 + 0.004 * k, 0.003 * (k % 2), 0.0) for k in range(12)]
    cups = [
        CollisionObject.single(f"cup {k}", shape, SE3.from_xyz(*at), movable=True, mass=0.2)
        for k, at in enumerate(places)
    ]
    model = load_robot("panda")
    scene = PlanningScene.of(model, objects=[table, *cups])
    SimWorld(scene.with_positions(model.default_positions())).step(1)
    assert "arena" not in caplog.text


@pytest.mark.slow
def test_physics_and_the_exact_checker_agree_which_regions_are_solid():
    """A small ball at random places around a cup: who sees a contact deeper, or a gap wider, than 1 mm?"""
    radius, solid = 0.004, cup()
    world = _world(solid, False, Sphere(radius), 0.3)
    winding = WindingNumbers(solid.vertices, solid.faces)
    surface = trimesh.sample.sample_surface(solid, 100_000, seed=1)[0]  # about 0.7 mm apart
    rng, wrong, touching = np.random.default_rng(5), 0, 0
    for x, y, z in rng.uniform((-0.06, -0.06, 0.005), (0.06, 0.06, 0.12), (300, 3)):
        world.set_object_pose("item", SE3.from_xyz(AT[0] + x, AT[1] + y, z))
        contact = any({c.body_a, c.body_b} == {"item", "hollow"} for c in world.contacts())
        distance = float(np.linalg.norm(surface - (x, y, z), axis=1).min())
        inside = winding([[x, y, z]])[0] > 0.5
        gap = (-distance if inside else distance) - radius
        touching += contact
        wrong += (contact and gap > 1e-3) or (not contact and gap < -1e-3)
    assert touching > 30 and wrong == 0
