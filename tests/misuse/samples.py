"""A valid value for each kind of parameter of the public API, by type hint and by name."""

from __future__ import annotations

import functools
import inspect
import re
import threading
from pathlib import Path
from typing import Any

import numpy as np

import armcell
from armcell.core import SE3, SO3, Box, ErrorCode, JointPath, JointState, JointTrajectory, Mesh, Sphere

CUBE = ([-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1])
FACES = ([0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [1, 2, 6],
         [1, 6, 5], [0, 4, 7], [0, 7, 3])  # fmt: skip


@functools.cache
def cell() -> Any:
    return armcell.load("panda_pick")


@functools.cache
def by_type() -> dict[str, Any]:
    """By the name of a type, as hints write it."""
    scene = cell().scene(0)
    model, arm = scene.model, scene.model.group("arm")
    q = scene.positions[model.columns(arm.joint_names)]
    path = JointPath(arm.joint_names, np.array([q, q + 0.1]))
    times = np.array([0.0, 1.0])
    still = np.zeros((2, len(q)))
    cube = scene.objects["cube"]
    return {
        "float": 0.3, "int": 2, "bool": True, "Any": 0.3,
        "SE3": SE3.from_xyz_rpy([0.4, 0.1, 0.3]), "SO3": SO3.identity(),
        "PlanningScene": scene, "RobotModel": model, "CollisionObject": cube, "Group": arm,
        "Gripper": next(iter(model.grippers.values())), "Link": model.links["panda_link3"],
        "JointState": JointState(arm.joint_names, q), "JointPath": path,
        "JointTrajectory": JointTrajectory(arm.joint_names, times, path.waypoints, still, still),
        "ErrorCode": ErrorCode.FAILURE, "Shape": Box(0.1, 0.1, 0.1), "Box": Box(0.1, 0.1, 0.1),
        "Sphere": Sphere(0.1), "Mesh": Mesh(np.array(CUBE, float) / 20, np.array(FACES)),
        "Path": Path("no_such_file"), "Cell": cell(), "Event": threading.Event(),
        "Generator": np.random.default_rng(0), "Vector": np.array([0.0, 0.0, 1.0]),
        "tuple[float, float, float]": (0.1, 0.2, 0.3), "tuple[float, float]": (0.1, 0.2),
        "tuple[tuple[Shape, SE3], ...]": ((Box(0.1, 0.1, 0.1), SE3.identity()),),
        "dict[str, Any]": {}, "Mapping[str, Any]": {}, "Mapping[str, float]": {"panda_joint1": 0.1},
        "Color": (0.5, 0.5, 0.5, 1.0),
    }  # fmt: skip


@functools.cache
def by_name() -> dict[str, Any]:
    """Texts and arrays, whose hints do not say what they mean."""
    q = by_type()["JointState"].positions
    links = ("panda_link3", "panda_link4")
    points = np.array(CUBE, float) / 20
    return {
        "group": "arm", "group_name": "arm", "link": links[0], "tip": "panda_hand", "frame": "world",
        "object": "cube", "name": "cube", "body": "cube", "other": "table", "a": 0.1, "b": 0.2,
        "joint_names": by_type()["JointState"].joint_names, "names": by_type()["JointState"].joint_names,
        "links": links, "touch_links": links, "q": q, "positions": q, "seed": q, "start": q, "goal": q,
        "velocities": 0 * q, "accelerations": 0 * q, "q0": q, "lower": q - 1, "upper": q + 1, "limits": q + 3,
        "waypoints": np.array([q, q + 0.1]), "path": np.array([q, q + 0.1]), "configurations": q[None],
        "points": points, "vertices": points, "centers": points, "cloud": points,
        "normals": points / np.linalg.norm(points, axis=1)[:, None], "faces": np.array(FACES),
        "times": np.array([0.0, 1.0]), "depth": np.ones((4, 5)), "image": np.zeros((4, 5, 3), np.uint8),
        "matrix": np.eye(3), "xyz": [0.1, 0.2, 0.3], "rpy": [0.1, 0.2, 0.3], "axis": [0.0, 0.0, 1.0],
        "direction": [0.0, 0.0, 1.0], "translation": np.array([0.1, 0.2, 0.3]), "quat_xyzw": [0, 0, 0, 1],
        "quat_wxyz": [1, 0, 0, 0], "rotvec": [0.1, 0.2, 0.3], "size": (0.1, 0.1, 0.1), "offsets": [0.1, 0.2],
    }  # fmt: skip


def sample(parameter: inspect.Parameter) -> Any:
    """A valid value; LookupError if none is known."""
    hint = re.sub(r"\b(\w+\.)+(?=\w)", "", str(parameter.annotation)).strip("'\"")
    hint = hint.removeprefix("<class ").removesuffix(">").strip("'\"")
    kinds = [kind.strip() for kind in re.split(r"\|(?![^\[]*\])", hint)]
    types, names = by_type(), by_name()
    first = kinds[0]
    if first in (
        "str",
        "ArrayLike",
        "Array",
        "F64",
        "Iterable[str]",
        "Sequence[str]",
        "tuple[str, ...]",
    ) or first.startswith("NDArray"):
        if parameter.name in names:
            return names[parameter.name]
        if first == "str":
            return "cube"
        if "str" in first:
            return ("panda_link3",)
        return names["q"]
    for kind in kinds:
        if kind in types:
            return types[kind]
        inner = re.fullmatch(r"(?:Sequence|Iterable|list|tuple)\[([\w.]+)(?:, \.\.\.)?\]", kind)
        if inner and inner[1] in types:
            return (types[inner[1]],)
    if parameter.default is not inspect.Parameter.empty:
        return parameter.default
    raise LookupError(hint)


NAN, INF = float("nan"), float("inf")
HUGE = 10**400  # no float can hold it
LONG = 2**63  # no array can be as long


def is_array(value: Any) -> bool:
    """Whether a valid value is an array, or a list of numbers in the place of one."""
    return isinstance(value, np.ndarray) or (
        isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], int | float)
    )


