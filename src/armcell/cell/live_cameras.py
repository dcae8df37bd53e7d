"""Cameras of a running cell: newest images, rendering in another process, and octomap updates.

The other process renders the cameras of a real-time cell without blocking the cell. Octomap updates use
depth images.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.core import ArmcellError, CameraImage, ErrorCode, Event, JointTrajectory, StateSample
from armcell.core.checks import checked, require
from armcell.drivers import Driver
from armcell.perception import CameraMap, MapSettings, MapUpdate
from armcell.scene import OCTOMAP, PlanningScene
from armcell.sim import Camera, Decal, SimWorld, take_image
from armcell.sim.render_process import MeasuredState, PhysicsState, RenderProcess, RenderRequest, RenderSetup
from armcell.tasks import TaskContext

logger = logging.getLogger(__name__)
Give = Callable[[CameraImage], None]

MOST_KEPT = 64  # queued pictures of key moments
GIVES_UP_AFTER = 3  # failures in a row
CLOSE = 10.0  # [s] to draw the queued key moments when the cell closes
TOO_LATE = 0.25  # [s] a picture that took longer is taken once more; the first of a process does


@dataclass(frozen=True, eq=False)
class _Request:
    order: RenderRequest
    time: float  # [s] time of the state, driver's clock
    give: Give
    keep: bool


class CellRenderer:
    """Renderer for the live cameras of a real-time cell. It queues image requests, and a separate process
    draws the images.

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
        """Return the ID of the process that renders images for a cell's live cameras, or None if it is not
        running.
        """
        return self._process.pid

    def ask(
        self, key: Hashable, camera: Camera, give: Give, rgb: bool = True, depth: bool = True,
        keep: bool = False,
    ) -> None:  # fmt: skip
        """Request an image of a cell's camera from the renderer of the live cameras, without waiting. A
        separate process draws the image.

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
        """End the process that renders images for a cell's live cameras. If images of key moments are still
        waiting, the process renders them first.
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
        """Render the requested images of the live cameras in a real-time cell. This function runs in the
        renderer's thread; a separate process draws the images.

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
        """Start rendering the oldest waiting image request in the renderer of the live cameras, and return
        this request.

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


class LiveCamera:
    """Camera of a connected (live) cell, which takes images at its frame rate according to the driver's
    clock.

    Without physics, pictures show the joint positions and object poses that the driver reports. In lock-step,
    the calling thread draws. If the driver runs in real time, `ask` and `take` use another process that draws
    a copy of the state, so no motion waits for a picture.

    Attributes:
        frozen: set True to simulate a broken camera that repeats its last picture, for trials.
        renderer: the renderer that all cameras of the cell share.
    """

    def __init__(
        self, camera: Camera, driver: Driver, scene: PlanningScene, decals: Sequence[Decal] = (),
        renderer: CellRenderer | None = None,
    ):  # fmt: skip
        self.camera, self.frozen = camera, False
        self.renderer = renderer or CellRenderer(driver, scene, decals)
        self._driver, self._scene, self._decals = driver, scene, decals
        self._mirror: SimWorld | None = None
        self._newest: CameraImage | None = None
        self._given: CameraImage | None = None  # the last picture given by `ask`

    @property
    def name(self) -> str:
        return self.camera.name

    def due(self) -> bool:
        """Return whether a live camera has a newer image than the one last taken."""
        if self.frozen and self._newest is not None:
            return False
        return self._newest is None or self._number(self._driver.now) > self._number(self._newest.time)

    def ask(self, key: Hashable, give: Give, rgb: bool = True, depth: bool = True) -> None:
        """Request an image of the current state from a live camera without waiting.
        The image is passed to a function later.

        In lock-step, `give` runs at once. In real time, `give` runs in another thread when the picture is
        drawn; a new request replaces a waiting one with the same key (`CellRenderer.ask`).
        """
        if not self._driver.is_paced:
            give(self.image(rgb=rgb))
        elif self.frozen and self._given is not None:
            give(self._given)
        else:
            self.renderer.ask((key, self.name), self.camera, self._giving(give), rgb, depth)

    def _giving(self, give: Give) -> Give:
        def gives(image: CameraImage) -> None:
            self._given = image
            give(image)

        return gives

    def take(self, advance: Callable[[float], None], rgb: bool = True) -> CameraImage:
        """Return the newest image from a live camera. `advance` lets time
        pass while another process renders the image.

        Args:
            advance: lets the given number of seconds pass, e.g. `TaskContext.advance`.
        Raises:
            ArmcellError: no picture can be drawn.
        """
        if not self._driver.is_paced or not (self.due() or self._lacks(rgb)):
            return self.image(rgb)
        image = self._taken(advance, rgb)
        if self._driver.now - image.time > TOO_LATE:
            image = self._taken(advance, rgb)
        self._newest = image
        return image

    def _taken(self, advance: Callable[[float], None], rgb: bool) -> CameraImage:
        found: list[CameraImage] = []
        came = threading.Event()

        def give(image: CameraImage) -> None:
            found.append(image)
            came.set()

        self.renderer.ask((came, self.name), self.camera, self._giving(give), rgb)
        while not came.is_set() and not self.renderer.broken:
            before = self._driver.now
            advance(self._driver.period)
            if self._driver.now == before:  # a cancelled task does not advance the clock
                came.wait(0.01)
        if not found:
            raise ArmcellError(f"camera {self.name!r} gives no picture: {self.renderer.broken}")
        return found[0]

    def _lacks(self, rgb: bool) -> bool:
        """Return whether a color image is requested although the newest image of a `LiveCamera` has only
        depth.
        """
        return rgb and not self.frozen and self._newest is not None and self._newest.rgb is None

    def image(self, rgb: bool = True) -> CameraImage:
        """Return the newest image from a live camera.
        The calling thread renders at most one image per camera period.
        """
        newest = self._newest
        if newest is None or self.due() or self._lacks(rgb):
            newest = self._newest = self.draw(rgb)
        return newest

    def draw(self, rgb: bool = True, depth: bool = True) -> CameraImage:
        """Render an image of the current state for a live camera in the calling thread."""
        image = take_image(self._world(), self.camera, rgb=rgb, depth=depth and self.camera.has_depth)
        return replace(image, time=self._driver.now)

    def _number(self, time: float) -> int:
        return int(np.floor(time * self.camera.rate + 1e-6))

    def _world(self) -> SimWorld:
        world = self._driver.world
        if world is not None:
            return world
        if self._mirror is None:
            self._mirror = SimWorld(self._scene, decals=self._decals)
        state = MeasuredState(self._driver.joint_state().positions, self._driver.object_poses())
        state.put_into(self._mirror)
        return self._mirror


