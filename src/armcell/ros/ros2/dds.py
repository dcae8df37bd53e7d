"""Cyclone DDS for serialized samples: participant, writers and readers.

armcell's codec encodes the messages, and the library transports them. The `cyclonedds` Python package needs
type descriptions, which `codec.py` generates from armcell's definitions; the package's own, slower encoder is
not used. Writing calls the C library directly through ctypes, which releases the GIL (the package's own calls
do not).
"""

from __future__ import annotations

import contextlib
import ctypes as ct
import itertools
import logging
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

from armcell.core import ArmcellError, InputError, MissingExtraError
from armcell.core.network_endpoints import open_sockets
from armcell.ros.ros2.codec import Ros2Codec, Types
from armcell.ros.ros2.domain_scope import DomainScope
from armcell.ros.ros2.names import DdsName
from armcell.ros.ros2.qos import QosProfile, to_dds_qos

logger = logging.getLogger(__name__)
BATCH = 64  # samples per take
ANY_STATE = 3 | 12 | 112  # sample, view and instance states
SHUT_DOWN = 5.0  # [s]
NEVER = (1 << 63) - 1
TIMEOUT = -10  # DDS_RETCODE_TIMEOUT
OFFERED_INCOMPATIBLE, REQUESTED_INCOMPATIBLE = (
    "dds_get_offered_incompatible_qos_status",
    "dds_get_requested_incompatible_qos_status",
)


class DdsError(ArmcellError):
    """Error reported by the Cyclone DDS library."""


class _Sample(ct.Structure):
    """C struct through which cyclonedds reads and writes serialized data: a pointer to the bytes of a sample,
    and their number.
    """

    _fields_ = [("data", ct.c_void_p), ("size", ct.c_size_t)]


class _QosStatus(ct.Structure):
    _fields_ = [("total", ct.c_uint32), ("change", ct.c_int32), ("policy", ct.c_uint32)]


def _prototypes() -> dict[str, tuple[Any, tuple[Any, ...]]]:
    entity, pointer, number = ct.c_int32, ct.c_void_p, ct.c_int32
    return {
        "dds_create_domain": (entity, (ct.c_uint32, ct.c_char_p)),
        "dds_create_participant": (entity, (ct.c_uint32, pointer, pointer)),
        "dds_create_writer": (entity, (entity, entity, pointer, pointer)),
        "dds_create_reader": (entity, (entity, entity, pointer, pointer)),
        "dds_create_readcondition": (entity, (entity, ct.c_uint32)),
        "dds_create_waitset": (entity, (entity,)),
        "dds_waitset_attach": (number, (entity, entity, ct.c_ssize_t)),
        "dds_waitset_detach": (number, (entity, entity)),
        "dds_waitset_set_trigger": (number, (entity, ct.c_bool)),
        "dds_waitset_wait": (number, (entity, ct.POINTER(ct.c_ssize_t), ct.c_size_t, ct.c_int64)),
        "dds_write": (number, (entity, ct.POINTER(_Sample))),
        "dds_delete": (number, (entity,)),
        "dds_get_guid": (number, (entity, ct.c_char_p)),
        "dds_get_instance_handle": (number, (entity, ct.POINTER(ct.c_uint64))),
        "dds_get_matched_subscriptions": (number, (entity, ct.POINTER(ct.c_uint64), ct.c_size_t)),
        "dds_get_matched_publications": (number, (entity, ct.POINTER(ct.c_uint64), ct.c_size_t)),
        OFFERED_INCOMPATIBLE: (number, (entity, ct.POINTER(_QosStatus))),
        REQUESTED_INCOMPATIBLE: (number, (entity, ct.POINTER(_QosStatus))),
        "dds_strretcode": (ct.c_char_p, (number,)),
    }


