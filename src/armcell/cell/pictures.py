"""Images of a run for reports, taken at the end of each stage and at the first contact."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.cell.live import LiveCell
from armcell.core import CameraImage, Event, JointTrajectory, StateSample
from armcell.scene import PlanningScene, extent
from armcell.sim import Camera, render_rgb

logger = logging.getLogger(__name__)

Picture = NDArray[np.uint8]

FROM = np.array([0.75, -0.6, 0.45])  # direction from the scene's center to the viewer
FIELD = 45.0  # [deg]


def overview(scene: PlanningScene) -> Camera:
    """Return a camera for pictures of a run, placed such that it shows the robot and all objects near it."""
    middle, radius = extent(scene)
    away = 1.3 * radius / np.sin(np.deg2rad(FIELD / 2))
    eye = middle + away * FROM / np.linalg.norm(FROM)
    return Camera.looking_at("overview", eye, middle, fovy_deg=FIELD)


class Pictures:
    """Observer that takes pictures during a run, for reports.

    It uses the cell's first camera that is not mounted on a link; without such a camera, an overview from the
    side in front. If the driver runs in real time, another process draws the pictures and they arrive later,
    in another thread (`CellRenderer`).

    Args:
        take: receives the time [s], a description and the picture (h, w, 3).
        stages: also take a picture at the end of each stage.
    """

    def __init__(self, live: LiveCell, take: Callable[[float, str, Picture], None], stages: bool = True):
        self._driver: Any = live.driver  # has a `world` once it is connected
        self._scene, self._take, self._stages = live.scene_at_start, take, stages
        self._touched = self._broken = False
        self._renderer = next((c.renderer for c in live.cameras.values()), None)
        self._number = 0

    @cached_property
    def _camera(self) -> Camera:
        still = (camera for camera in self._driver.world.cameras.values() if camera.link is None)
        return next(still, None) or overview(self._scene)

    def now(self) -> Picture:
        return render_rgb(self._driver.world, self._camera)

    def on_event(self, event: Event) -> None:
        touches = event.kind == "contact" and not self._touched
        if touches or (self._stages and event.kind == "stage" and event.data.get("phase") == "end"):
            self._touched = self._touched or touches
            self._try(event)

    def _try(self, event: Event) -> None:
        if self._broken:
            return
        if self._driver.is_paced and self._renderer is not None:
            self._number += 1
            key = "key moment", self._number
            self._renderer.ask(key, self._camera, partial(self._give, event), depth=False, keep=True)
            return
        try:
            picture = self.now()
        except Exception as error:  # the run continues on machines without graphics
            self._broken = True
            logger.warning("no more pictures of this run: %s", error)
        else:
            self._take(event.time, event.text, picture)

    def _give(self, event: Event, image: CameraImage) -> None:
        if image.rgb is not None:
            self._take(event.time, event.text, image.rgb)

    def on_state(self, sample: StateSample) -> None:
        pass

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass
