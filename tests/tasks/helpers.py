"""Live cells of scenes made by the tests, and things that go wrong in them."""

from __future__ import annotations

from functools import cache

import numpy as np

import armcell
from armcell.cell import LiveCell
from armcell.core import SE3, Box
from armcell.drivers import DriverOptions, DriverProxy, drivers
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import PhysicsSettings
from armcell.tasks import TaskSettings

PICK_STAGES = ["open", "move to pre-grasp", "approach", "close", "lift"]
PLACE_STAGES = ["move to pre-place", "lower", "open", "retreat"]


@cache
def panda_pick() -> armcell.Cell:
    return armcell.load("panda_pick")


@cache
def nominal() -> PlanningScene:
    """The built-in cell: table, wall, post, tray, cube."""
    return panda_pick().scene()


def with_cube(scene: PlanningScene | None = None, size: float = 0.05, at=None, **properties) -> PlanningScene:
    """The scene with another cube, by default where the cell's own is."""
    scene = scene or nominal()
    was = scene.object("cube").T_world_object.translation
    x, y = at or was[:2]
    pose = SE3.from_xyz(x, y, was[2] - 0.025 + size / 2)
    return scene.with_object(
        CollisionObject.single("cube", Box(size, size, size), pose, movable=True, **properties)
    )


def prison() -> PlanningScene:
    """A ring around the flange, narrower than the hand: the arm and the grasps are free, there is no way."""
    long, short = Box(0.17, 0.01, 0.01), Box(0.01, 0.15, 0.01)
    bars = [(long, SE3.from_xyz(0, s * 0.08, 0)) for s in (-1, 1)]
    bars += [(short, SE3.from_xyz(s * 0.08, 0, 0)) for s in (-1, 1)]
    ring = CollisionObject("ring", tuple(bars), SE3.from_xyz(0.307, 0, 0.635))
    table = CollisionObject.single("table", Box(2.0, 2.0, 0.04), SE3.from_xyz(0, 0, -0.021))
    cube = CollisionObject.single("cube", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.5, 0, 0.024), movable=True)
    scene = PlanningScene.of(nominal().model, objects=[table, ring, cube])
    return scene.with_state(scene.model.named_state("arm", "home"))


def live(
    mode: str = "fake",
    scene: PlanningScene | None = None,
    settings: TaskSettings | None = None,
    observers=(),
    **physics,
) -> LiveCell:
    """Like `Cell.connect`, but of any scene."""
    scene = scene or nominal()
    options = DriverOptions(physics=PhysicsSettings(**physics))
    settings = settings or panda_pick().settings
    return LiveCell("test", scene, drivers[mode](scene, options), settings, observers, 0)


class AtStage:
    """An observer that does something when a stage begins, at its nth beginning."""

    def __init__(self, stage: str, act, nth: int = 1):
        self._stage, self._act, self._nth, self._count = stage, act, nth, 0

    def on_state(self, sample) -> None: ...

    def on_trajectory(self, time, trajectory) -> None: ...

    def on_event(self, event) -> None:
        if (event.kind, event.text, event.data.get("phase")) == ("stage", self._stage, "begin"):
            self._count += 1
            if self._count == self._nth:
                self._act()


class AtTime(AtStage):
    """An observer that does something once, at a time [s] of the driver's clock."""

    def __init__(self, time: float, act):
        super().__init__("", act)
        self._time = time

    def on_state(self, sample) -> None:
        if self._count == 0 and sample.time >= self._time:
            self._count = 1
            self._act()


class Freezable(DriverProxy):
    """A driver with a joint that stops following from `freeze` to `thaw`."""

    joint: str | None = None
    at = 0.0

    def freeze(self, joint: str) -> None:
        self.joint, self.at = joint, self._driver.joint_state()[joint]

    def thaw(self) -> None:
        self.joint = None

    def command(self, joint_names, positions, velocities):
        positions, velocities = np.array(positions, float), np.array(velocities, float)
        if self.joint in joint_names:
            i = joint_names.index(self.joint)
            positions[i], velocities[i] = self.at, 0.0
        return self._driver.command(joint_names, positions, velocities)


def teleport(cell: LiveCell, dx: float, dy: float, dz: float = 0.0) -> None:
    """Somebody takes the cube and puts it elsewhere (physics only)."""
    pose = cell.driver.object_poses()["cube"]
    cell.driver.world.set_object_pose("cube", pose.shifted(dx, dy, dz))


def stages(cell: LiveCell) -> list[str]:
    return [report.name for report in cell.ctx.reports]


def notes(cell: LiveCell, kind: str = "note") -> list[str]:
    return [event.text for event in cell.ctx.events if event.kind == kind]
