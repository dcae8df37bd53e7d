"""The planning panel in a real browser: the page opens, "Plan" is pressed, success is read."""

from __future__ import annotations

import time

import numpy as np
import pytest
from tests.viewer.chromium import Chromium, find_chromium
from tests.viewer.test_browser import keep

from armcell.cell import load
from armcell.core import SE3
from armcell.viewer import PlanningPanel, PlanningSession

pytestmark = [
    pytest.mark.interop,
    pytest.mark.skipif(
        find_chromium() is None,
        reason="no chromium or chrome in PATH to show the panel in (Debian: apt install chromium)",
    ),
]

SIZE, SCALE = (1280, 800), 0.4
PAGE_S = 240.0  # [s] without a GPU the first frame takes long
BUTTON = """(() => {
  const found = [...document.querySelectorAll("button")].filter(b => b.innerText.trim() === "%s");
  if (found.length !== 1 || found[0].disabled) return null;
  const r = found[0].getBoundingClientRect();
  return [r.x + r.width / 2, r.y + r.height / 2];
})()"""


def evaluated(browser, expression):
    return browser.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")


def until(browser, expression, timeout=PAGE_S):
    """The first value of an expression that is true."""
    end = time.monotonic() + timeout
    while not (value := evaluated(browser, expression)):
        assert time.monotonic() < end, f"did not come true: {expression}"
        time.sleep(0.2)
    return value


def press(browser, label):
    """A real click in the middle of a button, once it can be clicked."""
    x, y = until(browser, BUTTON % label)
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def says(text):
    return f"document.body.innerText.includes({text!r})"


def test_plan_is_pressed_and_success_is_read(tmp_path):
    cell = load("panda_pick")
    session = PlanningSession(
        cell.scene(), lambda scene, observers: cell.connect("fake", observers=observers, scene=scene)
    )
    with (
        PlanningPanel(session, port=0, title=cell.name, folder=tmp_path) as panel,
        Chromium(find_chromium(), tmp_path / "profile", SIZE, scale=SCALE) as browser,
    ):
        panel.viewer.server.scene.configure_default_lights(cast_shadow=False)  # the dearest part of a frame
        browser.open(panel.url)
        until(browser, says("Goal free"))
        session.set_goal_pose(SE3.from_xyz_rpy((0.48, -0.25, 0.25), (np.pi, 0.0, 0.0)))
        press(browser, "Plan")
        until(browser, says("SUCCESS"))
        assert session.result is not None and session.result.ok
        assert evaluated(browser, says(f"duration {session.result.trajectory.duration:.2f} s"))
        picture = browser.screenshot()
        keep(picture, "planning_panel")
        view = picture[:, : picture.shape[1] * 2 // 3]
        assert len(np.unique(view.reshape(-1, 3), axis=0)) > 500, "the view is blank"
        press(browser, "Execute")
        until(browser, says("executed"))
        assert session.outcome is not None and session.outcome.ok

        session.set_goal_pose(SE3.from_xyz_rpy((0.55, 0.06, 0.2), (np.pi, 0.0, 0.0)))
        until(browser, says("panda_hand touches wall"))
        press(browser, "Plan")
        until(browser, says("What would help"))
        keep(browser.screenshot(), "planning_panel_why")
        press(browser, "move the goal 67 mm along +z")
        until(browser, says("SUCCESS"))
