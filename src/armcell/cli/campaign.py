"""`armcell campaign`: run a randomized task many times and estimate its success rate."""

from __future__ import annotations

import os
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from armcell import _interrupts
from armcell.cli.console import check_writable, console, errors, print_addresses, write_json
from armcell.core import InputError

EXAMPLES = """
Examples:

  armcell campaign panda_pick --trials 200                     200 draws of what the cell randomises

  armcell campaign panda_pick --vary objects.cube.mass=0.05,0.5 --vary physics.arm_kp=2000,8000

  armcell campaign campaign.yaml                               distributions and stop rules from a file

  armcell campaign --resume runs/20261122-101500-campaign-panda_pick

  armcell campaign panda_pick --trials 10000 --ray 10.0.0.5:6379    on a Ray cluster, from any of its nodes

  armcell campaign --compare runs/A runs/B                     is B better than A, or was it chance?
"""


def campaign(
    cell: str | None = typer.Argument(
        None, help="Built-in cell, folder or YAML file of a cell; or a campaign's YAML file."
    ),
    trials: int | None = typer.Option(None, min=1, help="How many at most. [default: 100]"),
    workers: int = typer.Option(0, min=0, help="Processes; 0: one per core (with --ray: of the cluster)."),
    ray: str | None = typer.Option(
        None,
        metavar="auto|ADDRESS",
        help="Run on a Ray cluster: HOST:PORT, or auto: the one that runs here, else one for this campaign.",
    ),
    vary: list[str] = typer.Option(
        [], metavar="PATH=LOW,HIGH", help="Vary a value of the cell file uniformly; may be repeated."
    ),
    set_: list[str] = typer.Option(
        [], "--set", metavar="PATH=VALUE", help="Another value in every trial; may be repeated."
    ),
    sampling: str | None = typer.Option(
        None, help="random, latin_hypercube, or adaptive (half of the trials near failures)."
    ),
    seed: int | None = typer.Option(None, min=0, help="Of the first trial; each next one has the next."),
    half_width: float | None = typer.Option(
        None, help="Stop when the 95 % interval of success is so narrow to each side, e.g. 0.01."
    ),
    max_seconds: float | None = typer.Option(None, help="Stop after so long [s]."),
    resume: Path | None = typer.Option(None, metavar="FOLDER", help="Go on with one that was broken off."),
    compare: tuple[Path, Path] | None = typer.Option(
        None, metavar="FOLDER FOLDER", help="Compare two campaigns; runs nothing."
    ),
    runs: Path = typer.Option(Path("runs"), metavar="FOLDER", help="Where the campaign's folder goes."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the summary as JSON."),
) -> int:
    """Run a campaign, which repeats a cell's task many times in the physics simulation with varied values.
    The report shows successes and failures.

    Every finished trial is saved at once (trials.jsonl): after Ctrl-C or a crash, continue with --resume.
    Writes report.html, report.md and summary.json. Exit status 0 if every trial succeeded, 1 if not.
    """
    if json_file is not None:
        check_writable(json_file)
    if sum((cell is not None, resume is not None, compare is not None)) != 1:
        raise typer.BadParameter("give a cell or a campaign's file, or --resume, or --compare")
    if compare is not None:
        return _compare(*compare, json_file)
    from armcell import campaigns

    if ray is not None:  # report errors before the campaign begins
        from armcell.campaigns.ray_workers import find_cluster

        find_cluster(ray)
    if resume is not None:
        if vary or set_ or any(v is not None for v in (sampling, seed, half_width, max_seconds)):
            raise typer.BadParameter(
                "--resume goes on with what was asked then; only --trials, --workers and --ray go with it"
            )
        store = campaigns.resume(resume)
        if trials is not None:
            store.spec = replace(store.spec, trials=trials)
        if store.dropped:
            console.print(f"the last line was cut off ({store.dropped} bytes); that trial runs again")
    else:
        spec = _spec(str(cell), vary, set_, {
            "trials": trials, "sampling": sampling, "seed": seed, "half_width": half_width,
            "max_seconds": max_seconds,
        })  # fmt: skip
        store = campaigns.begin(spec, runs)
    data = run_campaign(store, workers, ray)
    if json_file is not None:
        write_json(json_file, data)
    return 0 if data["success"]["total"] and not data["failures"] else 1


def run_campaign(store: Any, workers: int, ray: str | None = None) -> dict[str, Any]:
    """Run a campaign from the command line: run the trials that it still lacks, write the report, print the
    summary and return it.

    Args:
        workers: number of processes; 0: one per core.
        ray: address of a Ray cluster, or "auto".
    """
    from armcell import campaigns

    stopped = "it was stopped"
    with closing(store):
        try:
            stopped = _run(store, workers, ray)
            _take_pictures(store)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                _interrupts.take_time()
                errors.print(f"stopped; go on with: armcell campaign --resume {store.folder}", soft_wrap=True)
            with suppress(InputError):  # e.g. a full disk: report the first error, not this one
                campaigns.write_report(store, stopped)
            raise
        data = campaigns.summary(store, stopped)
        _print(data)
        report = campaigns.write_report(store, stopped)
    console.print(f"report: {report}", soft_wrap=True)
    return data


def _spec(cell: str, vary: list[str], set_: list[str], options: dict[str, Any]) -> Any:
    from armcell.campaigns import CampaignSpec
    from armcell.cell.value_overrides import parse_value
    from armcell.model.untrusted_files import read_yaml

    path = Path(cell)
    from_file = os.path.isfile(path) and "cell" in read_yaml(path) and "robot" not in read_yaml(path)
    spec = CampaignSpec.read(path) if from_file else CampaignSpec(cell)
    ranges: dict[str, Any] = {}
    for one in vary:
        name, _, ends = one.partition("=")
        try:
            low, high = (float(end) for end in ends.split(","))
        except ValueError:
            text = f"--vary {one!r} is not PATH=LOW,HIGH"
            raise InputError(text, hint="e.g. --vary objects.cube.mass=0.05,0.5") from None
        ranges[name.strip()] = {"uniform": [low, high]}
    given = {key: value for key, value in options.items() if value is not None}
    return replace(
        spec,
        parameters={**spec.parameters, **ranges},
        values={**spec.values, **dict(parse_value(one) for one in set_)},
        **given,
    )


def _run(store: Any, workers: int, ray: str | None) -> str:
    from armcell import campaigns
    from armcell.campaigns.statistics import success

    total = store.spec.trials
    columns = (
        TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"), TimeRemainingColumn(), TextColumn("{task.fields[share]}"),
    )  # fmt: skip
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as progress:
        task = progress.add_task("trials", total=total, completed=len(store.rows), rate="", share="")

        def tell(store: Any, count: int) -> None:
            seconds = progress.tasks[task].elapsed or 0.0
            found = success(list(store.rows.values()))
            low, high = found.wilson
            progress.update(
                task, completed=len(store.rows), rate=f"{count / max(seconds, 1e-9):.1f}/s",
                share=f"{found.value:.1%} succeed ({low:.1%} to {high:.1%})" if found.total else "",
            )  # fmt: skip

        return campaigns.run(store, workers, tell, ray, print_addresses)


def _take_pictures(store: Any) -> None:
    from armcell import campaigns

    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn())
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as progress:
        task = progress.add_task("pictures of failures", total=None)
        campaigns.take_pictures(store, lambda done, of: progress.update(task, completed=done, total=of))


