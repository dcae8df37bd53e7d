"""The viewer in a real browser: a screenshot shows the arm at its pose, and follows when it moves.

The floor is green and the Panda is not: a pixel without color is the arm's, a green one is not.
"""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from tests.viewer.chromium import Chromium, find_chromium

from armcell.core import SE3, SO3, Box, StateSample
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.viewer import CellViewer

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_chromium() is None,
        reason="no chromium or chrome in PATH to show the viewer in (Debian: apt install chromium)",
    ),
]

SIZE = (900, 640)  # [px] kept small: without a GPU a frame takes seconds
FIRST_FRAME_S, NEXT_FRAME_S = 240.0, 120.0
HOME = [-0.6, 0.5, 0.0, -1.7, 0.0, 2.2, 0.785, 0.0]  # fingers closed: the tcp is inside them
TURNED = [0.9, 0.5, 0.0, -1.7, 0.0, 2.2, 0.785, 0.0]
EYE, TARGET = (1.7, -0.5, 1.2), (0.2, 0.42, 0.25)  # [m], z is up
FOV = np.deg2rad(45.0)  # vertical
POINTS = {"panda_hand_tcp": (0, 0, 0), "panda_hand": (0, 0, 0.03), "panda_link4": (0, 0, 0)}  # [m] in links


def aim(camera):
    """Put a client's camera at `EYE`, again if the page's own start-up has moved it since."""
    camera.fov = FOV
    if not (np.allclose(camera.position, EYE, atol=1e-3) and np.allclose(camera.look_at, TARGET, atol=1e-3)):
        camera.position = EYE  # takes look_at along
        camera.look_at = TARGET


def places(scene, q):
    """Where each of `POINTS` is in the picture (column, row) [px] with the arm at q (dof,)."""
    forward = np.subtract(TARGET, EYE) / np.linalg.norm(np.subtract(TARGET, EYE))
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)  # x right, y down, z forward
    T_world_camera = SE3(SO3(R), np.array(EYE))
    tree, focal, found = kinematic_tree(scene.model), SIZE[1] / 2 / np.tan(FOV / 2), {}
    for link, point in POINTS.items():
        x, y, z = T_world_camera.inverse().apply(tree.link_pose(q, link).apply(point))
        found[link] = (round(SIZE[0] / 2 + focal * x / z), round(SIZE[1] / 2 + focal * y / z))
    return found


def around(picture, place, reach=2):
    """The median color of the pixels around a place, (3,)."""
    u, v = place
    assert 10 < u < SIZE[0] - 340 and 10 < v < SIZE[1] - 10, f"{place} is outside or under the panel"
    return np.median(picture[v - reach : v + reach + 1, u - reach : u + reach + 1].reshape(-1, 3), axis=0)


def is_floor(color):
    red, green, blue = color
    return green > red + 30 and green > blue + 30


def is_robot(color):
    return np.ptp(color) < 30


def picture_when(browser, camera, condition, timeout):
    """Screenshots until one meets the condition; the last one if none does."""
    end = time.monotonic() + timeout
    while True:
        aim(camera)
        picture = browser.screenshot()
        if condition(picture) or time.monotonic() > end:
            return picture
        time.sleep(0.5)


def keep(picture, name):
    """For a look with one's own eyes: ARMCELL_TEST_PICTURES=folder."""
    if "ARMCELL_TEST_PICTURES" in os.environ:
        from PIL import Image

        folder = Path(os.environ["ARMCELL_TEST_PICTURES"])
        folder.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).save(folder / f"{name}.png")


@pytest.mark.interop  # more than a minute: Chromium draws in software
def test_the_picture_shows_the_arm_at_its_pose_and_follows_it(tmp_path):
    floor = CollisionObject.single(
        "floor", Box(6, 6, 0.02), SE3.from_xyz(0, 0, -0.02), color=(0.05, 0.55, 0.2, 1.0)
    )
    scene = PlanningScene.of(load_robot("panda"), HOME, [floor])
    with CellViewer(scene, port=0) as viewer:
        viewer.server.scene.configure_default_lights(cast_shadow=False)  # the dearest part of a frame
        with Chromium(find_chromium(), tmp_path / "profile", SIZE) as browser:
            browser.open(viewer.url)
            end = time.monotonic() + 60
            while not viewer.server.get_clients():
                assert time.monotonic() < end, "the browser did not connect to the viewer"
                time.sleep(0.1)
            (client,) = viewer.server.get_clients().values()
            assert (client.camera.image_width, client.camera.image_height) == SIZE

            home, turned = (places(scene, np.array(q)) for q in (HOME, TURNED))

            def arm_at(where):
                return lambda picture: all(is_robot(around(picture, place)) for place in where.values())

            def arm_only_at(where, elsewhere):
                def check(picture):
                    left = all(is_floor(around(picture, place)) for place in elsewhere.values())
                    return left and arm_at(where)(picture)

                return check

            first = picture_when(browser, client.camera, arm_only_at(home, turned), FIRST_FRAME_S)
            keep(first, "home")
            assert len(np.unique(first.reshape(-1, 3), axis=0)) > 500, "the page is blank"
            colors = {link: around(first, place).tolist() for link, place in home.items()}
            assert arm_at(home)(first), f"the arm is not where it should be: {home} {colors}"
            assert arm_only_at(home, turned)(first), "something else than the floor is where the arm will go"

            joints = scene.with_positions(TURNED).state
            viewer.on_state(StateSample(1.0, joints))
            second = picture_when(browser, client.camera, arm_only_at(turned, home), NEXT_FRAME_S)
            keep(second, "turned")
            colors = {link: around(second, place).tolist() for link, place in turned.items()}
            assert arm_at(turned)(second), f"the arm is not where it was moved to: {turned} {colors}"
            assert arm_only_at(turned, home)(second), "the arm is still where it was"
