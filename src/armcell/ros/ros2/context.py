"""Shared state of all parts of the ROS 2 bridge: bus, DDS participant, workers, error log."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from armcell.ros.bus import Bus
from armcell.ros.faults import FaultCounter
from armcell.ros.ros2.codec import Ros2Codec
from armcell.ros.ros2.dds import Participant, Reader, Sample, Writer
from armcell.ros.ros2.domain_scope import DomainScope
from armcell.ros.ros2.graph import Announcer, Graph
from armcell.ros.ros2.names import DdsName
from armcell.ros.ros2.qos import QosProfile

logger = logging.getLogger(__name__)
WORKERS = 8  # service calls that are answered in parallel
MAX_CALLS = 64  # service calls that wait or run
MAX_COMPLAINTS = 200  # different kinds of errors that are logged


class Context:
    """Objects that all parts of a ROS 2 bridge share: the bus, the DDS participant and the worker threads.
    The bridge closes them.

    Raises:
        MissingExtraError: cyclonedds is not installed.
        InputError, DdsError: the participant cannot join the domain.
    """

    def __init__(self, bus: Bus, codec: Ros2Codec, reach: DomainScope, node: str):
        self.bus, self.codec = bus, codec
        self.participant = Participant(reach, codec)
        self.graph = Graph(self.participant, codec)
        self.announcer = Announcer(self.participant, codec, node)
        self.complaints = FaultCounter(MAX_COMPLAINTS)
        self.dropped = 0
        self._lock = threading.Lock()
        self._calls = 0
        self._clients = 0
        self._workers = ThreadPoolExecutor(WORKERS, "ros2 service")

    def close(self) -> None:
        self._workers.shutdown(wait=False, cancel_futures=True)
        self.participant.close()

    @property
    def closed(self) -> bool:
        return self.participant.closed

    def complain(self, kind: str, text: str) -> None:
        """Count an error of the ROS 2 bridge. Only the first error of each kind is logged."""
        if self.complaints.count(kind):
            logger.warning("%s", text[:400])

    def has_dropped(self) -> None:
        with self._lock:
            self.dropped += 1

    # --- endpoints that belong to this bridge's node ---
    def writer(self, name: DdsName, profile: QosProfile, user_data: str = "", wait: bool = False) -> Writer:
        writer = self.participant.writer(name, profile, user_data.encode(), wait)
        self.announcer.add(writer.guid, True)
        return writer

    def reader(
        self, name: DdsName, profile: QosProfile, on_sample: Callable[[Sample], None], user_data: str = ""
    ) -> Reader:
        reader = self.participant.reader(name, profile, on_sample, user_data.encode())
        self.announcer.add(reader.guid, False)
        return reader

    def drop(self, *endpoints: Writer | Reader) -> None:
        for endpoint in endpoints:
            self.announcer.remove(endpoint.guid)
            endpoint.close()

    def service_id(self) -> str:
        """Return a new id for a service client or server of the ROS 2 bridge.

        Both endpoints (reader and writer) of the client or server carry the id.
        """
        with self._lock:
            self._clients += 1
            number = self._clients
        data = self.participant.guid[:12] + number.to_bytes(4, "big")
        return ".".join(f"{byte:x}" for byte in data)

    # --- work that may take long ---
    def run_in_pool(self, run: Callable[..., Any], *arguments: Any) -> bool:
        """Run a function in the worker pool of the ROS 2 bridge. Return False if too many calls are
        waiting.
        """
        with self._lock:
            if self._calls >= MAX_CALLS:
                return False
            self._calls += 1
        try:
            self._workers.submit(self._run, run, arguments)
        except RuntimeError:  # the pool is shut down
            with self._lock:
                self._calls -= 1
            return False
        return True

    def _run(self, run: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        try:
            run(*arguments)
        except Exception:
            logger.exception("a ROS 2 service failed")
        finally:
            with self._lock:
                self._calls -= 1
