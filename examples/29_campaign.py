"""How often does it work, and what decides? A small campaign from Python.

Run: python examples/29_campaign.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from armcell.campaigns import CampaignSpec, begin, run, summary, take_pictures, write_report

CELL = """
robot: panda
start: {arm: home}
objects:
  lamp: {sphere: 0.06, pose: [0.25, 0.0, 1.0]}
task:
  - move: extended
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "lamp.yaml").write_text(CELL)
        # The arm stretches out; somewhere near its way hangs a lamp.
        spec = CampaignSpec(
            str(folder / "lamp.yaml"),
            parameters={
                "objects.lamp.pose.y": {"normal": [0.0, 0.2]},
                "objects.lamp.pose.z": {"uniform": [0.7, 1.1]},
                "settings.attempts": {"choice": [1, 3]},
            },
            sampling="latin_hypercube",
            trials=40,
        )
        store = begin(spec, folder / "runs")  # says what is wrong before anything runs
        stopped = run(store, workers=2)
        data = summary(store, stopped)
        share = data["success"]
        low, high = share["wilson"]
        print(f"{share['count']} of {share['total']} succeed, 95 % interval {low:.0%} to {high:.0%}")
        for cause in data["causes"]:
            print(f"{cause['count']} x {cause['code']}: {cause['message']}")
            print(f"   {cause['replay']}")
        for effect in data["effects"]:
            print(f"{effect['parameter']}: {effect['words']} (p = {effect['p_value']:.2g})")
        take_pictures(store)  # of failures, for the report
        print("report:", write_report(store, stopped).name)
        store.close()


if __name__ == "__main__":
    main()
