"""Checks of camera images before use: age and depth."""

from __future__ import annotations

import numpy as np

from armcell.core import CameraImage, ErrorCode, Outcome


def check_image_age(image: CameraImage, max_age: float, now: float | None) -> Outcome | None:
    """Check the age of a camera image: return an error outcome if the image is older than `max_age` [s] and
    must not be used. Otherwise return None.
    """
    if now is None or now - image.time <= max_age:
        return None
    age = now - image.time
    return Outcome(
        ErrorCode.SENSOR_INFO_STALE,
        f"camera {image.camera!r}: the newest picture is {age:.2f} s old, more than {max_age:g} s "
        "(is the camera frozen? restart it, or raise max_age)",
        {"age_s": age},
    )


def check_image(image: CameraImage, max_age: float, now: float | None) -> Outcome | None:
    """Check whether a camera image can be used: return an error outcome if it is too old or has no depth.
    Otherwise return None.
    """
    old = check_image_age(image, max_age, now)
    if old is not None:
        return old
    name = f"camera {image.camera!r}"
    if image.depth is None:
        return Outcome(
            ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA,
            f"{name} has no depth (use an RGB-D camera: 'depth: true' in the cell file)",
        )
    with np.errstate(invalid="ignore"):
        share = float(np.mean(np.isfinite(image.depth) & (image.depth > 0)))
    if share < 0.01:
        what = "no pixel" if share == 0 else f"only {share:.1%} of the pixels"
        return Outcome(
            ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA,
            f"{name}: {what} has a depth (is the lens covered, or everything nearer or farther than it "
            "measures?)",
            {"share": share},
        )
    return None
