"""Gate before real arms: a signed record that a campaign validated this cell and task.

The record is signed with a keyed hash (HMAC-SHA256). The key belongs to the user and is created at first
use. The signature shows that `armcell gate` issued the record under this user's account and that the record
is unchanged: the success rate is not edited, and a campaign from another machine does not count unless
its key was copied, too. The signature does not protect against a person who can read the key.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.statistics import Proportion, success
from armcell.campaigns.store import TRIALS, rows_of, stored_spec
from armcell.cell import Cell, cell_names, content_hashes
from armcell.cell.built_in import LIBRARY
from armcell.cell.cell_hashes import versions
from armcell.core import InputError

FORMAT = 2  # format 1 did not list the varied parameters
LEAST = 0.95
"""Success rate that the lower bound of the exact 95 % interval must reach."""
KEY_VARIABLE = "ARMCELL_GATE_KEY"
KEY_BYTES = 32


def gate_file(cell: Cell) -> Path:
    """Return the default path of a cell's gate record: the signed file that permits the cell's task to run on
    real arms.

    The record is next to the cell file; for a built-in cell it is in the working folder.
    """
    if LIBRARY in cell.file.parents:
        return Path(f"{cell.name}.gate.json")
    return cell.file.with_name(f"{cell.file.stem}.gate.json")


def issue(
    cell: Cell, folder: str | Path, file: Path, least: float = LEAST, allow_unvaried: str | None = None
) -> dict[str, Any]:
    """Write the gate record of a finished campaign: the signed file that permits the cell's task to run on
    real arms. Raise an error if the campaign's success rate is too low.

    Args:
        cell: cell of the record: the campaign's cell with its `values`.
        folder: folder of the campaign.
        least: required lower bound of the success rate.
        allow_unvaried: reason to accept a campaign with identical trials; stored in the record.
    Raises:
        InputError: the campaign belongs to another cell, its success rate is too low, or its trials do not
            vary; the error states the measured values.
    """
    check_reason(allow_unvaried)
    folder = Path(folder)
    spec, then = stored_spec(folder)
    now = content_hashes(cell)
    changed = changed_parts(then, now)
    if changed:
        raise InputError(
            f"belongs to another state of this cell; differences: {', '.join(changed)}", file=folder,
            hint=f"armcell gate {cell.file}",
        )  # fmt: skip
    rows, _ = rows_of(folder / TRIALS)
    if spec.half_width is not None or spec.max_seconds is not None or len(rows) != spec.trials:
        raise InputError(
            f"has {len(rows)} trials, and {_asked(spec)}: where the number was not fixed beforehand, the "
            "interval promises too much",
            file=folder, hint=f"armcell gate {_name(cell)} --trials {max(len(rows), _fewest(least))}",
        )  # fmt: skip
    names = varied_paths(cell, rows)
    if not names and allow_unvaried is None:
        raise _unvaried(cell, f"{len(rows)} trials that differ in nothing but the planners' seed", folder)
    share = success(rows)
    low, high = share.clopper_pearson
    if share.total == 0 or low < least:
        raise InputError(
            f"shows too little: {share.count} of {share.total} succeeded, which is at least {low:.1%} "
            f"(95 % interval), and {least:.0%} is asked for",
            file=folder, hint=_hint(share.count, share.total, least),
        )  # fmt: skip
    record = {
        "format": FORMAT,
        "cell": cell.name,
        "issued": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "hashes": now,
        "versions": versions(),
        "least": least,
        "allow_unvaried": None if names else allow_unvaried,
        "campaign": {
            "folder": folder.name,
            "trials_sha256": hashlib.sha256((folder / TRIALS).read_bytes()).hexdigest(),
            "trials": share.total,
            "succeeded": share.count,
            "interval": [low, high],
            "unwanted_contacts": sum(row["unwanted_contacts"] for row in rows),
            "sampling": spec.sampling,
            "seed": spec.seed,
            "varied": names,
            "parameters": {path: _plain(value) for path, value in spec.parameters.items()},
            "values": {path: _plain(value) for path, value in spec.values.items()},
        },
    }
    signed = {**record, "signature": _signature(record, _key(make=True))}
    try:
        file.write_text(json.dumps(signed, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"cannot be written: {error.strerror}", file=file, hint="choose another with -o"
        ) from None
    return signed


def check_reason(allow_unvaried: str | None) -> None:
    """Raise an error if the reason that the user gives with the option `--allow-unvaried` is blank. This
    option permits a gate record for a campaign that varies nothing.

    Raises:
        InputError: the reason contains no words.
    """
    if allow_unvaried is not None and not allow_unvaried.strip():
        raise InputError(
            "--allow-unvaried needs a reason", hint='--allow-unvaried "the fixture holds every part in place"'
        )


def check_draws(cell: Cell) -> None:
    """Check that the trials of a campaign for a gate record would differ in more than the planners' seed.
    Otherwise, reject the cell.

    `armcell gate` calls this function before it runs the campaign.

    Raises:
        InputError: the cell randomizes nothing.
    """
    ranges = [value for entry in cell.spec.randomize.values() for value in entry.model_dump().values()]
    if cell.spec.drop is None and not any(value is not None and value[0] < value[1] for value in ranges):
        raise _unvaried(cell, "trials that differ in nothing but the planners' seed", cell.file)


def varied_paths(cell: Cell, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the paths of all parameters and randomized values that differ between the trials of a campaign.
    If no value differs, the gate before real arms rejects the campaign.

    "drop" means objects that physics drops into a bin, different for each seed. Sensor noise does not
    count, because it leaves the task unchanged.
    """
    seen: dict[str, set[str]] = {}
    for row in rows:
        drawn = {
            f"randomize.{name}.{key}": value
            for name, values in row["randomized"].items()
            for key, value in values.items()
        }
        for path, value in {**row["values"], **drawn}.items():
            seen.setdefault(path, set()).add(json.dumps(value, sort_keys=True))
    found = sorted(path for path, values in seen.items() if len(values) > 1)
    if cell.spec.drop is not None and len({row["seed"] for row in rows}) > 1:
        found.append("drop")
    return found


