"""A running cell's cameras: their newest picture, and the planning scene kept true by what they see."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.cell.rendering import CellRenderer, Give
from armcell.control import Driver
from armcell.core import ArmcellError, CameraImage, ErrorCode, Event, JointTrajectory, StateSample
from armcell.core.checks import checked, require
from armcell.perception import CameraMap, MapSettings, MapUpdate
from armcell.scene import OCTOMAP, PlanningScene
from armcell.sim import Camera, Decal, SimWorld, take_image
from armcell.sim.render_process import MeasuredState
from armcell.tasks import TaskContext

TOO_LATE = 0.25  # [s] a picture that took longer (the first of a process does) is taken once more


class LiveCamera:
    """One camera of a connected cell. Pictures come at its rate, of the driver's clock.

    A driver without physics is drawn from what it says of joints and objects. In lock-step pictures are drawn
    by the caller. Where the driver keeps to the wall's clock, `ask` and `take` have them drawn in another
    process, of a copy of the state: no motion waits for them.

    Attributes:
        frozen: set it and the camera gives its last picture for ever, as a broken one does. For trials.
        renderer: shared by the cell's cameras.
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
        self._given: CameraImage | None = None  # the last one of `ask`

    @property
    def name(self) -> str:
        return self.camera.name

    def due(self) -> bool:
        """Whether a new picture has come since the last one that was taken."""
        if self.frozen and self._newest is not None:
            return False
        return self._newest is None or self._number(self._driver.now) > self._number(self._newest.time)

    def ask(self, key: Hashable, give: Give, rgb: bool = True, depth: bool = True) -> None:
        """Have a picture of the present state given to a function, without waiting for it.

        In lock-step that is at once. Else it comes in another thread, when it is drawn; a picture that waits
        under the same key is replaced by this one (`CellRenderer.ask`).
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
        """The newest picture, as `image`; while it is drawn elsewhere, `advance` lets time pass.

        Args:
            advance: for so many seconds, as `TaskContext.advance`.
        Raises:
            ArmcellError: none can be drawn.
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
            if self._driver.now == before:  # who is cancelled lets no time pass
                came.wait(0.01)
        if not found:
            raise ArmcellError(f"camera {self.name!r} gives no picture: {self.renderer.broken}")
        return found[0]

    def _lacks(self, rgb: bool) -> bool:
        """Whether the newest picture has no color that is wanted."""
        return rgb and not self.frozen and self._newest is not None and self._newest.rgb is None

    def image(self, rgb: bool = True) -> CameraImage:
        """The newest picture; the same one until the next has come. Drawn here: the caller waits for it."""
        newest = self._newest
        if newest is None or self.due() or self._lacks(rgb):
            newest = self._newest = self.draw(rgb)
        return newest

    def draw(self, rgb: bool = True, depth: bool = True) -> CameraImage:
        """A picture of the present state, drawn here."""
        image = take_image(self._world(), self.camera, rgb=rgb, depth=depth and self.camera.has_depth)
        return replace(image, time=self._driver.now)

    def _number(self, time: float) -> int:
        return int(np.floor(time * self.camera.rate + 1e-6))

    def _world(self) -> SimWorld:
        world = getattr(self._driver, "world", None)
        if isinstance(world, SimWorld):
            return world
        if self._mirror is None:
            self._mirror = SimWorld(self._scene, decals=self._decals)
        state = MeasuredState(self._driver.joint_state().positions, self._driver.object_poses())
        state.put_into(self._mirror)
        return self._mirror


@dataclass
@checked()
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
        self._mapping = threading.Lock()
        self._since = np.inf  # [s] when a picture was first waited for, or the last one came
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
        if self.ctx.driver.is_paced and not self.camera.renderer.ready:
            self.camera.take(self.ctx.advance, rgb=False)  # of a process that starts the first one takes long
        scene = self.ctx.scene()
        return self._use(self.camera.take(self.ctx.advance, rgb=False), scene)

    def _use(self, image: CameraImage, scene: PlanningScene) -> MapUpdate:
        """Put a picture into the map.

        Args:
            scene: as it was when the picture was taken, to know the robot in it.
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
        """Have the present state drawn elsewhere and put into the map."""
        now, scene = self.ctx.driver.now, self.ctx.scene()
        self._since = min(self._since, now)

        def use(image: CameraImage) -> None:
            self._since = self.ctx.driver.now
            if ready:  # the first one of a process comes too late to be true
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
    """By name, with one renderer for all."""
    renderer = CellRenderer(driver, scene, decals)
    return {camera.name: LiveCamera(camera, driver, scene, decals, renderer) for camera in cameras}
