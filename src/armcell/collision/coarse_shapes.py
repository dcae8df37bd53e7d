"""Visual meshes in place of coarse collision shapes, to recognize contacts of bounding boxes only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.core.geometry import local_bounds
from armcell.model import RobotModel
from armcell.model.assets import load_mesh
from armcell.model.robot import Collision, Link

WHOLE = (
    0.5  # least size of a link's visual shapes, as a fraction of the size of its collision shapes along the
)
# link's axes: a ball in a tilted box has 0.58


def with_visual_shapes(model: RobotModel, links: Iterable[str]) -> RobotModel:
    """Return a robot model in which the visual shapes of some links are their collision shapes, and all other
    links have no collision shapes.

    A link whose visual shapes are missing has none either, nor has a link whose visual shapes are clearly
    smaller than its collision shapes along an axis of the link: they show only a part of the link.
    """
    named = set(links)
    shown = {
        name: replace(link, collisions=_visuals(link) if name in named else ())
        for name, link in model.links.items()
    }
    return replace(model, links=shown, disabled_collisions={})


def _visuals(link: Link) -> tuple[Collision, ...]:
    """Return the visual shapes of a link as collision shapes, or none if they show only a part of it."""
    found = []
    for visual in link.visuals:
        try:
            shape = load_mesh(visual.file, visual.scale) if visual.file else visual.shape
        except InputError:
            return ()
        if shape is not None:
            found.append(Collision(shape, visual.T_link_visual))
    if not found or np.any(_size(found) < WHOLE * _size(link.collisions)):
        return ()
    return tuple(found)


def _size(solids: Iterable[Collision]) -> NDArray[np.float64]:
    """Return the size (3,) [m] of a link's shapes along the axes of the link."""
    corners = np.vstack([_corners(solid) for solid in solids])
    return corners.max(axis=0) - corners.min(axis=0)


def _corners(solid: Collision) -> NDArray[np.float64]:
    center, half = local_bounds(solid.shape)
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    return solid.T_link_shape.apply(center + half * signs)
