"""A Panda hands a bar over to a UR10e in mode `real`: two vendors, each over its own protocol.

One command emulates both controllers in one physics world. With real arms only the addresses change:
`armcell run panda_ur10e_handover --mode real --set real.arms.franka_arm.host=172.16.0.2 ...`
"""

import subprocess
import sys

from armcell.cell import load, run_task, with_values
from armcell.planning import warm_up

CELL = "panda_ur10e_handover"
HOSTS = {"real.arms.franka_arm.host": "127.0.0.33", "real.arms.ur_arm.host": "127.0.0.34"}
# Wide, for a computer that does other things as well; the defaults are 0.05, 1 and 0.1 s.
LIMITS = {"real.max_state_age": 0.3, "real.max_silence": 3.0, "real.watchdog": 0.5}

command = [sys.executable, "-m", "armcell", "emulate", CELL, "--seed", "0"]
addresses = [part for key, host in HOSTS.items() for part in ("--set", f"{key}={host}")]
robots = subprocess.Popen([*command, *addresses], stdout=subprocess.PIPE, text=True)
try:
    assert robots.stdout is not None
    for line in robots.stdout:
        if line.startswith("an emulator"):  # all ports are open
            break
        print(line, end="")
    cell = with_values(load(CELL), {**HOSTS, "real.arms.ur_arm.port": 30743, **LIMITS})
    warm_up()
    with cell.connect("real", seed=0) as live:
        result = run_task(cell, live, 0, "real")
        for event in live.driver.safety_events:
            print(f"  {event.arm}: {event.kind}: {event.text}")
    print("success" if result["success"] else f"failed: {result['message']}")
    if result["success"]:
        print(f"placed {result['measures']['placed_off_mm']:.1f} mm from the middle of the tray")
finally:
    robots.terminate()
    robots.communicate()
