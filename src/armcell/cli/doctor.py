"""`armcell doctor`: find faults of installation, packages, endpoint, cell and arm drives, with hints."""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import socket
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import typer
import yaml
from rich.markup import escape
from rich.table import Table

from armcell import __version__, _cache
from armcell.cli import goal_options
from armcell.cli.console import console
from armcell.core import ArmcellError, InputError, UnknownNameError
from armcell.model import MoveItConfig

DRIVER_FILES = (
    "ros2_controllers.yaml",
    "ros_controllers.yaml",
)  # files of the controller manager


def check_package(folder: Path) -> Iterator[Finding]:
    """Check a MoveIt package for `armcell doctor`: its files,
    and that each joint has one controller with a valid name.
    """
    try:
        config = MoveItConfig.load(folder)
    except InputError as error:
        yield Finding(NO, "MoveIt package", str(error))
        return
    files = ", ".join(config.names[key] for key in config.files)
    yield Finding(OK, "MoveIt package", f"{folder}: {config.names['srdf']}, {files}")
    yield from check_joint_controllers(config)
    yield from check_controller_names(config)


def check_joint_controllers(config: MoveItConfig) -> Iterator[Finding]:
    """Check, for `armcell doctor`, that a MoveIt package has exactly
    one controller for every joint of its groups.

    MoveIt refuses to execute a motion if a joint has no controller. If a joint has several default
    controllers, the choice is arbitrary.
    """
    of_joint: dict[str, list[str]] = {}
    for name, entry in config.controllers.items():
        joints = entry.get("joints") or []
        yield Finding(OK, f"controller {name}", f"{entry.get('type')} of {', '.join(joints) or 'no joints'}")
        if entry.get("default"):
            for joint in joints:
                of_joint.setdefault(joint, []).append(name)
    every = {joint for entry in config.controllers.values() for joint in entry.get("joints") or []}
    for group in config.model.groups.values():
        missing = [joint for joint in group.joint_names if joint not in every]
        if group.tip_link is not None and missing:
            hint = "MoveIt would plan and then refuse to execute; add them to a controller's joints"
            yield Finding(NO, f"group {group.name}", f"no controller moves {', '.join(missing)}: {hint}")
    for joint, names in of_joint.items():
        if len(names) > 1:
            hint = "which one executes is chance; take `default: true` from all but one"
            yield Finding(NO, f"joint {joint}", f"is in {' and '.join(names)}: {hint}")


def check_controller_names(config: MoveItConfig) -> Iterator[Finding]:
    """Check, for `armcell doctor`, that the controllers of a MoveIt
    package also occur in the controller manager's file.
    """
    for file in (config.folder / "config" / name for name in DRIVER_FILES):
        if os.path.isfile(file) and file.name != config.names.get("controllers"):
            yield from _compared(config, file)


