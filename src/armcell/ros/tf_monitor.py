"""A monitor that builds the frame tree from TF messages, like tf2_monitor and view_frames.

It measures the age and rate of each frame and detects faults.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.ros.names import resolve

STALE = 1.0  # [s] a moving frame is stale if its last transform is older
LATE = 1.0  # [s] maximum difference between a transform's stamp and the receiver's clock
UNIT = 1e-3  # tolerance of a quaternion's length from 1
NAMES = 200  # maximum number of frames, so that a publisher of ever new names cannot fill the memory
TOPICS = ("/tf", "/tf_static")


@dataclass
class Frame:
    """TF frame with statistics of the transforms received for it."""

    name: str
    parents: dict[str, float]  # arrival time of the last transform from each parent [s, receiver's clock]
    first: float  # [s]
    last: float  # [s]
    stamp: float  # [s] stamp of the last transform
    count: int = 1
    static: bool = False
    fault: str = ""  # fault in the numbers of the last transform

    @property
    def parent(self) -> str:
        """Return the parent of a TF frame, according to the last transform that was received."""
        return max(self.parents, key=lambda name: self.parents[name])

    @property
    def rate(self) -> float:
        """Return the mean rate [Hz] at which transforms of the TF frame arrive."""
        return (self.count - 1) / (self.last - self.first) if self.last > self.first else 0.0


class TfMonitor:
    """Monitor that collects TF transforms. It reports the tree of frames as text and detects faults in it.

    Args:
        expected: frames that must exist, e.g. the links of a cell.
    """

    def __init__(self, expected: tuple[str, ...] = ()):
        self.frames: dict[str, Frame] = {}
        self._expected = expected
        self._dropped = 0

    def add(self, message: Any, now: float, static: bool = False) -> None:
        """Add a tf2_msgs/TFMessage that was received at the time `now` to the TF monitor.

        Args:
            message: the TFMessage.
            now: arrival time [s] on the clock that the stamps use.
            static: True for messages from /tf_static.
        """
        for transform in message.transforms:
            parent, child = (n.lstrip("/") for n in (transform.header.frame_id, transform.child_frame_id))
            stamp, frame = transform.header.stamp.to_sec(), self.frames.get(child)
            if frame is None and len(self.frames) >= NAMES:
                self._dropped += 1
                continue
            if frame is None:
                frame = self.frames[child] = Frame(child, {}, now, now, stamp, 0)
            frame.parents[parent] = now
            frame.last, frame.stamp, frame.static = now, stamp, static
            frame.count += 1
            frame.fault = _fault(child, parent, transform.transform)

    @property
    def roots(self) -> list[str]:
        """Return the TF frames that have no parent, sorted by name."""
        return sorted({f.parent for f in self.frames.values()} - set(self.frames))

    def lines(self, now: float) -> list[str]:
        """Return the tree of TF frames as text.
        Each line contains one frame, indented by its depth, with its age and rate.
        """
        below: dict[str, list[str]] = {}
        for frame in self.frames.values():
            below.setdefault(frame.parent, []).append(frame.name)
        found: list[str] = []
        for root in self.roots:
            found.append(root)
            found += self._below(root, below, now, 1)
        return found

    def _below(self, parent: str, below: dict[str, list[str]], now: float, depth: int) -> list[str]:
        found = []
        for name in sorted(below.get(parent, ())):
            frame = self.frames[name]
            how = "static" if frame.static else f"{frame.rate:.0f} Hz, {max(now - frame.last, 0.0):.2f} s old"
            found.append(f"{'  ' * depth}{name}  ({how})")
            found += self._below(name, below, now, depth + 1)
        return found

    def faults(self, now: float) -> list[str]:
        """Return a message for each fault in the tree of TF frames. The message names the frame and the
        remedy.
        """
        found = [f.fault for f in self.frames.values() if f.fault]
        for frame in self.frames.values():
            fresh = [p for p, at in frame.parents.items() if frame.last - at <= STALE or frame.static]
            if len(fresh) > 1:
                names = " and ".join(sorted(fresh))
                found.append(f"{frame.name} has two parents: {names}; end one of the publishers")
            if not frame.static and now - frame.last > STALE:
                found.append(f"{frame.name} is stale: no transform for {now - frame.last:.1f} s")
            late = frame.last - frame.stamp
            if not frame.static and abs(late) > LATE:
                word = "old" if late > 0 else "ahead of the clock"
                found.append(
                    f"{frame.name}: its transforms are {abs(late):.1f} s {word} when they come; "
                    "set the computers' clocks alike, and use_sim_time where a simulator publishes /clock"
                )
        found += [f"cycle: {' -> '.join(c)}; its frames have no root" for c in self._cycles()]
        if len(self.roots) > 1:
            parts = ", ".join(self.roots)
            found.append(f"{len(self.roots)} trees, not one: {parts}; publish a transform between them")
        have = set(self.frames) | set(self.roots)
        missing = [name for name in self._expected if name not in have]
        if missing:
            found.append(
                f"the cell's frames {', '.join(missing[:8])} are missing: no publisher tells of them"
            )
        if self._dropped:
            found.append(f"more than {NAMES} frames: the others are left out")
        return found

    def _cycles(self) -> list[list[str]]:
        seen: set[str] = set()
        found = []
        for name in sorted(self.frames):
            path: list[str] = []
            while name in self.frames and name not in seen:
                seen.add(name)
                path.append(name)
                name = self.frames[name].parent
            if name in path:
                found.append([*path[path.index(name) :], name])
        return found


def subscribe_monitor(monitor: TfMonitor, bus: Any) -> list[Any]:
    """Subscribe a TF monitor to the topics /tf and /tf_static of a bus.

    Returns:
        The subscriptions; the caller closes them.
    """

    def taker(static: bool) -> Any:
        return lambda message: monitor.add(message, bus.clock.now(), static)

    names = [(resolve(topic), topic.endswith("static")) for topic in TOPICS]
    return [bus.subscribe(n, "tf2_msgs/TFMessage", taker(static), 100) for n, static in names]


def _fault(child: str, parent: str, transform: Any) -> str:
    t, r = transform.translation, transform.rotation
    values = np.array([t.x, t.y, t.z, r.x, r.y, r.z, r.w], dtype=float)
    if child == parent:
        return f"{child} is its own parent"
    if not np.isfinite(values).all():
        return f"{child} below {parent}: numbers that are not finite"
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1.0) > UNIT:
        return f"{child} below {parent}: its quaternion has the length {length:.3f}, not 1"
    return ""
