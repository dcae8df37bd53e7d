"""`armcell bench`: benchmarks of armcell. Each benchmark has its own file."""

from __future__ import annotations

import typer

from armcell.cli import bench_dual, bench_grasp, bench_ik, bench_mbm, bench_timing
from armcell.cli.common_options import robot_options

app = typer.Typer(help="Measure armcell.", no_args_is_help=True, rich_markup_mode=None)
app.command("mbm")(bench_mbm.mbm)
app.command("dual")(bench_dual.dual)
app.command("ik", epilog=bench_ik.EXAMPLES)(robot_options(bench_ik.ik))
app.command("grasp", epilog=bench_grasp.EXAMPLES)(bench_grasp.grasp)
app.command("timing")(robot_options(bench_timing.timing))


@app.callback()
def _group() -> None:
    """Run one of armcell's benchmarks."""
