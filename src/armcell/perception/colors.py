"""Color names for camera images, robust against lighting, and a color distance."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import float_array

HUES = {"red": 0, "orange": 30, "yellow": 58, "green": 120, "cyan": 180, "blue": 225, "purple": 285}
"""Hue angles of the named colors [degrees]."""
PALE = 0.25  # HSV saturation below which a color is black, grey or white
DARK, BRIGHT = 0.2, 0.75  # HSV value limits of black and white


def color_name(rgb: Sequence[float]) -> str:
    """Return the name of the color nearest to an RGB color in 0..1.
    It is a color in `HUES`, or black, grey or white.
    """
    hue, saturation, value = colorsys.rgb_to_hsv(*_rgb(rgb).tolist())
    if value < DARK:
        return "black"
    if saturation < PALE:
        return "white" if value > BRIGHT else "grey"
    return min(HUES, key=lambda name: abs((360 * hue - HUES[name] + 180) % 360 - 180))


def _rgb(color: Sequence[float]) -> NDArray[np.float64]:
    return float_array(color, None, "a color").ravel()[:3]


def color_distance(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the distance between two colors, a number from 0 to 1 that does not depend on the brightness of
    the colors.

    The distance is half the sum of the differences of their red, green and blue fractions. Brightness is left
    out because it depends on the lighting.
    """
    shares = [c / max(float(sum(c)), 1e-6) for c in (_rgb(a), _rgb(b))]
    return float(np.abs(shares[0] - shares[1]).sum() / 2)
