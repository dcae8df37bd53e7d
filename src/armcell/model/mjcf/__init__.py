"""Conversion of MuJoCo models (MJCF) to robot models, with the MJCF text for physics."""

from armcell.model.mjcf.reader import load_mjcf

__all__ = ["load_mjcf"]
