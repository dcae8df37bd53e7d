"""`armcell bench`: one command per benchmark."""

from __future__ import annotations

import typer

from armcell.cli import bench_dual, bench_mbm

app = typer.Typer(help="Measure armcell.", no_args_is_help=True, rich_markup_mode=None)
app.command("mbm")(bench_mbm.mbm)
app.command("dual")(bench_dual.dual)


@app.callback()
def _group() -> None:
    """Measure armcell on public and on generated problems."""
