"""MuJoCo models (MJCF) as robot models: links, joints, couplings, and the source text for physics."""

from armcell.model.mjcf.reader import load_mjcf

__all__ = ["load_mjcf"]
