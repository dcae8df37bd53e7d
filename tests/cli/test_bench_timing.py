"""`armcell bench timing`: rows that can be checked, against toppra where it is asked for."""

from __future__ import annotations

import json

import pytest

from armcell.cli.main import main
from armcell.timing import TimingSettings


@pytest.mark.slow
@pytest.mark.parametrize("keep", ["acceleration", "torque", "jerk"])
def test_rows_keep_limits_and_compare(tmp_path, keep, capsys):
    out = tmp_path / "out.json"
    arguments = ["bench", "timing", "--robot", "ur10", "--count", "2", "--waypoints", "6", "--keep", keep]
    assert main([*arguments, "--peer", "--json", str(out)]) == 0
    rows = json.loads(out.read_text())
    assert [row["index"] for row in rows] == [0, 1] and "toppra" in capsys.readouterr().out
    for row in rows:
        assert 0.0 < row["timing_us"] < row["peer_us"] and row["waypoints"] == 6
        assert row["worst_of_limit"] <= 1.0 + 1e-6
        assert row["duration_s"] == pytest.approx(row["of_peer"] * row["peer_duration_s"])
        assert row["unsmoothed_of_peer"] <= 1.02 or keep == "jerk"
        assert (f"{keep}_of_limit" in row) and row["smoothing_s"] == (
            0.0 if keep == "jerk" else TimingSettings().smoothing
        )


def test_the_same_seed_gives_the_same_paths(tmp_path):
    lengths = []
    for i, seed in enumerate((1, 1, 2)):
        out = tmp_path / f"{i}.json"
        assert main(["bench", "timing", "--robot", "panda", "--count", "1", "--seed", str(seed),
                     "--json", str(out)]) == 0  # fmt: skip
        lengths.append(json.loads(out.read_text())[0]["length"])
    assert lengths[0] == lengths[1] != lengths[2]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--robot", "ur10", "--keep", "fuel"], "must be acceleration, torque or jerk"),
        (["--robot", "ur11"], "ur11"),
        (["--robot", "ur10", "--group", "leg"], "unknown planning group 'leg'"),
        (["--robot", "panda", "--group", "nothing"], "unknown planning group"),
    ],
)
def test_bad_input_is_one_line(arguments, reason, capsys):
    assert main(["bench", "timing", *arguments]) == 1
    shown = capsys.readouterr().err
    assert reason in shown and "Traceback" not in shown and len(shown.strip().splitlines()) == 1