def _compared(config: MoveItConfig, file: Path) -> Iterator[Finding]:
    try:
        started = _joints_of(yaml.safe_load(file.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        yield Finding(NO, file.name, f"cannot be read: {str(error).splitlines()[0]}")
        return
    wrong = False
    for name, entry in config.controllers.items():
        if name not in started:
            why = UnknownNameError("controller", name, started)
            yield Finding(NO, file.name, f"{_named(config)} names a controller that it does not start: {why}")
            wrong = True
        elif started[name] and set(started[name]) != set(entry.get("joints") or []):
            only = ", ".join(sorted(set(started[name]) ^ set(entry.get("joints") or [])))
            yield Finding(
                NO, file.name, f"{name} has other joints than in {_named(config)}: {only} in one only"
            )
            wrong = True
    if not wrong:
        yield Finding(OK, file.name, f"has the controllers that {_named(config)} names")


def _named(config: MoveItConfig) -> str:
    return config.names.get("controllers", "no file")


def _joints_of(data: Any) -> dict[str, list[str]]:
    """Return, for `armcell doctor`, the joints of each controller in the controller manager's file of a
    MoveIt package (ROS 2 or ROS 1).

    ROS 2 nests the joints as `name: {ros__parameters: {joints: []}}`; ROS 1 omits the key `ros__parameters`.
    """
    found: dict[str, list[str]] = {}
    for name, entry in data.items() if isinstance(data, dict) else ():
        if not isinstance(entry, dict):
            continue
        inner = entry.get("ros__parameters", entry)
        if name == "controller_manager":
            for other, settings in inner.items() if isinstance(inner, dict) else ():
                if isinstance(settings, dict) and "type" in settings:
                    found.setdefault(other, [])
        elif isinstance(inner, dict):
            joints = inner.get("joints") or ([inner["joint"]] if isinstance(inner.get("joint"), str) else [])
            found[name] = [str(joint) for joint in joints] if isinstance(joints, list) else []
    return found


OK, NO, NOTE = "ok", "no", "note"

NEEDED = (
    "coal", "lxml", "matplotlib", "mcap", "mujoco", "networkx", "numba", "numpy",
    "ompl", "pillow", "pycollada", "pydantic", "pyyaml", "rich", "rosbags", "ruckig", "scipy", "trimesh",
    "typer", "viser",
)  # fmt: skip

EXTRAS = {
    "robots": ("example-robot-data",),
    "vision": ("opencv-python-headless",),
    "ik": ("eaik",),
    "ros2": ("cyclonedds",),
    "trees": ("py_trees",),
    "ray": ("ray",),
    "ur-rtde": ("ur_rtde",),
    "franka": ("franky-control",),
}

PORTS = {10000: "Unity (ROS-TCP)", 11311: "ROS 1 master", 8080: "viewer"}

PATIENCE = 3.0  # [s] to connect

JUMP = 0.05  # [rad or m] step of each joint's target, in turn

TIME = 1.0  # [s] time to follow the step

MOST_OFF = 0.2  # largest error at the end, as share of the step

MOST_OVER = 0.5  # largest overshoot, as share of the step

FINER = (0.005, 0.002, 0.001, 0.0005)  # [s] physics time steps to try if the cell's own fails


@dataclass(frozen=True)
class Finding:
    """Line with the result of one check by `armcell doctor`.

    Attributes:
        verdict: "ok", "no" (fault) or "note" (information).
        check: name of the check.
        found: the result in words; for a fault, with the hint.
    """

    verdict: str
    check: str
    found: str


STYLES = {OK: "[green]ok[/green]", NO: "[red]no[/red]", NOTE: "[yellow]--[/yellow]"}


def doctor(
    cell: str | None = typer.Argument(
        None, help="Also look at this cell (built-in, folder, YAML file) or MoveIt package."
    ),
    connect: str | None = typer.Option(
        None, metavar="HOST:PORT", help="Also try to reach an endpoint, e.g. Unity's 127.0.0.1:10000."
    ),
    json_file: Path | None = goal_options.JSON,
) -> int:
    """Check the armcell installation and the requirements of a cell.
    Each fault is printed with a hint on how to fix it.

    Example: armcell doctor panda_pick --connect 192.168.1.20:10000

    Exit status 0 if nothing is wrong, 1 if something is.
    """
    goal_options.check_json_path(json_file)
    lines: list[Finding] = []
    table = Table(box=None, pad_edge=False, show_header=False)
    for line in _lines(cell, connect):
        lines.append(line)
        table.add_row(STYLES[line.verdict], escape(line.check), escape(line.found))
    console.print(table)
    goal_options.save(json_file, [asdict(line) for line in lines])
    return 1 if any(line.verdict == NO for line in lines) else 0


def _lines(cell: str | None, connect: str | None) -> Iterator[Finding]:
    yield from machine()
    yield from packages()
    yield from cache()
    yield opengl()
    yield from ports()
    if connect is not None:
        yield check_endpoint(connect)
    if cell is not None:
        yield from check_cell(cell)


# --- the machine ---
def machine() -> Iterator[Finding]:
    yield Finding(OK, "armcell", f"{__version__} in {Path(__file__).parents[1]}")
    found = f"{platform.python_version()} ({sys.executable})"
    fit = (3, 11) <= sys.version_info[:2] < (3, 14)
    yield Finding(OK if fit else NO, "Python", found if fit else f"{found}: 3.11 to 3.13 are supported")
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding(
        OK, "machine", f"{platform.platform(terse=True)}, {platform.machine()}, {usable} cores usable"
    )


def packages() -> Iterator[Finding]:
    have = {name: _version(name) for name in NEEDED}
    missing = [name for name, found in have.items() if found is None]
    versions = ", ".join(f"{name} {found}" for name, found in have.items() if found)
    if missing:
        yield Finding(NO, "packages", f"missing: {', '.join(missing)} (pip install {' '.join(missing)})")
    else:
        yield Finding(OK, "packages", versions)
    for extra, names in EXTRAS.items():
        absent = [name for name in names if _version(name) is None]
        if absent:
            yield Finding(NOTE, f"extra {extra}", f"not installed (pip install 'armcell[{extra}]')")
        else:
            yield Finding(OK, f"extra {extra}", ", ".join(f"{name} {_version(name)}" for name in names))


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _size_of(root: Path) -> int:
    """Return the size [bytes] of all files in a folder; other processes may delete some meanwhile."""
    size = 0
    for folder, _, names in os.walk(root):  # a quarter of the time of Path.rglob
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                size += os.lstat(os.path.join(folder, name)).st_size
    return size


def cache() -> Iterator[Finding]:
    root, folder = _cache.cache_root(), Path(os.environ["NUMBA_CACHE_DIR"])
    chosen = _cache.chosen_root()
    if (reason := _cache.doubt(chosen)) is not None:
        hint = "let only your user write there (chmod go-w), or set ARMCELL_CACHE_DIR to another folder"
        yield Finding(NO, "cache folder", f"{chosen} is not used, because {reason}: {hint}")
    elif _cache.writable(root):
        yield Finding(OK, "cache folder", f"{root}: writable, {_size_of(root) / 1e6:.0f} MB")
    else:
        hint = "kernels compile again in every process; set ARMCELL_CACHE_DIR to a folder that can be written"
        yield Finding(NO, "cache folder", f"{root} is not writable: {hint}")
    kept = len(list(folder.rglob("*.nbi")))
    if kept:
        yield Finding(OK, "compiled kernels", f"{kept} functions kept in {folder}")
    else:
        yield Finding(NOTE, "compiled kernels", "none yet: the first plan compiles for about half a minute")


def opengl() -> Finding:
    from armcell.sim.gl import gl_backend

    backend = gl_backend()
    if backend:
        return Finding(OK, "OpenGL", f"cameras draw with {backend}")
    hint = "cameras cast rays, which is slower (apt install libegl1 libosmesa6, or unset MUJOCO_GL)"
    return Finding(NOTE, "OpenGL", hint)


# --- the network ---
def ports() -> Iterator[Finding]:
    for port, what in PORTS.items():
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
                yield Finding(OK, f"port {port}", f"free, for {what}")
            except OSError as error:
                hint = f"taken ({error.strerror}): stop that program, or give another port"
                yield Finding(NOTE, f"port {port}", f"{hint} for {what}")


def check_endpoint(connect: str) -> Finding:
    """Check, for `armcell doctor`, whether a ROS-TCP endpoint accepts connections. If not, name the cause.

    The cause can be a wrong address, an endpoint that is not running, or a firewall.
    """
    from armcell.cli.serve import address

    host, port = address(connect)
    what = f"endpoint {host}:{port}"
    try:
        with socket.create_connection((host, port), timeout=PATIENCE):
            return Finding(OK, what, "accepts connections")
    except socket.gaierror:
        return Finding(NO, what, f"wrong address: {host!r} is not known (check the name, or give the number)")
    except ConnectionRefusedError:
        hint = "the machine answers, but nothing listens there: start the endpoint, or give its port"
        return Finding(NO, what, hint)
    except TimeoutError:
        hint = f"no answer in {PATIENCE:g} s: a firewall drops it (open TCP {port}), or the address is wrong"
        return Finding(NO, what, hint)
    except OSError as error:
        return Finding(NO, what, f"cannot be reached ({error.strerror}): check the network and the address")


# --- a cell ---
def check_cell(name: str) -> Iterator[Finding]:
    """Yield the results of `armcell doctor` for a cell: those of `armcell check` and of further checks.

    Further checks: the robot's files and meshes, transforms, effort limits, gains, drives and controllers.
    """
    from armcell.cell import load
    from armcell.cli.check import findings
    from armcell.model.setup import is_moveit_config

    if is_moveit_config(Path(name)):
        yield from check_package(Path(name))
        if not any(Path(name).glob("cell.y*ml")):
            return

    heard = _Warnings()
    logger = logging.getLogger("armcell")
    logger.addHandler(heard)
    try:
        loaded = load(name)
    except InputError as error:
        yield Finding(NO, "cell", str(error))
        return
    finally:
        logger.removeHandler(heard)
    yield from (Finding(OK if sound else NO, what, text) for sound, what, text in findings(loaded))
    meshes = sum(v.file is not None for link in loaded.model.links.values() for v in link.visuals)
    if heard.lines:
        yield from (Finding(NO, "robot's files", text) for text in heard.lines)
    else:
        yield Finding(OK, "robot's files", f"all found; {meshes} visual meshes")
    yield from check_transforms(loaded.model)
    yield from check_drive_strength(loaded)
    yield from check_drives(loaded)
    yield from controllers(loaded.model)


class _Warnings(logging.Handler):
    """Logging handler that stores warnings for `armcell doctor`."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def check_transforms(model: Any) -> Iterator[Finding]:
    """Check, for `armcell doctor`, that all links form one tree of transforms below the root link."""
    below = set(model.subtree(model.root_link))
    loose = [name for name in model.links if name not in below]
    if loose:
        yield Finding(NO, "TF tree", f"not below {model.root_link}: {', '.join(loose)} (give them a joint)")
    else:
        yield Finding(OK, "TF tree", f"{len(below)} frames, all below {model.root_link}")


def check_drive_strength(loaded: Any) -> Iterator[Finding]:
    """Check, for `armcell doctor`, that the effort limits and gains of the joint drives are sufficient to
    hold the robot in its start state.
    """
    import numpy as np

    from armcell.kinematics import InverseDynamics
    from armcell.sim.joint_gains import arm_joints
    from armcell.sim.settings import effective_gains

    model, physics = loaded.model, loaded.physics
    names = model.joint_names
    effort = model.limits(names, "effort")
    weak = [n for n, e in zip(names, effort, strict=True) if not 0 < e < np.inf]
    if weak:
        yield Finding(NO, "effort limits", f"{', '.join(weak)} have none: add <limit effort=...> to the URDF")
        return
    q, zero = loaded.scene().positions, np.zeros(len(names))
    held = np.abs(InverseDynamics(model, names, q).torques(q, zero, zero)[0])
    share = held / effort
    k = int(np.argmax(share))
    text = f"holding the start takes {share[k]:.0%} of {names[k]}'s effort ({held[k]:.3g} of {effort[k]:.3g})"
    hint = ": the robot would sag; check masses and effort limits in the URDF"
    yield Finding(OK if share[k] <= 1 else NO, "gains", text if share[k] <= 1 else text + hint)
    gains = [effective_gains(model.joint(n), physics).kp for n in arm_joints(model)] or [0.0]
    low, high = min(gains), max(gains)
    yield Finding(
        OK, "gains in physics", f"stiffness {low:.3g} to {high:.3g} Nm/rad (fingers have their own)"
    )


def controllers(model: Any) -> Iterator[Finding]:
    """Yield, for `armcell doctor`, the controllers that accept trajectories, each with its joints."""
    groups = [g.arm_group for g in model.grippers.values()]
    groups = groups or [g.name for g in model.groups.values() if g.tip_link]
    for group in groups:
        joints = ", ".join(model.group(group).joint_names)
        yield Finding(OK, f"controller {group}_controller", f"follow_joint_trajectory of {joints}")
    if not groups:
        yield Finding(
            NO, "controllers", "the robot has no arm: give it a planning group that is a chain (SRDF)"
        )


def check_drives(loaded: Any) -> Iterator[Finding]:
    """Check, for `armcell doctor`, how well the arm joints follow a small step in the physics simulation.

    The check uses the cell's time step and gains. If the joints do not follow, finer time steps show whether
    the time step or the gains are the cause.
    """
    scene, physics = loaded.scene(), loaded.physics
    step = physics.timestep
    text, sound = _followed(scene, physics)
    if sound:
        yield Finding(OK, "physics step", f"{1e3 * step:g} ms: {text}")
        return
    for finer in (s for s in FINER if s < step):
        if _followed(scene, replace(physics, timestep=finer))[1]:
            hint = f"with {1e3 * finer:g} ms they follow: write `timestep: {finer:g}` under `physics:`"
            yield Finding(NO, "physics step", f"{1e3 * step:g} ms is too coarse: {text}; {hint}")
            return
    gains = f"arm_kp {physics.arm_kp:g}, arm_kv {physics.arm_kv:g}"
    gains += f", joint_gains of {', '.join(physics.joint_gains)}" if physics.joint_gains else ""
    hint = f"look at the gains under `physics:` ({gains}), and at efforts, masses and inertias in the URDF"
    yield Finding(NO, "drives", f"{text}, with a finer step as well: {hint}")


def _followed(scene: Any, physics: Any) -> tuple[str, bool]:
    """Simulate the step response of each joint for `armcell doctor`. Return a description of the worst
    response, and whether this response is acceptable.
    """
    from armcell.sim.step_response import step_responses

    fingers = {name for g in scene.model.grippers.values() for name in g.joint_names}
    worst, text = -1.0, "no joint has room to move"
    for joint in scene.model.joint_names:
        if joint in fingers:
            continue
        try:
            (found,) = step_responses(scene, (joint,), physics, JUMP, TIME)
        except InputError:  # the joint limits leave no range for the step
            continue
        except ArmcellError as error:
            return f"{joint}: {error}", False
        off = found.final_error / JUMP
        badness = max(off / MOST_OFF, found.overshoot / MOST_OVER)
        if badness > worst:
            worst = badness
            over = f"{found.overshoot:.0%} beyond on the way"
            text = f"{joint} is off by {off:.0%} of a jump of {JUMP:g} after {TIME:g} s, {over}"
    return text, bool(np.isfinite(worst) and worst <= 1.0)
