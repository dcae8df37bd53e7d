"""Rendering of a real-time cell's cameras in another process, without blocking the cell."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

from armcell.core import ArmcellError, CameraImage
from armcell.drivers import Driver
from armcell.scene import PlanningScene
from armcell.sim import Camera, Decal
from armcell.sim.render_process import MeasuredState, PhysicsState, RenderProcess, RenderRequest, RenderSetup

logger = logging.getLogger(__name__)
Give = Callable[[CameraImage], None]

MOST_KEPT = 64  # queued pictures of key moments
GIVES_UP_AFTER = 3  # failures in a row
CLOSE = 10.0  # [s] to draw the queued key moments when the cell closes


@dataclass(frozen=True, eq=False)
class _Request:
    order: RenderRequest
    time: float  # [s] time of the state, driver's clock
    give: Give
    keep: bool


class CellRenderer:
    """Renderer for the cameras of a real-time cell. It queues image requests, and a separate process draws
    the images.

    The thread and the process start with the first request.

    Attributes:
        ready: True after the first picture: the process has started and has built the scene.
        broken: the reason why no more pictures come; empty if there is none. Motions continue.
    """

    def __init__(self, driver: Driver, scene: PlanningScene, decals: Sequence[Decal] = ()):
        self._driver, self._scene, self._decals = driver, scene, decals
        self._setup: tuple[object, RenderSetup] | None = None
        self._wake = threading.Condition()
        self._waiting: dict[Hashable, _Request] = {}
        self._thread: threading.Thread | None = None
        self._closing = False
        self._process = RenderProcess()
        self._failures = 0
        self.ready = False
        self.broken = ""

    @property
    def pid(self) -> int | None:
        """Return the process ID of a cell's rendering process, or None if it is not running."""
        return self._process.pid

    def ask(
        self, key: Hashable, camera: Camera, give: Give, rgb: bool = True, depth: bool = True,
        keep: bool = False,
    ) -> None:  # fmt: skip
        """Request an image of a cell's camera from the cell's renderer, without waiting. A separate process
        draws the image.

        Call this method from the thread that steps the driver.

        Args:
            key: identifies the request. A new request replaces a waiting one with the same key, so the newest
                state is drawn. Requests are drawn in the order of their keys' first request.
            give: receives the picture, stamped with the time of the state, in the renderer's thread.
            keep: marks a key moment, which is also drawn if the cell closes in the meantime.
        """
        if self.broken or self._closing:
            return
        order = RenderRequest(*self._state(), camera, rgb, depth)
        with self._wake:
            if keep and len(self._waiting) >= MOST_KEPT:
                logger.warning("a picture is left out: %d wait to be drawn", MOST_KEPT)
                return
            self._waiting[key] = _Request(order, self._driver.now, give, keep)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="armcell-renderer", daemon=True)
                self._thread.start()
            self._wake.notify()

    def close(self) -> None:
        """End the rendering process of a cell after it has rendered all
        images of key moments that are still waiting.
        """
        with self._wake:
            self._closing = True
            self._waiting = {k: r for k, r in self._waiting.items() if r.keep}
            thread, self._thread = self._thread, None
            self._wake.notify()
        if thread is not None:
            thread.join(CLOSE)
            self._waiting = {}
            if thread.is_alive():
                self._process.kill()
                thread.join(1.0)
        self._setup = None

    # --- implementation ---
    def _state(self) -> tuple[RenderSetup, PhysicsState | MeasuredState]:
        world = self._driver.world
        if world is not None:
            if self._setup is None or self._setup[0] is not world.mj_model:
                self._setup = world.mj_model, RenderSetup.of(world)
            return self._setup[1], PhysicsState.of(world)
        if self._setup is None:
            self._setup = self, RenderSetup(self._scene, decals=self._decals)
        q = self._driver.joint_state().positions
        return self._setup[1], MeasuredState(q, self._driver.object_poses())

    def _run(self) -> None:
        """Render the requested camera images of a real-time cell. This function runs in the renderer's
        thread; a separate process draws the images.

        The process draws the next image while `give` handles the last one.
        """
        try:
            request = self._next(wait=True)
            while request is not None:
                image = self._finish(request)
                following = self._next(wait=False)
                if image is not None:
                    self._give(request, image)
                request = following or self._next(wait=True)
        finally:
            self._process.close()

    def _next(self, wait: bool) -> _Request | None:
        """Start rendering the oldest waiting request for a camera image of the cell, and return this request.

        Args:
            wait: wait for a request.
        Returns:
            The request; None if none waits, or if the renderer is closed or broken.
        """
        with self._wake:
            if wait:
                self._wake.wait_for(lambda: self._waiting or self._closing or self.broken)
            if not self._waiting or self.broken:
                return None
            request = self._waiting.pop(next(iter(self._waiting)))
        self._process.begin(request.order)
        return request

    def _finish(self, request: _Request) -> CameraImage | None:
        try:
            image = self._process.finish()
        except ArmcellError as error:
            self._failed(f"camera {request.order.camera.name!r}: {error}")
            return None
        self._failures, self.ready = 0, True
        return replace(image, time=request.time)

    def _give(self, request: _Request, image: CameraImage) -> None:
        try:
            request.give(image)
        except Exception:  # an error in one receiver must not stop the pictures of others
            logger.exception("a picture of %s could not be used", image.camera)

    def _failed(self, reason: str) -> None:
        self._failures += 1
        if self._failures < GIVES_UP_AFTER:
            logger.warning("%s; motions go on, rendering is tried again", reason)
            return
        self.broken = reason
        logger.warning(
            "%s: no more pictures of this cell; motions go on (MUJOCO_GL=off draws without OpenGL)", reason
        )
