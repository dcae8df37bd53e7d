"""Run all benchmarks in turn and write docs/benchmarks.md: their results, machine, versions, date.

    python -m benchmarks                        # everything, some hours
    python -m benchmarks --quick                # a few runs of each, for a look at whether they still work
    python -m benchmarks --only campaign wires

What was printed is kept in benchmarks/kept.json, one entry per benchmark; the page is made from it, so
benchmarks can be run on different days and by different people: commit both. Nothing else should run on the
machine meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from dataclasses import KW_ONLY, dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
KEPT = ROOT / "benchmarks" / "kept.json"
PACKAGES = (
    "mujoco", "coal", "ompl", "numba", "numpy", "pin", "toppra", "ruckig", "roboplan", "vamp-planner", "ray",
    "opencv-python-headless",
)  # fmt: skip
COLUMNS = re.compile(r" *\| *| {2,}")  # what separates the columns of a printed table
NO_HEADER = ("what", "measured", "bar")  # of tables that are printed without one
REASON = 2  # exit status of a benchmark that cannot run here and says why


@dataclass(frozen=True)
class Benchmark:
    """`python -m benchmarks.<name>`, with the arguments of a quick look and of a full one.

    Attributes:
        page: page of the docs that contains its results.
        draws: whether it takes `--picture FILE`.
    """

    name: str
    title: str
    quick: tuple[str, ...] = ()
    _: KW_ONLY
    full: tuple[str, ...] = ()
    page: str | None = None
    draws: bool = False


BENCHMARKS = (
    Benchmark("planning", "Comparison with other planners", ("--quick",), page="benchmarks_planning.md"),
    Benchmark(
        "planners",
        "Every planner",
        ("--seeds", "1", "--seconds", "1", "--out", os.devnull),
        page="benchmarks_planners.md",
    ),
    Benchmark("cartesian", "Straight lines"),
    Benchmark("changing_scenes", "Changing scenes", ("--passes", "2"), page="benchmarks_planning.md"),
    Benchmark("grasping", "Any object", ("--every", "20", "--poses", "1"), page="grasping.md"),
    Benchmark(
        "grasp_probability",
        "Predicted success of grasps",
        ("--factors", "5", "--count", "2"),
        page="grasping.md",
    ),
    Benchmark("bins", "Bins of mixed objects", ("--seeds", "1", "--counts", "12"), page="tasks.md"),
    Benchmark("mesh_poses", "Poses of known meshes", ("--set", "tune", "--poses", "1"), page="perception.md"),
    Benchmark("solid_regions", "Solid regions of meshes", ("--poses", "200"), page="grasping.md"),
    Benchmark(
        "holding",
        "Held objects",
        ("--seconds", "5", "--runs", "0"),
        full=("--runs", "10"),
        page="grasping.md",
    ),
    Benchmark("constraints", "Path constraints", ("--runs", "3", "--rejection", "2")),
    Benchmark("kernel_truth", "The kernel against exact meshes", ("--samples", "20000")),
    Benchmark("perception", "Perception", ("--scenes", "5")),
    Benchmark("robots", "Vendors' robots", page="robots.md"),
    Benchmark("robot_picks", "Picks of each robot", ("panda", "--seeds", "1"), page="robots.md"),
    Benchmark("wires", "The ROS-TCP wire", ("--seconds", "5")),
    Benchmark(
        "two_arms", "Two arms", ("--runs", "1", "--recheck", "1", "--batches", "1"), page="two_arms.md"
    ),
    Benchmark("carry", "Carrying round obstacles", ("--scenes", "4", "--recheck", "1", "--physics", "1")),
    Benchmark(
        "franka", "An emulated Franka arm", ("stops", "--count", "4"), full=("stops",), page="real_franka.md"
    ),
    Benchmark("ur_stops", "Stops of two emulated UR10", ("--count", "4"), draws=True),
    Benchmark(
        "twin_guard",
        "The twin guard",
        ("--clean", "4", "--rounds", "1"),
        full=("--clean", "500", "--rounds", "10"),
        draws=True,
    ),
    Benchmark(
        "campaign",
        "Campaigns",
        ("--trials", "20", "--rounds", "2", "--kills", "3"),
        full=("--trials", "300"),
        draws=True,
    ),
)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    names = [benchmark.name for benchmark in BENCHMARKS]
    parser.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=", ".join(names))
    parser.add_argument("--quick", action="store_true", help="a few runs of each; the page is not written")
    given = parser.parse_args()
    wanted = [benchmark for benchmark in BENCHMARKS if benchmark.name in (given.only or names)]
    kept: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    failed = []
    for benchmark in wanted:
        found = run(benchmark, given.quick)
        if found["status"] not in (0, REASON):
            failed.append(benchmark.name)
        if not given.quick:
            kept[benchmark.name] = found
            KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
            PAGE.write_text(page(kept), encoding="utf-8")
    print(f"failed: {', '.join(failed)}" if failed else f"{len(wanted)} benchmarks ran", flush=True)
    return 1 if failed else 0


def run(benchmark: Benchmark, quick: bool) -> dict[str, Any]:
    """Run one, with its output on the terminal as well."""
    words = [
        sys.executable,
        "-m",
        f"benchmarks.{benchmark.name}",
        *(benchmark.quick if quick else benchmark.full),
    ]
    if benchmark.draws and not quick:
        words += ["--picture", str(PAGE.parent / picture(benchmark))]
    print(f"\n== {benchmark.title} ({benchmark.name})", flush=True)
    load, began, lines = os.getloadavg()[0], time.monotonic(), []
    with subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
        env={**os.environ, "COLUMNS": "120", "PYTHONUNBUFFERED": "1"},
    ) as process:  # fmt: skip
        assert process.stdout is not None
        for line in process.stdout:
            sys.stdout.write(line)
            sys.stdout.flush()
            lines.append(line.rstrip())
    return {
        "status": process.returncode, "seconds": time.monotonic() - began, "load": load, "printed": lines,
        "date": time.strftime("%Y-%m-%d"), "machine": machine(), "versions": versions(),
    }  # fmt: skip


def machine() -> str:
    names = [
        line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")
    ]
    memory = [int(line.split()[1]) for line in _lines("/proc/meminfo") if line.startswith("MemTotal")]
    told = [names[0] if names else platform.machine(), f"{os.cpu_count()} cores"]
    told += [f"{memory[0] / 2**20:.0f} GiB"] if memory else []
    return ", ".join([*told, platform.platform(terse=True)])


def _lines(file: str) -> list[str]:
    try:
        return Path(file).read_text().splitlines()
    except OSError:
        return []


def versions() -> str:
    found = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"no {package}")
    return ", ".join(found)


# --- the page ---
def picture(benchmark: Benchmark) -> str:
    return f"pictures/bench_{benchmark.name}.png"


def page(kept: dict[str, Any]) -> str:
    """docs/benchmarks.md."""
    parts = [
        "# Benchmarks",
        "The command `make bench` runs every benchmark in `benchmarks/` and writes the results to this page. "
        'To run only some benchmarks, name them: `make bench ONLY="campaign wires"`. For a short test of the '
        "benchmarks, run `make bench SIZE=quick`, which executes fewer runs and does not change this page. "
        "The file `benchmarks/kept.json` contains the complete output of each benchmark.",
    ]
    for benchmark in BENCHMARKS:
        parts += [f"## {benchmark.title}", *section(benchmark, kept.get(benchmark.name))]
    return "\n\n".join(parts) + "\n"


def section(benchmark: Benchmark, found: dict[str, Any] | None) -> list[str]:
    where = (
        [f"For the results of this benchmark, see [{benchmark.title}]({benchmark.page})."]
        if benchmark.page
        else []
    )
    drawn = []
    if benchmark.draws and (PAGE.parent / picture(benchmark)).exists():
        drawn.append(f"![{benchmark.title}]({picture(benchmark)})")
    if benchmark.page and found is not None and (PAGE.parent / benchmark.page).exists():
        written = (PAGE.parent / benchmark.page).read_text(encoding="utf-8").splitlines()
        drawn += [line for line in written if line.startswith("![")]
    if found is None:
        return where or [f"There are no results yet: run `make bench ONLY={benchmark.name}`."]
    how = (
        "| date | duration | load before | machine | versions |\n|---|---|---|---|---|\n"
        f"| {found['date']} | {found['seconds'] / 60:.1f} minutes | {found['load']:.1f} "
        f"| {found['machine']} | {found['versions']} |"
    )
    if found["status"] == REASON:
        return [*where, how, f"Left out: {' '.join(found['printed'][-1:])}"]
    if found["status"] != 0:
        how += f"\n\nThe benchmark failed with status {found['status']}."
    if benchmark.page:
        return [*where, how, *drawn]
    return [how, *results(found["printed"]), *drawn]


def results(lines: list[str]) -> list[str]:
    """Return what a benchmark printed as tables and lists. Progress (indented), log lines of files and JSON
    are left out; `kept.json` has them.
    """
    shown = [line for line in lines if line.strip() and line[0] not in " /{}" and '{"' not in line]
    parts: list[str] = []
    for columns, group in groupby(shown, lambda line: len(cells(line))):
        rows = [cells(line) for line in group]
        if columns == 1:
            parts.append("\n".join(f"- {row[0]}" for row in rows))
            continue
        has_header = not any(cell[:1].isdigit() for cell in rows[0][1:])
        header, rows = (rows[0], rows[1:]) if has_header else ([*NO_HEADER, *[""] * columns][:columns], rows)
        rows = [row for row in rows if set("".join(row)) - set("-:")]  # without the rule of a Markdown table
        parts.append("\n".join(f"| {' | '.join(row)} |" for row in (header, ["---"] * columns, *rows)))
    return parts


def cells(line: str) -> list[str]:
    """Return the columns of a line that a benchmark printed, by bars or by two spaces and more."""
    return COLUMNS.split(line.strip().strip("|").strip())


if __name__ == "__main__":
    sys.exit(main())
