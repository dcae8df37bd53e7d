"""Warm-up that compiles or loads the planner's kernels: in a second process, with a progress line."""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel import block
from armcell.collision.kernel.block import check_address
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import clearance_from_rest
from armcell.kinematics import ik_solver
from armcell.model import RobotModel, load_robot
from armcell.planning.planners.rrt_connect import NativePlanner
from armcell.scene import PlanningScene
from armcell.timing import BlendedPath, parameterize

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)
BOUNDS = np.array([0.0]), np.array([0.05])  # joint limits of the gripper in the warm-up problem


@contextmanager
def in_another_process(*statements: str) -> Iterator[None]:
    """Run Python statements in a second process during a `with` block, so that the first compilation of
    kernels runs in parallel.

    Machines with one core start no second process. The statements must be optional work: an error in the
    second process has no effect.
    """
    process, none, call = None, subprocess.DEVNULL, [sys.executable, "-c", "; ".join(statements)]
    if (os.cpu_count() or 1) > 1 and sys.executable:
        with suppress(OSError):
            process = subprocess.Popen(call, stdin=none, stdout=none, stderr=none)
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None and process.poll() is None:
            process.kill()
            process.wait()


@contextmanager
def progress_line(text: str) -> Iterator[None]:
    """Show a line on the terminal that reports the progress and the elapsed seconds of the first
    compilation.
    """
    if not sys.stderr.isatty():
        yield
        return
    done, began = threading.Event(), time.monotonic()

    def show() -> None:
        while True:
            sys.stderr.write(f"\r{text}: {time.monotonic() - began:.0f} s")
            sys.stderr.flush()
            if done.wait(1.0):
                sys.stderr.write("\r\033[K")  # clear the line
                sys.stderr.flush()
                return

    thread = threading.Thread(target=show, name="armcell-compile-progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def prepare_group(scene: PlanningScene, group: str) -> None:
    """Warm up the planning of a group before its first plan: load or compile the kernels, and compute the
    data that all plans of the group share.

    The data are collision covers, pairs of links that can collide, and the inverse kinematics.
    """
    warm_up()
    KernelChecker(scene, scene.model.group(group).joint_names)
    if scene.model.group(group).tip_link:
        warm_up_ik(scene.model, group)


@lru_cache(maxsize=64)
def warm_up_ik(model: RobotModel, group: str, link: str | None = None) -> None:
    """Warm up the inverse kinematics of a kinematic chain: compile its kernels, so that the first query is
    fast.

    Arms with a closed-form solution use other kernels.
    """
    ik, home = ik_solver(model, group, link), model.default_positions()
    pose = ik.tree.link_pose(home, ik.tip_link)
    ik.solve(pose, home)
    ik.descend(home.copy(), pose)


@lru_cache(maxsize=1)
def warm_up() -> float:
    """Warm up the default planner: compile all its kernels, or load them from the cache on disk.

    The first call on a machine (or after source changes) compiles: two processes share the work, and a
    progress line on the terminal shows the wait. Later runs load the kernels from disk.

    Returns:
        The duration of the warm-up [s]. Later calls return at once.
    """
    began = time.monotonic()
    compiled = Path(os.environ["NUMBA_CACHE_DIR"]) / "planner_compiled"
    if os.path.exists(compiled):
        _plan_small_problem()
        return time.monotonic() - began
    with progress_line("compiling the planner, once on this machine"):
        with in_another_process(
            "from armcell.planning.first_compile import compile_planner_kernels", "compile_planner_kernels()"
        ):
            check_address()
        _plan_small_problem()
    with contextlib.suppress(OSError):
        compiled.touch(0o600)
    seconds = time.monotonic() - began
    logger.info("compiled the planner in %.0f s; later runs load it", seconds)
    return seconds


def compile_planner_kernels() -> None:
    """Compile all planner kernels except collision checking before their first use, in a separate process
    during the warm-up.

    Planners call the collision check by its address, so a check that reports every configuration as free
    replaces it here.
    """
    block.check_address = block.free_check_address  # pyright: ignore[reportAttributeAccessIssue]
    _plan_small_problem()


def _plan_small_problem() -> None:
    checker, a, b = small_problem()
    checker.is_free(a)
    checker.edge_is_free(a, b)
    checker.certify([a, b])
    NativePlanner(checker).plan(a, b[None], *BOUNDS)
    path = BlendedPath(np.array([[0.01], [0.02], [0.04]]), 0.0)
    path.polyline()
    clearance_from_rest(checker, parameterize(path, checker.joint_names, [0.1], [1.0]).positions)


def small_problem() -> tuple[KernelChecker, Array, Array]:
    """Create a tiny problem that warms up (compiles) the planner: a gripper's collision checker, a start and
    a goal position of the gripper joint (1,).
    """
    model = load_robot("parallel_gripper")
    checker = KernelChecker(PlanningScene.of(model), model.group("gripper").joint_names)
    return checker, np.array([0.01]), np.array([0.04])
