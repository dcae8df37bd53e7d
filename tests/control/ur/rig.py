"""Two UR10 as one model, and motions for them."""

from __future__ import annotations

import numpy as np
from tests.control.ur.emulated import free_port

from armcell.control import DriverOptions, drivers
from armcell.core import SE3, JointTrajectory
from armcell.model import Part, compose, load_robot
from armcell.scene import PlanningScene

MOVE = np.array([0.8, -0.3, 0.3, 0.2, 0.3, 0.4])


def one_arm(host: str, arm: dict | None = None, **settings):
    """The driver of a single UR10 (group "arm"), not yet connected."""
    block = {"host": host, "model": "UR10", "port": free_port(), **(arm or {})}
    return made(load_robot("ur10"), {"arm": block}, **settings)


def two_arms(hosts: list[str], left: dict | None = None, right: dict | None = None, **settings):
    """The driver of two UR10 (groups "left_arm", "right_arm")."""
    blocks = [
        {"host": h, "model": "UR10", "port": free_port(), **(more or {})}
        for h, more in zip(hosts, (left, right), strict=True)
    ]
    return made(pair(), dict(zip(("left_arm", "right_arm"), blocks, strict=True)), **settings)


def pair():
    robot = load_robot("ur10")
    parts = [
        Part(robot, f"{side}_", T_parent_root=SE3.from_xyz(0, y, 0))
        for side, y in (("left", 0.75), ("right", -0.75))
    ]
    return compose("pair", parts)


def made(model, arms: dict, **settings):
    # Wide, for machines that other programs fill; test_safety.py sets its own.
    settings = {"max_state_age": 0.3, "watchdog": 0.5, **settings}
    options = DriverOptions(extra={"real": {"arms": arms, **settings}})
    return drivers["real"](PlanningScene.of(model), options)


def swing(driver, names, distance, seconds: float, every: float = 0.02) -> JointTrajectory:
    """From where the arms are, by `distance` [rad], with a cosine of speed."""
    q0 = driver.joint_state().reindexed(names).positions
    t = np.linspace(0.0, seconds, round(seconds / every) + 1)[:, None]
    w, d = np.pi / seconds, np.asarray(distance)
    return JointTrajectory(
        tuple(names), t[:, 0], q0 + (1 - np.cos(w * t)) / 2 * d, w / 2 * np.sin(w * t) * d,
        w * w / 2 * np.cos(w * t) * d,
    )  # fmt: skip
