"""`Pack`: a scene and a joint group as arrays for the kernel, and their layout as three flat arrays.

Numba counts the references of every array that is passed or taken out of a tuple with atomic
instructions; with thirty arrays in a tuple, the kernel was eight times slower. All integers are
therefore in one int32 array `I`, all floats in a float32 array `F`, and all doubles in a float64 array
`D`. The first integers of `I` hold the counts and the start index of each table.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.convex_pieces import join_pieces
from armcell.collision.kernel.robot_arrays import RobotPart
from armcell.collision.kernel.world_arrays import World
from armcell.scene import PlanningScene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
Flat = tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float64]]
HEADER = 56
_INTS = (
    "parent",
    "kind",
    "column",
    "frame",
    "body_groups",
    "group_spheres",
    "body_pieces",
    "pairs",
    "near",
    "near_groups",
    "meet",
    "meet_groups",
    "gap_table",
    "shape_kind",
    "shape_object",
    "shape_planes",
    "shape_pieces",
    "child",
    "piece_kind",
    "piece_points",
    "shape_cloud",
    "cloud",
    "cloud_child",
)
_FLOATS = (
    "fixed",
    "multiplier",
    "offset",
    "body_sphere",
    "padding",
    "margin",
    "group_sphere",
    "sphere",
    "rate",
    "pair_rate",
    "shape_pose",
    "shape_size",
    "planes",
    "boxes",
    "points32",
    "cloud_boxes",
    "cloud_parts",
    "pair_margin",
    "gap_grid",
    "gaps",
)
_DOUBLES = (
    "piece_size",
    "piece_pose",
    "piece_ball",
    "points",
    "reach",
    "pair_reach",
)


class Pack(NamedTuple):
    """Pack of arrays for one scene and one joint group, with all data that the collision kernel reads.

    Sizes: `f` frames (0 is the world), `k` bodies, `g` groups of spheres, `s` spheres, `o` world shapes, `e`
    exact pieces. Arrays whose last size is L hold one value per SIMD lane.
    """

    dof: int
    # frames: T_parent_joint, rotated so that the joint's axis is z
    parent: I32  # (f,)
    fixed: F32  # (f, 12) rows of 3x4
    kind: I32  # (f,) 1 revolute, 2 prismatic
    column: I32  # (f,) column of the joint in the group's positions
    multiplier: F32  # (f,)
    offset: F32  # (f,)
    # bodies: links and attached objects that the group moves
    frame: I32  # (k,)
    body_sphere: F32  # (k, 4) center in the frame, radius
    body_groups: I32  # (k + 1,) first group of each body
    padding: F32  # (k,) padding against world shapes, the largest margin of the body
    margin: F32  # (k, objects) padding of each body against each object, -1 where contact is ignored
    group_sphere: F32  # (g, 4)
    group_spheres: I32  # (g + 1,) first sphere of each group
    sphere: F32  # (s, 5) center in the frame, outer radius, inner radius
    body_pieces: I32  # (k + 1,) first exact piece of each body
    # pairs of bodies
    pairs: I32  # (p, 2)
    pair_margin: F32  # (p,) distance [m] that the two bodies must keep; 0: they must not touch
    near: I32  # (p + 1,) first entry of each pair in near_groups
    near_groups: I32  # (n,) groups of the first body that can meet the second body
    meet: I32  # (n + 1,) first entry of each near group in meet_groups
    meet_groups: I32  # groups of the second body that can meet the near group
    gap_table: I32  # (p, 5) first entry in gaps or -1, columns of the two joints, cells of each joint
    gap_grid: F32  # (p, 6) lower limit, cells per unit and period in cells of each of the two joints
    gaps: F32  # [m] lower bounds of the gaps in all cells of all tables
    # world shapes
    shape_kind: I32  # (o,)
    shape_pose: F32  # (o, 12) rows of T_shape_world (world to shape)
    shape_size: F32  # (o, 3)
    shape_object: I32  # (o,)
    shape_planes: I32  # (o + 1,) first plane of each convex mesh
    planes: F32  # (n, 4) outward normal and offset
    boxes: F32  # (blocks, 6, L) axis-aligned boxes, 16 per block, block 0 outermost; unused lanes are empty
    child: I32  # (blocks, L) the shape in each box, or minus the block of boxes inside it
    shape_pieces: I32  # (o + 1,) first exact piece of each world shape
    shape_cloud: I32  # (o,) the cloud whose bounding box the shape is, or -1
    # clouds: shapes of many parts, in the frame of their bounding box (see cloud_part)
    cloud: I32  # (c, 4) kind of part, first block of boxes, first value in cloud_parts, whether closed
    cloud_boxes: F32  # (blocks, 6, L) like `boxes`
    cloud_child: I32  # (blocks, L) the block of parts in each box, or minus the block of boxes inside it
    cloud_parts: F32  # blocks of L parts
    # exact pieces: convex solids of bodies (in their frame) and of world shapes (in the world)
    piece_kind: I32  # (e,)
    piece_size: F64  # (e, 3)
    piece_pose: F64  # (e, 12) rows of T_frame_piece, or T_world_piece
    piece_points: I32  # (e, 2) first point (a multiple of L) and count
    piece_ball: F64  # (e, 4) bounding sphere in the frame (bodies) or world (shapes)
    points: F64  # (n, 3)
    points32: F32  # (n / L, 3, L) `points` as float32
    # motion bounds
    reach: F64  # (k, dof) upper bound of the motion of a body's points per unit of each joint
    pair_reach: F64  # (p, dof) upper bound of the relative motion of a pair per unit of each joint
    rate: F32  # `reach`, rounded up to float32
    pair_rate: F32  # `pair_reach`, rounded up to float32


class Names(NamedTuple):
    """Names of the bodies and world objects to which the indices of a `Pack` refer."""

    bodies: tuple[str, ...]
    objects: tuple[str, ...]


def pack(scene: PlanningScene, robot: RobotPart, world: World) -> tuple[Pack, Names]:
    """Convert the robot and the world of a scene to the collision kernel's arrays, a `Pack`.

    Joints outside the group stay at the scene's positions.
    """
    margin = np.repeat(robot.arrays["padding"][:, None], len(world.names), axis=1)
    margin[_ignored(scene, robot.bodies, world.names)] = -1.0
    arrays: dict[str, Any] = robot.arrays | world.arrays | join_pieces(robot.pieces.tables, world.pieces)
    shape_pieces = world.shape_pieces + np.int32(len(robot.pieces.kind))
    return Pack(**arrays, margin=margin, shape_pieces=shape_pieces), Names(robot.bodies, world.names)


def _ignored(scene: PlanningScene, bodies: tuple[str, ...], objects: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return a mask (bodies, objects) of the pairs for which the scene allows contact. The pack passes it to
    the kernel, which ignores these pairs.

    Contact is ignored only for pairs that the scene names.
    """
    ignored = np.zeros((len(bodies), len(objects)), bool)
    if not scene.allowed:
        return ignored
    body = {name: k for k, name in enumerate(bodies)}
    item = {name: o for o, name in enumerate(objects)}
    for pair in scene.allowed:
        for a in pair:
            for b in pair:
                if a in body and b in item:
                    ignored[body[a], item[b]] = scene.allowed[pair]
    return ignored


