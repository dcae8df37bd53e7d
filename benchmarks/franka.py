"""Figures of the Franka driver against the emulated controller: stops, a busy computer, picks, cycles.

    sudo chrt -f 10 python -m benchmarks.franka stops              # 50 stops at random instants
    sudo chrt -f 10 python -m benchmarks.franka stops --backend franky
    sudo python -m benchmarks.franka busy                          # motions while all processors are busy
    sudo chrt -f 10 python -m benchmarks.franka picks              # 20 seeds of panda_pick; --model panda
    sudo chrt -f 10 python -m benchmarks.franka handovers          # 20 seeds of panda_ur10e_handover
    sudo python -m benchmarks.franka cycles                        # 1e6 cycles of pylibfranka, 17 minutes

The trace that the emulator writes in every control step decides when the arm rests and how far it steps.
`picks`, `handovers` and `cycles` need a quiet computer.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from armcell.cell import load, run_task, with_values
from armcell.core import ArmcellError, InputError, JointTrajectory
from armcell.drivers import DriverOptions
from armcell.drivers.real import RealDriver
from armcell.emulators.franka import scene_without_cell
from armcell.emulators.franka.controller import TRACE
from armcell.emulators.franka.operator_server import PORT as OPERATOR
from armcell.planning import warm_up

HOST, UR_HOST = "127.0.0.65", "127.0.0.66"
SWING = np.array([0.6, 0.2, -0.4, 0.4, 0.4, -0.4, 0.6])  # [rad] in `SWING_TIME`
SWING_TIME = 3.0  # [s]
STOPS = {  # operator's command, and the command that undoes it
    "reflex": "",
    "user stop on": "user stop off",
    "fault drop 0.3": "",
    "fault freeze 0.05": "",
    "fault garbage 100": "",
}
STILL = 1e-4  # [rad] from where it is at the end of the look: then an arm rests
LOOK = 1.2  # [s] after each event
CAP_SYS_NICE, PR_CAPBSET_DROP = 23, 24


def operate(host: str, command: str) -> str:
    """Answer of the emulator's operator port, or an empty text if a fault cuts it off."""
    with suppress(OSError), socket.create_connection((host, OPERATOR), 5.0) as sock:
        sock.sendall(command.encode() + b"\n")
        with sock.makefile("rb") as file:
            return file.readline().decode("ascii", "replace").strip()
    return ""


