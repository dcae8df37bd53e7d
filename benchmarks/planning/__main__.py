"""`python -m benchmarks.planning`: measure, judge, write. From the repository's folder."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.planning import commands, memory, report
from benchmarks.planning.bars import lines
from benchmarks.planning.peers import FAST, NATIVE, OmplCoal, all_peers
from benchmarks.planning.pose_goals import pose_goals
from benchmarks.planning.problems import load
from benchmarks.planning.side_by_side import Settings, compare

ROOT = Path(__file__).parents[2]
PACKAGES = ("vamp-planner", "roboplan", "ompl", "pin", "coal", "toppra", "numba")
SLOW_EVERY = 5  # the planner with a Python callback on exact meshes takes every n-th problem


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 whatever the bars say, 2 for wrong usage."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning", description=__doc__)
    default = Path(os.environ.get("MBM") or ROOT.parent / "shared" / "data" / "mbm")
    parser.add_argument("--mbm", type=Path, default=default, help="folder of MotionBenchMaker's problems")
    parser.add_argument("--quick", action="store_true", help="one problem of each family, public ones only")
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks/results/planning.json")
    parser.add_argument(
        "--document", type=Path, help="Markdown file to fill in; docs/benchmarks_planning.md unless --quick"
    )
    options = parser.parse_args(arguments)
    results: dict[str, Any] = {"machine": machine(), "rows": [], "problems": {}, "missing": {}}
    began = time.monotonic()
    _side_by_side(results, options.mbm, options.quick)
    if not options.quick:
        _others(results)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(results, indent=1) + "\n")
    document = options.document or (None if options.quick else ROOT / "docs/benchmarks_planning.md")
    if document is not None:
        report.write(results, document, document.parent / "pictures")
    show(results)
    print(f"\n{time.monotonic() - began:.0f} s; rows in {options.json}, tables in {document or 'no file'}")
    return 0


def machine() -> str:
    """Processor and versions, for whoever reads the numbers."""
    try:
        info = Path("/proc/cpuinfo").read_text()
        cpu = next(s.split(":", 1)[1].strip() for s in info.splitlines() if s.startswith("model name"))
    except (OSError, StopIteration):
        cpu = platform.processor() or platform.machine()
    found = [f"{cpu} ({os.cpu_count()} cores)", f"Python {platform.python_version()}"]
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found.append(f"{package} {version(package)}")
    return ", ".join(found)


def _side_by_side(results: dict[str, Any], folder: Path, quick: bool) -> None:
    if not (folder / "mbm_panda.json.gz").is_file():
        reason = f"no problems in {folder}; say where they are with MBM=/path"
        results["missing"]["mbm"] = reason
        print(f"Skipping MotionBenchMaker: {reason}", file=sys.stderr)
        return
    for robot in ("panda", "ur5") if quick else report.ROBOTS:
        if not (folder / f"mbm_{robot}.json.gz").is_file():
            continue
        data, problems = load(folder, robot, 1 if quick else 0)
        peers = [(peer, SLOW_EVERY if peer.name == OmplCoal.name else 1) for peer in all_peers()]
        settings = Settings()
        if quick:
            settings = Settings(seconds=2.0, repeat=1, sample=1)
        elif robot not in ("panda", "ur5"):  # the others need seconds for each problem
            peers = [(peer, 1) for peer in all_peers() if peer.name in FAST]
            settings = Settings(seconds=2.0, end=150.0)
        began = time.monotonic()
        rows = compare(data, problems, peers, settings)
        results["rows"] += rows
        done = sum(r["planner"] == NATIVE for r in rows)
        results["problems"][robot] = {"begun": done, "all": len(problems)}
        print(
            f"{robot}: {done} of {len(problems)} problems, {time.monotonic() - began:.0f} s", file=sys.stderr
        )


def _others(results: dict[str, Any]) -> None:
    """The lines that other commands and processes measure."""
    sections = {
        "dual": lambda: commands.bench("dual", "--count", "100", "--seconds", "3"),
        "ik_ur10": lambda: commands.bench("ik", "--robot", "ur10"),
        "ik_panda": lambda: commands.bench("ik", "--robot", "panda"),
        "timing": lambda: commands.bench("timing", "--robot", "panda", "--peer"),
        "pose_goals": lambda: pose_goals(50),
        "compile": commands.compile_times,
        "memory": memory.measure,
    }
    for name, measure in sections.items():
        print(f"{name} ...", file=sys.stderr)
        try:
            results[name] = measure()
        except commands.Missing as reason:
            results["missing"][name] = str(reason)


def show(results: dict[str, Any]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("what", "bar", "measured", ""):
        table.add_column(title, overflow="fold")
    for line in lines(results):
        style = {"hit": "green", "MISSED": "red"}.get(line.verdict)
        table.add_row(line.what, line.bar, line.measured, line.verdict, style=style)
    Console(width=None if sys.stdout.isatty() else 200, highlight=False).print(table)


if __name__ == "__main__":
    sys.exit(main())
