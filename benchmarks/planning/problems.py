"""MotionBenchMaker's problems as every planner here gets them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.cli.bench_mbm import find_robot, read_problems

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """One start and one goal (dof,) among obstacles, in the problem file's own form."""

    family: str
    index: int
    start: Array
    goal: Array
    obstacles: list[dict[str, Any]]

    @property
    def key(self) -> str:
        return f"{self.family}/{self.index}"


@dataclass(frozen=True, eq=False)
class Robot:
    """Files of a robot and the joints that are planned for."""

    name: str
    urdf: Path
    joints: tuple[str, ...]
    fixed: dict[str, float]

    @property
    def srdf(self) -> Path:
        return self.urdf.with_suffix(".srdf")


def load(folder: Path, robot: str, limit: int = 0) -> tuple[Robot, list[Problem]]:
    """A robot of the data folder and its problems, one of each family in turn."""
    file = folder / f"mbm_{robot}.json.gz"
    data = read_problems(file)
    families = [
        [_problem(family, p) for p in some[: limit or None]] for family, some in data["families"].items()
    ]
    mixed = [p for row in itertools.zip_longest(*families) for p in row if p is not None]
    return Robot(robot, Path(find_robot(robot, file)), tuple(data["joints"]), data["fixed_joints"]), mixed


def _problem(family: str, p: dict[str, Any]) -> Problem:
    start, goal = np.array(p["start"], float), np.array(p["goals"][0], float)
    return Problem(family, p["index"], start, goal, p["obstacles"])
