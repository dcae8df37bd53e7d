"""Compiled prediction of how a piece on a level floor moves when a closed hand pushes it."""

from __future__ import annotations

import numpy as np
from numba import njit

PASSES = 24  # corrections of the contacts per step of the hand
ALIKE = 0.0015  # [m] difference of depth at which points touch the hand together
TOUCHES = 1e-4  # [m]
JAMMED = 0.002  # [m] overlap of hand and piece that remains if the piece cannot move
LEAST_RATE = 0.05  # smallest movement of a contact point per unit of the piece's motion
FAR = 0.03  # [m] more room than this is no further gain


@njit(cache=True)
def _at(field, x0, y0, resolution, x, y):
    """Return the value of a map (nx, ny) at (x, y), interpolated between four cells; 0 outside the map."""
    i, j = (x - x0) / resolution, (y - y0) / resolution
    a, b = int(np.floor(i)), int(np.floor(j))
    if a < 0 or b < 0 or a + 1 >= field.shape[0] or b + 1 >= field.shape[1]:
        return 0.0
    u, v = i - a, j - b
    return (
        (1 - u) * (1 - v) * field[a, b]
        + u * (1 - v) * field[a + 1, b]
        + (1 - u) * v * field[a, b + 1]
        + u * v * field[a + 1, b + 1]
    )


@njit(cache=True)
def _nudge(points, normals, middle, at, force, along, depth, radius):
    """Move a piece, in place, as a force at a contact point pushes it, until this point has advanced by
    `depth` [m] along a direction. Return False if the force does not move the point in this direction.

    An ellipsoid approximates the limit surface of the friction with the floor (Howe and Cutkosky 1996): the
    motion has the direction of the force, and the turn is torque / `radius` squared.
    """
    rx, ry = at[0] - middle[0], at[1] - middle[1]
    turn = (rx * force[1] - ry * force[0]) / radius**2
    rate = (force[0] - turn * ry) * along[0] + (force[1] + turn * rx) * along[1]
    if rate < LEAST_RATE:
        return False
    scale = depth / rate
    c, s = np.cos(turn * scale), np.sin(turn * scale)
    for k in range(len(points)):
        x, y = points[k, 0] - middle[0], points[k, 1] - middle[1]
        points[k, 0] = middle[0] + c * x - s * y + scale * force[0]
        points[k, 1] = middle[1] + s * x + c * y + scale * force[1]
        x, y = normals[k, 0], normals[k, 1]
        normals[k, 0], normals[k, 1] = c * x - s * y, s * x + c * y
    middle[0] += scale * force[0]
    middle[1] += scale * force[1]
    return True


@njit(cache=True)
def _within_cone(direction, normal, slope):
    """Return the direction in the friction cone around a normal that is nearest to the given direction."""
    size = np.hypot(normal[0], normal[1])
    if size < 1e-9:
        return direction.copy()
    nx, ny = normal[0] / size, normal[1] / size
    along, across = direction[0] * nx + direction[1] * ny, -direction[0] * ny + direction[1] * nx
    if along > 0 and abs(across) <= slope * along:
        return direction.copy()
    side = slope if across > 0 else -slope
    found = np.array([nx - side * ny, ny + side * nx])
    return found / np.hypot(found[0], found[1])


@njit(cache=True)
def _from_hand(points, normals, middle, hand, along, fingers, friction, radius):
    """Move a pushed piece out of the front of the hand, in place. Return the depth [m] to which the hand
    overlapped the piece, as a negative number if the piece cannot move.
    """
    depth = 0.0
    for k in range(len(points)):
        u, v = _seen_from(points[k], hand, along)
        if abs(v) <= fingers[1] and abs(u) < fingers[0]:
            depth = max(depth, fingers[0] - u)
    if depth <= TOUCHES:
        return 0.0
    at, normal, n = np.zeros(2), np.zeros(2), 0
    for k in range(len(points)):
        u, v = _seen_from(points[k], hand, along)
        if abs(v) <= fingers[1] and abs(u) < fingers[0] and fingers[0] - u > depth - ALIKE:
            at += points[k]
            normal += normals[k]
            n += 1
    force = _within_cone(along, normal, friction)
    return depth if _nudge(points, normals, middle, at / n, force, along, depth, radius) else -depth


@njit(cache=True)
def _seen_from(point, hand, along):
    """Return the coordinates of a point along and across the push, from the center of the hand."""
    dx, dy = point[0] - hand[0], point[1] - hand[1]
    return dx * along[0] + dy * along[1], -dx * along[1] + dy * along[0]


