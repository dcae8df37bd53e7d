"""Stops at random instants while two emulated UR10 move, and the regularity of streaming.

    sudo chrt -f 10 python -m benchmarks.ur_stops --count 50

Judged by what the emulator itself wrote down at every control step (`armcell ur-controller --trace`): how
long after the event until both arms rest, the largest step of a joint, and what moved before the resume.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from tests.execution.ungated import execute

from armcell.core import SE3, ArmcellError, InputError, JointTrajectory
from armcell.drivers import DriverOptions, drivers
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.emulators.ur.controller import TRACE
from armcell.model import MountedRobot, RobotModel, compose, load_robot
from armcell.scene import PlanningScene
from benchmarks.picture import dots

MOVE = np.array([0.8, -0.3, 0.3, 0.2, 0.3, 0.4])
STOPS = {
    "protective stop": ("unlock protective stop",),
    "safeguard stop": ("armcell safeguard reset",),
    "emergency stop": ("armcell emergency release", "power on", "brake release"),
    "fault drop 0.3": (),
    "fault freeze 0.5": (),
}
STILL = 1e-4  # [rad] from where it is at the end of the look: then an arm rests
LOOK = 1.2  # [s] after each event


@contextmanager
def emulator(hosts: list[str], trace: Path, model: str = "UR10") -> Iterator[None]:
    """Two emulated arms in a process of their own."""
    command = [sys.executable, "-m", "armcell", "ur-controller", "--model", model, "--trace", str(trace)]
    process = subprocess.Popen(
        [*command, *(part for host in hosts for part in ("--host", host))], stdout=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + 60
        for host in hosts:
            while True:
                try:
                    socket.create_connection((host, 29999), 1.0).close()
                    break
                except OSError:
                    if time.monotonic() > end:
                        raise
                    time.sleep(0.1)
        yield
    finally:
        process.kill()
        process.wait()


def ask(host: str, *commands: str) -> None:
    with DashboardClient(host) as dashboard:
        for command in commands:
            with suppress(ArmcellError):  # a link that drops gives no answer
                dashboard.ask(command)


def pair() -> RobotModel:
    """Two UR10, 1.5 m apart, as one model (groups "left_arm", "right_arm")."""
    robot = load_robot("ur10")
    parts = [
        MountedRobot(robot, f"{side}_", T_parent_root=SE3.from_xyz(0, y, 0))
        for side, y in (("left", 0.75), ("right", -0.75))
    ]
    return compose("pair", parts)


def two_arms(hosts: list[str], ports: list[int], model: str = "UR10", **settings):
    """The driver of two arms (groups "left_arm", "right_arm"), not yet connected."""
    arms = {
        group: {"host": host, "model": model, "port": port}
        for group, host, port in zip(("left_arm", "right_arm"), hosts, ports, strict=True)
    }
    options = DriverOptions(extra={"real": {"arms": arms, **settings}})
    return drivers["real"](PlanningScene.of(pair()), options)


def swing(driver, names, distance, seconds: float, every: float = 0.02) -> JointTrajectory:
    """From where the arms are, by `distance` [rad], with a cosine of speed."""
    q0 = driver.joint_state().reindexed(names).positions
    t = np.linspace(0.0, seconds, round(seconds / every) + 1)[:, None]
    w, d = np.pi / seconds, np.asarray(distance)
    return JointTrajectory(
        tuple(names), t[:, 0], q0 + (1 - np.cos(w * t)) / 2 * d, w / 2 * np.sin(w * t) * d,
        w * w / 2 * np.cos(w * t) * d,
    )  # fmt: skip


def read_trace(path: Path) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """By arm: the wall's time (n,) and actual positions (n, 6)."""
    data = path.read_bytes()
    lines = np.array(list(TRACE.iter_unpack(data[: len(data) // TRACE.size * TRACE.size])))
    return {arm: (lines[lines[:, 0] == arm, 1], lines[lines[:, 0] == arm, 3:9]) for arm in (0, 1)}


def judged(trace: dict, moments: list[tuple[str, float, float]]) -> list[dict]:
    """Of every event, over both arms: time to rest [s], farthest from there afterwards [rad], and speed
    before [rad/s]."""
    rows = []
    for stop, at, until in moments:
        rest = moved = 0.0
        speed = 0.0
        for wall, q in trace.values():
            after = (wall > at) & (wall < until)
            end = q[after][-1]
            off = np.abs(q[after] - end).max(axis=1)
            late = np.flatnonzero(off > STILL)
            rest = max(rest, float(wall[after][late[-1]] - at) if len(late) else 0.0)
            moved = max(moved, float(off[wall[after] > at + 0.3].max(initial=0.0)))
            before = (wall > at - 0.05) & (wall <= at)
            if before.sum() > 2:
                moving = np.abs(np.diff(q[before], axis=0)).max() / np.diff(wall[before]).mean()
                speed = max(speed, float(moving))
        rows.append({"stop": stop, "rest_s": rest, "moved_rad": moved, "speed": speed})
    return rows


def spoilt(driver) -> bool:
    """Whether the machine itself was late, not the robot; the arms are let move again."""
    fault = driver.fault()
    if fault is None or fault.kind not in ("stale state", "program ended"):
        return False
    time.sleep(0.5)
    driver.resume()
    return True


def moving(driver, together: bool, seconds: float):
    """Have both arms under way for so long."""
    left, right = driver.arms.values()
    for _ in range(6):
        if together:
            joints = [*left.joint_names, *right.joint_names]
            plans = [swing(driver, joints, [*MOVE, *-MOVE], 3.0)]
        else:
            plans = [swing(driver, arm.joint_names, MOVE, 3.0) for arm in (left, right)]
        running = [driver.follow(plan) for plan in plans]
        time.sleep(seconds)
        if all(r.state() == "running" for r in running) and driver.fault() is None:
            return plans
        if not spoilt(driver):
            raise AssertionError([r.state() for r in running])
    raise AssertionError("the machine is too busy for this")


def stops(hosts: list[str], ports: list[int], count: int, seed: int = 7, tell=print, **settings) -> dict:
    """Events at random instants, of every kind in turn, every other one with both arms on one clock."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace"
        moments, refused, unresumed = [], 0, 0
        with emulator(hosts, trace), two_arms(hosts, ports, **settings) as driver:
            left = next(iter(driver.arms.values()))
            for i in range(count):
                stop, undo = list(STOPS.items())[i % len(STOPS)]
                plans = moving(driver, (i // len(STOPS)) % 2 == 1, float(rng.uniform(0.3, 2.4)))
                victim = hosts[int(rng.integers(2))]
                at = time.monotonic()
                ask(victim, f"armcell {stop}")  # a frozen one answers when it has thawed
                time.sleep(LOOK)
                if driver.fault() is None:
                    raise AssertionError(f"nothing noticed: {stop}")
                try:
                    driver.follow(plans[0])
                except InputError:
                    refused += 1
                moments.append((stop, at, time.monotonic()))
                if undo:
                    ask(victim, *undo)
                    time.sleep(0.8)
                unresumed += driver.fault() is not None  # the cause is gone, and it still stands
                driver.resume()
                for _ in range(5):
                    done = execute(driver, swing(driver, left.joint_names, -0.2 * MOVE, 1.0))
                    if done.ok or not spoilt(driver):
                        break
                if not done.ok:
                    raise AssertionError(f"after {stop}: {done.message}")
                for arm in driver.arms.values():  # not farther and farther away
                    execute(driver, swing(driver, arm.joint_names, -arm.q, 3.0))
                    if driver.fault() is not None:
                        spoilt(driver)
                tell(f"  {i + 1} of {count}: {stop}")
            events = [e.kind for e in driver.safety_events]
        found = read_trace(trace)
    rows = judged(found, moments)
    step = max(float(np.abs(np.diff(q, axis=0)).max()) for _, q in found.values())
    by_kind = {s: [r["rest_s"] for r in rows if r["stop"] == s] for s in STOPS}
    return {
        "events": count, "worst_rest_s": max(r["rest_s"] for r in rows), "rest_by_kind_s": by_kind,
        "moved_after_rad": max(r["moved_rad"] for r in rows), "largest_step_rad": step, "refused": refused,
        "stood_until_resumed": unresumed, "fastest_before": max(r["speed"] for r in rows),
        "peer_stopped": events.count("peer stopped"), "resumed": events.count("resumed"),
    }  # fmt: skip


def periods(hosts: list[str], ports: list[int], model: str, seconds: float = 10.0, **settings) -> dict:
    """Both arms streamed on one clock: time between points sent [ms]."""
    with (
        tempfile.TemporaryDirectory() as folder,
        emulator(hosts, Path(folder) / "trace", model),
        two_arms(hosts, ports, model, **settings) as driver,
    ):
        left, right = driver.arms.values()
        joints = [*left.joint_names, *right.joint_names]
        running = driver.follow(swing(driver, joints, [*MOVE, *-MOVE], seconds))
        while running.state() == "running":
            time.sleep(0.1)
        gaps = 1000 * np.diff(running.sent_at)
    p50, p99 = np.percentile(gaps, (50, 99))
    return {"model": model, "points": len(gaps) + 1, "median_ms": float(p50), "p99_ms": float(p99),
            "max_ms": float(gaps.max()), "ended": running.state()}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50, help="0: only how regular streaming is")
    parser.add_argument("--max-state-age", type=float, default=0.05)
    parser.add_argument("--watchdog", type=float, default=0.1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path, help="where to draw how soon the arms rested")
    given = parser.parse_args()
    limits = {"max_state_age": given.max_state_age, "watchdog": given.watchdog}
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    found: dict = {"load": os.getloadavg()[0], **limits}
    hosts, ports = ["127.0.0.62", "127.0.0.63"], [50721, 50731]
    for model in ("UR10", "UR10e"):
        found[f"periods {model}"] = p = periods(hosts, ports, model, **limits)
        print(
            f"{model}: streamed every {p['median_ms']:.2f} ms, p99 {p['p99_ms']:.2f}, max {p['max_ms']:.1f}"
        )
    if given.count:
        found["stops"] = s = stops(hosts, ports, given.count, **limits)
        worst = {kind: round(max(rests, default=0.0), 3) for kind, rests in s["rest_by_kind_s"].items()}
        print(json.dumps(s | {"rest_by_kind_s": worst}, indent=1))
        if given.picture:
            dots(given.picture, s["rest_by_kind_s"], "from the event until both arms rest [s]", 0.3)
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
