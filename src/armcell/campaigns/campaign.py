"""Execution of a campaign: draw trials, run them, store results, stop by the stop rules."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from armcell.campaigns.gate import changed_parts
from armcell.campaigns.pool import Pool, Processes, Workers, cores
from armcell.campaigns.spec import (
    ROUND,
    Array,
    CampaignSpec,
    Distribution,
    adaptive_draw,
    checked_cell,
    distributions,
    latin_hypercube_draw,
    random_draw,
)
from armcell.campaigns.statistics import success
from armcell.campaigns.store import Store
from armcell.campaigns.trial import Trial
from armcell.cell import announce_code, cell_names, content_hashes
from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint
from armcell.planning import warm_up

FEWEST = 20  # trials before the stop rule tests the confidence interval
Tell = Callable[[Store, int], None]  # (store, trials run in this process)


def begin(spec: CampaignSpec, runs: Path) -> Store:
    """Begin a new campaign: check that its cell is valid at both ends of every parameter range, and create
    the campaign's folder.

    Raises:
        InputError: the cell or a parameter is invalid; raised before any trial runs.
    """
    if spec.sampling == "adaptive" and not spec.parameters:  # not checked in the spec: options may add some
        raise InputError(
            "adaptive sampling needs parameters, to go where they fail", hint="--vary PATH=LOW,HIGH"
        )
    if spec.cell not in cell_names() and os.path.exists(file := Path(spec.cell)):
        spec = replace(spec, cell=str(file.resolve()))  # the printed commands must work in any folder
    cell = checked_cell(spec)
    announce_code(cell)  # announced here because workers do not log
    return Store.new(runs, spec, content_hashes(cell))


def resume(folder: str | Path) -> Store:
    """Resume an interrupted campaign after checking that its cell has not changed since the campaign began.

    Raises:
        InputError: the folder contains no campaign, or the cell has changed since the campaign began.
    """
    store = Store.open(folder)
    cell = checked_cell(store.spec)
    changed = changed_parts(store.hashes, content_hashes(cell))
    if changed:
        store.close()
        raise InputError(
            f"changed since this campaign began: {', '.join(changed)}", file=store.folder,
            hint="trials of two different cells do not make one table: begin a new campaign",
        )  # fmt: skip
    announce_code(cell)
    return store


def run(
    store: Store, workers: int = 0, tell: Tell = lambda store, began: None, ray: str | None = None,
    listening: Callable[[Sequence[Endpoint]], None] = lambda endpoints: None,
) -> str:  # fmt: skip
    """Run the missing trials of a campaign until all trials are done or a stop rule applies.

    Args:
        workers: number of workers; 0 for one per core.
        tell: called after every trial with the store and the number of trials run by this process.
        ray: run on a Ray cluster, given as HOST:PORT or "auto"; see `RayWorkers`.
        listening: called with the sockets that the cluster opens on this machine, when they appear.
    Returns:
        Reason why the campaign stopped, as text.
    Raises:
        InputError: no worker starts, or the cluster's address is wrong or its version differs.
        MissingExtraError: Ray is not installed.
    """
    spec = store.spec
    if _sure_enough(store):
        return _sure(spec)
    # Statistics between trials use it. A signal during an import ends the process at once, without a report.
    importlib.import_module("scipy.stats")
    warm_up()  # compile once here instead of in every worker
    began, count = time.monotonic(), 0
    with _workers(store, workers, ray) as found:
        seen: set[Endpoint] = set()

        def look() -> None:
            new = [endpoint for endpoint in found.endpoints() if endpoint not in seen]
            if new:
                seen.update(new)
                listening(new)

        look()
        pool = Pool(spec, found)
        for first in range(0, spec.trials, ROUND if spec.sampling == "adaptive" else spec.trials):
            last = min(first + ROUND, spec.trials) if spec.sampling == "adaptive" else spec.trials
            for row in pool.run(_missing(store, first, last)):
                store.append(row)
                count += 1
                if count <= found.size:  # each worker may open a port
                    look()
                tell(store, count)
                if spec.max_seconds is not None and time.monotonic() - began > spec.max_seconds:
                    return f"{spec.max_seconds:g} s are over"
                if _sure_enough(store):
                    return _sure(spec)
    return f"all {spec.trials} trials are done"


def _workers(store: Store, count: int, ray: str | None) -> Workers:
    if ray is None:
        return Processes(store.spec, count or cores())
    from armcell.campaigns.ray_workers import RayWorkers

    return RayWorkers(store.spec, store.hashes, count, ray)


def _sure(spec: CampaignSpec) -> str:
    return f"the interval is within {spec.half_width:.2%} to each side"


def _sure_enough(store: Store) -> bool:
    found = success(list(store.rows.values()))
    if store.spec.half_width is None or found.total < FEWEST:
        return False
    low, high = found.wilson
    return (high - low) / 2 <= store.spec.half_width


def _missing(store: Store, first: int, last: int) -> Iterator[Trial]:
    """Yield the campaign's next trials to run: those from number `first` to `last` (excluded) that have no
    stored result.
    """
    spec = store.spec
    ranges = distributions(spec)
    failed = [
        np.array(row["draw"]) for number, row in sorted(store.rows.items())
        if number < first and not row["success"]
    ]  # fmt: skip
    for number in range(first, last):
        if number not in store.rows:
            yield trial(spec, ranges, number, failed)


def trial(
    spec: CampaignSpec, ranges: dict[str, Distribution], number: int, failed: Sequence[Array] = ()
) -> Trial:
    """Draw one trial of the campaign. Its sampled values depend only on the seed, the trial's number and
    earlier failures.

    Args:
        failed: draws of failed trials of earlier rounds, for adaptive sampling.
    """
    near = False
    if spec.sampling == "latin_hypercube":
        draw = latin_hypercube_draw(spec.seed, number, len(ranges))
    elif spec.sampling == "adaptive":
        draw, near = adaptive_draw(spec.seed, number, failed, len(ranges))
    else:
        draw = random_draw(spec.seed, number, len(ranges))
    values = {path: found.at(float(u)) for (path, found), u in zip(ranges.items(), draw, strict=True)}
    return Trial(number, spec.seed + number, values, tuple(draw.tolist()), near)
