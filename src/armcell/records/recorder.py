"""`RunRecorder`: observer that records a run to MCAP, and in memory for the report."""

from __future__ import annotations

import contextlib
import io
import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell._interrupts import SteadyLock, last_will
from armcell.core import Event, InputError, JointState, JointTrajectory, StateSample
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

MCAP_FILE = "run.mcap"
MAX_RATE_HZ = 100.0
"""Maximum sampling rate by the cell's clock; further samples are skipped, the last one is kept."""
MOST_SAMPLES = 60_000
"""Maximum samples in memory for the report (10 minutes); beyond it, every other sample is dropped."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture of a key moment of a run, kept by the run recorder: an RGB image (h, w, 3) uint8 with its time
    and title.
    """

    time: float  # [s]
    title: str
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Series:
    """Values sampled during a run, kept by the run recorder as arrays over time. Unknown values are NaN."""

    times: Array  # (n,) [s]
    joint_names: tuple[str, ...]  # the model's order
    positions: Array  # (n, dof) [rad or m]
    velocities: Array  # (n, dof) [rad/s or m/s]
    efforts: Array  # (n, dof) [Nm or N]
    gripper_width: dict[str, Array]  # (n,) [m]
    gripper_force: dict[str, Array]  # (n,) [N] per finger
    object_positions: dict[str, Array]  # (n, 3) [m], in the world frame
    object_quats_wxyz: dict[str, Array]  # (n, 4)

    @property
    def object_heights(self) -> dict[str, Array]:
        """Return the height (world z) of each object's origin (n,) [m] at the samples of the run recorder, by
        object name.
        """
        return {name: xyz[:, 2] for name, xyz in self.object_positions.items()}


