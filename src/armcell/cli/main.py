"""The entry point of `armcell`: one-line errors, and `--help` with the commands under headings.

Errors have a traceback if ARMCELL_DEBUG=1. Headings and commands are in the order of their registration.
"""

from __future__ import annotations

import os
from typing import Any

import typer
from typer.core import TyperGroup

from armcell import __version__, _interrupts
from armcell.cli import (
    bench,
    bringup,
    campaign,
    check,
    check_state,
    doctor,
    emulate,
    explain,
    export,
    franka_controller,
    gate,
    ik,
    import_,
    look,
    msg,
    new,
    plan,
    replay,
    robots,
    run,
    script,
    serve,
    service,
    setup,
    step_response,
    tf,
    topic,
    twin,
    ur_controller,
    view,
)
from armcell.cli.common_options import robot_options
from armcell.cli.console import err
from armcell.cli.script import UnityCommand
from armcell.core import ArmcellError

EXAMPLES = """
Examples:

  armcell run panda_pick                      run a built-in cell and write a report

  armcell run panda_pick --view               watch it in the browser

  armcell run my_cell/ --seed 7 --json out.json

  armcell run my_script.py --cell panda_table a moveit_commander script, with no ROS installed

  armcell lint my_script.py                   known traps in such a script

  armcell check my_cell/                      what is wrong with a cell, and how to fix it

  armcell setup my_robot.urdf -o my_cell      a cell and MoveIt's files from a URDF

  armcell import my.world --robot panda -o my_cell.yaml    a cell from a Gazebo world

  armcell serve panda_pick --unity            let Unity join: states out, trajectories in

  armcell export unity panda_table -o project write a cell and our C# package into a Unity project

  armcell plan panda_pick --pose 0.5 0.2 0.3  plan a motion, with its numbers

  armcell explain panda_pick --pose 0.5 0 0.3 can the arm get there, and if not, why, and what would help

  armcell view panda_pick                     plan in the browser: drag the goal, plan, preview, execute

  armcell look six_axis_camera                what a depth camera sees: objects with poses and sizes

  armcell campaign panda_pick --trials 200    how often does it work, and why not

  armcell gate my_cell.yaml                   the record that mode real asks for, from a campaign

  armcell replay runs/20261122-101500-panda_pick    a recorded run in the browser; --execute runs it again

  armcell doctor panda_pick                   what this machine lacks, and how to get it
"""


class SectionedGroup(TyperGroup):
    """Group of Typer commands whose `--help` lists each command under
    the heading in its `rich_help_panel`.
    """

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        shown = [(name, c) for name, c in commands if c is not None and not c.hidden]
        room = formatter.width - 6 - max(len(name) for name, _ in shown)
        headings: dict[str, list[tuple[str, str]]] = {}
        for name, command in shown:
            heading = getattr(command, "rich_help_panel", None) or "Commands"
            headings.setdefault(heading, []).append((name, command.get_short_help_str(room)))
        for heading, rows in headings.items():
            with formatter.section(heading):
                formatter.write_dl(rows)


