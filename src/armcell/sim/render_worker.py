"""The process of `render_process.py`: `python -m armcell.sim.render_worker FD`, a socket that it obeys.

To it: pickled setups (bytes) and orders (state, camera, rgb, depth). From it: a `CameraImage` for each order,
or what went wrong, in words. Both ends are armcell's own; nobody else can reach the socket.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import sys
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

NICENESS = 10  # physics comes first: of a core that both want it gets nine tenths
HANGS_AFTER = (
    60  # [s] that a picture may take, a model built before it included; then the process ends itself
)


def _draw(world: Any, order: tuple) -> Any:
    from armcell.sim.render import take_image
    from armcell.sim.render_process import PhysicsState

    state, camera, rgb, depth = order
    state.put_into(world)
    image = take_image(world, camera, rgb=rgb, depth=depth and camera.has_depth)
    return image if isinstance(state, PhysicsState) else replace(image, time=0.0)


def _obey(link: Connection) -> None:
    world: Any = None
    failure = ""
    while True:
        order = link.recv()
        signal.alarm(HANGS_AFTER)
        if isinstance(order, bytes):
            try:
                from armcell.sim.world import SimWorld

                scene, settings, seed, decals = pickle.loads(order)
                world = SimWorld(scene, settings, seed=seed, decals=decals)
                failure = ""
            except Exception as error:
                world, failure = None, f"{type(error).__name__}: {error}"
            continue
        try:
            answer = _draw(world, order) if world is not None else failure
        except Exception as error:
            answer = f"{type(error).__name__}: {error}"
        link.send(answer)
        signal.alarm(0)


def main(descriptor: int) -> None:
    """Draw until the other side is gone. Ctrl-C and SIGTERM are meant for that."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    with contextlib.suppress(EOFError, OSError):
        _obey(Connection(descriptor))


if __name__ == "__main__":
    main(int(sys.argv[1]))