@njit(cache=True)
def _from_obstacle(points, normals, middle, room, x0, y0, resolution, radius):
    """Move a piece, in place, out of the obstacle that it penetrates most deeply, in the compiled kernel for
    pushes. Return whether the piece was in an obstacle.
    """
    deepest, worst = -1, TOUCHES
    for k in range(len(points)):
        inside = resolution - _at(room, x0, y0, resolution, points[k, 0], points[k, 1])
        if inside > worst:
            deepest, worst = k, inside
    if deepest < 0:
        return False
    (x, y), r = points[deepest], resolution
    away = np.array([
        _at(room, x0, y0, r, x + r, y) - _at(room, x0, y0, r, x - r, y),
        _at(room, x0, y0, r, x, y + r) - _at(room, x0, y0, r, x, y - r),
    ])  # fmt: skip
    size = np.hypot(away[0], away[1])
    if size < 1e-9:
        return False
    away /= size
    return _nudge(points, normals, middle, points[deepest].copy(), away, away, worst, radius)


@njit(cache=True)
def _fits(heights, x0, y0, resolution, center, along, half, limit):
    """Return whether all cells of a map below a rectangle are lower than a limit [m]."""
    p = -half[0]
    while p <= half[0] + 1e-9:
        q = -half[1]
        while q <= half[1] + 1e-9:
            x, y = center[0] + p * along[0] - q * along[1], center[1] + p * along[1] + q * along[0]
            i = int(np.floor((x - x0) / resolution + 0.5))
            j = int(np.floor((y - y0) / resolution + 0.5))
            if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1] or heights[i, j] > limit:
                return False
            q += resolution
        p += resolution
    return True


@njit(cache=True)
def _mean_room(room, x0, y0, resolution, points):
    """Return the mean distance [m] of the points on a piece's outline from obstacles, each at most `FAR`."""
    total = 0.0
    for k in range(len(points)):
        total += min(_at(room, x0, y0, resolution, points[k, 0], points[k, 1]), FAR)
    return total / len(points)


@njit(cache=True)
def predict(
    heights, others, room, x0, y0, resolution, outline, inward, middle, radius, starts, alongs, tool, limits,
    length, friction,
):  # fmt: skip
    """Predict the motions of a piece for several straight pushes with a closed hand.

    The prediction is quasi-static: in each step of one cell, a force in the friction cone of the contact with
    the hand moves the piece out of the hand, and forces without friction move it out of the obstacles.

    Args:
        heights: (nx, ny) [m] heights of the cells.
        others: (nx, ny) [m] the heights without the piece.
        room: (nx, ny) [m] distance of each cell from the nearest obstacle of the piece.
        x0, y0: center of the first cell [m].
        resolution: edge length of a cell [m].
        outline: (k, 2) [m] points on the outline of the piece.
        inward: (k, 2) normals of the outline, into the piece.
        middle: (2,) [m] center of the piece.
        radius: [m] ratio of the largest friction torque to the largest friction force of the piece.
        starts: (m, 2) [m] centers of the hand at the start.
        alongs: (m, 2) unit vectors of the pushes.
        tool: half sizes [m] of the closed fingers along and across the push, half sizes of the palm, free
            distance on all sides of the fingers.
        limits: largest heights [m] of the cells below the fingers and below the palm.
        length: [m] of the push after the first contact.
        friction: coefficient of friction between hand and piece.
    Returns:
        (m, 5) one row per push: distance [m] of the hand's motion after which the piece has gained most room,
        gain of the outline's mean distance from obstacles [m], the piece's shift in x and y [m] and its turn
        [rad] until then; zeros if the piece gains no room.
    """
    found = np.zeros((len(starts), 5))
    fingers, palm, margin = tool[0:2], tool[2:4], tool[4]
    wide = fingers + margin
    before = _mean_room(room, x0, y0, resolution, outline)
    for c in range(len(starts)):
        along, hand = alongs[c], starts[c].copy()
        if not _fits(heights, x0, y0, resolution, hand, along, wide, limits[0]):
            continue
        points, normals, center = outline.copy(), inward.copy(), middle.copy()
        travel, pushed, touched = 0.0, 0.0, False
        while pushed < length:
            ahead = hand + resolution * along
            if not _fits(others, x0, y0, resolution, ahead, along, wide, limits[0]):
                break
            if not _fits(heights, x0, y0, resolution, ahead, along, palm, limits[1]):
                break
            hand[:] = ahead
            depth = 0.0
            for _ in range(PASSES):
                depth = _from_hand(points, normals, center, hand, along, fingers, friction, radius)
                touched = touched or depth != 0.0
                if depth < 0.0:
                    break
                moved = _from_obstacle(points, normals, center, room, x0, y0, resolution, radius)
                if depth == 0.0 and not moved:
                    break
            if abs(depth) > JAMMED:
                break
            travel += resolution
            if touched:
                pushed += resolution
                gain = _mean_room(room, x0, y0, resolution, points) - before
                if gain > found[c, 1]:
                    found[c, 0], found[c, 1] = travel, gain
                    found[c, 2], found[c, 3] = center[0] - middle[0], center[1] - middle[1]
                    ax, ay = outline[0, 0] - middle[0], outline[0, 1] - middle[1]
                    bx, by = points[0, 0] - center[0], points[0, 1] - center[1]
                    found[c, 4] = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    return found
