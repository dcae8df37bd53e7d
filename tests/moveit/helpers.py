"""Where the users' scripts are; a Panda's home; a pose."""

from __future__ import annotations

from pathlib import Path

SHARED = "shared/scripts"
SCRIPTS = next(
    (p / SHARED for p in Path(__file__).parents if (p / SHARED).is_dir()), Path(__file__).parents[3] / SHARED
)

HOME = (0.0, -0.785398163, 0.0, -2.35619449, 0.0, 1.570796327, 0.785398163)  # of the Panda's arm


def stamped(x, y, z, frame="world"):
    """A PoseStamped that looks down."""
    from geometry_msgs.msg import PoseStamped

    pose = PoseStamped()
    pose.header.frame_id = frame
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = x, y, z
    pose.pose.orientation.x = 1.0
    return pose
