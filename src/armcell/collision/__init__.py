"""Collision checking, distance queries, and certification of whole motions."""

from armcell.collision.certify import Certificate, MotionBound, certify_path
from armcell.collision.certify_timed import TimedCertificate, certify_timed
from armcell.collision.exact_checker import ExactChecker, neighbors
from armcell.collision.inter_arm_checker import InterArmChecker, without_arms
from armcell.collision.resting_height import resting_shift
from armcell.collision.self_collision import disabled_collision_pairs
from armcell.collision.self_filter import object_mask, remove_robot_points, robot_mask
from armcell.collision.touch_links import attached_by_contact, touching_links
from armcell.collision.view_cone import links_by_distance, links_in_hull, view_cone

__all__ = [
    "Certificate",
    "ExactChecker",
    "InterArmChecker",
    "MotionBound",
    "TimedCertificate",
    "attached_by_contact",
    "certify_path",
    "certify_timed",
    "disabled_collision_pairs",
    "links_by_distance",
    "links_in_hull",
    "neighbors",
    "object_mask",
    "remove_robot_points",
    "resting_shift",
    "robot_mask",
    "touching_links",
    "view_cone",
    "without_arms",
]
