"""Does it touch? The exact checker, distances, and proofs for whole motions."""

from armcell.collision.certificate import Certificate
from armcell.collision.certify import MotionBound, certify_path
from armcell.collision.exact import ExactChecker, neighbours
from armcell.collision.self_collision import disabled_collision_pairs

__all__ = [
    "Certificate",
    "ExactChecker",
    "MotionBound",
    "certify_path",
    "disabled_collision_pairs",
    "neighbours",
]
