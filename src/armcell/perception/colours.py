"""What colour is it? Names for what a camera sees, whatever the light, and how unlike two colours are."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import float_array

HUES = {"red": 0, "orange": 30, "yellow": 58, "green": 120, "cyan": 180, "blue": 225, "purple": 285}
"""Where the named colours lie on the colour circle [degrees]."""
PALE = 0.25  # saturation of HSV below which a thing has no colour, only a brightness
DARK, BRIGHT = 0.2, 0.75  # brightness of black and white


def colour_name(rgb: Sequence[float]) -> str:
    """The nearest of `HUES`, or black, grey or white, of a colour with parts from 0 to 1."""
    hue, saturation, value = colorsys.rgb_to_hsv(*_rgb(rgb).tolist())
    if value < DARK:
        return "black"
    if saturation < PALE:
        return "white" if value > BRIGHT else "grey"
    return min(HUES, key=lambda name: abs((360 * hue - HUES[name] + 180) % 360 - 180))


def _rgb(color: Sequence[float]) -> NDArray[np.float64]:
    return float_array(color, None, "a color").ravel()[:3]


def colour_distance(a: Sequence[float], b: Sequence[float]) -> float:
    """How unlike two colours are, 0 to 1, with their brightness left out: that is the light's as well.

    Half the sum of what their shares of red, green and blue differ by.
    """
    shares = [c / max(float(sum(c)), 1e-6) for c in (_rgb(a), _rgb(b))]
    return float(np.abs(shares[0] - shares[1]).sum() / 2)
