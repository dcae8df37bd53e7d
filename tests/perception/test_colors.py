"""Names of colors, and known objects of one shape told apart by theirs."""

from __future__ import annotations

import numpy as np
import pytest

import armcell
from armcell.core import SE3, Box
from armcell.perception import LookSettings, color_distance, color_name, look
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, DepthNoise, SimWorld, look_at, take_image

CSS = {  # CSS Color Module Level 4, named colors: hex values and what we should call them
    "#ff0000": "red", "#b22222": "red", "#ffa500": "orange", "#ffd700": "yellow", "#008000": "green",
    "#32cd32": "green", "#00ffff": "cyan", "#0000ff": "blue", "#4169e1": "blue", "#800080": "purple",
    "#000000": "black", "#808080": "grey", "#f5f5f5": "white",
}  # fmt: skip


@pytest.mark.parametrize(("value", "name"), CSS.items())
@pytest.mark.parametrize("light", [1.0, 0.8])
def test_names_of_colors_whatever_the_light(value, name, light):
    rgb = np.array([int(value[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    if name != "white":  # which is grey in less light
        assert color_name(tuple(rgb * light)) == name


def test_distance_leaves_brightness_out():
    assert color_distance((0.8, 0.2, 0.2), (0.4, 0.1, 0.1)) == pytest.approx(0.0)
    assert color_distance((1, 0, 0), (0, 0, 1)) == pytest.approx(1.0)
    assert color_distance((0, 0, 0), (0, 0, 0)) == 0.0


@pytest.mark.slow
@pytest.mark.cases("True")
@pytest.mark.parametrize("swapped", [False, True])
def test_alike_shapes_are_told_apart_by_color(swapped):
    red, blue = (0.85, 0.3, 0.22, 1.0), (0.22, 0.42, 0.8, 1.0)
    places = [(0.45, 0.1), (0.55, -0.1)][:: -1 if swapped else 1]
    things = [
        CollisionObject.single(
            name, Box(0.05, 0.05, 0.05), SE3.from_xyz(x, y, 0.025), color=color, movable=True
        )
        for name, color, (x, y) in zip(("red", "blue"), (red, blue), places)
    ]
    table = CollisionObject.single("table", Box(1.2, 1.2, 0.04), SE3.from_xyz(0.6, 0, -0.02))
    world = SimWorld(PlanningScene.of(armcell.load_robot("parallel_gripper"), objects=[table, *things]))
    eye = Camera(
        "eye", look_at([0.2, -0.5, 0.6], [0.5, 0, 0]), width=320, height=240, noise=DepthNoise.for_stereo()
    )
    sight = look(
        take_image(world, eye), known=[t.at(SE3.identity()) for t in things], settings=LookSettings()
    )
    for thing in things:
        seen = sight[thing.name]
        assert color_name(seen.color) == thing.name
        assert np.linalg.norm(seen.T_world_object.translation - thing.T_world_object.translation) < 0.01
