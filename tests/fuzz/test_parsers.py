"""The parsers' fuzzer: it finds what crashes, hangs and eats memory, and nothing in a short run."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from tests import programs
from tests.fuzz import files, parsers

from armcell.core import ArmcellError

QUICK = 80  # inputs of each parser

# What runs of the fuzzer have found, by target.
FOUND = {
    "mesh-obj": [b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
                 b"v 0 0 0\nv 1 0 0\nv 0 1 1e308\nf 1 2 -9\n", b"v 1e400 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"],
    "mesh-off": [b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", b"OFF\n3 1 0\n0 0\n1 0 0\n0 1 0\n3 0 1 2\n"],
    "mesh-stl": [b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0\nvertex 1 0 0\nvertex 0 1e400 0\n"
                 b"endloop\nendfacet\nendsolid\n"],
    "mesh-ply": [parsers.seed("part.ply").replace(b"3 1 2 3", b"3 1 2 99"),
                 parsers.seed("part.ply").replace(b"0.1 0 0", b"1e400 0 0")],
    "cell": [parsers.seed("cell.yaml").replace(b"0.05, 0.05, 0.05]", value)
             for value in (b"1e400, 0.05, 0.05]", b".nan, 0.05, 0.05]")],
    "urscript": [b"movej([1e400, 0, 0, 0, 0, 0])\n", b"x = 1e400\n", b"x = " + b"9" * 5000 + b"\n"],
    "trials": [b'{"trial": 1, "success": false}\n', b'{"trial": [], "success": 1}\n'],
}  # fmt: skip


@pytest.mark.parametrize(("name", "number"), [(n, i) for n, all in FOUND.items() for i in range(len(all))])
def test_what_was_found_stays_fixed(name, number, tmp_path):
    target = parsers.targets()[name]
    file = target.folder(tmp_path) / target.file
    file.write_bytes(FOUND[name][number])
    parsers.forget()
    wire = name == "urscript"  # a controller reports it and goes on
    try:
        target.take(file)
    except ArmcellError as error:
        assert not wire and str(error)
    else:
        assert wire


@pytest.mark.slow
def test_every_seed_is_taken(tmp_path):
    """Damaging what is refused anyway would show little. The gate record alone is refused: it is unsigned."""
    for name, target in parsers.targets().items():
        file = target.folder(tmp_path) / target.file
        parsers.forget()
        file.write_bytes(target.seeds[0])
        if name == "gate":
            with pytest.raises(ArmcellError, match="signature"):
                target.take(file)
        else:
            target.take(file)


def test_an_input_depends_on_seed_parser_and_number_alone():
    target = parsers.targets()["cell"]
    first = [files.made(target, 1, n) for n in range(20)]
    assert first == [files.made(target, 1, n) for n in range(20)]
    assert len(set(first)) > 15 and first != [files.made(target, 2, n) for n in range(20)]


BROKEN = """
import os, sys
from tests.fuzz import parsers

def break_down(path):
    number = int(open("now").read().split()[1])
    if number == 3:
        os.abort()
    if number == 5:
        while True:
            pass
    if number == 7:
        bytearray(8 << 30)
    if number == 9:
        raise KeyError("ours")

targets = parsers.targets()
targets["trials"] = parsers.Target("trials", "trials.jsonl", targets["trials"].seeds, break_down)
"""


@pytest.mark.long
def test_crashes_hangs_and_hunger_are_found_and_kept(tmp_path, monkeypatch):
    """By a parser that has all four faults, in the process that takes the inputs."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nif '--work' in sys.orig_argv:\n"
        f"    sys.path[:0] = {[str(files.ROOT / 'src'), str(files.ROOT)]!r}\n"
        "    exec(open({!r}).read())\n".format(str(tmp_path / "broken.py"))
    )
    (tmp_path / "broken.py").write_text(BROKEN)
    monkeypatch.setattr(files, "PATHS", (tmp_path, *files.PATHS))
    report = files.fuzz_parsers(["trials"], 12, 1, tmp_path / "found")
    words = {fault.number: fault.words for fault in report.faults}
    assert sorted(words) == [3, 5, 7, 9], words
    assert "status -6" in words[3] and "more than 2 s" in words[5] and "MiB" in words[7]
    assert "KeyError" in words[9]
    assert all(fault.file.read_bytes() for fault in report.faults)


@pytest.mark.slow
def test_a_kept_input_is_given_again_by_one_command(tmp_path):
    bad = tmp_path / "trials-1-98"
    bad.write_bytes(b'{"trial": 1}\n')
    paths = os.pathsep.join(map(str, files.PATHS))
    done = programs.run(
        [sys.executable, "-m", "tests.fuzz", "--replay", bad], capture_output=True, text=True,
        cwd=files.ROOT, env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip
    assert (
        done.returncode == 0 and "trials refuses it" in done.stdout and "jsonl:1: is no trial" in done.stdout
    )


@pytest.mark.long
def test_a_short_run_over_every_parser_finds_nothing(tmp_path):
    report = files.fuzz_parsers(list(parsers.targets()), QUICK, 5, Path(tmp_path))
    assert [f"{f.target} {f.number}: {f.words}" for f in report.faults] == []
    assert report.inputs == QUICK * len(parsers.targets())