@cache
def library() -> SimpleNamespace:
    """Load the C functions that armcell uses from Cyclone DDS and its Python package.

    Raises:
        MissingExtraError: cyclonedds is not installed.
    """
    try:
        from cyclonedds import _clayer, builtin  # pyright: ignore[reportAttributeAccessIssue]
        from cyclonedds.internal import DDS
        from cyclonedds.qos import _CQos
    except ImportError:
        raise MissingExtraError("cyclonedds", "ros2") from None
    found = SimpleNamespace(c=_clayer, cqos=_CQos, builtin=builtin)
    for name, (result, arguments) in _prototypes().items():
        function = DDS._dll_handle[name]
        function.restype, function.argtypes = result, arguments
        setattr(found, name, function)
    return found


def check(result: int, what: str) -> int:
    """Check a return value of the Cyclone DDS library.
    Raise an exception if the value is an error code; otherwise return it.

    Raises:
        DdsError: the result is an error code.
    """
    if result < 0:
        raise DdsError(f"{what}: {library().dds_strretcode(-result).decode()}")
    return result


class Sample(NamedTuple):
    """Received DDS sample in serialized form."""

    data: bytes
    writer: int  # instance handle of the publication
    timestamp: int  # [ns] time of writing, by the sender's clock


class _Domains:
    """DDS domains that this process has joined with Cyclone DDS.

    Each domain has one configuration and ends with its last participant.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._domains: dict[int, tuple[int, str]] = {}
        self._users: Counter[int] = Counter()

    def enter(self, reach: DomainScope) -> None:
        dds, xml = library(), reach.xml()
        with self._lock:
            have = self._domains.get(reach.domain)
            if have is None:
                handle = dds.dds_create_domain(reach.domain, xml.encode())
                self._domains[reach.domain] = (check(handle, f"domain {reach.domain}"), xml)
            elif have[1] != xml:
                raise InputError(f"this process has joined domain {reach.domain} with another reach already")
            self._users[reach.domain] += 1

    def leave(self, domain: int) -> None:
        with self._lock:
            self._users[domain] -= 1
            if not self._users[domain]:
                library().dds_delete(self._domains.pop(domain)[0])


_DOMAINS = _Domains()


class Participant:
    """Participant in a DDS domain. A single thread reads the data for all its readers.

    Attributes:
        endpoints: sockets that joining the domain opened; empty if the system does not report them, and for
            a second participant of the domain, which shares the sockets of the first.

    Raises:
        MissingExtraError: cyclonedds is not installed.
        InputError, DdsError: the participant cannot join the domain.
    """

    def __init__(self, reach: DomainScope, codec: Ros2Codec, enclave: str = "/"):
        self._dds = library()
        self.reach, self.codec = reach, codec
        self._types = Types(codec)
        self.closed = False
        self._topics: dict[DdsName, int] = {}
        self._takers: dict[int, Callable[[], None]] = {}
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        before = open_sockets()
        _DOMAINS.enter(reach)
        try:
            with self._qos(QosProfile(), f"enclave={enclave};".encode(), bare=True) as qos:
                made = self._dds.dds_create_participant(reach.domain, qos, None)
            self.handle = check(made, "participant")
            self._waitset = check(self._dds.dds_create_waitset(self.handle), "waitset")
            check(self._dds.dds_waitset_attach(self._waitset, self._waitset, 0), "waitset")
        except DdsError:
            _DOMAINS.leave(reach.domain)
            raise
        self.endpoints = tuple(
            replace(found, service=f"DDS domain {reach.domain}") for found in sorted(open_sockets() - before)
        )
        self._thread = threading.Thread(target=self._read, name="ros2 read", daemon=True)
        self._thread.start()

    @property
    def guid(self) -> bytes:
        return self.guid_of(self.handle)

    def guid_of(self, handle: int) -> bytes:
        """Return the 16-byte GUID that identifies a DDS entity on the network."""
        found = ct.create_string_buffer(16)
        check(self._dds.dds_get_guid(handle, found), "guid")
        return found.raw

    def close(self) -> None:
        """Leave the DDS domain. The callback of a reader must not call this method."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
        self._dds.dds_waitset_set_trigger(self._waitset, True)
        self._thread.join(SHUT_DOWN)
        self._dds.dds_delete(self.handle)
        _DOMAINS.leave(self.reach.domain)

    # --- endpoints ---
    def writer(
        self, name: DdsName, profile: QosProfile, user_data: bytes = b"", wait: bool = False
    ) -> Writer:
        with self._qos(profile, user_data + self._type_hash(name), wait=wait) as qos:
            made = self._dds.dds_create_writer(self.handle, self._topic(name), qos, None)
        return Writer(self, name, check(made, f"writer of {name.topic}"))

    def reader(
        self,
        name: DdsName,
        profile: QosProfile,
        on_sample: Callable[[Sample], None],
        user_data: bytes = b"",
        ignore_own: bool = True,
    ) -> Reader:
        """Create a Cyclone DDS reader for a topic.

        Args:
            on_sample: called with each sample, in order of arrival, in the participant's reading thread.
            ignore_own: ignore samples that this participant writes.
        """
        with self._qos(profile, user_data + self._type_hash(name), ignore_own) as qos:
            made = self._dds.dds_create_reader(self.handle, self._topic(name), qos, None)
        handle = check(made, f"reader of {name.topic}")
        return Reader(self, name, handle, self._watch(handle, lambda: self._take(handle, on_sample)))

    def watch_endpoints(self, publications: bool, on_endpoint: Callable[[Any], None]) -> Reader:
        """Call a function for every DDS endpoint that joins or leaves the domain.

        Args:
            publications: True reports writers, False readers.
            on_endpoint: called with each `cyclonedds` DcpsEndpoint.
        """
        builtin = self._dds.builtin
        topic = builtin.BuiltinTopicDcpsPublication if publications else builtin.BuiltinTopicDcpsSubscription
        handle = check(self._dds.dds_create_reader(self.handle, topic._ref, None, None), "discovery")

        def take() -> None:
            while found := self._dds.c.ddspy_take_endpoint(
                handle, BATCH, builtin.endpoint_constructor, builtin.cqos_to_qos
            ):
                if isinstance(found, int):
                    return
                for endpoint in found:
                    on_endpoint(endpoint)

        return Reader(self, DdsName("", "", ""), handle, self._watch(handle, take))

    def _type_hash(self, name: DdsName) -> bytes:
        """Return the DDS user data with which a writer or reader announces the type hash (REP 2016) of its
        topic.

        rmw warns about every DDS endpoint without a type hash.
        """
        found = self.codec.type_hash(name.message)
        return f"typehash={found};".encode() if found else b""

    @contextlib.contextmanager
    def _qos(
        self, profile: QosProfile, user_data: bytes, ignore: bool = False, wait: bool = False, bare=False
    ):
        from cyclonedds.qos import Policy, Qos

        made = Qos(Policy.Userdata(user_data)) if bare else to_dds_qos(profile, user_data, ignore, wait)
        qos = self._dds.cqos.qos_to_cqos(made)
        try:
            yield qos
        finally:
            self._dds.cqos.cqos_destroy(qos)

    def _topic(self, name: DdsName) -> int:
        with self._lock:
            if name not in self._topics:
                made = self._dds.c.ddspy_topic_create(
                    self.handle, name.topic, self._types.of(name), None, None
                )
                self._topics[name] = check(made, f"topic {name.topic} of type {name.type}")
            return self._topics[name]

    def delete(self, handle: int) -> None:
        if not self.closed:
            self._dds.dds_delete(handle)

    # --- reading ---
    def _watch(self, reader: int, take: Callable[[], None]) -> int:
        """Call `take` whenever a DDS reader has data. Return an id, which `forget` requires."""
        condition = check(self._dds.dds_create_readcondition(reader, ANY_STATE), "condition")
        with self._lock:
            number = next(self._numbers)
            self._takers[number] = take
        check(self._dds.dds_waitset_attach(self._waitset, condition, number), "waitset")
        return number

    def forget(self, number: int) -> None:
        with self._lock:
            self._takers.pop(number, None)

    def _take(self, handle: int, on_sample: Callable[[Sample], None]) -> None:
        while isinstance(found := self._dds.c.ddspy_take(handle, ANY_STATE, BATCH), list) and found:
            for data, info in found:
                if info.valid_data:
                    on_sample(Sample(data, info.publication_handle, info.source_timestamp))
            if len(found) < BATCH:
                return

    def _read(self) -> None:
        triggered = (ct.c_ssize_t * BATCH)()
        while not self.closed:
            count = self._dds.dds_waitset_wait(self._waitset, triggered, BATCH, NEVER)
            if count < 0:
                return
            for number in list(triggered[: min(count, BATCH)]):
                take = self._takers.get(number)
                if take is None:
                    continue
                try:
                    take()
                except Exception:
                    logger.exception("a ROS 2 reader failed")


