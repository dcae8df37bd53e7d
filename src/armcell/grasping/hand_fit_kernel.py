"""Compiled grasp geometry: rays through a triangle mesh, and fits of a hand around points."""

from __future__ import annotations

import numpy as np
from numba import njit

FREE, NOTHING_BETWEEN, TOO_WIDE, HAND_HITS, SUPPORT_HIT, TOO_FLAT = range(6)

MAX_HITS = 64
TIE = 1e-6  # [m] nearer hits count as one point, where entering precedes leaving
PATCH = 0.001  # [m] depth below the outermost point within which points touch the pad
INSET = 0.0015  # [m] minimum distance of a contact from the pads' edges
CLEARANCE = 0.003  # [m] distance of the hand from the object's support
GAP = 0.001  # [m] distance of the fingers from the object
PALM_GAP = 0.003  # [m] of the palm: physics' solids are up to 2 mm larger than meshes, and objects shift
BESIDE = 0.02  # [m] points farther beyond the open pads are another part, such as a bin's other wall
WIDER, MARGIN = 1.125, 0.010  # opening before the approach: factor on the width, and minimum margin [m]


@njit(cache=True)
def cast(origins, directions, triangles):
    """Cast rays from the surface of a mesh into its interior and find where they leave the mesh, in the
    compiled hand-fit kernel.

    Several solids may touch or overlap: a ray has left the solids when it is in none of them.

    Args:
        origins: (n, 3) start points [m].
        directions: (n, 3) directions of the rays.
        triangles: (t, 3, 3) surface [m].
    Returns:
        Distances (n, 2) [m] of the first and the last exit, and indices (n, 2) of the triangles there; -1
        without an exit.
    """
    n, m = len(origins), len(triangles)
    distance = np.full((n, 2), -1.0)
    where = np.full((n, 2), -1, dtype=np.int64)
    t_hit, way_hit, k_hit = (
        np.empty(MAX_HITS),
        np.empty(MAX_HITS, dtype=np.int64),
        np.empty(MAX_HITS, dtype=np.int64),
    )
    for i in range(n):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        hits = 0
        for k in range(m):
            ax, ay, az = triangles[k, 0, 0], triangles[k, 0, 1], triangles[k, 0, 2]
            e1x, e1y, e1z = triangles[k, 1, 0] - ax, triangles[k, 1, 1] - ay, triangles[k, 1, 2] - az
            e2x, e2y, e2z = triangles[k, 2, 0] - ax, triangles[k, 2, 1] - ay, triangles[k, 2, 2] - az
            px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
            det = e1x * px + e1y * py + e1z * pz  # negative if the ray leaves the solid through the triangle
            if det == 0.0:
                continue
            sx, sy, sz = ox - ax, oy - ay, oz - az
            u = (sx * px + sy * py + sz * pz) / det
            if u < 0.0 or u > 1.0:
                continue
            qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
            v = (dx * qx + dy * qy + dz * qz) / det
            if v < 0.0 or u + v > 1.0:
                continue
            t = (e2x * qx + e2y * qy + e2z * qz) / det
            if t > 1e-5 and hits < MAX_HITS:
                t_hit[hits], way_hit[hits], k_hit[hits] = t, (-1 if det < 0.0 else 1), k
                hits += 1
        for a in range(1, hits):  # insertion sort, because there are few hits
            t, way, k, b = t_hit[a], way_hit[a], k_hit[a], a
            while b > 0 and (
                t_hit[b - 1] > t + TIE or (abs(t_hit[b - 1] - t) <= TIE and way_hit[b - 1] < way)
            ):
                t_hit[b], way_hit[b], k_hit[b] = t_hit[b - 1], way_hit[b - 1], k_hit[b - 1]
                b -= 1
            t_hit[b], way_hit[b], k_hit[b] = t, way, k
        inside = 1
        for a in range(hits):
            inside += way_hit[a]
            if inside <= 0 and way_hit[a] < 0:
                if where[i, 0] < 0:
                    distance[i, 0], where[i, 0] = t_hit[a], k_hit[a]
                distance[i, 1], where[i, 1] = t_hit[a], k_hit[a]
        if where[i, 1] < 0 and hits and way_hit[hits - 1] < 0:  # a surface with holes
            for which in range(2):
                distance[i, which], where[i, which] = t_hit[hits - 1], k_hit[hits - 1]
    return distance, where


@njit(cache=True)
def _lowest(R, p, box, up, shift):
    """Return the height [m] along `up` of the lowest point of one box of the hand, in the compiled hand-fit
    kernel.

    The box is moved by `shift` along the hand's y axis.
    """
    cx = (box[0] + box[3]) / 2
    cy = (box[1] + box[4]) / 2 + shift
    cz = (box[2] + box[5]) / 2
    height = 0.0
    for a in range(3):
        center = R[a, 0] * cx + R[a, 1] * cy + R[a, 2] * cz + p[a]
        height += up[a] * center
    for b in range(3):
        along = up[0] * R[0, b] + up[1] * R[1, b] + up[2] * R[2, b]
        height -= abs(along) * (box[3 + b] - box[b]) / 2
    return height


