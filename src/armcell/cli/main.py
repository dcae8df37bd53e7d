"""`armcell`: the command line's entry. Every error is one line; a traceback only with ARMCELL_DEBUG=1."""

from __future__ import annotations

import os
import sys

import typer

from armcell import __version__
from armcell.cli import (
    bench,
    bringup,
    campaign,
    check,
    check_state,
    doctor,
    explain,
    export,
    gate,
    ik,
    look,
    msg,
    plan,
    replay,
    run,
    script,
    serve,
    service,
    setup,
    step_response,
    topic,
    twin,
    ur_controller,
    view,
)
from armcell.cli.console import err
from armcell.core import ArmcellError

EXAMPLES = """
Examples:

  armcell run panda_pick                      run a built-in cell and write a report

  armcell run panda_pick --view               watch it in the browser

  armcell run my_cell/ --seed 7 --json out.json

  armcell run my_script.py --cell panda_table a moveit_commander script, with no ROS installed

  armcell lint my_script.py                   known traps in such a script

  armcell check my_cell/                      what is wrong with a cell, and the cure

  armcell setup my_robot.urdf -o my_cell      a cell and MoveIt's files from a URDF

  armcell serve panda_pick --unity            let Unity join: states out, trajectories in

  armcell export unity panda_table -o project write a cell and our C# package into a Unity project

  armcell plan panda_pick --pose 0.5 0.2 0.3  plan a motion, with its numbers

  armcell explain panda_pick --pose 0.5 0 0.3 can the arm get there, and if not, why, and what would help

  armcell view panda_pick                     plan in the browser: drag the goal, plan, preview, execute

  armcell look six_axis_camera                what a depth camera sees: objects with poses and sizes

  armcell campaign panda_pick --trials 200    how often does it work, and why not

  armcell gate my_cell.yaml                   the record that mode real asks for, from a campaign

  armcell replay runs/20261122-101500-panda_pick    a recorded run in the browser; --execute runs it again

  armcell doctor panda_pick                   what this machine lacks, and the cure
"""

app = typer.Typer(
    name="armcell",
    help="A robot work cell: plans that are proven not to touch, grasps that hold by physics.",
    epilog=EXAMPLES,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command("run")(run.run)
app.command("campaign", epilog=campaign.EXAMPLES)(campaign.campaign)
app.command("replay", epilog=replay.REPLAY_EXAMPLES)(replay.replay)
app.command("diff", epilog=replay.DIFF_EXAMPLES)(replay.diff)
app.command("gate", epilog=gate.EXAMPLES)(gate.gate)
app.command("lint")(script.lint)
app.command("check")(check.check)
app.command("setup", epilog=setup.EXAMPLES)(setup.setup)
app.command("explain")(explain.explain)
app.command("plan")(plan.plan)
app.command("view", epilog=view.EXAMPLES)(view.view)
app.command("ik")(ik.ik)
app.command("fk")(ik.fk)
app.command("check-state")(check_state.check_state)
app.command("look", epilog=look.EXAMPLES)(look.look)
app.command("step-response")(step_response.step_response)
app.command("doctor")(doctor.doctor)
app.command("cells")(check.cells)
app.add_typer(bench.app, name="bench")
app.add_typer(msg.app, name="msg")
app.add_typer(export.app, name="export")
app.command("serve")(serve.serve)
app.command("sim")(serve.sim)
app.command("ur-controller", epilog=ur_controller.EXAMPLES)(ur_controller.ur_controller)
app.command("bringup")(bringup.bringup)
app.command("twin")(twin.twin)
app.command("ur-dashboard")(ur_controller.ur_dashboard)
app.add_typer(topic.app, name="topic")
app.add_typer(service.app, name="service")


@app.callback(invoke_without_command=True)
def _root(version: bool = typer.Option(False, "--version", help="Print the version and exit.")) -> None:
    if version:
        typer.echo(f"armcell {__version__}")
        raise typer.Exit()


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; its status: 0, 1 for failures and errors, 2 for usage, 130 for Ctrl-C."""
    try:
        result = app(args=arguments, standalone_mode=False)
        return result if isinstance(result, int) else 0
    except typer.Exit as exit_:
        return exit_.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return 130
    except ArmcellError as error:
        err(str(error))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        if hasattr(error, "show") and hasattr(error, "exit_code"):  # a usage error of typer's own click
            error.show()
            return int(error.exit_code)
        if os.environ.get("ARMCELL_DEBUG"):
            raise
        err(f"internal error: {type(error).__name__}: {error} (set ARMCELL_DEBUG=1 for the traceback)")
    return 1
