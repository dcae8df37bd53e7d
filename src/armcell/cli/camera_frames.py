"""`armcell run --frames CAMERA`: record the pictures of a simulated camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from armcell.core import Event, InputError, JointTrajectory, StateSample, UnknownNameError

RATE = 5.0  # [Hz] of the cell's clock


def camera_frames(wanted: Sequence[str], live: Any, mode: str, recorder: Any) -> list[CameraFrames]:
    """Return the observers that record camera frames of a run, as requested by `armcell run --frames`.

    Args:
        wanted: CAMERA or CAMERA=HZ, each.
    Raises:
        InputError: the run has no physics or no record, or a rate is invalid.
        UnknownNameError: a camera does not exist.
    """
    if recorder is None or mode != "sim":
        raise InputError("--frames needs physics and a record", hint="mode sim, and no --headless")
    known = live.cameras
    found = []
    for each in wanted:
        name, _, rate = each.partition("=")
        if name not in known:
            raise UnknownNameError("camera", name, known)
        try:
            hertz = float(rate or RATE)
        except ValueError:
            hertz = 0.0
        if not 0 < hertz <= 100:
            raise InputError(
                f"--frames {each}: {rate!r} is no rate", hint="a number of Hz up to 100: overview=10"
            )
        found.append(CameraFrames(live.driver, known[name], hertz, recorder))
    return found


class CameraFrames:
    """Observer that records frames of a camera for `armcell run --frames`, at a fixed rate [Hz] on the cell's
    clock.
    """

    def __init__(self, driver: Any, camera: Any, rate: float, recorder: Any):
        self._driver, self._camera, self._period, self._recorder = driver, camera, 1.0 / rate, recorder
        self._due = 0.0

    def on_state(self, sample: StateSample) -> None:
        if sample.time < self._due - 1e-9:
            return
        self._due = sample.time + self._period
        if self._driver.is_paced:  # asynchronous: a step must not wait for a picture
            self._camera.ask("frames", self._keep, depth=False)
        else:
            self._keep(self._camera.draw(depth=False))

    def _keep(self, image: Any) -> None:
        self._recorder.add_frame(image.time, image.camera, image.rgb)

    def on_event(self, event: Event) -> None:
        pass

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass
