"""An FR3 in mode `real` that the library `franky` moves, instead of armcell's own stream.

`pip install 'armcell[franka]'` installs `franky`. An emulated FR3 in physics serves Franka's ports. With a
real arm only the address changes: see docs/real_franka.md.
"""

import subprocess
import sys

from armcell.cell import load, run_task, with_values
from armcell.planning import warm_up

HOST = "127.0.0.35"
REAL = {
    "kind": "franka",
    "backend": "franky",
    # Wide, for a computer that does other things as well; the defaults are 0.05 and 0.1 s.
    "max_state_age": 0.3,
    "watchdog": 0.5,
    "arms": {"arm": {"host": HOST, "model": "fr3", "gripper": {"kind": "hand"}}},
}

command = [sys.executable, "-m", "armcell", "franka-controller", "--model", "fr3", "--host", HOST]
robot = subprocess.Popen([*command, "--cell", "panda_pick", "--seed", "0"], stdout=subprocess.PIPE, text=True)
try:
    assert robot.stdout is not None
    print(robot.stdout.readline(), end="")  # the emulator prints this line once its ports are open
    cell = with_values(load("panda_pick"), {"real": REAL})
    warm_up()
    with cell.connect("real", seed=0) as live:
        result = run_task(cell, live, 0, "real")
        for event in live.driver.safety_events:
            print(f"  {event.arm}: {event.kind}: {event.text}")
    print("success" if result["success"] else f"failed: {result['message']}")
    print(f"placed {result['placement_error_m'] * 1000:.1f} mm off")
finally:
    robot.terminate()
    robot.communicate()
