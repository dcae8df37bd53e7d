"""Two emulated UR10 carry a rod in mode `real`: the script of the simulation, over UR's own protocols.

The emulators share one physics world. With real arms only the addresses change:
`armcell run dual_ur10_rod --mode real --set real.arms.left_arm.host=192.168.1.10 ...`
"""

import subprocess
import sys
import time

from armcell.cell import load, run_task, with_values
from armcell.core import InputError
from armcell.drivers import DashboardClient
from armcell.planning import warm_up

HOSTS = {"left_arm": "127.0.0.23", "right_arm": "127.0.0.24"}
# Wide, for a computer that does other things as well; the defaults are 0.05, 0.1 and 0.04 s.
LIMITS = {"real.max_state_age": 0.3, "real.watchdog": 0.5, "real.stream_lead": 0.1}


def wait_for(host: str) -> None:
    for _ in range(600):
        try:
            with DashboardClient(host) as dashboard:
                return print(f"{host}: {dashboard.ask('get robot model')}, {dashboard.ask('robotmode')}")
        except InputError:
            time.sleep(0.1)


command = [sys.executable, "-m", "armcell", "ur-controller", "--cell", "dual_ur10_rod", "--seed", "0"]
robots = subprocess.Popen(
    [*command, *(part for host in HOSTS.values() for part in ("--host", host))], stdout=subprocess.DEVNULL
)
try:
    for host in HOSTS.values():
        wait_for(host)
    addresses = {f"real.arms.{arm}.host": host for arm, host in HOSTS.items()}
    ports = {f"real.arms.{arm}.port": 30723 + 10 * i for i, arm in enumerate(HOSTS)}
    cell = with_values(load("dual_ur10_rod"), {**addresses, **ports, **LIMITS})
    warm_up()
    with cell.connect("real", seed=0) as live:
        result = run_task(cell, live, 0, "real")
        for event in live.driver.safety_events:
            print(f"  {event.arm}: {event.kind}: {event.text}")
    print("success" if result["success"] else f"failed: {result['message']}")
    for name in ("relative_error_mm", "relative_error_deg", "squeeze_N", "slip_mm"):
        if name in result["measures"]:
            print(f"  {name}: {result['measures'][name]:.3f}")
finally:
    robots.terminate()
    robots.wait()
