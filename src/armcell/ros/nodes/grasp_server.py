"""The grasp server: a service and a topic that pick an object step by step.

The steps are: move to the pre-grasp above the object, grasp, close, lift. Measurements confirm each step. The
server uses only message types that Unity's connector includes, so that a button can call the service and a
topic can name the object.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.core import SE3, SO3, InputError, UnknownNameError
from armcell.core.checks import require
from armcell.ros.actions import ActionClient, GoalState
from armcell.ros.bus import Bus
from armcell.ros.convert import pose_message
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.scene import WORLD, CollisionObject, PlanningScene

logger = logging.getLogger(__name__)
SERVICE, REQUESTS, STATUS = "/grasp", "/grasp_object", "/grasp_status"
TIMEOUT = 180.0  # [s, wall clock] for one grasp


@dataclass(frozen=True)
class GraspServerSettings:
    """Settings of the ROS grasp server, such as distances and planning time."""

    above: float = 0.10  # [m] distance from pre-grasp to grasp
    lift: float = 0.20  # [m]
    side_grasps: bool = True  # also try grasps from the side if no grasp from above is reachable
    planning_time: float = 20.0  # [s] for all motions of one grasp together

    def __post_init__(self) -> None:
        for name in ("above", "lift", "planning_time"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


class GraspServer:
    """Node that grasps and lifts an object when a client calls its service or publishes on its topic.

    Service /grasp (std_srvs/Trigger) grasps the only movable object. Topic /grasp_object (std_msgs/String)
    names the object to grasp. Topic /grasp_status (std_msgs/String, latched) reports the progress and the
    cause of a failure.
    """

    def __init__(self, cell: CellMotions, bus: Bus, settings: GraspServerSettings = GraspServerSettings()):
        self._cell, self._bus, self._settings = cell, bus, settings
        self._turn = threading.Lock()
        self._status = bus.advertise(STATUS, "std_msgs/String", latch=True)
        self._client = ActionClient(bus, "/pickup", "moveit_msgs/Pickup")
        self._members = [
            bus.serve(SERVICE, "std_srvs/Trigger", self._on_call),
            bus.subscribe(REQUESTS, "std_msgs/String", self._on_request, 5),
            self._client,
            self._status,
        ]

    def close(self) -> None:
        for member in self._members:
            member.close()

    # --- requests ---
    def _on_call(self, request: Any) -> Any:
        ok, text = self.grasp()
        return self._bus.schema.new("std_srvs/TriggerResponse", ok, text)

    def _on_request(self, message: Any) -> None:
        self.grasp(message.data)

    def grasp(self, name: str = "") -> tuple[bool, str]:
        """Grasp and lift an object for a client of the grasp server.

        Args:
            name: name of the object; empty means the only movable object.
        Returns:
            Tuple (success, text that states the result or the cause of the failure).
        """
        if not self._turn.acquire(blocking=False):
            return self._said(False, "busy with another grasp")
        try:
            return self._grasp(name)
        except InputError as error:
            return self._said(False, str(error))
        finally:
            self._turn.release()

    def _grasp(self, name: str) -> tuple[bool, str]:
        scene = self._cell.scene()
        item = self._object(scene, name)
        gripper = next(iter(self._cell.model.grippers.values()))
        if len(self._cell.model.grippers) > 1:
            point = item.T_world_object.translation
            gripper = min(
                self._cell.model.grippers.values(),
                key=lambda g: float(np.linalg.norm(scene.frame_pose(g.tcp_link).translation - point)),
            )
        goal = self._bus.schema.new(
            "moveit_msgs/PickupGoal", target_name=item.name, group_name=gripper.arm_group,
            possible_grasps=self._grasps(scene, item, gripper.arm_group, gripper.tcp_link),
            allowed_planning_time=self._settings.planning_time,
        )  # fmt: skip
        self._say(f"grasping {item.name}")
        sent = self._client.send_goal(
            goal, lambda feedback: self._say(f"{item.name}: {feedback.state.lower()}")
        )
        if not sent.wait(TIMEOUT):
            sent.cancel()
            return self._said(False, f"{item.name}: nothing happened for {TIMEOUT:.0f} s")
        if sent.state is GoalState.SUCCEEDED:
            return self._said(True, f"{item.name} is lifted")
        code = sent.result.error_code.val if sent.result is not None else "none"
        return self._said(False, f"{item.name}: {sent.text} (code {code})")

    def _object(self, scene: PlanningScene, name: str) -> CollisionObject:
        movable = {n: o for n, o in scene.objects.items() if o.movable}
        if name:
            if name not in movable:
                raise UnknownNameError("movable object", name, movable)
            return movable[name]
        if len(movable) != 1:
            raise InputError(
                f"{len(movable)} objects can be moved", hint=f"name one on {REQUESTS}: {', '.join(movable)}"
            )
        return next(iter(movable.values()))

    def _grasps(self, scene: PlanningScene, item: CollisionObject, group: str, tcp: str) -> list[Any]:
        """Return the grasps that the grasp server tries, best first: from above in four yaw angles, then from
        four sides.

        Grasps from the sides are included only if `side_grasps` is set.
        """
        T, center = item.T_world_object, item.T_world_object.translation
        yaw = float(np.arctan2(T.rotation.matrix[1, 0], T.rotation.matrix[0, 0]))
        tip = scene.model.group(group).tip_link or tcp
        T_tcp_tip = scene.transform(tcp, tip)
        low, high = item.bounds()
        grasps = []
        turns = sorted((0.0, np.pi / 2, np.pi, -np.pi / 2), key=lambda a: abs(_wrapped(a + yaw)))
        for k, turn in enumerate(turns):
            down = SO3.from_rpy((np.pi, 0.0, yaw + turn))
            grasps.append(self._message(SE3(down, center) @ T_tcp_tip, (0.0, 0.0, -1.0), 1.0 - 0.01 * k))
        if self._settings.side_grasps:
            height = max(float(high[2] - low[2]) / 2 - 0.01, 0.0)
            for k, turn in enumerate((0.0, np.pi / 2, np.pi, -np.pi / 2)):
                ahead = np.array([np.cos(yaw + turn), np.sin(yaw + turn), 0.0])
                across = np.array([-ahead[1], ahead[0], 0.0])
                R = SO3(np.column_stack([np.cross(across, ahead), across, ahead]))
                at = center + np.array([0.0, 0.0, min(height, 0.02)])
                x, y, z = ahead.tolist()
                grasps.append(self._message(SE3(R, at) @ T_tcp_tip, (x, y, z), 0.5 - 0.01 * k))
        return grasps

    def _message(self, T: SE3, direction: tuple[float, float, float], quality: float) -> Any:
        schema, s = self._bus.schema, self._settings
        header = self._bus.header(WORLD)
        grasp = schema.new("moveit_msgs/Grasp", grasp_quality=quality)
        grasp.grasp_pose = schema.new("geometry_msgs/PoseStamped", header, pose_message(schema, T))
        towards = schema.new("geometry_msgs/Vector3", *direction)
        up = schema.new("geometry_msgs/Vector3", 0.0, 0.0, 1.0)
        grasp.pre_grasp_approach = schema.new(
            "moveit_msgs/GripperTranslation",
            schema.new("geometry_msgs/Vector3Stamped", header, towards), s.above, s.above / 2,
        )  # fmt: skip
        grasp.post_grasp_retreat = schema.new(
            "moveit_msgs/GripperTranslation",
            schema.new("geometry_msgs/Vector3Stamped", header, up),
            s.lift,
            s.lift / 2,
        )
        return grasp

    # --- status ---
    def _say(self, text: str) -> None:
        logger.info("grasp: %s", text)
        if not self._status.closed:
            self._status.publish(self._bus.schema.new("std_msgs/String", text))

    def _said(self, ok: bool, text: str) -> tuple[bool, str]:
        self._say(f"{'done' if ok else 'failed'}: {text}")
        return ok, text


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
