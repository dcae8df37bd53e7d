"""Grasps and placements for arms with few independent joints, rotated to poses that the arm reaches.

With fewer than six independent joints, an arm reaches only some orientations at a position. A rotation about
an object's axis of symmetry changes nothing between hand and object. A rotation about the vertical turns the
hand against the object's sides, or the placed object on its support. An arm with five joints reaches a pose
if one such rotation is free. An arm with fewer joints may also pitch the hand about the closing axis and tilt
it slightly, because a measured pose is never exactly among the poses that the arm reaches.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armcell.core import SE3, SO3, Capsule, Cylinder, Sphere
from armcell.grasping import (
    POSE_ERROR,
    RELEASE_GAP,
    Grasp,
    Placement,
    Rejection,
    hand_of,
    lowest_point,
    placement_axis,
    rotated_placement,
    turned_grasp,
)
from armcell.kinematics import POSE_JOINTS, TurnedPose, ik_solver, poses_about_axis
from armcell.model import Gripper, RobotModel
from armcell.scene import CollisionObject, PlanningScene

TILT = 0.05  # [rad] maximum tilt of a grasp or placement about each of two axes
SETTLED = 5e-4, 1e-2  # [m], [rad] from the pose that the checks of a grasp return to a pose in reach
ROUNDS = 3  # alternations between these checks and inverse kinematics
ALIKE = 1e-3, 2e-2  # [m], [rad] nearer grasps count as one
OUT_OF_REACH = "out of reach, however the hand turns about the object"
PITCHES = np.deg2rad([15.0, 30.0, 45.0]).tolist()  # [rad] of rotated grasps, about the closing axis


def has_few_joints(model: RobotModel, gripper: Gripper) -> bool:
    """Return whether the arm of a gripper has fewer than six independent joints, so that it reaches only some
    orientations at a position.
    """
    return independent_joints(model, gripper) < POSE_JOINTS


def independent_joints(model: RobotModel, gripper: Gripper) -> int:
    """Return the number of independent joints of a gripper's arm; those of a telescope count as one."""
    return ik_solver(model, gripper.arm_group, gripper.tcp_link).independent_joints


# --- grasps ---
@dataclass(frozen=True, eq=False)
class _Family:
    """Grasps of an object whose TCP poses differ only by a rotation about one axis. An arm with few joints
    reaches some of these rotations.

    Attributes:
        T_world_tcp: TCP pose of the first grasp; the hand is pitched about its closing axis by `pitch` [rad].
        turns: the grasps, each with its rotation [rad] about the axis from the first grasp.
    """

    T_world_axis: SE3
    T_world_tcp: SE3
    pitch: float
    turns: list[tuple[Grasp, float]]

    def nearest(self, angle: float) -> tuple[Grasp, float]:
        """Return the grasp of a family that is nearest to a given rotation [rad] from the first grasp, and
        the remaining rotation [rad] from the returned grasp.
        """
        turns = [(grasp, (angle - own + np.pi) % (2 * np.pi) - np.pi) for grasp, own in self.turns]
        return min(turns, key=lambda turn: abs(turn[1]))


def grasps_in_reach(
    scene: PlanningScene, gripper: Gripper, item: CollisionObject, grasps: Sequence[Grasp], enough: int,
    reject: Callable[[str, str], None], pose_error: float = POSE_ERROR,
) -> list[Grasp]:  # fmt: skip
    """Return the grasps that an arm with few joints reaches, best first. Collisions are not checked.

    Grasps that the arm does not reach are replaced by grasps that are rotated about an axis of the object and
    pitched about the closing axis, and that pass the checks of grasp candidates.

    Args:
        grasps: grasp candidates, best first.
        enough: number of reached grasps at which the search for replacements ends.
        reject: receives the name of each grasp that no rotation about an axis replaces, and the reason.
        pose_error: [m] distance by which the object's true pose may differ from the believed one.
    """
    ik = ik_solver(scene.model, gripper.arm_group, gripper.tcp_link)
    found: list[Grasp] = []
    missed: list[Grasp] = []
    for grasp in grasps:
        T_world_tcp = item.T_world_object @ grasp.T_object_tcp
        solutions = ik.solutions(T_world_tcp, scene.positions, np.random.default_rng(0))
        (missed if next(solutions, None) is None else found).append(grasp)
    uses: Counter[str] = Counter()
    reasons: dict[str, str] = {}
    replaced: set[str] = set()
    for family in _families(scene, gripper, item, grasps, missed):
        if len(found) >= enough:
            break
        names, reason = [grasp.name for grasp, _ in family.turns], OUT_OF_REACH
        for other in _rotated_grasps(scene, gripper, item, family, pose_error):
            if isinstance(other, Rejection):
                reason = other.reason
                continue
            replaced.update(names if not family.pitch else ())
            if not any(_alike(other, known) for known in found):
                uses[other.name] += 1
                number = f" ({uses[other.name]})" if uses[other.name] > 1 else ""
                found.append(replace(other, name=f"{other.name}{number}"))
        for name in names if not family.pitch else ():
            if reasons.get(name, OUT_OF_REACH) == OUT_OF_REACH:
                reasons[name] = reason
    for name, reason in reasons.items():
        if name not in replaced:
            reject(name, reason)
    return sorted(found, key=lambda grasp: -grasp.score)


