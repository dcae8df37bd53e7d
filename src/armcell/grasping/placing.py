"""Where to put an object: place candidates on a support, best first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armcell.core import SE3, SO3, Box, Cylinder, InputError
from armcell.scene import CollisionObject

RELEASE_GAP = 0.001  # [m] above the support when the fingers open
STABILITY_MARGIN = 0.004  # [m] the object's foot stays inside the support's edge


@dataclass(frozen=True, eq=False)
class Placement:
    """A pose to leave an object at; `T_world_object` is where it comes to rest."""

    name: str
    T_world_object: SE3
    score: float = 0.0


def support_surface(support: CollisionObject) -> tuple[SE3, float, float]:
    """The largest flat, upward surface of an object: its centre frame (z up) and its size x, y [m].

    Raises:
        InputError: none of its shapes has one.
    """
    best = None
    for shape, T_object_shape in support.shapes:
        T = support.T_world_object @ T_object_shape
        if isinstance(shape, (Box, Cylinder)):
            half = shape.half_extents
            axis = int(np.argmax(np.abs(T.rotation.matrix[2])))
            sign = np.sign(T.rotation.matrix[2, axis])
            if abs(T.rotation.matrix[2, axis]) < 0.999:
                continue
            x, y = [k for k in range(3) if k != axis]
            if isinstance(shape, Cylinder) and axis != 2:
                continue
            scale = 1 / np.sqrt(2) if isinstance(shape, Cylinder) else 1.0  # the square inside the circle
            area = 4 * half[x] * half[y] * scale**2
            if best is None or area > best[0]:
                offset = np.zeros(3)
                offset[axis] = sign * half[axis]
                X = T.rotation.matrix[:, x]
                Z = np.array([0.0, 0.0, 1.0])
                frame = SE3(SO3(np.column_stack([X, np.cross(Z, X), Z])), T.apply(offset))
                best = (area, frame, 2 * half[x] * scale, 2 * half[y] * scale)
    if best is None:
        raise InputError(
            f"object {support.name!r} has no flat surface on top", cure="place on a box, table or tray"
        )
    return best[1:]


def place_candidates(
    item: CollisionObject, support: CollisionObject, at: tuple[float, float] | None = None, step: float = 0.02
) -> list[Placement]:
    """A 3 x 3 grid around a point of the support, the object turned to the support's axes or as it is.

    Args:
        item: the object at its present pose: it keeps its upright axis.
        at: point on the surface [m] from its centre; the centre by default.
        step: grid spacing [m].
    Raises:
        InputError: no flat surface, or the object does not fit on it.
    """
    frame, size_x, size_y = support_surface(support)
    low, high = item.bounds()
    up = item.T_world_object.rotation.matrix[2]  # world z in the object's frame
    axis = int(np.argmax(np.abs(up)))
    sign = float(np.sign(up[axis]))
    upright = SO3.between(np.eye(3)[axis] * sign, (0.0, 0.0, 1.0))
    height = float(-low[axis] if sign > 0 else high[axis])  # of the object's origin above its lowest point
    yaw_now = _yaw(item.T_world_object.rotation, upright)
    yaw_frame = _yaw(frame.rotation, SO3.identity())
    quarter = [yaw_frame + k * np.pi / 2 for k in range(4)]
    quarter.sort(key=lambda yaw: abs(_wrap(yaw - yaw_now)))
    cx, cy = at or (0.0, 0.0)
    if abs(cx) > size_x / 2 or abs(cy) > size_y / 2:
        raise InputError(
            f"place {at} m is beside {support.name!r}: {size_x:.2f} x {size_y:.2f} m from its centre on"
        )
    middle = (low + high) / 2
    found = []
    for i, yaw in enumerate([*quarter, yaw_now]):
        R = SO3.exp((0.0, 0.0, yaw)) @ upright
        foot = np.abs((frame.rotation.inv() @ R).matrix) @ ((high - low) / 2)
        for dx in (0.0, -step, step):
            for dy in (0.0, -step, step):
                x, y = cx + dx, cy + dy
                if (
                    abs(x) + foot[0] > size_x / 2 - STABILITY_MARGIN
                    or abs(y) + foot[1] > size_y / 2 - STABILITY_MARGIN
                ):
                    continue
                # The foot's middle goes to (x, y), wherever in the object its origin is.
                aside = R.matrix @ middle
                point = frame.apply((x, y, height)) - np.array([aside[0], aside[1], 0.0])
                score = -float(np.hypot(dx, dy)) * 10 - 0.1 * i
                found.append(
                    Placement(
                        f"({x * 1000:+.0f}, {y * 1000:+.0f}) mm, {np.rad2deg(yaw):.0f} deg",
                        SE3(R, point),
                        score,
                    )
                )
    if not found:
        raise InputError(
            f"object {item.name!r} does not fit on {support.name!r}: "
            f"its surface is {size_x * 1000:.0f} x {size_y * 1000:.0f} mm"
        )
    found.sort(key=lambda p: -p.score)
    return found


def _yaw(R: SO3, upright: SO3) -> float:
    """Rotation about world z that is left when the upright turn is taken off."""
    return float((R @ upright.inv()).rpy[2])


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
