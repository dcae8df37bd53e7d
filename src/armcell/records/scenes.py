"""Sequence of planning scenes in a recorded run."""

from __future__ import annotations

from armcell.core import SE3
from armcell.records.reader import Record
from armcell.records.shapes import object_of
from armcell.scene import PlanningScene


def scenes_of(record: Record, start: PlanningScene) -> list[tuple[float, PlanningScene]]:
    """Return the scene at the start and after each change, with times [s].

    The robot and the movable objects keep their initial poses; the recorded states contain their motion.
    """
    found = [(record.states[0].time, start)]
    for event in record.events:
        if event.kind != "scene":
            continue
        scene, data = found[-1][1], event.data
        for name in data.get("removed", ()):
            if name in scene.objects:
                scene = scene.without_object(name)
        for name, entry in {**data.get("added", {}), **data.get("changed", {})}.items():
            item = object_of(name, entry)
            if item is not None:
                scene = scene.with_object(item)
        for name, pose in data.get("moved", {}).items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, SE3.from_mapping(pose, "pose"))
        found.append((event.time, scene))
    return found