def _print(data: dict[str, Any]) -> None:
    share = data["success"]
    if share["total"]:
        low, high = share["wilson"]
        console.print(
            f"{share['count']} of {share['total']} succeeded: {share['share']:.2%} "
            f"(95 % interval {low:.2%} to {high:.2%}), {data['unwanted_contacts']} unwanted contacts"
        )
    for cause in data["causes"][:5]:
        place = ", ".join(part for part in (cause["stage"], cause["pair"]) if part)
        console.print(f"{cause['count']} x {cause['code']}{f' ({place})' if place else ''}: ", end="")
        console.print(cause["message"], markup=False, soft_wrap=True)
        console.print(f"    {cause['replay']}", markup=False, soft_wrap=True)
    for effect in data["effects"][:3]:
        console.print(f"{effect['parameter']}: {effect['words']} (p = {effect['p_value']:.2g})", markup=False)


def _compare(first: Path, second: Path, json_file: Path | None) -> int:
    from armcell import campaigns
    from armcell.campaigns.gate import changed_parts
    from armcell.campaigns.store import TRIALS, stored_spec

    (before, hashes), (after, now) = (
        stored_spec(first),
        stored_spec(second),
    )  # reports a folder that contains no campaign
    differ = [f"cell {before.cell} and {after.cell}"] if before.cell != after.cell else []
    differ += changed_parts(hashes, now)
    differ += [
        name
        for name in ("parameters", "values", "sampling", "seed")
        if getattr(before, name) != getattr(after, name)
    ]
    console.print(f"what differs: {', '.join(differ) or 'nothing'}", soft_wrap=True, markup=False)
    found = campaigns.compare(campaigns.rows_of(first / TRIALS)[0], campaigns.rows_of(second / TRIALS)[0])
    console.print(found.words)
    if json_file is not None:
        write_json(json_file, {
            "first": found.first.as_dict(), "second": found.second.as_dict(),
            "what_differs": differ, "difference": found.difference, "interval": list(found.interval),
            "p_value": found.p_value,
        })  # fmt: skip
    return 0