def _unvaried(cell: Cell, what: str, file: Path) -> InputError:
    return InputError(
        f"a campaign that varies nothing shows one case only: {what}", file=file,
        hint="say under 'randomize' in the cell file what may vary; or armcell campaign "
        f"{_name(cell)} --vary PATH=LOW,HIGH and then armcell gate {_name(cell)} --campaign FOLDER; or "
        "--allow-unvaried REASON, which the record keeps",
    )  # fmt: skip


def check(cell: Cell, file: Path | None = None) -> dict[str, Any]:
    """Verify and return the gate record of a cell, which states that the cell passed a simulation campaign.

    Commands that move real arms require this record, unless the user overrides the gate. The record must
    match the current cell, task, configuration and library versions, and prove a success rate of at least
    `LEAST`.

    Raises:
        InputError: the record is missing or invalid; the error says what is wrong.
    """
    place = file or gate_file(cell)
    hint = f"armcell gate {_name(cell)}, or --without-gate REASON, which goes into the run's record"
    if not os.path.isfile(place):
        raise InputError(
            f"cell {cell.name!r} has not been shown to work in simulation: no gate record {place}", hint=hint
        )
    try:
        record = json.loads(place.read_text(encoding="utf-8"))
        signature = record.pop("signature")
        form, then, least = record["format"], record["hashes"], record["least"]
        low = record["campaign"]["interval"][0]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(f"is no gate record ({type(error).__name__})", file=place, hint=hint) from None
    if form != FORMAT:
        raise InputError(f"is of format {form}, this armcell reads {FORMAT}", file=place, hint=hint)
    if not hmac.compare_digest(str(signature), _signature(record, _key(make=False))):
        raise InputError(
            "its signature is not right: it was edited, or issued under another key", file=place,
            hint=f"{hint}; to take a key to another machine: {KEY_VARIABLE}=FILE",
        )  # fmt: skip
    changed = changed_parts(then, content_hashes(cell), record["versions"])
    if changed:
        raise InputError(
            f"is not valid for this state of the cell; changed since: {', '.join(changed)}",
            file=place, hint=hint,
        )  # fmt: skip
    if low < LEAST or least < LEAST:
        raise InputError(f"shows {low:.1%}, {LEAST:.0%} is asked for", file=place, hint=hint)
    return {**record, "file": str(place)}


def changed_parts(
    then: Mapping[str, str], now: Mapping[str, str], old_versions: Mapping[str, str] | None = None
) -> list[str]:
    """List the parts of a cell that have changed since the gate approved it, or between two other states, by
    comparing content hashes. Library versions count as parts.

    Args:
        then: content hashes of the first state.
        now: content hashes of the second state.
        old_versions: library versions of the first state; if given, the list also contains the first version
            and the installed version of each library.
    """
    found = []
    for part in sorted({*then, *now}):
        if then.get(part) == now.get(part):
            continue
        library = part.partition("versions.")[2]
        if library and old_versions is not None:
            found.append(f"{library} {old_versions.get(library)} -> {versions().get(library)}")
        else:
            found.append("armcell's code" if part == "code" else part)
    return found


# --- the key ---
def key_file() -> Path:
    """Return the path of the key that signs the user's gate records. A gate record permits a cell's task to
    run on real arms. An environment variable can override the path.
    """
    named = os.environ.get(KEY_VARIABLE)
    if named:
        return Path(named)
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "armcell" / "gate.key"


def _key(make: bool) -> bytes:
    file = key_file()
    try:
        if make and not os.path.exists(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "w", encoding="ascii") as stream:
                stream.write(secrets.token_hex(KEY_BYTES) + "\n")
        key = bytes.fromhex(file.read_text(encoding="ascii").strip())
    except FileNotFoundError:
        return b""  # no key, so no signature is valid
    except (OSError, ValueError) as error:
        raise InputError(f"the gate's key cannot be read ({error})", file=file) from None
    if len(key) < KEY_BYTES:
        raise InputError("is too short for a key", file=file, hint="delete it: a new one is made")
    return key


def _signature(record: Mapping[str, Any], key: bytes) -> str:
    text = json.dumps(record, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hmac.new(key, text.encode("ascii"), hashlib.sha256).hexdigest() if key else "none"


# --- messages ---
def _asked(spec: CampaignSpec) -> str:
    if spec.half_width is not None:
        return f"was to stop when its interval is within {spec.half_width:.2%} to each side"
    if spec.max_seconds is not None:
        return f"was to stop after {spec.max_seconds:g} s"
    return f"was asked for {spec.trials}"


def _fewest(least: float, above: int = 0) -> int:
    """Return the smallest number of trials with which a campaign can pass the gate if all of them succeed:
    the exact 95 % confidence interval must show a success rate of at least `least`.
    """
    return next(n for n in range(above + 1, 10**6) if Proportion(n, n).clopper_pearson[0] >= least)


def _hint(count: int, total: int, least: float) -> str:
    if count == total:
        more = _fewest(least, total)
        return f"{more} trials without a failure show it: armcell gate CELL --trials {more}"
    return "see the campaign's report for the causes, mend them, and run it again"


def _name(cell: Cell) -> str:
    return cell.name if cell.name in cell_names() else str(cell.file)


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=str))