app = typer.Typer(
    name="armcell",
    cls=SectionedGroup,
    help="A robot work cell: plans that are proven not to touch, grasps that hold by physics.",
    epilog=EXAMPLES,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
RUN, PLAN, CELLS = "Run a task, and prove it", "Plan and explain", "Cells and robots"
WIRES, REAL, MEASURE = "Unity, ROS 1 and ROS 2", "Real arms", "Measure"
app.command("run", cls=UnityCommand, rich_help_panel=RUN)(robot_options(run.run))
app.command("campaign", epilog=campaign.EXAMPLES, rich_help_panel=RUN)(robot_options(campaign.campaign))
app.command("gate", epilog=gate.EXAMPLES, rich_help_panel=RUN)(gate.gate)
app.command("replay", epilog=replay.REPLAY_EXAMPLES, rich_help_panel=RUN)(replay.replay)
app.command("diff", epilog=replay.DIFF_EXAMPLES, rich_help_panel=RUN)(replay.diff)
app.command("lint", rich_help_panel=RUN)(script.lint)
app.command("plan", rich_help_panel=PLAN)(robot_options(plan.plan))
app.command("view", epilog=view.EXAMPLES, rich_help_panel=PLAN)(robot_options(view.view))
app.command("explain", rich_help_panel=PLAN)(robot_options(explain.explain))
app.command("ik", rich_help_panel=PLAN)(robot_options(ik.ik))
app.command("fk", rich_help_panel=PLAN)(robot_options(ik.fk))
app.command("check-state", rich_help_panel=PLAN)(robot_options(check_state.check_state))
app.command("look", epilog=look.EXAMPLES, rich_help_panel=PLAN)(robot_options(look.look))
app.command("cells", rich_help_panel=CELLS)(check.cells)
app.command("robots", epilog=robots.EXAMPLES, rich_help_panel=CELLS)(robot_options(robots.robots))
app.command("new", epilog=new.EXAMPLES, rich_help_panel=CELLS)(robot_options(new.new))
app.command("setup", epilog=setup.EXAMPLES, rich_help_panel=CELLS)(robot_options(setup.setup))
app.command("import", epilog=import_.EXAMPLES, rich_help_panel=CELLS)(robot_options(import_.import_))
app.command("check", rich_help_panel=CELLS)(robot_options(check.check))
app.command("doctor", rich_help_panel=CELLS)(robot_options(doctor.doctor))
app.command("step-response", epilog=step_response.EXAMPLES, rich_help_panel=CELLS)(
    robot_options(step_response.step_response)
)
app.command("serve", rich_help_panel=WIRES)(robot_options(serve.serve))
app.command("sim", rich_help_panel=WIRES)(robot_options(serve.sim))
app.command("tf", epilog=tf.EXAMPLES, rich_help_panel=WIRES)(robot_options(tf.tf))
app.add_typer(topic.app, name="topic", rich_help_panel=WIRES)
app.add_typer(service.app, name="service", rich_help_panel=WIRES)
app.add_typer(msg.app, name="msg", rich_help_panel=WIRES)
app.add_typer(export.app, name="export", rich_help_panel=WIRES)
app.command("bringup", rich_help_panel=REAL)(robot_options(bringup.bringup))
app.command("twin", rich_help_panel=REAL)(robot_options(twin.twin))
app.command("emulate", epilog=emulate.EXAMPLES, rich_help_panel=REAL)(robot_options(emulate.emulate))
app.command("ur-dashboard", rich_help_panel=REAL)(ur_controller.ur_dashboard)
app.command("ur-controller", epilog=ur_controller.EXAMPLES, rich_help_panel=REAL)(
    robot_options(ur_controller.ur_controller)
)
app.command("franka-operator", rich_help_panel=REAL)(franka_controller.franka_operator)
app.command("franka-controller", epilog=franka_controller.EXAMPLES, rich_help_panel=REAL)(
    robot_options(franka_controller.franka_controller)
)
app.add_typer(bench.app, name="bench", rich_help_panel=MEASURE)


@app.callback(invoke_without_command=True)
def _root(
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
    allow_env: bool = typer.Option(
        False,
        "--allow-env",
        help="Let xacro files read environment variables, $(env NAME); only for files that you trust.",
    ),
) -> None:
    if allow_env:
        from armcell.model.xacro import ALLOW_ENV

        os.environ[ALLOW_ENV] = "1"  # child processes of a command read this variable
    if version:
        typer.echo(f"armcell {__version__}")
        raise typer.Exit()


def main(arguments: list[str] | None = None) -> int:
    """Run the command line of armcell, and return its exit status.

    Exit status: 0 for success, 1 for failures and errors, 2 for wrong usage, 130 for Ctrl-C.
    `python -m armcell` handles output errors (`armcell._streams`) and signals (`armcell._interrupts`).
    """
    try:
        result = app(args=arguments, standalone_mode=False)
        return result if isinstance(result, int) else 0
    except typer.Exit as exit_:
        return exit_.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return _interrupts.status()
    except ArmcellError as error:
        if _interrupts.asked():  # a library may raise its own error after an interrupt
            return _interrupts.status()
        err(str(error))
    except Exception as error:
        if _interrupts.asked():
            return _interrupts.status()
        show, status = getattr(error, "show", None), getattr(error, "exit_code", None)
        if show is not None and status is not None:  # a usage error from typer
            show()
            return int(status)
        if os.environ.get("ARMCELL_DEBUG"):
            raise
        if isinstance(error, OSError) and error.filename is not None:
            err(f"{error.filename}: {error.strerror}")  # for example, no write access
            return 1
        err(f"internal error: {type(error).__name__}: {error} (set ARMCELL_DEBUG=1 for the traceback)")
    return 1
