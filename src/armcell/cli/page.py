"""Web pages of commands: options, output of the address, and `--view` of motions and explanations."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import typer

from armcell import _interrupts
from armcell.cli.console import console, print_addresses
from armcell.core import Explanation, JointState, JointTrajectory, StateSample

if TYPE_CHECKING:
    from armcell.viewer.server import PageServer

HOST = typer.Option(
    "127.0.0.1", "--host", metavar="ADDRESS",
    help="Address that the page listens on; 0.0.0.0 lets the network in, which needs the URL's token, too.",
)  # fmt: skip
PORT = typer.Option(
    8080, min=0, max=65535, help="Port of the page, the next free one if it is taken; 0: any free one."
)
ALLOW_HOST = typer.Option(
    [], "--allow-host", metavar="NAME",
    help="Further host name under which browsers may ask for the page, as behind a proxy; may be repeated.",
)  # fmt: skip
OPEN = typer.Option(False, "--open", help="Open the page in the browser.")
FRAME = 1 / 30  # [s]


class PageAddress(NamedTuple):
    """Address of a web page that a command serves: the host, the port and the accepted host names."""

    host: str
    port: int
    names: list[str]


def print_page_address(page: PageServer) -> None:
    """Print the URL of a web page that a command serves, with its token,
    and the addresses on which it listens.
    """
    console.print(f"view: {page.url}", markup=False, soft_wrap=True)
    print_addresses(page.endpoints)


def serve_page(page: PageServer, open_browser: bool) -> NoReturn:
    """Print the address of a web page, open the page if requested, and serve it until Ctrl-C."""
    print_page_address(page)
    console.print("press Ctrl-C to end")
    if open_browser:
        import webbrowser

        webbrowser.open(page.url)
    while True:
        _interrupts.sleep(3600)


def show(
    scene: Any,
    trajectory: JointTrajectory | None,
    explanation: Explanation | None,
    at: PageAddress,
    title: str,
) -> None:
    """Show a web page with a trajectory (played once, in real time) or an explanation, for a command's option
    `--view`. Then wait for Enter.
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
