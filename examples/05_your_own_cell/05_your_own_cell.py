"""A cell of your own: cell.yaml in this folder names robot, objects, what is random, and the task.

The same file runs from the command line:

    armcell check examples/05_your_own_cell
    armcell run examples/05_your_own_cell --seed 3 --view

and here from Python, on two draws of its random values.

    python examples/05_your_own_cell/05_your_own_cell.py
"""

import tempfile
from pathlib import Path

import armcell
from armcell.cell import run_task
from armcell.core import InputError

folder = Path(__file__).parent
cell = armcell.load(folder)
print(cell.spec.description)
print("robot:", cell.model.name, "  objects:", ", ".join(cell.scene().objects))

# A seed is one draw of the random values, and the seed of the planners: the same seed, the same run.
for seed in (0, 1):
    draw = cell.draw(seed)["can"]
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    print(
        f"\nseed {seed}: can of {draw['mass']:.2f} kg, friction {draw['friction']:.2f}, "
        f"moved {draw['dx'] * 1000:+.0f}, {draw['dy'] * 1000:+.0f} mm"
    )
    print(f"  success: {result['success']} {result['message']}")
    print(
        f"  slip {result['slip_m'] * 1000:.3f} mm, placed {result['placement_error_m'] * 1000:.1f} mm off, "
        f"{len(result['unwanted_contacts'])} unwanted contacts, {result['task_time_s']:.1f} s"
    )

# Your own script instead of the file's task: what is on the stool in the end?
with cell.connect("fake") as live:
    live.arm.pick("can")
    live.arm.place("can", on="stool", at=(0.03, 0.0))
    T_stool_can = live.scene().transform("stool", "can")
print("\nthe can stands", T_stool_can.translation.round(3), "m from the stool's foot")

# A mistake in the file is one line that names the place and a hint; nothing runs with half a cell.
with tempfile.TemporaryDirectory() as other:
    text = folder.joinpath("cell.yaml").read_text()
    Path(other, "cell.yaml").write_text(text.replace("friction: 0.5", "frction: 0.5"))
    try:
        armcell.load(other)
    except InputError as error:
        print("\na typing error:", error)
