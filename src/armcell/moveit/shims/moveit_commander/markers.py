"""Conversion of the robot's collision geometry to a visualization_msgs/MarkerArray."""

from __future__ import annotations

from typing import Any

from armcell.core import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from armcell.moveit.session import Session
from armcell.ros.convert import pose_message
from armcell.scene import WORLD, PlanningScene

CUBE, SPHERE, CYLINDER, TRIANGLES = 1, 2, 3, 11  # visualization_msgs/Marker


def markers(session: Session, scene: PlanningScene, links: Any) -> Any:
    """Return markers (visualization messages) that show the collision geometry of links at their poses, like
    moveit_commander.

    Shapes without a marker type (cones) are omitted.
    """
    found = []
    for name in links:
        T_world_link = scene.frame_pose(name)
        for collision in scene.model.link(name).collisions:
            shaped = _shaped(session, collision.shape)
            if shaped is None:
                continue
            kind, scale, points = shaped
            found.append(
                session.new(
                    "visualization_msgs/Marker",
                    header=session.messages.local(session.bus.header(WORLD)),
                    ns=name, id=len(found), type=kind,
                    pose=session.messages.local(
                        pose_message(session.bus.schema, T_world_link @ collision.T_link_shape)
                    ),
                    scale=session.new("geometry_msgs/Vector3", *scale),
                    color=session.new("std_msgs/ColorRGBA", 0.5, 0.5, 0.5, 1.0),
                    points=points,
                )
            )  # fmt: skip
    return session.new("visualization_msgs/MarkerArray", found)


def _shaped(session: Session, shape: Shape) -> tuple[int, tuple[float, float, float], list[Any]] | None:
    match shape:
        case Box():
            return CUBE, (shape.x, shape.y, shape.z), []
        case Sphere():
            return SPHERE, (2 * shape.radius, 2 * shape.radius, 2 * shape.radius), []
        case Cylinder():
            return CYLINDER, (2 * shape.radius, 2 * shape.radius, shape.length), []
        case Capsule():
            return CYLINDER, (2 * shape.radius, 2 * shape.radius, shape.length + 2 * shape.radius), []
        case Mesh():
            corners = shape.vertices[shape.faces.reshape(-1)].tolist()
            return TRIANGLES, (1.0, 1.0, 1.0), [session.new("geometry_msgs/Point", *p) for p in corners]
    return None
