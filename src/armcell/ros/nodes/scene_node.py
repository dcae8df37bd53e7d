"""Planning scene on the bus: clients query and edit it, and receive its updates."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from armcell.core import InputError
from armcell.ros.bus import Bus
from armcell.ros.faults import FaultCounter
from armcell.ros.moveit_convert import (
    Components,
    attached_changes,
    diff_from_message,
    object_changes,
    scene_message,
    world_from_message,
)
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.scene import OCTOMAP, WORLD, PlanningScene, SceneDiff, SetOctomap

log = logging.getLogger(__name__)
PUBLISH_PERIOD = 0.25  # [s] 4 Hz, as in move_group's planning scene monitor
STATE = Components.ROBOT_STATE | Components.ROBOT_STATE_ATTACHED_OBJECTS
MONITORED = ("/move_group/monitored_planning_scene", "/monitored_planning_scene")


class SceneNode:
    """Node through which clients on the bus query and edit the planning scene of a cell.

    Services: /get_planning_scene, /apply_planning_scene, /clear_octomap. Input topics: /planning_scene,
    /planning_scene_world (replaces the world), /collision_object, /attached_collision_object. Output topics:
    /move_group/monitored_planning_scene and /monitored_planning_scene.
    """

    def __init__(self, cell: CellMotions, bus: Bus):
        self._cell, self._bus = cell, bus
        self._stop, self._changed = threading.Event(), threading.Event()
        self._complaints = FaultCounter()
        self._clearing: list[Callable[[], None]] = []
        self._out = [bus.advertise(name, "moveit_msgs/PlanningScene", latch=True) for name in MONITORED]
        self._members: list[Any] = [
            bus.serve("/get_planning_scene", "moveit_msgs/GetPlanningScene", self._get),
            bus.serve("/apply_planning_scene", "moveit_msgs/ApplyPlanningScene", self._apply),
            bus.serve("/clear_octomap", "std_srvs/Empty", self._clear_octomap),
            bus.subscribe("/planning_scene", "moveit_msgs/PlanningScene", self._on(diff_from_message), 50),
            bus.subscribe(
                "/planning_scene_world", "moveit_msgs/PlanningSceneWorld", self._on(world_from_message), 50
            ),
            bus.subscribe(
                "/collision_object", "moveit_msgs/CollisionObject", self._on(_one(object_changes)), 100
            ),
            bus.subscribe(
                "/attached_collision_object", "moveit_msgs/AttachedCollisionObject",
                self._on(_one(attached_changes)), 100,
            ),
            *self._out,
        ]  # fmt: skip
        self._changed.set()
        threading.Thread(target=self._tell, name="planning scene", daemon=True).start()

    def close(self) -> None:
        self._stop.set()
        self._changed.set()
        for member in self._members:
            member.close()

    def header(self) -> Any:
        """Return a message header of the scene node, in the frame of the planning scene (the world frame)."""
        return self._bus.header(WORLD)

    def message(self, scene: PlanningScene, parts: Components = Components.ALL) -> Any:
        return scene_message(self._bus.schema, self.header(), scene, parts)

    # --- services ---
    def _get(self, request: Any) -> Any:
        parts = Components(int(request.components.components) & int(Components.ALL)) or Components.ALL
        return self._bus.schema.new(
            "moveit_msgs/GetPlanningSceneResponse", self.message(self._cell.scene(), parts)
        )

    def _apply(self, request: Any) -> Any:
        try:
            self._change(diff_from_message, request.scene)
        except InputError as error:
            log.warning("planning scene refused: %s", error)
            return self._bus.schema.new("moveit_msgs/ApplyPlanningSceneResponse", False)
        return self._bus.schema.new("moveit_msgs/ApplyPlanningSceneResponse", True)

    def on_clear_octomap(self, clear: Callable[[], None]) -> None:
        """Register a function that the scene node calls when a client clears the octomap."""
        self._clearing.append(clear)

    def schedule_publication(self) -> None:
        """Request that the scene node publishes the complete planning scene soon, after a change that did not
        come from a client.
        """
        self._changed.set()

    def _clear_octomap(self, request: Any) -> Any:
        for clear in self._clearing:
            clear()

        def make(scene: PlanningScene) -> PlanningScene:
            return scene.apply(SceneDiff.of(SetOctomap(None))) if OCTOMAP in scene.objects else scene

        self._cell.edit_scene(make)
        self._changed.set()
        return self._bus.schema.new("std_srvs/EmptyResponse")

    # --- topics ---
    def _on(self, diff: Callable[[Any, PlanningScene], SceneDiff]) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            try:
                self._change(diff, message)
            except InputError as error:
                if self._complaints.count(f"{message._type}: {error}"):
                    log.warning("%s refused: %s", message._type, error)

        return take

    def _change(self, diff: Callable[[Any, PlanningScene], SceneDiff], message: Any) -> None:
        self._cell.edit_scene(lambda scene: scene.apply(diff(message, scene)))
        self._changed.set()

    def _tell(self) -> None:
        """Publish the complete planning scene on the topics of the scene node after each change of the scene.

        Between changes, publish the robot state at 4 Hz while a client subscribes.
        """
        while not self._stop.is_set():
            changed = self._changed.wait(PUBLISH_PERIOD)
            self._changed.clear()
            if self._stop.is_set() or not (changed or any(p.subscribers for p in self._out)):
                continue
            try:
                scene = self._cell.scene()
                message = self.message(scene, Components.ALL if changed else STATE)
                message.is_diff = message.robot_state.is_diff = not changed
                for publisher in self._out:
                    if changed or publisher.subscribers:
                        publisher.publish(message)
            except InputError as error:  # the cell was closed, or the simulator is not connected yet
                log.debug("planning scene not published: %s", error)
                if changed and not self._stop.wait(PUBLISH_PERIOD):
                    self._changed.set()


def _one(changes: Callable[[Any, PlanningScene], Any]) -> Callable[[Any, PlanningScene], SceneDiff]:
    return lambda message, scene: SceneDiff(tuple(changes(message, scene)))