@njit(cache=True)
def pre_opening(width, max_width, pose_error):
    """Return how far [m] the fingers open before they grasp an object, in the compiled hand-fit kernel.

    The fingers pass the object if its true pose differs from the believed one by `pose_error` [m].
    """
    return min(max(width * WIDER, width + MARGIN, width + 2.0 * (pose_error + GAP)), max_width)


@njit(cache=True)
def depth_on_approach(q, palm, left, right, approach, opening, gap):
    """Return how deep [m] an open hand enters an object on its straight approach, in the compiled hand-fit
    kernel.

    Args:
        q: (n, 3) points of the object's surface in the frame of the hand.
        gap: [m] distance of the hand from the object beside and below it.
    """
    deepest = 0.0
    for side in range(3):
        boxes = palm if side == 0 else left if side == 1 else right
        shift = 0.0 if side == 0 else opening / 2 if side == 1 else -opening / 2
        for b in range(len(boxes)):
            for j in range(len(q)):
                if boxes[b, 2] - approach < q[j, 2] < boxes[b, 5] + gap:
                    x, y = q[j, 0], q[j, 1] - shift
                    if boxes[b, 0] - gap < x < boxes[b, 3] + gap and boxes[b, 1] < y < boxes[b, 4]:
                        inside = min(x - boxes[b, 0], boxes[b, 3] - x, y - boxes[b, 1], boxes[b, 4] - y)
                        deepest = max(deepest, inside + gap)
    return deepest