def misuses(value: Any) -> list[Any]:
    """Wrong values in the place of a valid one."""
    numbers = [
        NAN,
        INF,
        -INF,
        1e308,
        -1e308,
        1e-320,
        -1.0,
        0.0,
        -0.0,
        2**63,
        HUGE,
        np.float32(NAN),
        1j,
        None,
        [],
    ]
    if isinstance(value, bool):
        return [NAN, "yes"]
    if isinstance(value, int | float):
        return [*numbers, np.array([NAN]), "0.3", np.zeros(0)]
    if isinstance(value, str):
        return [
            "",
            "\0",
            "no such name",
            "x" * 100_000,
            "../..",
            "a b",
            "\ud800",
            "%s{}",
            b"cube",
            None,
            NAN,
            (),
        ]
    if isinstance(value, np.ndarray) or (
        isinstance(value, list | tuple) and value and isinstance(value[0], int | float)
    ):
        array = np.asarray(value)
        return [
            *(wrong for number in (NAN, INF, 1e308, -1.0) if (wrong := _with(array, number)) is not None),
            np.full(array.shape, NAN), np.zeros(0), np.zeros((0, 3)), np.zeros((3, 0)), np.zeros((1, 1, 1)),
            np.zeros(array.size + 1), np.zeros((2, 5)), array.astype(object), array.astype("U8"),
            array.astype(complex), array.astype(np.float32), array[..., ::-1], np.zeros((100_000, 3)), [],
            [[]], [[1.0], [2.0, 3.0]], NAN, None, "text", {}, np.array(None), np.zeros((2, 0, 2)),
        ]  # fmt: skip
    if isinstance(value, list | tuple | frozenset | set):
        return [(), ("no such name",), ("",), (*value, *value), ("x" * 100_000,), NAN]
    if isinstance(value, dict):
        return [{"no such name": 1.0}, {"": NAN}, {"panda_joint1": NAN}, {"panda_joint1": INF}, {1: 2}]
    return [None, NAN, "text", (), object()]


def _with(array: np.ndarray, number: float) -> np.ndarray | None:
    """The array with one element replaced."""
    if array.size == 0 or array.dtype.kind not in "fiu":
        return None
    wrong = array.astype(float)
    wrong.flat[array.size // 2] = number
    return wrong
