"""Client of a Franka robot through the library `franky`, for the worker process of one arm.

`franky` runs a joint impedance controller at 1 kHz in its own thread. The worker streams the reference of
this controller; a late reference therefore never misses one of the robot's cycles. To the worker, the client
looks like `FciClient`: it answers the same commands, and its states are messages of the same format.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.drivers.franka.client import FciClient, FciError
from armcell.drivers.franka.wire import commands as wire
from armcell.drivers.franka.wire.commands import (
    NEWEST,
    REQUESTS,
    Command,
    MoveStatus,
    RecoveryStatus,
    SetterStatus,
    StopStatus,
)
from armcell.drivers.franka.wire.state import (
    ERRORS,
    ControllerMode,
    GeneratorMode,
    RobotMode,
    StateMessage,
    read_command,
)

Array = NDArray[np.float64]

STIFFNESS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # [Nm/rad] libfranka's impedance example
DAMPING = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)  # [Nm s/rad] of the same example
MAX_ACCELERATION = 20.0  # [rad/s^2] of the torque feedforward
CLOSING_TIME = 0.5  # [s] for each thread to end
POLL = 0.0005  # [s] between two looks at the robot's state


class FrankyClient(FciClient):
    """Client of one Franka robot that the library `franky` drives, with the interface of `FciClient`.

    Raises:
        FciError: no robot answers, or it rejects the connection.
    """

    def __init__(self, host: str):
        import franky

        self.host, self.protocol, self._franky = host, NEWEST, franky
        self._identifier, self._received = 0, bytearray()
        try:
            self._robot_api: Any = franky.Robot(host, realtime_config=franky.RealtimeConfig.Ignore)
        except Exception as error:
            raise FciError("refused", f"franky does not connect to {host}: {error}") from None
        self.tcp, self._answers = socket.socketpair()
        self.udp, self._states = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.udp.setblocking(False)
        self._states.setblocking(False)
        self._message = StateMessage(NEWEST.version)
        self._motion: Any = None
        self._stopping = self._finished = False
        self._reference = (0, np.zeros(7), np.zeros(7), np.zeros(7))  # time [ms], q, dq, ddq
        self._alive = True
        self._orders = ThreadPoolExecutor(1, "franky orders")
        self._threads = [threading.Thread(target=self._watch, name="franky states", daemon=True)]
        self._threads[0].start()

    # --- states ---
    def _watch(self) -> None:
        before = -1
        while self._alive:
            try:
                state = self._robot_api.state
            except Exception:  # the connection is lost
                self._alive = False
                self._answers.close()  # the worker reads this as a connection that the robot closed
                return
            now = state.time.to_msec()
            if now != before:
                before = now
                with suppress(OSError):  # the worker is late: it misses this state
                    self._states.send(self._packed(state, now))
            time.sleep(POLL)

    def _packed(self, state: Any, now: int) -> bytes:
        """Encode a robot state from the library `franky` as a Franka state message. During a motion, the
        desired joint positions, velocities and accelerations in the message are the streamed reference.
        """
        m, mode = self._message, RobotMode(int(state.robot_mode.value))
        for field in ("q", "dq", "tau_J", "dtau_J", "tau_ext_hat_filtered", "O_F_ext_hat_K", "K_F_ext_hat_K"):
            m[field] = getattr(state, field)
        m["O_T_EE"] = state.O_T_EE.matrix.T.ravel()
        moving = self._motion is not None
        if moving:
            _, m["q_d"], m["dq_d"], m["ddq_d"] = self._reference
        else:
            m["q_d"], m["dq_d"], m["ddq_d"] = state.q_d, state.dq_d, state.ddq_d
        for flags, errors in ((m.errors, state.current_errors), (m.reflex_reason, state.last_motion_errors)):
            flags[:] = [getattr(errors, name.lower(), False) for name in ERRORS]
        generator = GeneratorMode.JOINT_POSITION if moving else GeneratorMode.IDLE
        controller = ControllerMode.EXTERNAL if moving else ControllerMode.OTHER
        m.write_scalars(now, generator, controller, mode, state.control_command_success_rate)
        return bytes(m)

    # --- commands ---
    def send(self, command: Command, payload: bytes = b"") -> int:
        self._identifier += 1
        identifier = self._identifier

        def perform() -> None:
            status = self._perform(command, payload, identifier)
            if status is not None:
                self._answer(command, identifier, status)

        if command is Command.STOP_MOVE:  # a motion occupies the thread of the other orders only at its start
            self._stop()
            self._answer(command, identifier, StopStatus.SUCCESS)
        else:
            self._orders.submit(perform)
        return identifier

    def _answer(self, command: Command, identifier: int, status: IntEnum) -> None:
        content = wire.STATUS.pack(NEWEST.status_code(status))
        with suppress(OSError):  # the worker has closed the client
            self._answers.sendall(wire.message(NEWEST.code(command), identifier, content))

    def _perform(self, command: Command, payload: bytes, identifier: int) -> IntEnum | None:
        robot, values = self._robot_api, REQUESTS[command].unpack(payload)
        match command:
            case Command.MOVE:
                return self._move(identifier)
            case Command.AUTOMATIC_ERROR_RECOVERY:
                done = self._tried(robot.recover_from_errors)
                return RecoveryStatus.SUCCESS if done else RecoveryStatus.MANUAL_RECOVERY_REQUIRED
            case Command.SET_COLLISION_BEHAVIOR:
                torque, force = np.reshape(values[:28], (4, 7)), np.reshape(values[28:], (4, 6))
                done = self._tried(lambda: robot.set_collision_behavior(*torque, *force))
            case Command.SET_JOINT_IMPEDANCE:
                done = self._tried(lambda: robot.set_joint_impedance(list(values)))
            case Command.SET_LOAD:
                mass, center, inertia = values[0], list(values[1:4]), list(values[4:])
                done = self._tried(lambda: robot.set_load(mass, center, inertia))
            case _:
                done = False
        return SetterStatus.SUCCESS if done else SetterStatus.NOT_POSSIBLE

    def _tried(self, act: Callable[[], object]) -> bool:
        try:
            return act() is not False
        except Exception:
            return False

    # --- motions ---
    def _move(self, identifier: int) -> MoveStatus | None:
        franky, state = self._franky, self._robot_api.state
        q = np.asarray(state.q_d)
        self._reference = (state.time.to_msec(), q, np.zeros(7), np.zeros(7))
        self._stopping = self._finished = False
        motion = franky.JointImpedanceTrackingMotion(stiffness=list(STIFFNESS), damping=list(DAMPING))
        motion.set_reference(franky.JointReference(q=q))
        try:
            self._robot_api.move(motion, asynchronous=True)
        except Exception:
            return MoveStatus.NOT_POSSIBLE
        self._motion = motion
        joins = threading.Thread(target=self._join, args=(identifier,), name="franky motion", daemon=True)
        self._threads[1:] = [joins]
        joins.start()
        return MoveStatus.STARTED

    def _join(self, identifier: int) -> None:
        """Wait until `franky` has ended the motion, and answer the Move command with the resulting status."""
        failed = False
        try:
            while not self._robot_api.join_motion(0.02):
                pass
        except Exception:  # franky's exceptions have no common base class
            failed = True
        mode = RobotMode.OTHER
        with suppress(Exception):  # the connection is lost
            mode = RobotMode(int(self._robot_api.state.robot_mode.value))
        self._motion = None
        if mode is RobotMode.USER_STOPPED:
            status = MoveStatus.EMERGENCY_ABORTED
        elif failed and not self._stopping:
            status = MoveStatus.REFLEX_ABORTED
        else:
            status = MoveStatus.SUCCESS if self._finished else MoveStatus.PREEMPTED
        self._answer(Command.MOVE, identifier, status)

    def _stop(self) -> None:
        if self._motion is not None:
            self._stopping = True
            self._tried(self._robot_api.stop)

    def command(self, data: bytes) -> None:
        """Pass a motion command to `franky`'s joint impedance controller as joint positions, velocities and
        feedforward torques. Finite differences of the commands give the velocities and accelerations.
        """
        motion, wanted = self._motion, read_command(data)
        if motion is None or self._finished:
            return
        before, q0, dq0, _ = self._reference
        q, dt = np.array(wanted.q), 0.001 * max(wanted.time - before, 1)
        dq = (q - q0) / dt
        ddq = np.clip((dq - dq0) / dt, -MAX_ACCELERATION, MAX_ACCELERATION)
        self._reference = wanted.time, q, dq, ddq
        torque = self._robot_api.model.mass(self._robot_api.state) @ ddq
        motion.set_reference(self._franky.JointReference(q=q, dq=dq, tau_ff=torque))
        if wanted.motion_finished:
            self._finished = True
            self._tried(lambda: self._robot_api.move(self._franky.TorqueStopMotion(), asynchronous=True))

    def close(self) -> None:
        self._stop()
        self._alive = False
        self._orders.shutdown(cancel_futures=True)
        for thread in self._threads:  # a thread within the library aborts the process when it exits
            thread.join(CLOSING_TIME)
        for end in (self.tcp, self.udp, self._answers, self._states):
            end.close()
