"""Collision checking, distance queries, and certification of whole motions."""

from armcell.collision.arms import Arms, without_arms
from armcell.collision.certificate import Certificate
from armcell.collision.certify import MotionBound, certify_path
from armcell.collision.certify_timed import TimedCertificate, certify_timed
from armcell.collision.exact import ExactChecker, neighbors
from armcell.collision.self_collision import disabled_collision_pairs
from armcell.collision.self_filter import object_mask, robot_mask, without_robot
from armcell.collision.touch_links import attached_by_contact, touching_links
from armcell.collision.view_cone import link_hull_distances, links_in_hull, view_cone

__all__ = [
    "Arms",
    "Certificate",
    "ExactChecker",
    "MotionBound",
    "TimedCertificate",
    "attached_by_contact",
    "certify_path",
    "certify_timed",
    "disabled_collision_pairs",
    "link_hull_distances",
    "links_in_hull",
    "neighbors",
    "object_mask",
    "robot_mask",
    "touching_links",
    "view_cone",
    "without_arms",
    "without_robot",
]
