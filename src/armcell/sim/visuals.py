"""Loading of a link's visual meshes, one mesh per color."""

from __future__ import annotations

import logging

from armcell.core import InputError, Mesh
from armcell.model import Visual
from armcell.model.assets import Color, load_visual_parts

log = logging.getLogger(__name__)


def visual_parts(visual: Visual) -> tuple[tuple[Mesh, Color], ...]:
    """Load the meshes [m, visual frame] of a link's visual element, with their RGBA colors, for the
    simulation.

    A mesh file that cannot be read is logged and yields no meshes: an image without one link is better than
    no run.
    """
    if visual.file is None:
        return ()
    try:
        parts = load_visual_parts(visual.file, visual.scale)
    except InputError as error:
        log.warning("visual mesh is not drawn: %s", error)
        return ()
    return parts if visual.color is None else tuple((mesh, visual.color) for mesh, _ in parts)
