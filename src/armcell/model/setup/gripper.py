"""Detection of parallel grippers: derives robot.yaml's gripper parameters from the meshes."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, Mesh
from armcell.core.geometry import local_bounds
from armcell.model.robot import EndEffector, Gripper, Joint, RobotModel

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

PALM_MARGIN = 0.005  # [m] minimum distance of a grasped object from the palm
PAD = 0.01  # [m] from the tcp toward the palm: range in which the fingers' inner faces count as pads
STRAIGHT = 0.99  # cosine between the fingers' direction and the tcp frame's y


def find_grippers(model: RobotModel) -> RobotModel:
    """Detect grippers: return the robot with a `Gripper` for each end effector that is a parallel gripper.

    A parallel gripper has two fingers that slide along the y axis of a frame fixed to the palm; the z axis of
    this frame points out of the hand. The user must describe other grippers.
    """
    found = dict(model.grippers)
    for end in model.end_effectors.values():
        gripper = _parallel(model, end)
        if gripper is not None:
            found[end.name] = gripper
    return replace(model, grippers=found)


def _parallel(model: RobotModel, end: EndEffector) -> Gripper | None:
    group = model.groups[end.group]
    sliding = [j for j in model.joints.values() if j.movable and j.child in group.link_names]
    if len(group.joint_names) != 1 or len(sliding) != 2 or end.parent_group is None:
        return None
    if any(j.type != "prismatic" or (j.mimic and j.mimic.offset) for j in sliding):
        return None
    palm = sliding[0].parent
    if sliding[1].parent != palm:
        return None
    for tcp in _frames(model, palm):
        gripper = _measured(model, end, sliding, palm, tcp)
        if gripper is not None:
            return gripper
    logger.info("%s: no frame below %s fits its fingers: no entry under grippers", end.name, palm)
    return None


def _frames(model: RobotModel, palm: str) -> list[str]:
    """Return a detected gripper palm's fixed links without collision geometry, which may be the tcp."""
    rigid = next(links for links in model.rigid_groups if palm in links)
    return [n for n in model.subtree(palm) if n in rigid and n != palm and not model.links[n].collisions]


def _measured(
    model: RobotModel, end: EndEffector, sliding: list[Joint], palm: str, tcp: str
) -> Gripper | None:
    T_tcp_palm = _pose(model, palm, tcp).inv()
    ways, points = [], []
    for joint in sliding:
        T = T_tcp_palm @ joint.T_parent_joint
        factor = joint.mimic.multiplier if joint.mimic else 1.0
        ways.append(T.rotation.matrix @ np.array(joint.axis) * factor)
        points.append(_corners(model, joint.child, T))
    way = ways[0] - ways[1]  # motion of one finger relative to the other, per unit of the joint
    speed = float(np.linalg.norm(way))
    if speed < 1e-6 or abs(way[1]) < STRAIGHT * speed or any(len(p) == 0 for p in points):
        return None
    if ways[0][1] < ways[1][1]:
        points.reverse()  # so that the first finger opens toward +y
    pads = [p[p[:, 2] > -PAD] for p in points]
    reach = min(float(p[:, 2].max()) for p in points)
    if any(len(p) == 0 for p in pads) or reach <= 0:
        return None  # z does not point out of the hand, or the frame is beyond the fingers
    driver = next(j for j in sliding if j.actuated)
    offset = max(float(pads[0][:, 1].min() - pads[1][:, 1].max()), 0.0)
    body = _corners(model, palm, T_tcp_palm)
    depth = -float(body[:, 2].max()) - PALM_MARGIN if len(body) else 0.02
    effort = driver.limits.effort
    return Gripper(
        name=end.name,
        arm_group=str(end.parent_group),
        group=end.group,
        joint_name=driver.name,
        tcp_link=tcp,
        finger_links=tuple(j.child for j in sliding),
        hand_links=(palm, *(n for j in sliding for n in model.subtree(j.child))),
        width_per_joint=round(speed, 6),
        width_offset=round(offset, 6),
        max_width=round(speed * driver.limits.upper + offset, 6),
        max_force=float(effort) if np.isfinite(effort) else Gripper.max_force,
        finger_depth=round(max(depth, PALM_MARGIN), 6),
        pad_depth=round(reach, 6),
    )


def _pose(model: RobotModel, base: str, tip: str) -> SE3:
    """Return link `tip`'s pose in link `base`'s frame at zero joints, to detect a gripper."""
    T = SE3.identity()
    for joint in model.chain(base, tip):
        T = T @ joint.T_parent_joint
    return T


def _corners(model: RobotModel, link: str, T: SE3) -> Array:
    """Return points (n, 3) [m] that bound a link's shapes, transformed by `T`, to detect a gripper.

    A mesh contributes its vertices, another shape the corners of its bounding box.
    """
    found = [np.zeros((0, 3))]
    for collision in model.links[link].collisions:
        if isinstance(collision.shape, Mesh):
            points = collision.shape.vertices
        else:
            center, half = local_bounds(collision.shape)
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            points = center + signs * half
        M = (T @ collision.T_link_shape).matrix
        found.append(points @ M[:3, :3].T + M[:3, 3])
    return np.concatenate(found)