def new_run_folder(root: Path, cell: str, now: datetime | None = None) -> Path:
    """Create the folder `root/<YYYYmmdd-HHMMSS>-<cell>/` for the recorder of a new run. If it already exists,
    append the suffix "-2".

    Args:
        root: usually "runs"; created if missing.
        cell: the cell's name or path; only the last path component is used.
    """
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(cell).stem).strip("._") or "run"
    base = f"{now or datetime.now():%Y%m%d-%H%M%S}-{stem}"
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot be made: {error.strerror}", file=root, hint="choose another --runs folder"
        ) from None
    for count in range(1, 10_000):
        folder = root / (base if count == 1 else f"{base}-{count}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        except OSError as error:
            raise InputError(f"cannot be written to: {error.strerror}", file=root) from None
        return folder
    raise InputError(f"no free folder name for {base}", file=root)


class RunRecorder:
    """Observer that records a run: it writes `run.mcap` into a folder and keeps the data for the report.

    The MCAP file has a temporary name until `close`. Leaving the `with` block closes it, also after an error.
    If an error occurs before the first state, the folder is removed.

    Args:
        folder: the run's folder (`new_run_folder`); created if missing.
        scene: scene with the recorded robot and objects.
        start_ns: time of cell time 0 in the MCAP, in nanoseconds since 1970; now by default.
        metadata: see `run_metadata`; without it, the record can be viewed but not executed again.
    Raises:
        InputError: the record cannot be created; raised before the robot moves.
    """

    def __init__(
        self,
        folder: Path,
        scene: PlanningScene,
        start_ns: int | None = None,
        metadata: Mapping[str, Any] | None = None,
    ):
        from armcell.records.mcap_writer import McapWriter

        self.folder = Path(folder)
        self.scene = scene
        self.events: list[Event] = []
        self.trajectories: list[tuple[float, JointTrajectory]] = []
        self.pictures: list[Picture] = []
        self._samples: list[StateSample] = []
        self._count, self._every = 0, 1  # samples on disk; every n-th stays in memory
        self._last: StateSample | None = None  # last sample on disk
        self._skipped: StateSample | None = None  # newest sample, if it was skipped
        self._due = -np.inf
        self._q = np.array(scene.positions)
        self._column = {name: i for i, name in enumerate(scene.model.joint_names)}
        self._lock = SteadyLock()  # an interrupt must not leave an incomplete message
        self._closed = False
        self._broken: OSError | None = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._mcap = McapWriter(self.folder / MCAP_FILE, scene, start_ns, metadata)
        except OSError as error:
            raise InputError(
                f"no record can be begun: {error.strerror}", file=self.folder,
                hint="make room, or choose another folder (--runs)",
            ) from None  # fmt: skip
        self._revoke = last_will(self.close)

    @property
    def mcap_file(self) -> Path:
        """Return the path that the MCAP file of the run recorder has after `close`."""
        return self._mcap.file

    # --- Observer ---
    def on_state(self, sample: StateSample) -> None:
        with self._lock:
            if self._closed:
                return
            if sample.time < self._due - 1e-9 and not self._clock_set_back(sample.time):
                self._skipped = sample
                return
            self._keep(sample)

    def on_event(self, event: Event) -> None:
        with self._lock:
            self.events.append(event)
            self._keep_on_disk(lambda: self._mcap.write_event(event))

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        with self._lock:
            self.trajectories.append((time, trajectory))
            self._keep_on_disk(lambda: self._mcap.write_trajectory(time, trajectory))

    # --- additions ---
    def add_picture(self, time: float, title: str, rgb: NDArray[np.uint8]) -> None:
        """Add an image `rgb` (h, w, 3) uint8 of a key moment to the run recorder, for use in the report."""
        image = np.asarray(rgb)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
            raise InputError(
                f"picture {title!r} has shape {image.shape} of {image.dtype}, need (h, w, 3) of uint8"
            )
        with self._lock:
            self.pictures.append(Picture(time, title, image.copy()))

    def add_frame(self, time: float, camera: str, rgb: NDArray[np.uint8]) -> None:
        """Write a camera image `rgb` (h, w, 3) uint8 to the MCAP file of the run recorder."""
        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(rgb).save(file, format="png", compress_level=3)
        with self._lock:
            self._keep_on_disk(lambda: self._mcap.write_image(camera, time, file.getvalue()))

    def finish(self, result: Mapping[str, Any]) -> None:
        """Write the result of the run and close the run recorder."""
        with self._lock:
            self._keep_last()
            self._keep_on_disk(lambda: self._mcap.write_result(result))
        self.close()

    def series(self) -> Series:
        """Return the samples that the run recorder keeps.
        If there are more than `MOST_SAMPLES`, return an evenly thinned subset.
        """
        with self._lock:
            samples, newest = list(self._samples), self._skipped or self._last
        if newest is not None and newest is not samples[-1]:
            samples.append(newest)
        return _series(self.scene.model.joint_names, samples)

    def close(self) -> None:
        """Close the run recorder: write the last sample and finish the MCAP file. Repeated calls have no
        effect.
        """
        with self._lock:
            if self._closed:
                return
            self._keep_last()
            self._keep_on_disk(self._mcap.close)
            self._closed = True
        self._revoke()

    def __enter__(self) -> RunRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close()
        if kind is not None and self._last is None:  # the run did not begin: remove its files
            with contextlib.suppress(OSError):
                for file in (self.mcap_file, self.mcap_file.with_name(self.mcap_file.name + ".part")):
                    file.unlink(missing_ok=True)
                self.folder.rmdir()

    # --- how ---
    def _keep_last(self) -> None:
        if self._skipped is not None and not self._closed:
            self._keep(self._skipped)

    def _keep_on_disk(self, write: Callable[[], None]) -> None:
        """Call a function with which the run recorder writes to disk. A disk error ends the recording but not
        the run.

        A real arm may be moving when the error occurs.
        """
        if self._closed or self._broken is not None:
            return
        try:
            write()
        except OSError as error:
            self._broken = error
            logger.error("the record %s ends here: %s", self._mcap.file, error.strerror)

    def _clock_set_back(self, time: float) -> bool:
        return self._last is not None and time < self._last.time - 1 / MAX_RATE_HZ

    def _keep(self, sample: StateSample) -> None:
        if self._count % self._every == 0:
            self._samples.append(sample)
        self._count += 1
        if len(self._samples) > MOST_SAMPLES:
            del self._samples[1::2]
            self._every *= 2
        self._last, self._skipped = sample, None
        # Advance by whole periods, so that the rate does not depend on the physics time step.
        late = not 0 <= sample.time - self._due < 1 / MAX_RATE_HZ
        self._due = (sample.time if late else self._due) + 1 / MAX_RATE_HZ
        for name, value in zip(sample.joints.joint_names, sample.joints.positions, strict=True):
            if name in self._column:
                self._q[self._column[name]] = value
        self._keep_on_disk(lambda: self._mcap.write_state(sample, self._q))


def _series(joint_names: tuple[str, ...], samples: list[StateSample]) -> Series:
    def column(values: Any, size: int) -> Array:
        missing = np.full(size, np.nan)
        return np.array([missing if v is None else v for v in values]).reshape(len(samples), size)

    def joints(kind: str) -> Array:
        return column((_in_order(joint_names, s.joints, kind) for s in samples), len(joint_names))

    def by_name(kind: str) -> dict[str, Array]:
        names = dict.fromkeys(name for s in samples for name in getattr(s, kind))
        return {n: np.array([getattr(s, kind).get(n, np.nan) for s in samples], dtype=float) for n in names}

    objects = dict.fromkeys(name for s in samples for name in s.object_poses)
    poses = {n: [s.object_poses.get(n) for s in samples] for n in objects}
    return Series(
        times=np.array([s.time for s in samples], dtype=float),
        joint_names=joint_names,
        positions=joints("positions"),
        velocities=joints("velocities"),
        efforts=joints("efforts"),
        gripper_width=by_name("gripper_width"),
        gripper_force=by_name("gripper_force"),
        object_positions={n: column((T and T.translation for T in Ts), 3) for n, Ts in poses.items()},
        object_quats_wxyz={n: column((T and T.quat_wxyz for T in Ts), 4) for n, Ts in poses.items()},
    )


def _in_order(joint_names: tuple[str, ...], state: JointState, kind: str) -> Array | None:
    """Return one kind of values, such as positions, from a joint state that the run recorder has sampled. The
    values are in the given joint order; missing joints get NaN.
    """
    values = getattr(state, kind)
    if values is None or state.joint_names == joint_names:
        return values
    known = dict(zip(state.joint_names, values, strict=True))
    return np.array([known.get(name, np.nan) for name in joint_names])
