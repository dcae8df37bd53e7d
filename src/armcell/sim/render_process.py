"""Rendering in a separate process, so that the physics thread never waits for an image.

Software OpenGL takes 10 to 100 ms per image, ray casting takes half a second, and building a model with
visual meshes blocks the Python interpreter for a second. The render process (`render_worker.py`) has a copy
of the world and sets it to each state that it receives, so its images equal those of `take_image` bit for
bit. The process runs at a lower priority, ignores the terminal's signals, and exits when its socket closes.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell._interrupts import unsignaled
from armcell.core import SE3, ArmcellError, CameraImage
from armcell.scene import PlanningScene
from armcell.sim.camera import Camera
from armcell.sim.decals import Decal
from armcell.sim.settings import PhysicsSettings
from armcell.sim.world import SimWorld

ENDS_WITHIN = 1.0  # [s] time the process has to exit after its socket closes, before it is killed
WORKER = "armcell.sim.render_worker"


@dataclass(frozen=True, eq=False)
class PhysicsState:
    """Copy of the state of a simulated world at one instant. It is sent to a render process."""

    time: float  # [s]
    qpos: NDArray[np.float64]  # (nq,) MuJoCo's generalized positions
    bodies: tuple[NDArray[np.float64], NDArray[np.float64]]  # (nbody, 3) [m], (nbody, 4) wxyz; parent frames

    @staticmethod
    def of(world: SimWorld) -> PhysicsState:
        with world.lock:
            model, data = world.mj_model, world.mj_data
            return PhysicsState(data.time, data.qpos.copy(), (model.body_pos.copy(), model.body_quat.copy()))

    def put_into(self, world: SimWorld) -> None:
        """Copy this physics state into the simulated world of a render process, which has the same scene and
        settings.
        """
        model, data = world.mj_model, world.mj_data
        data.time, data.qpos[:] = self.time, self.qpos
        model.body_pos[:], model.body_quat[:] = self.bodies
        mujoco.mj_kinematics(model, data)


@dataclass(frozen=True, eq=False)
class MeasuredState:
    """Measured joint positions and object poses of a robot that is not simulated.
    They are sent to a render process.
    """

    positions: NDArray[np.float64]  # (dof,) [rad or m] in the model's order
    object_poses: dict[str, SE3]  # T_world_object

    def put_into(self, world: SimWorld) -> None:
        # measured positions may exceed the joint limits
        world.set_positions(np.clip(self.positions, world.robot.lower, world.robot.upper))
        for name, pose in self.object_poses.items():
            world.set_object_pose(name, pose)


State = PhysicsState | MeasuredState


class RenderSetup:
    """Data from which a render process builds its copy of a simulated world.

    The constructor pickles them at once, so later changes of the scene have no effect.
    """

    def __init__(
        self, scene: PlanningScene, settings: PhysicsSettings | None = None, seed: int = 0,
        decals: Iterable[Decal] = (),
    ):  # fmt: skip
        self.data = pickle.dumps((scene, settings, seed, tuple(decals)), protocol=5)

    @staticmethod
    def of(world: SimWorld) -> RenderSetup:
        return RenderSetup(world.built.scene, world.settings, world.seed, world.decals)


@dataclass(frozen=True, eq=False)
class RenderRequest:
    """Request for one image to a render process."""

    setup: RenderSetup
    state: State
    camera: Camera
    rgb: bool = True
    depth: bool = True


class RenderProcess:
    """Process that renders images on request, so that the simulation never waits for them.

    The first `begin` starts the process; `begin` also restarts it after it has died. Only one thread may use
    the object: it calls `begin`, then `finish`.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._link: Connection | None = None
        self._setup: RenderSetup | None = None
        self._trouble = ""

    @property
    def pid(self) -> int | None:
        """Return the process ID of the running render process, or None."""
        return None if self._process is None else self._process.pid

    def begin(self, order: RenderRequest) -> None:
        """Request an image from the render process without waiting for it. Errors are raised by `finish`."""
        try:
            link = self._link or self._start()
            if order.setup is not self._setup:
                link.send(order.setup.data)
                self._setup = order.setup
            link.send((order.state, order.camera, order.rgb, order.depth))
        except OSError as error:
            self._trouble = error.strerror or str(error)

    def finish(self) -> CameraImage:
        """Wait for the image that was requested from the render process, and return it.

        Raises:
            ArmcellError: rendering failed, or the process has died.
        """
        answer: Any
        try:
            if self._link is None:
                raise EOFError
            answer = self._link.recv()
        except (OSError, EOFError):
            raise ArmcellError(self._last_words()) from None
        if isinstance(answer, CameraImage):
            return answer
        raise ArmcellError(str(answer))

    def kill(self) -> None:
        """Kill the render process at once. Any thread may do this; a waiting `finish` raises an error."""
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """End the render process and wait until it has exited."""
        link, self._link, self._setup = self._link, None, None
        if link is not None:
            link.close()
        if self._process is None:
            return
        try:
            self._process.wait(ENDS_WITHIN)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process = None

    def _start(self) -> Connection:
        ours, its = socket.socketpair()
        # -P: the worker must not import a file such as numpy.py from the current folder
        places = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
        env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in places if p)}
        try:
            with unsignaled():
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", WORKER, str(its.fileno())],
                    pass_fds=(its.fileno(),), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=env,
                )  # fmt: skip
        except OSError:
            ours.close()
            raise
        finally:
            its.close()
        self._link = Connection(ours.detach())
        return self._link

    def _last_words(self) -> str:
        process, trouble = self._process, self._trouble
        self.close()
        self._trouble = ""
        if process is None:
            return f"the render process cannot be started: {trouble}"
        status = process.returncode
        if status >= 0:
            return f"the render process ended with status {status}"
        return f"the render process ended by {signal.Signals(-status).name}"
