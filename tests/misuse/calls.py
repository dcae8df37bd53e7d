"""Calls of the public API with one wrong value each; `python -m tests.misuse.calls SHARD SHARDS` makes them.

Prints a line before each callable, so that one that ends the process is known, and a line per finding.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
import os
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests import programs
from tests.misuse.samples import HUGE, LONG, by_type, is_array, misuses, sample

from armcell.core import ArmcellError
from armcell.planning import prepare_group, solve_ik
from armcell.planning.first_compile import warm_up_ik
from armcell.timing import BlendedPath

PACKAGES = ("core", "model", "kinematics", "timing", "scene", "collision", "planning", "grasping",
            "perception", "sim", "drivers", "execution", "twin", "tasks", "cell", "campaigns")  # fmt: skip
ROOT = Path(__file__).parents[2]
LONGEST = 2.0  # [s] of processor time of a call: other processes may take the machine
WAITING = 20.0  # [s] of a call that waits
SLOW = ("collision.disabled_collision_pairs",)  # valid calls take longer
WRONG_TYPE = (TypeError, AttributeError)
"""Python's own errors for a value of another type, not from compiled code: what any Python library raises."""
NO_SCALAR = (*WRONG_TYPE, ValueError, OverflowError, IndexError)
"""The same where a number or object is needed and an array, or a number that no float can hold, is given."""


class TooLong(BaseException):
    pass


def public() -> Iterator[tuple[str, Callable[..., Any], Any]]:
    """Name, callable, and the instance that it is a method of or None."""
    seen = set()
    for package in PACKAGES:
        module = importlib.import_module(f"armcell.{package}")
        for name in getattr(module, "__all__", None) or [n for n in dir(module) if not n.startswith("_")]:
            found = getattr(module, name)
            if not str(getattr(found, "__module__", "")).startswith("armcell") or id(found) in seen:
                continue
            seen.add(id(found))
            if inspect.isclass(found) and issubclass(found, BaseException):
                continue
            if not inspect.isclass(found):
                if callable(found):
                    yield f"{package}.{name}", found, None
                continue
            yield f"{package}.{name}", found, None
            for member, value in vars(found).items():
                if member.startswith("_"):
                    continue
                if isinstance(value, staticmethod | classmethod):
                    yield f"{package}.{name}.{member}", getattr(found, member), None
                elif inspect.isfunction(value):
                    with contextlib.suppress(Exception):
                        yield f"{package}.{name}.{member}", value, instance(found)


def instance(cls: type) -> Any:
    if cls.__name__ in by_type():
        return by_type()[cls.__name__]
    return cls(**{p.name: sample(p) for p in parameters(cls, False) if p.default is p.empty})


def parameters(found: Callable[..., Any], method: bool) -> list[inspect.Parameter]:
    try:
        listed = list(inspect.signature(found).parameters.values())[method:]
    except ValueError:  # of a built-in, such as an exception's constructor
        return []
    return [p for p in listed if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]


def wrong_calls(found: Callable[..., Any], owner: Any) -> Iterator[tuple[str, Any, bool, Callable[[], Any]]]:
    """Name of the wrong argument, its value, whether it is of the type that is needed, the call."""
    every = parameters(found, owner is not None)
    valid = {}
    for p in every:
        try:
            valid[p.name] = sample(p)
        except LookupError:
            if p.default is p.empty:
                return
    first = () if owner is None else (owner,)
    for p in every:
        if p.name not in valid:
            continue
        for wrong in misuses(valid[p.name]):
            needed = {q.name: valid[q.name] for q in every if q.default is q.empty}
            arguments = {**needed, p.name: wrong}
            rest = [
                arguments.pop(q.name) for q in every if q.kind is q.POSITIONAL_ONLY and q.name in arguments
            ]
            same = is_array(valid[p.name]) or (
                type(wrong) in (int, float, str, dict) and wrong not in (HUGE, LONG)
            )
            yield p.name, wrong, same, lambda a=arguments, r=rest: found(*first, *r, **a)


def fault(call: Callable[[], Any], shaped: bool) -> str | None:
    """What is wrong with how a call ends, or None.

    Args:
        shaped: an array is needed, so that another shape is no other type.
    """
    allowed = WRONG_TYPE if shaped else NO_SCALAR
    began = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    signal.setitimer(signal.ITIMER_REAL, WAITING)
    try:
        made = call()
        if inspect.isgenerator(made):
            next(made, None)
    except ArmcellError as error:
        text = str(error)
        return None if text else "no message"
    except TooLong:
        return f"takes longer than {LONGEST:g} s"
    except allowed as error:
        if "numba" in type(error).__module__ or "numba" in str(error).lower():
            return f"{type(error).__name__}: {str(error)[:100]}"
    except StopIteration:
        return None
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:100]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
    took = time.process_time() - began
    return f"took {took:.1f} s" if took > LONGEST else None


def findings(shard: int, shards: int) -> Iterator[dict[str, Any]]:
    """Make a shard's calls in other processes; a finding each, then the number of calls."""
    with tempfile.TemporaryDirectory() as folder:  # some of the calls write files
        yield from _findings(shard, shards, folder)


def _findings(shard: int, shards: int, folder: str) -> Iterator[dict[str, Any]]:
    first, calls = 0, 0
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    while True:
        command = [sys.executable, "-m", "tests.misuse.calls", str(shard), str(shards), str(first)]
        done = programs.run(
            command, capture_output=True, text=True, timeout=600, check=False, cwd=folder, env=environment
        )
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        yield from (line for line in lines if "fault" in line)
        calls += sum(line.get("calls", 0) for line in lines)
        if done.returncode == 0:
            break
        if done.returncode > 0 or not lines:
            raise RuntimeError(done.stderr)
        last = [line for line in lines if "at" in line][-1]
        yield {"call": last["at"], "fault": f"ended the process ({done.returncode}) {done.stderr[-300:]}"}
        first = last["number"] + 1
    yield {"calls": calls}


def warm_up() -> None:
    """Compile what is compiled at its first call, and what a robot's first use takes: neither counts."""
    scene, q = by_type()["PlanningScene"], by_type()["JointState"].positions
    prepare_group(scene, "arm")
    for link in (None, "panda_hand"):
        warm_up_ik(scene.model, "arm", link)
    solve_ik(scene, "arm", by_type()["SE3"])
    BlendedPath([q, q + 0.1, q - 0.1]).polyline()


def main(shard: int, shards: int, first: int) -> None:
    warnings.simplefilter("ignore")
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def late(*_: Any) -> None:
        raise TooLong

    warm_up()
    signal.signal(signal.SIGALRM, late)
    signal.signal(signal.SIGPROF, late)
    calls = 0
    for k, (name, found, owner) in enumerate(public()):
        if k < first or k % shards != shard or name in SLOW:
            continue
        out.write(json.dumps({"at": name, "number": k, "calls": calls}) + "\n")
        calls = 0
        for parameter, wrong, shaped, call in wrong_calls(found, owner):
            calls += 1
            if (bad := fault(call, shaped)) is not None:
                line = {"call": name, "parameter": parameter, "wrong": repr(wrong)[:60], "fault": bad}
                out.write(json.dumps(line) + "\n")
    out.write(json.dumps({"calls": calls}) + "\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