@contextmanager
def emulator(*command: str, log: Path | None = None) -> Iterator[None]:
    """An `armcell` command that emulates controllers, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        log = log or Path(folder) / "log"
        with log.open("w") as file:
            process = subprocess.Popen([sys.executable, "-m", "armcell", *command], stdout=file, stderr=file)
        try:
            end = time.monotonic() + 120
            while "an emulator, not a robot" not in log.read_text():
                if process.poll() is not None or time.monotonic() > end:
                    raise RuntimeError(log.read_text())
                time.sleep(0.1)
            yield
        finally:
            process.kill()
            process.wait()


def one_arm(backend: str = "own", **settings) -> RealDriver:
    arms = {"arm": {"host": HOST, "model": "fr3", "backend": backend, "gripper": {"kind": "hand"}}}
    real = {"kind": "franka", "arms": arms, "twin": False, **settings}
    return RealDriver(scene_without_cell(), DriverOptions(extra={"real": real}))


def motion(driver: RealDriver, goal: np.ndarray, seconds: float) -> JointTrajectory:
    """From where the arm is to a goal (7,) [rad], with a cosine of speed that starts and ends smoothly."""
    (arm,) = driver.arms.values()
    q0 = arm.setpoint()[0]
    u = np.linspace(0.0, 1.0, round(seconds / 0.01) + 1)[:, None]
    s, ds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2 / seconds
    dds = (60 * u - 180 * u**2 + 120 * u**3) / seconds**2
    d = goal - q0
    return JointTrajectory(arm.joint_names, u[:, 0] * seconds, q0 + s * d, ds * d, dds * d)


def finished(driver: RealDriver, trajectory: JointTrajectory) -> object:
    handle = driver.follow(trajectory)
    while handle.state() == "running":
        time.sleep(0.01)
    return handle.state()


def resumed(driver: RealDriver, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while True:
        try:
            return driver.resume()
        except ArmcellError:  # a dropped link refuses connections for a while
            if time.monotonic() > end:
                raise
            time.sleep(0.1)


def read_trace(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The wall's time (n,) [s] and actual positions (n, 7) [rad]."""
    data = path.read_bytes()
    rows = np.array(list(TRACE.iter_unpack(data[: len(data) // TRACE.size * TRACE.size])))
    return rows[:, 1], rows[:, 3:10]


def judged(wall: np.ndarray, q: np.ndarray, event: str, at: float, until: float) -> dict:
    """Time to rest [s], motion after 300 ms [rad], and speed before the event [rad/s]."""
    after = (wall > at) & (wall < until)
    off = np.abs(q[after] - q[after][-1]).max(axis=1)
    late = np.flatnonzero(off > STILL)
    before = (wall > at - 0.05) & (wall <= at)
    return {
        "event": event,
        "rest_s": float(wall[after][late[-1]] - at) if len(late) else 0.0,
        "moved_rad": float(off[wall[after] > at + 0.3].max(initial=0.0)),
        "speed": float(np.abs(np.diff(q[before], axis=0)).max() / 0.001) if before.sum() > 2 else 0.0,
    }


def under_way(driver: RealDriver, home: np.ndarray, seconds: float, stopped: list[str]) -> None:
    """Start a swing from home that is under way after some seconds."""
    for _ in range(10):
        if driver.fault() is None and finished(driver, motion(driver, home, 2.0)) == "done":
            handle = driver.follow(motion(driver, home + SWING, SWING_TIME))
            time.sleep(seconds)
            if handle.state() == "running" and driver.fault() is None:
                return
        stopped.append(str(driver.fault()))  # the computer was late, or the hand has not reconnected
        time.sleep(0.5)
        resumed(driver)
    raise RuntimeError(f"the computer is too busy: {stopped}")


def stops(count: int, backend: str, seed: int = 7, **settings) -> dict:
    """Events at random instants of a motion, of every kind in turn."""
    rng = np.random.default_rng(seed)
    moments, refused, unresumed, stopped = [], 0, 0, []
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace"
        with (
            emulator("franka-controller", "--host", HOST, "--trace", str(trace)),
            one_arm(backend, **settings) as driver,
        ):
            (arm,) = driver.arms.values()
            home = arm.setpoint()[0].copy()
            for i in range(count):
                event, undo = list(STOPS.items())[i % len(STOPS)]
                under_way(driver, home, float(rng.uniform(0.3, 0.8 * SWING_TIME)), stopped)
                at = time.monotonic()
                operate(HOST, event)
                time.sleep(LOOK)
                fault = driver.fault()
                if fault is None:
                    raise AssertionError(f"{event} was not noticed")
                try:
                    driver.follow(motion(driver, home, 2.0))
                except InputError:
                    refused += 1
                driver.command(arm.joint_names, home, np.zeros(7))  # must not be sent
                time.sleep(0.3)
                moments.append((event, at, time.monotonic(), fault.kind))
                if undo:
                    operate(HOST, undo)
                unresumed += driver.fault() is not None  # the cause is gone, the stop remains
                resumed(driver)
                print(f"  {i + 1} of {count}: {event}: {fault}", flush=True)
            finished(driver, motion(driver, home, 2.0))
        wall, q = read_trace(trace)
    rows = [judged(wall, q, *moment[:3]) for moment in moments]
    rests = {event: [round(r["rest_s"], 3) for r in rows if r["event"] == event] for event in STOPS}
    return {
        "events": count,
        "worst_rest_s": max(r["rest_s"] for r in rows),
        "rest_by_event_s": rests,
        "moved_before_resume_rad": max(r["moved_rad"] for r in rows),
        "largest_step_rad": float(np.abs(np.diff(q, axis=0)).max()),
        "fastest_before": max(r["speed"] for r in rows),
        "refused": refused,
        "stood_until_resumed": unresumed,
        "faults": {e: sorted({m[3] for m in moments if m[0] == e}) for e in STOPS},
        "further_stops": stopped,
    }


@contextmanager
def busy_processors(per_processor: int = 2) -> Iterator[None]:
    loop = [sys.executable, "-c", "while True: pass"]
    loads = [subprocess.Popen(loop) for _ in range(per_processor * (os.cpu_count() or 1))]
    try:
        yield
    finally:
        for load_ in loads:
            load_.kill()
            load_.wait()


def busy(count: int, backend: str, **settings) -> dict:
    """Motions while all processors are busy; the second half without real-time priority for the worker."""
    found: dict = {}
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace"
        with emulator("franka-controller", "--host", HOST, "--trace", str(trace)):
            for priority in ("real-time", "normal"):
                if priority == "normal":  # processes that start from now on
                    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)
                with one_arm(backend, **settings) as driver, busy_processors():
                    (arm,) = driver.arms.values()
                    home, outcomes = arm.setpoint()[0].copy(), []
                    for i in range(count):
                        goal = home + (SWING if i % 2 == 0 else 0.0)
                        outcome = finished(driver, motion(driver, goal, SWING_TIME))
                        fault = driver.fault()
                        outcomes.append("done" if outcome == "done" else f"{outcome}: {fault}")
                        print(f"  {priority} priority, {i + 1} of {count}: {outcomes[-1]}", flush=True)
                        if fault is not None:
                            time.sleep(0.5)
                            resumed(driver)
                    finished(driver, motion(driver, home, SWING_TIME))
                    resumed(driver)
                found[priority] = {
                    "done": outcomes.count("done"),
                    "ended": [o for o in outcomes if o != "done"],
                }
        _, q = read_trace(trace)
    steps = np.diff(q, axis=0)
    return {
        **found,
        "motions": count,
        "largest_step_rad": float(np.abs(steps).max()),
        "largest_change_of_speed": float(np.abs(np.diff(steps, axis=0)).max() / 0.001),  # [rad/s] in 1 ms
    }


def over_the_wire(name: str, values: dict, seeds: int, command: Sequence[str], placed: str) -> dict:
    """Seeds of a cell's task in mode real; what went wrong, and where the object is by physics."""
    rows = []
    warm_up()
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "log"
            with emulator(*command, "--seed", str(seed), log=log):
                cell = with_values(load(name), values)
                with cell.connect("real", seed=seed) as live:
                    result = run_task(cell, live, seed, "real")
                    believed = live.driver.object_poses()[placed].translation
                physics = np.array(operate(HOST, f"pose {placed}").split(), dtype=float)
            lines = log.read_text().splitlines()
        error = result["placement_error_m"]
        if error is None:
            error = 0.001 * result.get("measures", {}).get("placed_off_mm", np.nan)
        rows.append(
            {
                "seed": seed,
                "success": result["success"],
                "message": result["message"],
                "placed_off_mm": 1000 * (error + float(np.linalg.norm((believed - physics)[:2]))),
                "violations": [x for x in lines if "violation" in x or "reflex" in x or "stop" in x],
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    good = [r["placed_off_mm"] for r in rows if r["success"]]
    return {
        "success": f"{len(good)} of {seeds}",
        "placed_off_mm": {"median": float(np.median(good)), "max": max(good)} if good else None,
        "violations": sum(len(r["violations"]) for r in rows),
        "rows": rows,
    }


def picks(model: str, seeds: int, backend: str, **settings) -> dict:
    """Seeds of panda_pick over the wire. The placement error is an upper bound: believed and physical."""
    arms = {"arm": {"host": HOST, "model": model, "gripper": {"kind": "hand"}}}
    real = {"kind": "franka", "backend": backend, "arms": arms, **settings}
    command = ("franka-controller", "--model", model, "--cell", "panda_pick", "--host", HOST)
    return over_the_wire("panda_pick", {"real": real}, seeds, command, "cube")


def handovers(seeds: int, **settings) -> dict:
    """Seeds of the handover from a Panda to a UR10e over both vendors' wires."""
    name = "panda_ur10e_handover"
    hosts = {"real.arms.franka_arm.host": HOST, "real.arms.ur_arm.host": UR_HOST}
    values = {**hosts, "real.arms.ur_arm.port": 50765, **{f"real.{k}": v for k, v in settings.items()}}
    command = ["emulate", name, *(part for k, v in hosts.items() for part in ("--set", f"{k}={v}"))]
    return over_the_wire(name, values, seeds, command, "bar")


CLIENT = """
import json, os, sys
from contextlib import suppress
import numpy as np
from pylibfranka import ControllerMode, JointPositions, RealtimeConfig, Robot
host, count = sys.argv[1], int(sys.argv[2])
with suppress(PermissionError):
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(11))
robot = Robot(host, RealtimeConfig.kIgnore)
robot.set_collision_behavior([20.0] * 7, [40.0] * 7, [20.0] * 6, [40.0] * 6)
rates, n, aborted = np.zeros(count + 10_000), 0, []
while n < count:
    control = None  # ends an aborted motion's control
    try:
        control = robot.start_joint_position_control(ControllerMode.JointImpedance)
        t, first, moved = 0.0, None, np.array([0, 0, 0, 1, 1, 0, 1])
        while True:
            state, step = control.readOnce()
            t += step.to_sec()
            first = first or state
            rates[n] = state.control_command_success_rate
            n += 1
            if n % 60000 == 0:  # a longer look would be late for the robot
                done = rates[n - 1000 : n].mean()
                print(f"{n} cycles: mean of the last 1000 {done:.4f}", file=sys.stderr, flush=True)
            ending = n >= count and abs(t % 5.0) < 0.0015
            d = np.pi / 16 * (1 - np.cos(np.pi / 2.5 * t))
            command = JointPositions(list(np.array(first.q_d) + d * moved))
            command.motion_finished = ending
            control.writeOnce(command)
            if ending:
                break
    except Exception as error:
        aborted.append(str(error).splitlines()[0])
        robot.automatic_error_recovery()
rates = rates[:n]
print(json.dumps({"cycles": n, "median": float(np.median(rates)), "mean": float(rates.mean()),
    "p1": float(np.percentile(rates, 1)), "below 0.99": float((rates < 0.99).mean()), "aborted": aborted}))
"""


def cycles(count: int) -> dict:
    """Cycles of a joint-position motion of pylibfranka: the robot's control_command_success_rate."""
    with emulator("franka-controller", "--host", HOST):
        done = subprocess.run(
            [sys.executable, "-c", CLIENT, HOST, str(count)], stdout=subprocess.PIPE, text=True, check=True
        )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["stops", "busy", "picks", "handovers", "cycles"])
    parser.add_argument("--count", type=int, help="events, motions, seeds or cycles")
    parser.add_argument("--model", choices=["fr3", "panda"], default="fr3")
    parser.add_argument("--backend", choices=["own", "franky"], default="own")
    parser.add_argument("--max-state-age", type=float, default=0.05)
    parser.add_argument("--watchdog", type=float, default=0.1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    limits = {"max_state_age": given.max_state_age, "watchdog": given.watchdog}
    load_average = os.getloadavg()[0]
    print(f"load average {load_average:.1f} on {os.cpu_count()} processors", flush=True)
    match given.what:
        case "stops":
            found = stops(given.count or 50, given.backend, **limits)
        case "busy":
            found = busy(given.count or 10, given.backend, **limits)
        case "picks":
            found = picks(given.model, given.count or 20, given.backend, **limits)
        case "handovers":
            found = handovers(given.count or 20, **limits)
        case _:
            found = cycles(given.count or 1_000_000)
    found = {"what": given.what, "load": load_average, **limits, **found}
    print(json.dumps({k: v for k, v in found.items() if k != "rows"}, indent=1))
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
