"""Cameras of a running cell: their newest images, and octomap updates from depth images."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.cell.rendering import CellRenderer, Give
from armcell.core import ArmcellError, CameraImage, ErrorCode, Event, JointTrajectory, StateSample
from armcell.core.checks import checked, require
from armcell.drivers import Driver
from armcell.perception import CameraMap, MapSettings, MapUpdate
from armcell.scene import OCTOMAP, PlanningScene
from armcell.sim import Camera, Decal, SimWorld, take_image
from armcell.sim.render_process import MeasuredState
from armcell.tasks import TaskContext

TOO_LATE = 0.25  # [s] a picture that took longer is taken once more; the first of a process does


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
