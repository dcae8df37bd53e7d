"""The twin guard against an emulated UR10 or UR10e in physics: false stops, how soon faults are found.

    python -m benchmarks.twin_guard --clean 40 --rounds 3 --model UR10

Each fault is switched on at a random moment of a random motion; the times are from the dashboard's answer to
the guard's note. A clean motion that did not end well is the guard's doing only where the guard said so.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from armcell.cell import Cell, LiveCell, load
from armcell.cell.twin import thresholds_file
from armcell.cell.twin_learning import learn_thresholds
from armcell.core import InputError, JointGoal, JointState, PlanRequest
from armcell.drivers import Driver
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.execution import execute
from armcell.planning import plan, warm_up
from benchmarks.picture import dots

HOST = "127.0.0.77"
ROOM = 0.015  # [m] that motions keep from everything: arms in physics give way by half of that
CELL = """robot: ur10_gripper
start: {arm: home, gripper: open}
objects:
  floor: {box: [3.0, 3.0, 0.04], pose: [0, 0, -0.021]}

real:
  max_state_age: 0.5
  watchdog: 0.5
  arms: {arm: {host: HOST, model: MODEL}}
"""
FROM_START = "2 kg payload from the start"
FAULTS = {
    FROM_START: "armcell fault payload 2",
    "2 kg payload": "armcell fault payload 2",
    "2 degree offset": f"armcell fault offset 1 {np.deg2rad(2.0):.6f}",
    "50 ms delay": "armcell fault delay 0.05",
    "blocked joint": "armcell fault block 0",
}


@contextmanager
def emulator(cell: Path, model: str = "UR10") -> Iterator[None]:
    """A fresh arm: what was hung on it or blocked is gone."""
    command = [
        sys.executable,
        "-m",
        "armcell",
        "ur-controller",
        "--cell",
        str(cell),
        "--host",
        HOST,
        "--model",
        model,
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    if hasattr(os, "setpriority") and os.geteuid() == 0:
        os.setpriority(os.PRIO_PROCESS, process.pid, -15)
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    try:
        while True:
            try:
                socket.create_connection((HOST, 29999), 1.0).close()
                break
            except OSError:
                assert process.poll() is None, "the emulator has ended"
                time.sleep(0.1)
        yield
    finally:
        process.kill()
        process.wait()


def motion(live: LiveCell, rng: np.random.Generator, speed: float):
    """A free motion to somewhere near home, long enough for a fault in its midst."""
    scene, model = live.scene(), live.model
    names = model.group("arm").joint_names
    home = model.named_state("arm", "home").reindexed(names).positions
    best = None
    for _ in range(12):  # the longest of some
        q = home + rng.uniform(-1.0, 1.0, 6)
        request = PlanRequest(
            "arm", (JointGoal(JointState(names, q)),), velocity_scaling=speed, acceleration_scaling=speed
        )
        found = plan(scene, request)
        if found.trajectory is None or found.min_clearance < ROOM:
            continue
        if best is None or found.trajectory.duration > best.duration:
            best = found.trajectory
        if best is not None and best.duration > 2.5:
            break
    assert best is not None, "no goal is free"
    return best


def arms_of(live: LiveCell) -> Driver:
    return live.driver


def deviations(live: LiveCell) -> list[tuple[float, str, str]]:
    events = arms_of(live).safety_events
    return [(e.time, e.kind, e.text) for e in events if e.kind.startswith("twin") and e.kind != "twin"]


def clean(cell: Cell, runs: int, seed: int) -> tuple[Counter[str], float, str]:
    """Motions by how they ended; how near the guard's bands they came, in bands, and with what."""
    rng, ended = np.random.default_rng(seed), Counter[str]()
    farthest, what = 0.0, ""
    with cell.connect("real") as live:
        for k in range(runs):
            before, said = len(arms_of(live).safety_events), len(deviations(live))
            result = execute(live.driver, live.ctx.gate.motion(motion(live, rng, (0.2, 0.4, 0.6)[k % 3])))
            for event in arms_of(live).safety_events[before:]:
                if event.kind == "twin":
                    most, text = event.text.split("at most ")[1].split(" of a band ")
                    farthest, what = max((farthest, what), (float(most), text))
            said = deviations(live)[said:]
            how = "well" if result.ok else "other"
            if said:
                how = "refused" if said[0][1] == "twin refused" else "slowed or stopped"
            ended[how] += 1
            if how != "well":
                print(f"  motion {k}: {how}: {result.code.name} {result.message} {said}", flush=True)
                time.sleep(1.0)  # until it rests: the next motion begins where it stands
            if arms_of(live).fault() is not None:
                arms_of(live).resume()
    return ended, farthest, what


