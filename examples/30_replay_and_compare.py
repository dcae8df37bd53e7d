"""A run is recorded, executed again bit for bit, and compared with a run under other settings.

Run: python examples/30_replay_and_compare.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from armcell.cell import Cell, load, run_task, with_values
from armcell.records import RunRecorder, compare, read_record, reexecute, run_metadata

CELL = """
robot: panda
start: {arm: home}
objects:
  lamp: {sphere: 0.06, pose: [0.35, 0.35, 0.9]}
task:
  - move: extended
"""


def recorded(cell: Cell, seed: int, folder: Path) -> Path:
    """Run the cell's task in physics, with a record; what `armcell run` does."""
    metadata = run_metadata(cell, seed, "sim")  # cell, seed, hashes, versions: all it takes to run it again
    with RunRecorder(folder, cell.scene(seed), metadata=metadata) as recorder:
        with cell.connect("sim", seed, [recorder]) as live:
            result = run_task(cell, live, seed, "sim")
        recorder.finish(result)
    return recorder.mcap_file


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "lamp.yaml").write_text(CELL)
        cell = load(folder / "lamp.yaml")

        first = read_record(recorded(cell, 0, folder / "first"))
        print(f"recorded: {len(first.states)} states, {len(first.events)} events")

        same, _, _ = reexecute(first, folder / "again")
        print(f"executed again: {same.same_states} of {same.states} states identical to the bit")

        # The same task with softer servos: where do the runs part, and how far do they get?
        softer = with_values(cell, {"physics.arm_kp": 2500})
        found = compare(first, read_record(recorded(softer, 0, folder / "softer")))
        for line in found.words():
            print(line)

        # A killed process leaves a record without its end: what was whole is there.
        cut = folder / "cut.mcap"
        cut.write_bytes(first.file.read_bytes()[: first.file.stat().st_size * 2 // 3])
        record = read_record(cut)
        print(f"cut off: {len(record.states) > 0 and 'some states are left'}; {record.cut}")


if __name__ == "__main__":
    main()