class _Endpoint:
    def __init__(self, participant: Participant, name: DdsName, handle: int):
        self._participant, self.name, self.handle = participant, name, handle
        self._dds = library()
        self.guid = participant.guid_of(handle)
        self._incompatible = 0

    @property
    def instance(self) -> int:
        """Return the handle that identifies the DDS endpoint within this process."""
        found = ct.c_uint64()
        check(self._dds.dds_get_instance_handle(self.handle, ct.byref(found)), "handle")
        return found.value

    def _matched(self, function: Any) -> list[int]:
        handles = (ct.c_uint64 * BATCH)()
        count = function(self.handle, handles, BATCH)
        return list(handles[: max(min(count, BATCH), 0)])

    def newly_incompatible(self, function: str) -> bool:
        """Return whether Cyclone DDS has reported a peer with incompatible QoS for this reader or writer
        since the last call.
        """
        status = _QosStatus()
        if getattr(self._dds, function)(self.handle, ct.byref(status)) < 0:
            return False
        before, self._incompatible = self._incompatible, status.total
        return status.total > before

    def close(self) -> None:
        self._participant.delete(self.handle)


class Writer(_Endpoint):
    """Cyclone DDS writer for serialized samples."""

    def write(self, data: bytes | bytearray | memoryview) -> bool:
        """Write a serialized DDS sample. Return False if the queue of the writer is full.

        Args:
            data: bytes of the sample, including CDR's 4-byte header.
        Raises:
            DdsError: the library reported another error.
        """
        size = len(data)
        padded = (ct.c_char * (size + -size % 4))()
        memoryview(padded).cast("B")[:size] = data
        sample = _Sample(ct.addressof(padded), len(padded))
        result = self._dds.dds_write(self.handle, ct.byref(sample))
        if result == TIMEOUT:
            return False
        check(result, f"writing to {self.name.topic}")
        return True

    def readers(self) -> list[int]:
        """Return the handles of the DDS readers that receive samples from this writer."""
        return self._matched(self._dds.dds_get_matched_subscriptions)

    def reader_qos(self, handle: int) -> Any:
        """Return the QoS of a DDS reader that is matched to this writer,
        or None if the reader no longer exists.
        """
        builtin = self._dds.builtin
        found = self._dds.c.ddspy_get_matched_subscription_data(
            self.handle, handle, builtin.endpoint_constructor, builtin.cqos_to_qos
        )
        return getattr(found, "qos", None)


class Reader(_Endpoint):
    """Cyclone DDS reader that passes samples to a callback until `close`."""

    def __init__(self, participant: Participant, name: DdsName, handle: int, number: int):
        super().__init__(participant, name, handle)
        self._number = number

    def writers(self) -> list[int]:
        """Return the handles of the DDS writers whose samples this reader receives."""
        return self._matched(self._dds.dds_get_matched_publications)

    def writer_qos(self, handle: int) -> Any:
        """Return the QoS of a DDS writer that is matched to this reader,
        or None if the writer no longer exists.
        """
        builtin = self._dds.builtin
        found = self._dds.c.ddspy_get_matched_publication_data(
            self.handle, handle, builtin.endpoint_constructor, builtin.cqos_to_qos
        )
        return getattr(found, "qos", None)

    def close(self) -> None:
        self._participant.forget(self._number)
        super().close()