def detect(cell: Cell, fault: str, seed: int, speed: float) -> tuple[float, float, str]:
    """Seconds until it was first noticed and until the stop, and what was said."""
    rng, at = np.random.default_rng(seed), []
    share = rng.uniform(0.05, 0.55)  # of the motion: half a second is left after it

    def begin() -> None:
        with DashboardClient(HOST) as dashboard:
            dashboard.ask(FAULTS[fault])

    def fault_at(fraction: float) -> None:
        if fraction > (0.0 if fault == FROM_START else share) and not at:
            if fault != FROM_START:
                begin()
            at.append(time.monotonic())

    with cell.connect("real") as live:
        if fault == FROM_START:
            begin()
            time.sleep(1.0)  # the arm has given way under it, and rests
        result = execute(live.driver, live.ctx.gate.motion(motion(live, rng, speed)), progress=fault_at)
        time.sleep(0.1)
        found = deviations(live)
    if not found or not at:
        return float("nan"), float("nan"), f"not found: {result.code.name} {result.message}"
    stops = [t for t, kind, _ in found if kind == "twin deviation"]
    return found[0][0] - at[0], (stops[0] - at[0]) if stops else float("nan"), found[-1][2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clean", type=int, default=40, help="clean motions")
    parser.add_argument("--rounds", type=int, default=3, help="of each fault")
    parser.add_argument("--motions", type=int, default=12, help="to learn from")
    parser.add_argument("--model", default="UR10", choices=("UR10", "UR10e"))
    parser.add_argument("--fault", default="", help="only those with this in their name")
    parser.add_argument("--seed", type=int, default=100, help="of the faults' motions and moments")
    parser.add_argument("--picture", type=Path, help="where to draw how soon faults were noticed")
    options = parser.parse_args()
    warm_up()
    times: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cell.yaml"
        file.write_text(CELL.replace("HOST", HOST).replace("MODEL", options.model))
        cell = load(file)
        with emulator(file, options.model):
            bands = learn_thresholds(cell, options.motions)
            bands.save(thresholds_file(cell))
            arm = bands.arms["arm"]
            print(f"{options.model}, learned from {arm.samples} looks: lag {arm.lag * 1000:.1f} ms,", end=" ")
            print(f"position {np.rad2deg(arm.position).round(2).tolist()} deg,", end=" ")
            print(f"velocity {arm.velocity.round(3).tolist()} rad/s,", end=" ")
            print(f"current {arm.current.round(2).tolist()} A, load {arm.load:.2f} kg,", end=" ")
            print(f"round trip {arm.trip * 1000:.0f} ms", flush=True)
            ended, farthest, what = clean(cell, options.clean, 1)
            print(f"{options.clean} clean: {dict(ended)}, farthest {farthest:.2f} bands {what}", flush=True)
        for name in (n for n in FAULTS if options.fault in n):
            first, stop = [], []
            for k in range(options.rounds):
                with emulator(file, options.model):
                    try:
                        found = detect(cell, name, options.seed + k, (0.2, 0.4, 0.6)[k % 3])
                    except InputError as error:
                        found = float("nan"), float("nan"), str(error)
                    noticed, stopped, text = found
                    print(f"  {name}: noticed {noticed:.3f} s, stopped {stopped:.3f} s: {text}", flush=True)
                    first.append(noticed)
                    stop.append(stopped)
            if not first:
                continue
            times |= {f"{name}: noticed": first, f"{name}: stopped": stop}
            missed = int(np.isnan(first).sum())
            print(f"{name}: {missed} of {len(first)} missed, noticed in {np.nanmedian(first):.3f} s (worst "
                  f"{np.nanmax(first):.3f}), stopped in {np.nanmedian(stop):.3f} s (worst "
                  f"{np.nanmax(stop):.3f})", flush=True)  # fmt: skip
    if options.picture and times:
        dots(options.picture, times, "since the fault [s]", 0.5)


if __name__ == "__main__":
    main()