@dataclass
@checked()
class OctomapUpdater:
    """Observer that updates the octomap of a live cell from the depth images of a `LiveCamera`.

    As an observer of the cell, it updates the octomap at its own rate whenever time passes. If the new
    octomap blocks the rest of a motion, the motion stops, as for any change of the scene
    (`TaskContext.change_scene`).

    Attributes:
        updates: results of the updates, newest last.
        stopped: the reason for the last stop of a motion; empty if there was none.
    """

    ctx: TaskContext
    camera: LiveCamera
    settings: MapSettings = MapSettings()
    rate: float = 10.0  # [Hz]
    updates: list[MapUpdate] = field(default_factory=list)
    stopped: str = ""

    def __post_init__(self) -> None:
        require(np.isfinite(self.rate) and self.rate > 0, f"rate is {self.rate:g} Hz, it must be positive")
        self.map = CameraMap(self.settings)
        self._next = -np.inf
        self._told = ""
        self._used: CameraImage | None = None
        self._mapping = threading.Lock()
        self._since = np.inf  # [s] time of the first request or of the last picture
        self.ctx.observers.append(self)

    def close(self) -> None:
        """Stop updating the octomap from a `LiveCamera`. The octomap stays in the scene."""
        if self in self.ctx.observers:
            self.ctx.observers.remove(self)

    def update(self) -> MapUpdate:
        """Update the octomap from a `LiveCamera` now. Return the previous update if the camera has no new
        image.

        Each image is used only once: later, the robot is no longer at the position that the image shows, and
        would be mapped as an obstacle.
        """
        if self.ctx.driver.is_paced and not self.camera.renderer.ready:
            self.camera.take(self.ctx.advance, rgb=False)  # the first picture of a new process is slow
        scene = self.ctx.scene()
        return self._use(self.camera.take(self.ctx.advance, rgb=False), scene)

    def _use(self, image: CameraImage, scene: PlanningScene) -> MapUpdate:
        """Insert the depth image of a live camera into the octomap and return the update.

        Args:
            scene: the scene when the picture was taken, to remove the robot from the picture.
        """
        with self._mapping:
            now = self.ctx.driver.now
            if image is self._used and now - image.time <= self.settings.max_age:
                return self.updates[-1]
            done = self.map.update(image, scene, now)
            self.updates.append(done)
            if done.ok:
                self._used = image
                self.ctx.change_scene(self.map.applied_to)
                self._told = ""
            else:
                self._tell(done.message, int(done.code))
            return done

    def _tell(self, message: str, code: int) -> None:
        if message != self._told:
            self._told = message
            self.ctx.emit("error", f"octomap: {message}", code=code)

    def _ask(self) -> None:
        """Request a new image from a `LiveCamera` and insert the rendered image into the octomap."""
        now, scene = self.ctx.driver.now, self.ctx.scene()
        self._since = min(self._since, now)

        def use(image: CameraImage) -> None:
            self._since = self.ctx.driver.now
            if ready:  # the first picture of a process is too old to use
                self._use(image, scene)

        ready = self.camera.renderer.ready
        if self.camera.renderer.broken or (ready and now - self._since > self.settings.max_age):
            self._tell("no new picture comes, the map is not true any more", int(ErrorCode.SENSOR_INFO_STALE))
        self.camera.ask(id(self), use, rgb=False)

    # --- as an observer ---
    def on_state(self, sample: StateSample) -> None:
        if sample.time < self._next:
            return
        self._next = sample.time + 1.0 / self.rate - 1e-6
        if self.ctx.driver.is_paced:
            self._ask()
        else:
            self.update()

    def on_event(self, event: Event) -> None:
        if event.kind == "stop" and event.data.get("object") == OCTOMAP:
            self.stopped = f"camera {self.camera.name!r} sees something across the path: {event.text}"

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass


def live_cameras(
    cameras: Sequence[Camera], driver: Driver, scene: PlanningScene, decals: Sequence[Decal]
) -> dict[str, LiveCamera]:
    """Return the live cameras of a cell by name. All of them share one renderer."""
    renderer = CellRenderer(driver, scene, decals)
    return {camera.name: LiveCamera(camera, driver, scene, decals, renderer) for camera in cameras}
