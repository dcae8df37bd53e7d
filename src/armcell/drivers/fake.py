"""Fake robot that follows every command exactly, without physics, to test plans and scripts.

A gripper that closes around an object holds it; when the gripper opens, the object stays at its pose.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, JointState
from armcell.core.checks import require
from armcell.drivers.driver import Array, Driver, DriverOptions, GripperReading, drivers
from armcell.kinematics import kinematic_tree
from armcell.model import SuctionGripper
from armcell.scene import PlanningScene
from armcell.sim import Pacer

FINGER_SPEED = 0.1  # [m/s] rate of the opening width
DEPTHS = 5  # points between the TCP and the ends of the pads at which jaws may grasp an object


class FakeDriver(Driver):
    """Driver for a fake robot without physics, which follows every command exactly."""

    name = "fake"
    is_simulated = True

    def __init__(self, scene: PlanningScene, options: DriverOptions):
        self._scene, self._model = scene, scene.model
        self._tree = kinematic_tree(scene.model)
        self.period = 0.01
        self._pacer = Pacer(options.time_scale)

    def __enter__(self) -> Self:
        self._now = 0.0
        self._q = np.array(self._scene.positions, dtype=float)
        self._v = np.zeros(self._model.dof)
        self._poses = {n: o.T_world_object for n, o in self._scene.objects.items() if o.movable}
        self._held: dict[str, tuple[str, SE3]] = {}  # gripper -> object, T_tcp_object
        self._targets: dict[str, tuple[float, float]] = {}  # gripper -> width, force
        return self

    def __exit__(self, *exc: object) -> None:
        pass

    @property
    def is_paced(self) -> bool:
        return self._pacer.time_scale is not None

    @property
    def now(self) -> float:
        return self._now

    def joint_state(self) -> JointState:
        return JointState(self._model.joint_names, self._q, self._v, time=self._now)

    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        sent = JointState(joint_names, positions, velocities, time=self._now)  # type: ignore[arg-type]
        columns = self._model.columns(joint_names)
        self._q[columns] = sent.positions
        self._v[columns] = 0.0 if sent.velocities is None else sent.velocities
        return sent

    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        opens = width > self.gripper(gripper).width + 1e-4
        suction = isinstance(self._model.gripper(gripper), SuctionGripper)
        require(bool(np.isfinite(width) and np.isfinite(force)), f"gripper target {width} m, {force} N")
        self._targets[gripper] = (width, force)
        if opens:
            self._held.pop(gripper, None)
        elif suction and gripper not in self._held:
            self._take(gripper)

    def gripper(self, gripper: str) -> GripperReading:
        g = self._model.gripper(gripper)
        held = self._held.get(gripper)
        target, force = self._targets.get(gripper, (g.max_width, 0.0))
        item = held[0] if held else None
        if isinstance(g, SuctionGripper):
            sealed = (len(g.cups) if held else 0, len(g.cups))
            width, vacuum = 0.0 if target <= 0.0 else g.max_width, g.vacuum if held else 0.0
            return GripperReading(width, g.max_force if held else 0.0, item, sealed=sealed, vacuum=vacuum)
        width = g.width(float(self._q[self._model.columns(g.joint_names)[0]]))
        return GripperReading(width, force if held else 0.0, item)

    def resume(self) -> None:
        """Do nothing: a fake robot never stops by itself, so there is nothing to resume."""

    def wrench(self, gripper: str) -> Array:
        self._model.gripper(gripper)
        return np.zeros(6)

    def advance(self, duration: float) -> None:
        self._now += duration
        for name, (target, _) in self._targets.items():
            g = self._model.gripper(name)
            if not g.joint_name:
                continue
            column = self._model.columns(g.joint_names)[0]
            width = g.width(float(self._q[column]))
            blocked = self._blocked_width(name) if target < width else 0.0
            step = FINGER_SPEED * duration
            width += float(np.clip(max(target, blocked) - width, -step, step))
            self._q[column] = g.joint_position(width)
            if blocked and abs(width - blocked) < 1e-6 and name not in self._held:
                self._take(name)
        for name, (item, T_tcp_object) in self._held.items():
            self._poses[item] = self._tcp(name) @ T_tcp_object
        self._pacer.wait_until(self._now)

    def _tcp(self, gripper: str) -> SE3:
        return self._tree.link_pose(self._q, self._model.gripper(gripper).tcp_link)

    def _take(self, gripper: str) -> None:
        """Let a fake gripper hold the object between its fingers or under its suction cups. Do nothing if
        there is no such object.
        """
        if item := self._between(gripper):
            self._held[gripper] = (item, self._tcp(gripper).inverse() @ self._poses[item])

    def _between(self, gripper: str) -> str | None:
        """Return the object that a fake gripper grasps, or None. Jaws grasp the object whose bounding box
        contains the TCP or, otherwise, the nearest point along the pads. A suction cup grasps an object that
        its lip reaches.
        """
        g, tcp = self._model.gripper(gripper), self._tcp(gripper)
        points = [tcp.apply((0.0, 0.0, depth)) for depth in np.linspace(0.0, g.pad_depth, DEPTHS)]
        if isinstance(g, SuctionGripper):
            cups = [self._tree.link_pose(self._q, cup.link) @ cup.T_link_cup for cup in g.cups]
            points = [T.apply((0.0, 0.0, cup.stroke)) for T, cup in zip(cups, g.cups, strict=True)]
        for point in points:
            for name, pose in self._poses.items():
                low, high = self._scene.object(name).bounds()
                local = pose.inverse().apply(point)
                if np.all((local >= low) & (local <= high)):
                    return name
        return None

    def _blocked_width(self, gripper: str) -> float:
        """Return the size [m] of the object between a fake gripper's fingers, measured along the closing
        axis, or 0 if there is no object.
        """
        item = self._held[gripper][0] if gripper in self._held else self._between(gripper)
        if item is None:
            return 0.0
        axis = (self._poses[item].rotation.inverse() @ self._tcp(gripper).rotation).matrix[:, 1]
        return self._scene.object(item).extent(axis)

    def stop(self) -> None:
        self._v[:] = 0.0

    def object_poses(self) -> dict[str, SE3]:
        return dict(self._poses)

    def targets(self) -> JointState | None:
        return self.joint_state()


drivers.register("fake")(FakeDriver)  # not a decorator: type checkers would lose the class