# indices of the counts in I
DOF, FRAMES, BODIES, GROUPS, SPHERES, PAIRS, OBJECTS = range(7)
# indices in I of the start of each integer table
(
    PARENT,
    KIND,
    COLUMN,
    FRAME,
    BODY_GROUPS,
    GROUP_SPHERES,
    BODY_PIECES,
    PAIR,
    NEAR,
    NEAR_GROUPS,
    MEET,
    MEET_GROUPS,
    GAP_TABLE,
    SHAPE_KIND,
    SHAPE_OBJECT,
    SHAPE_PLANES,
    SHAPE_PIECES,
    CHILD,
    PIECE_KIND,
    PIECE_POINTS,
    SHAPE_CLOUD,
    CLOUD,
    CLOUD_CHILD,
) = range(7, 30)
# indices in I of the start of each float table in F
(
    FIXED,
    MULTIPLIER,
    OFFSET,
    BODY_SPHERE,
    PADDING,
    MARGIN,
    GROUP_SPHERE,
    SPHERE,
    RATE,
    PAIR_RATE,
    SHAPE_POSE,
    SHAPE_SIZE,
    PLANES,
    BOXES,
    POINTS32,
    CLOUD_BOXES,
    CLOUD_PARTS,
    PAIR_MARGIN,
    GAP_GRID,
    GAPS,
) = range(30, 50)
# indices in I of the start of each double table in D
(
    PIECE_SIZE,
    PIECE_POSE,
    PIECE_BALL,
    POINTS,
    REACH,
    PAIR_REACH,
) = range(50, 56)


def flatten(p: Pack) -> Flat:
    """Return the arrays of a `Pack` in the memory layout of the kernel: the three flat arrays I, F and D."""
    counts = [
        p.dof, len(p.parent), len(p.frame), len(p.group_sphere), len(p.sphere), len(p.pairs),
        p.margin.shape[1],
    ]  # fmt: skip
    header = np.zeros(HEADER, np.int32)
    header[: len(counts)] = counts

    def table(names: tuple[str, ...], first: int, dtype: type, begin: int) -> list[np.ndarray]:
        parts, at = [], begin
        for i, name in enumerate(names):
            flat = np.asarray(getattr(p, name), dtype).ravel()
            header[first + i] = at
            at += len(flat)
            parts.append(flat)
        return parts

    ints = table(_INTS, PARENT, np.int32, HEADER)
    floats = table(_FLOATS, FIXED, np.float32, 0)
    doubles = table(_DOUBLES, PIECE_SIZE, np.float64, 0)
    return np.concatenate([header, *ints]), np.concatenate(floats), np.concatenate(doubles)
