"""From a campaign to real arms: a gate record is issued, checked, and void once the cell has changed.

Run: python examples/31_gate.py
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from armcell.campaigns import CampaignSpec, begin, gate, run
from armcell.cell import load
from armcell.core import InputError

CELL = """
robot: panda
start: {arm: home}
objects:
  lamp: {sphere: 0.06, pose: [0.35, 0.35, 0.9]}
task:
  - move: extended
"""


def asked(file: Path) -> None:
    """What `armcell run --mode real` asks before anything moves."""
    try:
        record = gate.check(load(file))
        shown = record["campaign"]
        print(f"gate: open, {shown['succeeded']} of {shown['trials']}, at least {shown['interval'][0]:.1%}")
    except InputError as error:
        print(f"gate: closed: {error.reason}")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ[gate.KEY_VARIABLE] = str(folder / "gate.key")  # else ~/.config/armcell/gate.key
        file = folder / "lamp.yaml"
        file.write_text(CELL)
        asked(file)

        # 72 trials without a failure show 95 % at the lower end of the exact 95 % interval.
        spec = CampaignSpec(str(file), {"objects.lamp.pose.y": [0.3, 0.45]}, trials=72)
        store = begin(spec, folder / "runs")
        run(store, workers=2)
        store.close()
        cell = load(file)
        gate.issue(cell, store.folder, gate.gate_file(cell))
        asked(file)

        file.write_text(CELL.replace("0.06", "0.07"))  # the lamp was measured again
        asked(file)


if __name__ == "__main__":
    main()
