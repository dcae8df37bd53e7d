"""Visual meshes, one per colour."""

from __future__ import annotations

import logging

from armcell.core import InputError, Mesh
from armcell.model import Visual
from armcell.model.assets import Color, load_visual_parts

log = logging.getLogger(__name__)


def visual_parts(visual: Visual) -> tuple[tuple[Mesh, Color], ...]:
    """The meshes [m, visual frame] and RGBA colours of a visual mesh file; none if it cannot be read.

    A picture without one link is better than no run at all, so a broken file is logged, not raised.
    """
    if visual.file is None:
        return ()
    try:
        parts = load_visual_parts(visual.file, visual.scale)
    except InputError as error:
        log.warning("visual mesh is not drawn: %s", error)
        return ()
    return parts if visual.color is None else tuple((mesh, visual.color) for mesh, _ in parts)
