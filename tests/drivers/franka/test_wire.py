"""Franka's messages: sizes of the public headers, round trips, and damaged input."""

from __future__ import annotations

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armcell.drivers.franka.settings import FR3, LIMITS, PANDA
from armcell.drivers.franka.wire import commands, gripper
from armcell.drivers.franka.wire.commands import (
    PROTOCOLS,
    REQUESTS,
    Command,
    MoveController,
    MoveGenerator,
    MoveRequest,
    MoveStatus,
    RecoveryStatus,
    SetterStatus,
    WireError,
)
from armcell.drivers.franka.wire.state import (
    COMMANDS,
    ERRORS,
    FIELDS,
    STATES,
    RobotCommand,
    StateMessage,
    read_command,
    read_state,
)


def test_sizes_are_those_of_protocol_10():
    assert (STATES[10].size, COMMANDS[10].size, len(ERRORS)) == (1377, 371, 41)
    sizes = {c: commands.HEADER.size + layout.size for c, layout in REQUESTS.items()}
    assert sizes[Command.MOVE] == 125
    assert sizes[Command.SET_COLLISION_BEHAVIOR] == 428
    assert sizes[Command.SET_JOINT_IMPEDANCE] == 68
    assert sizes[Command.SET_LOAD] == 116
    assert gripper.STATE.size == 23


def test_protocol_5_is_that_of_libfranka_0_9():
    """Sizes and codes by hand from its headers; `panda-python` checks them in test_interop.py."""
    numbers = 96 + 26 + 4 + 8 * 7 + 26 + 7 + 12 + 9 + 6 + 28 + 14
    assert (STATES[5].size, COMMANDS[5].size) == (8 + 8 * numbers + 2 + 82 + 1 + 8, 370)
    panda = PROTOCOLS[5]
    codes = {Command.MOVE: 1, Command.SET_COLLISION_BEHAVIOR: 4, Command.SET_LOAD: 10,
             Command.AUTOMATIC_ERROR_RECOVERY: 12, Command.LOAD_MODEL_LIBRARY: 13}  # fmt: skip
    assert {c: panda.code(c) for c in codes} == codes and panda.command(14) is None
    assert panda.requests[Command.MOVE].size == 56
    for status, code in (
        (MoveStatus.PREEMPTED, 2), (MoveStatus.NOT_POSSIBLE, 3), (MoveStatus.ABORTED, 9),
        (RecoveryStatus.MANUAL_RECOVERY_REQUIRED, 2), (SetterStatus.INVALID_ARGUMENT, 2),
    ):  # fmt: skip
        assert panda.status_code(status) == code
    assert panda.status(Command.MOVE, 6) is MoveStatus.REFLEX_ABORTED
    assert PROTOCOLS[10].status(Command.MOVE, 6) is MoveStatus.START_AT_SINGULAR_POSE
    with pytest.raises(WireError, match="status 10 in the answer to the command 'move'"):
        panda.status(Command.MOVE, 10)


@pytest.mark.parametrize("version", STATES)
def test_a_state_survives_the_wire(version):
    message = StateMessage(version)
    fields = {name: s for name, s in FIELDS.items() if s.stop <= STATES[version].count}
    values = {name: np.arange(s.stop - s.start) / 8 + s.start for name, s in fields.items()}
    for name, value in values.items():
        message[name] = value
    message.errors[ERRORS.index("joint_reflex")] = 1
    message.reflex_reason[ERRORS.index("power_limit_violation")] = 1
    message.write_scalars(2**40 + 7, 1, 2, 4, 0.5)
    state = read_state(bytes(message))
    assert (state.time, state.generator, state.controller, state.mode) == (2**40 + 7, 1, 2, 4)
    assert (state.errors, state.last_errors) == (("joint_reflex",), ("power_limit_violation",))
    assert state.success_rate == 0.5
    for name, value in values.items():
        assert np.array_equal(state[name], value), name


@pytest.mark.parametrize("version", COMMANDS)
def test_a_command_survives_the_wire(version):
    q = tuple(np.arange(7.0))
    sent = RobotCommand(9, q=q, motion_finished=True, torque=(1.5,) * 7, torque_finished=version == 5)
    assert read_command(sent.pack(version), version) == sent


def test_a_move_survives_the_wire():
    sent = MoveRequest(
        MoveController.EXTERNAL, MoveGenerator.NONE, interpolate=True, max_velocity=tuple(np.arange(7.0))
    )
    assert MoveRequest.unpack(sent.pack()) == sent
    panda, old = PROTOCOLS[5], MoveRequest(MoveController.EXTERNAL, MoveGenerator.JOINT_VELOCITY)
    assert MoveRequest.unpack(old.pack(panda), panda) == old
    with pytest.raises(ValueError, match="9"):
        MoveRequest.unpack(struct.pack("<I", 9) + sent.pack()[4:])


@pytest.mark.slow
@given(st.binary(max_size=2500))
def test_damaged_datagrams_are_rejected_or_read(data):
    for read in (read_state, read_command):
        with suppress(WireError):  # any other exception fails
            read(data)


@pytest.mark.parametrize("version", STATES)
def test_a_state_with_an_unknown_mode_or_flag_is_rejected(version):
    size = STATES[version].size
    modes, rest = STATES[version].modes, STATES[version].rest.size
    for at in (modes, modes + 1, modes + 2, modes + 50, size - rest):
        data = bytearray(size)
        read_state(bytes(data))
        data[at] = 208
        with pytest.raises(WireError, match="modes|flags"):
            read_state(bytes(data))


def test_numbers_that_are_not_finite_are_rejected():
    with pytest.raises(WireError, match="not finite"):
        read_command(RobotCommand(1, q=(float("nan"),) * 7).pack())
    message = StateMessage()
    message["q"] = np.inf
    with pytest.raises(WireError, match="not finite"):
        read_state(bytes(message))


@given(st.lists(st.binary(max_size=40), max_size=5), st.integers(1, 7))
def test_messages_are_cut_wherever_the_stream_breaks(contents, chunk):
    stream = b"".join(commands.message(3, i, c) for i, c in enumerate(contents))
    received, found = bytearray(), []
    for start in range(0, len(stream), chunk):
        received += stream[start : start + chunk]
        while (message := commands.take_message(received)) is not None:
            found.append(message)
    assert found == [(3, i, c) for i, c in enumerate(contents)]


def test_an_impossible_size_is_an_error():
    for size in (0, 11, 1 << 30):
        with pytest.raises(WireError, match="not possible"):
            commands.take_message(bytearray(struct.pack("<III", 1, 1, size)))


def test_velocity_limits_vanish_at_the_position_limits():
    for limits in LIMITS.values():
        middle = 0.5 * (limits.lower + limits.upper)
        low, high = limits.velocity_range(middle)
        assert np.all(low < 0) and np.all(high > 0)
        assert np.all(high <= limits.velocity) and np.all(-low <= limits.velocity)
    low, high = FR3.velocity_range(FR3.velocity_upper)
    assert np.all(high == 0.0) and np.all(low < -1.0)
    assert np.array_equal(PANDA.velocity_range(PANDA.upper)[1], PANDA.velocity)
