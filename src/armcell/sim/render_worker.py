"""The render process: `python -m armcell.sim.render_worker FD` serves requests on a socket.

`render_process.py` sends pickled setups (bytes) and orders (state, camera, rgb, depth) over the socket. The
process replies to each order with a `CameraImage`, or with an error message as a string. Both ends belong to
armcell, and no other process can reach the socket.
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

NICENESS = 10  # physics comes first: it gets nine tenths of a core that both processes want
HANGS_AFTER = 180  # [s, wall clock] for an image and the build of the model; then the process ends itself


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
    """Run the render worker: serve requests for images on a socket until the parent process closes it.

    The process ignores Ctrl-C and SIGTERM, which are meant for the parent.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    with contextlib.suppress(EOFError, OSError):
        _obey(Connection(descriptor))


if __name__ == "__main__":
    main(int(sys.argv[1]))
