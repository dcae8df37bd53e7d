"""A running cell's cameras: their newest picture, and the planning scene kept true by what they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.control import Driver
from armcell.core import CameraImage, Event, JointTrajectory, StateSample
from armcell.core.checks import require
from armcell.perception import CameraMap, MapSettings, MapUpdate
from armcell.scene import OCTOMAP, PlanningScene
from armcell.sim import Camera, Decal, SimWorld, take_image
from armcell.tasks import TaskContext


class LiveCamera:
    """One camera of a connected cell. Pictures come at its rate, of the driver's clock.

    A driver without physics is drawn from what it says of joints and objects.

    Attributes:
        frozen: set it and the camera gives its last picture for ever, as a broken one does. For trials.
    """

    def __init__(self, camera: Camera, driver: Driver, scene: PlanningScene, decals: Sequence[Decal] = ()):
        self.camera, self.frozen = camera, False
        self._driver, self._scene, self._decals = driver, scene, decals
        self._mirror: SimWorld | None = None
        self._newest: CameraImage | None = None

    @property
    def name(self) -> str:
        return self.camera.name

    def due(self) -> bool:
        """Whether a new picture has come since the last one that was taken."""
        if self.frozen and self._newest is not None:
            return False
        return self._newest is None or self._number(self._driver.now) > self._number(self._newest.time)

    def image(self, rgb: bool = True) -> CameraImage:
        """The newest picture; the same one until the next has come."""
        newest = self._newest
        if newest is None or self.due() or (rgb and newest.rgb is None and not self.frozen):
            newest = self._newest = take_image(self._world(), self.camera, rgb=rgb)
            newest = self._newest = replace(newest, time=self._driver.now)
        return newest

    def _number(self, time: float) -> int:
        return int(np.floor(time * self.camera.rate + 1e-6))

    def _world(self) -> SimWorld:
        world = getattr(self._driver, "world", None)
        if isinstance(world, SimWorld):
            return world
        if self._mirror is None:
            self._mirror = SimWorld(self._scene, decals=self._decals)
        self._mirror.set_positions(self._driver.joint_state().positions)
        for name, pose in self._driver.object_poses().items():
            self._mirror.set_object_pose(name, pose)
        return self._mirror


@dataclass
class CameraWatch:
    """Keeps the octomap of a running cell's planning scene true to what a camera sees.

    An observer of the cell: it looks at its own rate whenever time passes. A motion across whose rest the map
    has come is stopped, as by any other change of the scene (`TaskContext.change_scene`).

    Attributes:
        updates: what the pictures did, newest last.
        stopped: why a motion was stopped, the last time; else empty.
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
        self.ctx.observers.append(self)

    def close(self) -> None:
        """Look no more; the map stays in the scene."""
        if self in self.ctx.observers:
            self.ctx.observers.remove(self)

    def update(self) -> MapUpdate:
        """Look now; where no new picture has come, what the last one did.

        A picture counts once: by the next time the robot is not where it was in it, and would be taken for an
        obstacle.
        """
        image, now = self.camera.image(rgb=False), self.ctx.driver.now
        if image is self._used and now - image.time <= self.settings.max_age:
            return self.updates[-1]
        done = self.map.update(image, self.ctx.scene(), now)
        self.updates.append(done)
        if done.ok:
            self._used = image
            self.ctx.change_scene(self.map.applied_to)
            self._told = ""
        elif done.message != self._told:
            self._told = done.message
            self.ctx.emit("error", f"octomap: {done.message}", code=int(done.code))
        return done

    # --- as an observer ---
    def on_state(self, sample: StateSample) -> None:
        if sample.time < self._next:
            return
        self._next = sample.time + 1.0 / self.rate - 1e-6
        self.update()

    def on_event(self, event: Event) -> None:
        if event.kind == "stop" and event.data.get("object") == OCTOMAP:
            self.stopped = f"camera {self.camera.name!r} sees something across the path: {event.text}"

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass


def live_cameras(
    cameras: Sequence[Camera], driver: Driver, scene: PlanningScene, decals: Sequence[Decal]
) -> dict[str, LiveCamera]:
    """By name."""
    return {camera.name: LiveCamera(camera, driver, scene, decals) for camera in cameras}