def _lacks_two(scene: PlanningScene, gripper: Gripper) -> bool:
    """Return whether an arm has fewer than five independent joints. Such an arm cannot reach every pose, even
    if the tool may rotate freely about one axis.
    """
    return independent_joints(scene.model, gripper) < POSE_JOINTS - 1


def _families(
    scene: PlanningScene, gripper: Gripper, item: CollisionObject, grasps: Sequence[Grasp],
    missed: Sequence[Grasp],
) -> Iterator[_Family]:  # fmt: skip
    """Yield families of grasps for an arm with few joints, first those of the grasps that it cannot reach. If
    the arm may also pitch the hand, the families of all grasps follow, one pitch angle after the other.
    """
    yield from _families_at(item, missed, 0.0)
    for pitch in PITCHES if _lacks_two(scene, gripper) else ():
        for sign in (1.0, -1.0):
            yield from _families_at(item, grasps, sign * pitch)


def _families_at(item: CollisionObject, grasps: Sequence[Grasp], pitch: float) -> list[_Family]:
    """Group grasps for an arm with few joints into families, in which the TCP poses differ only by a rotation
    about one axis. The hand is pitched by the angle `pitch` [rad] in all of them.
    """
    families: dict[bytes, _Family] = {}
    lean = SE3(SO3.exp((0.0, pitch, 0.0)), np.zeros(3))
    for grasp in grasps:
        T_world_tcp = item.T_world_object @ grasp.T_object_tcp @ lean
        for T_world_axis in _free_axes(item, T_world_tcp):
            T_tcp_axis = T_world_tcp.inverse() @ T_world_axis
            numbers = [T_tcp_axis.translation, T_tcp_axis.rotation.matrix[:, 2], T_world_axis.translation]
            key = (np.concatenate(numbers).round(4) + 0.0).tobytes()
            family = families.setdefault(key, _Family(T_world_axis, T_world_tcp, pitch, []))
            turn = (T_world_tcp.rotation @ family.T_world_tcp.rotation.inverse()).log()
            family.turns.append((grasp, float(turn @ T_world_axis.rotation.matrix[:, 2])))
    return list(families.values())


def _rotated_grasps(
    scene: PlanningScene, gripper: Gripper, item: CollisionObject, family: _Family, pose_error: float
) -> Iterator[Grasp | Rejection]:
    """Yield those grasps of a family that an arm with few joints reaches. For a grasp that would not hold the
    object, yield the reason instead.
    """
    hand, T_object_world = hand_of(scene.model, gripper), item.T_world_object.inverse()
    pitched = f", pitched {np.rad2deg(family.pitch):.0f} deg" if family.pitch else ""
    for pose in _poses(scene, gripper, family.T_world_tcp, family.T_world_axis):
        grasp, angle = family.nearest(pose.angle)
        name = f"{grasp.name}{pitched}, turned to the arm"
        for _ in range(ROUNDS):
            T_object_tcp = T_object_world @ pose.T_world_tip
            other = turned_grasp(item, hand, grasp, name, T_object_tcp, angle, pose_error)
            if isinstance(other, Rejection):
                degrees = np.rad2deg(angle)
                yield replace(other, reason=f"in reach only turned by {degrees:.0f} deg: {other.reason}")
                break
            apart = other.T_object_tcp.distance_to(T_object_tcp)
            if apart[0] <= SETTLED[0] and apart[1] <= SETTLED[1]:
                yield replace(other, T_object_tcp=T_object_tcp)
                break
            T_world_tcp = item.T_world_object @ other.T_object_tcp
            above = SE3(SO3.identity(), T_world_tcp.translation)
            nearest = min(
                _poses(scene, gripper, T_world_tcp, above), key=lambda p: abs(p.angle), default=None
            )
            if nearest is None:
                break
            pose, angle = nearest, angle + nearest.angle


