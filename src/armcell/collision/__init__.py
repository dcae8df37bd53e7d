"""Does it touch? The exact checker, distances, and proofs for whole motions."""

from armcell.collision.arms import Arms, without_arm
from armcell.collision.certificate import Certificate
from armcell.collision.certify import MotionBound, certify_path
from armcell.collision.certify_timed import TimedCertificate, certify_timed
from armcell.collision.exact import ExactChecker, neighbours
from armcell.collision.self_collision import disabled_collision_pairs
from armcell.collision.self_filter import object_mask, robot_mask, without_robot
from armcell.collision.touch_links import attached_by_contact, touching_links
from armcell.collision.view import cone, links_apart, links_within

__all__ = [
    "Arms",
    "Certificate",
    "ExactChecker",
    "MotionBound",
    "TimedCertificate",
    "attached_by_contact",
    "certify_path",
    "certify_timed",
    "cone",
    "disabled_collision_pairs",
    "links_apart",
    "links_within",
    "neighbours",
    "object_mask",
    "robot_mask",
    "touching_links",
    "without_arm",
    "without_robot",
]
