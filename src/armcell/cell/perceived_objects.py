"""Driver wrapper that reports object poses only after a camera has detected the objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from armcell.cell.live_cameras import LiveCamera
from armcell.core import SE3
from armcell.drivers import Driver, DriverProxy, GripperReading
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel
from armcell.perception import DetectionResult, LookSettings, look
from armcell.scene import OCTOMAP, CollisionObject, PlanningScene
from armcell.tasks import StageReport, TaskContext

_REACH = 0.03  # [m] largest distance from a closed gripper's TCP to the object that it holds


@dataclass
class DetectedPoses:
    """Detected poses of those objects whose poses are known only from the cell's cameras.

    Attributes:
        known: the objects to detect, with their shapes, by name.
        surface: the object that supports them.
        poses: the last detected poses T_world_object, by name.
        initial: initial poses T_world_object that the planner uses before the first detection.
    """

    known: dict[str, CollisionObject]
    surface: str | None = None
    poses: dict[str, SE3] = field(default_factory=dict)  # T_world_object
    initial: Mapping[str, SE3] = field(default_factory=dict)  # T_world_object

    def __post_init__(self) -> None:
        self.poses.update(self.initial)

    def forget(self) -> None:
        self.poses.clear()
        self.poses.update(self.initial)

    @property
    def unknown(self) -> dict[str, CollisionObject]:
        """Return the perceived objects that had no initial pose.
        They are now at their last detected poses.
        """
        names = (n for n in self.known if n not in self.initial)
        return {n: self.known[n].at(self.poses.get(n, SE3.identity())) for n in names}

    def taken_from(self, scene: PlanningScene) -> PlanningScene:
        """Return the scene without those objects that no camera has perceived yet."""
        for name in self.known:
            if name in scene.objects and name not in self.poses:
                scene = scene.without_object(name)
        return scene

    def put_into(self, scene: PlanningScene) -> PlanningScene:
        """Return the scene with perceived objects at their detected poses. Attached objects stay
        unchanged.
        """
        for name, T in self.poses.items():
            if name not in scene.attached:
                scene = scene.with_object(self.known[name].at(T))
        return scene


class PerceivingDriver(DriverProxy):
    """Driver that reports perceived objects at their last detected poses.
    While the robot holds an object, its pose follows the gripper.

    As with a real gripper, the held object is inferred from the gripper's width and force and from the last
    detected poses.
    """

    def __init__(self, driver: Driver, model: RobotModel, seen: DetectedPoses):
        super().__init__(driver)
        self._model, self._seen = model, seen
        self._tree = kinematic_tree(model)
        self._held: dict[str, tuple[str, SE3]] = {}  # gripper -> object, T_tcp_object

    def __enter__(self) -> Self:
        super().__enter__()
        self._seen.forget()
        self._held.clear()
        return self

    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        if width > self._driver.gripper(gripper).width + 1e-4:
            self._follow()
            self._held.pop(gripper, None)
        self._driver.command_gripper(gripper, width, force)

    def gripper(self, gripper: str) -> GripperReading:
        reading = self._driver.gripper(gripper)
        if reading.held is not None and reading.held not in self._seen.known:
            return reading  # the driver measures this object's pose itself
        blocked = reading.force_per_finger > 1.0 and reading.width > 1e-3
        if gripper not in self._held and blocked:
            near = self._near(gripper)
            if near is not None:
                self._held[gripper] = (near, self._tcp(gripper).inverse() @ self._seen.poses[near])
        if gripper in self._held and not blocked:  # the fingers closed completely: the object is lost
            self._follow()
            self._held.pop(gripper)
        held = self._held.get(gripper)
        return replace(reading, held=held[0] if held else None)

    def object_poses(self) -> dict[str, SE3]:
        """Return the pose T_world_object of each object, by name.
        If an object has no perceived pose, the wrapped driver supplies it.
        """
        self._follow()
        others = {n: T for n, T in self._driver.object_poses().items() if n not in self._seen.known}
        return {**others, **self._seen.poses}

    def correct_object_pose(self, name: str, T_world_object: SE3) -> None:
        """Correct the last detected pose of a perceived object. For every other object, let the wrapped
        driver correct the pose.
        """
        if name not in self._seen.poses:
            return self._driver.correct_object_pose(name, T_world_object)
        self._seen.poses[name] = T_world_object
        for gripper, (held, _) in self._held.items():
            if held == name:
                self._held[gripper] = (name, self._tcp(gripper).inverse() @ T_world_object)
        return None

    def _follow(self) -> None:
        for gripper, (name, T_tcp_object) in self._held.items():
            self._seen.poses[name] = self._tcp(gripper) @ T_tcp_object

    def _near(self, gripper: str) -> str | None:
        """Return the perceived object that contains the gripper's TCP, or else the nearest one.
        Return None if it is too far away.
        """
        tcp, best, found = self._tcp(gripper).translation, _REACH, None
        for name, T in self._seen.poses.items():
            low, high = self._seen.known[name].bounds()
            local = T.inverse().apply(tcp)
            away = float(np.linalg.norm(np.maximum(np.maximum(low - local, local - high), 0.0)))
            if away < best:
                best, found = away, name
        return found

    def _tcp(self, gripper: str) -> SE3:
        g: Gripper = self._model.gripper(gripper)
        return self._tree.link_pose(self._driver.joint_state().positions, g.tcp_link)


def look_with(
    cameras: Sequence[LiveCamera], ctx: TaskContext, seen: DetectedPoses | None,
    settings: LookSettings | None,
) -> DetectionResult:  # fmt: skip
    """Detect objects with cameras and update the planning scene with the perceived poses. Held objects are
    skipped.

    An object whose pose is ambiguous is removed from the scene, so that no task picks it at a wrong pose.
    """
    scene = ctx.scene()
    settings = settings or LookSettings(surface=seen.surface if seen is not None else None)
    known = {n: o for n, o in scene.objects.items() if o.movable and n != OCTOMAP}
    if seen is not None and seen.unknown:
        known = seen.unknown
    wanted = tuple(o for n, o in known.items() if n not in scene.attached)
    names = ", ".join(camera.name for camera in cameras)
    report = StageReport(f"look with {names}", started_s=ctx.driver.now)
    ctx.emit("stage", report.name, phase="begin")
    images = [camera.take(ctx.advance) for camera in cameras]
    sight = look(images, scene, wanted, settings, ctx.driver.now)
    # without a plane, no detection
    report.ok = not (sight.missing or sight.doubtful) and sight.plane is not None
    report.error = "" if report.ok else sight.message
    report.planning_time_s = sight.cpu_time
    ctx.reports.append(report)
    if seen is not None:
        for item in sight.objects:
            if item.known and item.name in seen.known and item.T_world_object is not None:
                seen.poses[item.name] = item.T_world_object
        for name in sight.doubtful:
            seen.poses.pop(name, None)
        ctx.change_scene(lambda now: seen.taken_from(seen.put_into(now)))
    ctx.emit("stage", report.name, phase="end")
    return sight