def _poses(
    scene: PlanningScene, gripper: Gripper, T_world_tcp: SE3, T_world_axis: SE3
) -> Iterator[TurnedPose]:
    """Rotate a TCP pose about an axis, and yield the poses that an arm with few joints can reach. Poses are
    tilted only if the arm reaches none without tilt.
    """
    model, arm, tcp = scene.model, gripper.arm_group, gripper.tcp_link
    T_tcp_axis = T_world_tcp.inverse() @ T_world_axis
    for tilt in (0.0, TILT) if _lacks_two(scene, gripper) else (0.0,):
        found = False
        for pose in poses_about_axis(model, arm, tcp, T_tcp_axis, T_world_axis, scene.positions, tilt):
            found = True
            yield pose
        if found:
            return


def _free_axes(item: CollisionObject, T_world_tcp: SE3) -> list[SE3]:
    """Return the frames T_world_axis about whose z axes an arm with few joints may rotate a grasp: on the
    object's axis of symmetry, and on the vertical.

    The vertical passes through the center of a ball, or through the TCP.
    """
    above = SE3(SO3.identity(), T_world_tcp.translation)
    shape, T_object_shape = item.shapes[0] if len(item.shapes) == 1 else (None, None)
    if T_object_shape is None or not isinstance(shape, Sphere | Cylinder | Capsule):
        return [above]
    center = item.T_world_object @ T_object_shape
    if isinstance(shape, Sphere):
        return [SE3(SO3.identity(), center.translation)]
    upright = abs(center.rotation.matrix[2, 2]) > np.cos(TILT)
    return [center] if upright else [center, above]


def _alike(a: Grasp, b: Grasp) -> bool:
    apart = a.T_object_tcp.distance_to(b.T_object_tcp)
    return apart[0] < ALIKE[0] and apart[1] < ALIKE[1]


# --- placements ---
def placements_in_reach(
    scene: PlanningScene, gripper: Gripper, item: CollisionObject, support: CollisionObject,
    placement: Placement,
) -> Iterator[tuple[Placement, SE3, float]]:  # fmt: skip
    """Yield copies of a placement of the held object, each rotated about the surface normal to a pose that an
    arm with few joints reaches.

    The hand may hold the object at an angle, so such an arm reaches the placement at few angles only, or with
    a small tilt. A tilted object is released higher, so that no corner is below the support's surface.

    Yields:
        The rotated placement, the pose T_world_object at which the hand releases the object, and the angle
        [rad] of the rotation.
    """
    T_tcp_object = scene.frame_pose(gripper.tcp_link).inverse() @ scene.frame_pose(item.name)
    T_world_axis, normal = placement_axis(item, placement), np.array(placement.normal)
    T_axis_object = T_world_axis.inverse() @ placement.T_world_object
    gap = RELEASE_GAP
    for _ in range(ROUNDS):
        above = SE3(T_world_axis.rotation, T_world_axis.translation + gap * normal)
        poses = list(_poses(scene, gripper, above @ T_axis_object @ T_tcp_object.inverse(), above))
        released = [pose.T_world_tip @ T_tcp_object for pose in poses]
        lowest = min((lowest_point(item, T, placement) for T in released), default=RELEASE_GAP)
        if lowest >= RELEASE_GAP / 2:
            break
        gap += RELEASE_GAP - lowest
    for pose, T_world_object in zip(poses, released, strict=True):
        if (other := rotated_placement(item, support, placement, pose.angle)) is not None:
            yield other, T_world_object, pose.angle
