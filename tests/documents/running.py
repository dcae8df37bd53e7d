"""Run the source of a block as a user does: as a script in a cell."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import NamedTuple

from armcell.cell import LiveCell, load
from armcell.moveit import Session, run_script

SPEEDS = {"sim": 4.0, "fake": 20.0}


class Ran(NamedTuple):
    """What a script did; `said` has its log lines and the hints."""

    status: int
    session: Session
    live: LiveCell

    @property
    def said(self) -> str:
        return "\n".join(self.session.lines)

    def object_at(self, name: str) -> list[float]:
        return self.live.driver.object_poses()[name].translation.tolist()


def run(folder: Path, source: str, cell: str, mode: str = "sim", speed: float | None = None, **kwargs) -> Ran:
    """Run a script to its end; quiet, for its lines are in the session."""
    file = folder / "script.py"
    file.write_text(source, encoding="utf-8")
    live = load(cell).connect(mode, time_scale=speed or SPEEDS[mode])
    status, session = run_script(file, live, quiet=True, **kwargs)
    return Ran(status, session, live)


def indented(source: str) -> str:
    """A block that is the body of a function."""
    return textwrap.indent(source, "    ")
