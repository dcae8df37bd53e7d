"""Two UR10 as one model, and motions for them."""

from __future__ import annotations

from benchmarks.ur_stops import MOVE, pair, swing
from tests.drivers.ur.emulated import free_port

from armcell.drivers import DriverOptions, drivers
from armcell.model import load_robot
from armcell.scene import PlanningScene

__all__ = ["MOVE", "load_robot", "made", "one_arm", "pair", "swing", "two_arms"]


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


def made(model, arms: dict, **settings):
    # Wide, for machines that other programs fill; test_safety.py sets its own.
    settings = {"max_state_age": 0.3, "watchdog": 0.5, **settings}
    options = DriverOptions(extra={"real": {"arms": arms, **settings}})
    return drivers["real"](PlanningScene.of(model), options)
