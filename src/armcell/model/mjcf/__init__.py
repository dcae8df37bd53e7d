"""Conversion of MuJoCo models (MJCF) to robot models, with the MJCF text for physics."""

from armcell.model.mjcf.files import MjcfText, read_mjcf
from armcell.model.mjcf.reader import load_mjcf, parse_mjcf

__all__ = ["MjcfText", "load_mjcf", "parse_mjcf", "read_mjcf"]
