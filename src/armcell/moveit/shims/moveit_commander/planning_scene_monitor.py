"""PlanningSceneMonitor as tutorials use it from Python: octomap of the cell's depth cameras.

MoveIt 1 has the class only in C++. armcell's move_group always monitors states, attached objects and
collision objects, so the other monitors have nothing to start.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from armcell.core import InputError
from armcell.moveit.script_hints import CLASSES
from armcell.moveit.session import CHECK, current_session
from armcell.ros.nodes import ServedPlanner

NAME = "PlanningSceneMonitor"
FIRST_IMAGE = 90.0  # [s, wall clock] for the first images: on a busy machine the render process starts slowly
HINT = "describe a depth camera under `cameras:` of the cell file"


class PlanningSceneMonitor:
    """Monitor that updates the planning scene from the cell's cameras, like MoveIt's PlanningSceneMonitor.
    Updates can be started and stopped.
    """

    def __init__(self, robot_description: str = "robot_description", name: str = ""):
        self._session = current_session()
        self._watches: list[Any] = []
        self._session.hint(NAME, f"MoveIt's Python has no {NAME}; {CLASSES[NAME]}")

    def startWorldGeometryMonitor(self, *topics: Any) -> None:
        """Wait for the first images of the cameras and then update the octomap at 10 Hz, like MoveIt's
        PlanningSceneMonitor.

        The camera `overview`, which renders the report's pictures, is used only if it is the only camera.
        """
        served = self._session.served
        if isinstance(served, ServedPlanner):
            self._session.say(
                "WARN", "startWorldGeometryMonitor: the cameras are at the other end of the wire"
            )
            return
        cameras = [name for name in served.live.cameras if name != "overview"] or list(served.live.cameras)
        if not cameras:
            self._session.say("WARN", f"startWorldGeometryMonitor: the cell has no camera; {HINT}")
        for camera in cameras if not self._watches else ():
            try:
                self._watches.append(
                    self._session.close_on_shutdown(served.call(partial(served.live.watch, camera)))
                )
            except InputError as error:
                self._session.say("WARN", f"startWorldGeometryMonitor: no octomap of {camera}: {error}")
        give_up = time.monotonic() + FIRST_IMAGE
        while (
            any(not w.updates and not w.camera.renderer.broken for w in self._watches)
            and time.monotonic() < give_up
        ):
            if self._session.shutting_down.wait(CHECK):
                return
        for watch in self._watches:
            if not watch.updates:
                self._session.say("WARN", f"startWorldGeometryMonitor: no image of {watch.camera.name} yet")

    def stopWorldGeometryMonitor(self) -> None:
        """Stop updating the octomap from the cameras, like MoveIt's PlanningSceneMonitor. The octomap itself
        is kept.
        """
        for watch in self._watches:
            watch.close()
        self._watches.clear()

    def startSceneMonitor(self, scene_topic: str = "") -> None:
        """Do nothing. The method exists in MoveIt's PlanningSceneMonitor,
        but armcell's move_group always applies scene diffs.
        """

    def startStateMonitor(self, joint_states_topic: str = "", attached_objects_topic: str = "") -> None:
        """Do nothing. The method exists in MoveIt's PlanningSceneMonitor,
        but armcell's move_group always tracks the joint states.
        """
