"""The option `--view` of planning commands: show a motion or explanation in the browser."""

from __future__ import annotations

import sys
import time
from typing import Any

from armcell import _interrupts
from armcell.cli.console import console
from armcell.cli.page import PageAddress, print_page_address
from armcell.core import Explanation, JointState, JointTrajectory, StateSample

FRAME = 1 / 30  # [s]


def show(
    scene: Any,
    trajectory: JointTrajectory | None,
    explanation: Explanation | None,
    at: PageAddress,
    title: str,
) -> None:
    """Show a trajectory (once, in real time) or an explanation in the browser, for the option `--view`.
    Then wait for Enter.
    """
    from armcell.viewer import CellViewer, show_explanation

    with CellViewer(scene, title=title, **at._asdict()) as viewer:
        print_page_address(viewer.page)
        if explanation is not None:
            show_explanation(viewer, scene, explanation)
        if trajectory is not None:
            viewer.on_trajectory(0.0, trajectory)
            began = time.monotonic()
            while (t := time.monotonic() - began) < trajectory.duration + FRAME:
                state = JointState(trajectory.joint_names, trajectory.sample(t)[0])
                viewer.on_state(StateSample(t, state))
                _interrupts.sleep(FRAME)
        if sys.stdin.isatty():
            console.print("press Enter to end")
            sys.stdin.readline()