@njit(cache=True)
def fit_hand(
    poses, points, normals, palm, left, right, pad, thinnest, max_width, up, floor, approach, pose_error, deep
):  # fmt: skip
    """Fit a hand around the surface points of an object at each grasp pose, in the compiled hand-fit kernel.

    The function centers the hand between the surfaces that the pads touch, moves it back until palm and
    support are clear, opens it for the object, and checks its straight approach. Where possible, the hand
    keeps its distance from the object also at a pose error; otherwise it keeps the distances without error.

    Args:
        poses: (k, 4, 4) T_object_tcp, changed in place.
        points, normals: (n, 3) of the object's surface.
        palm, left, right: boxes of the hand, see `Hand`.
        pad: (2, 2) [m] minimum and maximum x and z of the pads.
        thinnest, max_width: smallest and largest width [m] of an object that the gripper can hold.
        up: (3,) direction away from the support, in the object's frame.
        floor: height of the support along `up` [m]; -inf without a support.
        approach: length [m] of the straight approach on which the open hand must not touch the object.
        pose_error: [m] distance by which the object's true pose may differ from the believed one.
        deep: True if the pose error must not move the hand back.

    Returns:
        Verdicts (k,). Measures (k, 5): the object's width, the opening before the approach, and the
        distance that the hand was moved (if the hand does not fit: the excess over the limit) [m]; the share
        of the distances that allow for the pose error, from 0 to 1; and 1 if the pose error moved the hand
        back, else 0. Contacts (k, 2, 9) of the pads at +y and -y: center and mean normal in the tcp frame,
        number of points, patch radius [m], and its part along z of the tcp [m].
    """
    k, n = len(poses), len(points)
    verdict = np.zeros(k, dtype=np.int64)
    measures = np.zeros((k, 5))
    contacts = np.zeros((k, 2, 9))
    q = np.empty((n, 3))
    for i in range(k):
        R, p = poses[i, :3, :3], poses[i, :3, 3].copy()
        along_up = R[0, 2] * up[0] + R[1, 2] * up[1] + R[2, 2] * up[2]
        drawn, low_y, high_y, width, opening, need = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for tight in range(1 if deep else 0, 2):  # with the distances for the pose error, then without
            spare = 0.0 if tight else pose_error
            bound = False  # the distances for the pose error decide
            p[:] = poses[i, :3, 3]
            drawn = 0.0
            verdict[i] = FREE
            for turn in range(4):
                for j in range(n):
                    x, y, z = points[j, 0] - p[0], points[j, 1] - p[1], points[j, 2] - p[2]
                    for a in range(3):
                        q[j, a] = R[0, a] * x + R[1, a] * y + R[2, a] * z
                low_y, high_y, found = np.inf, -np.inf, 0
                least, most = np.inf, -np.inf
                for j in range(n):
                    if (pad[0, 0] + INSET < q[j, 0] < pad[1, 0] - INSET
                            and pad[0, 1] + INSET < q[j, 2] < pad[1, 1] - INSET):  # fmt: skip
                        least, most = min(least, q[j, 1]), max(most, q[j, 1])
                        if abs(q[j, 1]) < max_width / 2 + BESIDE:
                            found += 1
                            low_y, high_y = min(low_y, q[j, 1]), max(high_y, q[j, 1])
                width = high_y - low_y
                if turn == 0 and most > least and (found == 0 or width > max_width - MARGIN / 2):
                    verdict[i], need = TOO_WIDE, most - least
                    break
                if found == 0 or width < thinnest:
                    verdict[i] = NOTHING_BETWEEN if turn == 0 else TOO_FLAT
                    need = drawn
                    break
                if width > max_width - MARGIN / 2:
                    verdict[i], need = TOO_WIDE, width
                    break
                opening = pre_opening(width, max_width, pose_error)
                middle = (low_y + high_y) / 2
                # --- distance to move back: palm off the object, whole hand off the support
                back, gap = 0.0, PALM_GAP + spare
                for b in range(len(palm)):
                    for j in range(n):
                        if (palm[b, 0] - gap < q[j, 0] < palm[b, 3] + gap
                                and palm[b, 1] - gap < q[j, 1] - middle
                                and q[j, 1] - middle < palm[b, 4] + gap):  # fmt: skip
                            back = max(back, palm[b, 5] + gap - q[j, 2])
                bound |= spare > 0.0 and back > 0.0
                lift = 0.0
                if floor > -np.inf:
                    lowest = np.inf
                    for a in range(3):
                        p[a] += R[a, 1] * middle
                    for b in range(len(palm)):
                        lowest = min(lowest, _lowest(R, p, palm[b], up, 0.0))
                    for b in range(len(left)):
                        lowest = min(lowest, _lowest(R, p, left[b], up, opening / 2))
                    for b in range(len(right)):
                        lowest = min(lowest, _lowest(R, p, right[b], up, -opening / 2))
                    for a in range(3):
                        p[a] -= R[a, 1] * middle
                    lift = max(0.0, floor + CLEARANCE - lowest)
                if lift > 1e-7 and along_up < -0.3:
                    back, lift = max(back, lift / -along_up), 0.0
                if along_up > 0.3 and lift > 1e-7:
                    verdict[i], need = SUPPORT_HIT, lift
                    break
                need = back + lift
                if need <= 1e-7 and abs(middle) < 1e-7:
                    break
                if turn == 3:
                    if need > 1e-4:
                        verdict[i] = SUPPORT_HIT if lift > back else HAND_HITS
                    break
                drawn += need
                for a in range(3):
                    p[a] += R[a, 1] * middle - R[a, 2] * back + up[a] * lift
            if verdict[i] == FREE:
                # --- approach of the open fingers and the palm
                deepest = depth_on_approach(q, palm, left, right, approach, opening, GAP + spare)
                if deepest > 0.0 and pose_error > 0.0:
                    opening = pre_opening(width, max_width, 0.0)
                    deepest = depth_on_approach(q, palm, left, right, approach, opening, GAP + spare)
                if deepest > 0.0:
                    verdict[i], need = HAND_HITS, deepest
                    bound |= spare > 0.0
            if verdict[i] == FREE or not bound:
                break
        measures[i, 0], measures[i, 1], measures[i, 2] = width, opening, drawn if verdict[i] == FREE else need
        poses[i, :3, 3] = p
        if verdict[i] != FREE:
            continue
        beside = min((opening - width) / 2 / (pose_error + GAP), 1.0)
        measures[i, 3], measures[i, 4] = (beside + (0.0 if tight else 1.0)) / 2, bound
        # --- contact patches of the pads
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            edge = high_y if side == 0 else -low_y
            count, sums, squares, heights = 0, np.zeros(6), 0.0, 0.0
            for j in range(n):
                if (sign * q[j, 1] > edge - PATCH and sign * q[j, 1] < edge + 1e-9
                        and pad[0, 0] + INSET < q[j, 0] < pad[1, 0] - INSET
                        and pad[0, 1] + INSET < q[j, 2] < pad[1, 1] - INSET):  # fmt: skip
                    facing = 0.0
                    for a in range(3):
                        facing += normals[j, a] * R[a, 1] * sign
                    if facing <= 0.05:
                        continue
                    count += 1
                    for a in range(3):
                        sums[a] += q[j, a]
                        sums[3 + a] += (
                            normals[j, 0] * R[0, a] + normals[j, 1] * R[1, a] + normals[j, 2] * R[2, a]
                        )
                    squares += q[j, 0] ** 2 + q[j, 2] ** 2
                    heights += q[j, 2] ** 2
            if count == 0:
                verdict[i] = NOTHING_BETWEEN
                break
            length = np.sqrt(sums[3] ** 2 + sums[4] ** 2 + sums[5] ** 2)
            for a in range(3):
                contacts[i, side, a] = sums[a] / count
                contacts[i, side, 3 + a] = sums[3 + a] / max(length, 1e-12)
            spread = squares / count - (sums[0] / count) ** 2 - (sums[2] / count) ** 2
            contacts[i, side, 6] = count
            contacts[i, side, 7] = np.sqrt(max(spread, 0.0))
            contacts[i, side, 8] = np.sqrt(max(heights / count - (sums[2] / count) ** 2, 0.0))
    return verdict, measures, contacts
