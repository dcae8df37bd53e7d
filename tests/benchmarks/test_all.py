"""`make bench` runs every benchmark that there is, and its page says what they printed."""

import json
import sys
from pathlib import Path

from benchmarks import __main__ as everything

FOLDER = Path(everything.__file__).parent


def test_every_benchmark_is_run():
    files = {f.stem for f in FOLDER.glob("*.py")} | {f.parent.name for f in FOLDER.glob("*/__main__.py")}
    helpers = {"__init__", "__main__", "grasp_objects", "picture"}
    assert {b.name for b in everything.BENCHMARKS} == files - helpers

    for benchmark in everything.BENCHMARKS:
        assert isinstance(benchmark.quick, tuple) and isinstance(benchmark.full, tuple)
        assert benchmark.page is None or (everything.PAGE.parent / benchmark.page).is_file()


def test_the_page_has_what_was_printed(tmp_path, monkeypatch, capfd):
    """With a benchmark of its own, in a process as the others."""
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "__init__.py").touch()
    text = (
        "import sys\nprint('a line')\nprint('| a | b |\\n|---|---|\\n| 1 | 2 |')\n"
        "if '--picture' in sys.argv: open(sys.argv[-1], 'w')\nsys.exit({})\n"
    )
    (tmp_path / "pictures").mkdir()
    (tmp_path / "own.md").write_text("# Own\n\n![A plot](pictures/own.png)\n")
    for name, status in (("good", 0), ("bad", 3), ("unable", 2)):
        (tmp_path / "benchmarks" / f"{name}.py").write_text(text.format(status))
    table = (
        everything.Benchmark("good", "Good", draws=True),
        everything.Benchmark("bad", "Bad", page="own.md"),
        everything.Benchmark("unable", "Unable", draws=True),
        everything.Benchmark("later", "Later"),
    )
    monkeypatch.setattr(everything, "ROOT", tmp_path)
    monkeypatch.setattr(everything, "BENCHMARKS", table)
    monkeypatch.setattr(everything, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(everything, "KEPT", tmp_path / "kept.json")
    for only, status in ((["good"], 0), (["bad"], 1), (["unable"], 0)):
        monkeypatch.setattr(sys, "argv", ["benchmarks", "--only", *only])
        assert everything.main() == status
    page, kept = (tmp_path / "page.md").read_text(), json.loads((tmp_path / "kept.json").read_text())
    assert "a line" in kept["good"]["printed"]
    good, bad, unable, later = page.split("\n## ")[1:]
    assert (
        "- a line\n\n| a | b |\n| --- | --- |\n| 1 | 2 |" in good
        and "mujoco" in good
        and "failed" not in good
    )
    assert "![Good](pictures/bench_good.png)" in good and (tmp_path / "pictures/bench_good.png").exists()
    assert "[Bad](own.md)" in bad and "![A plot](pictures/own.png)" in bad
    assert "failed with status 3" in bad and "Left out: | 1 | 2 |" in unable
    assert "make bench ONLY=later" in later
    assert "```" not in page
    assert capfd.readouterr().out.count("a line") == 3


def test_results_are_tables_and_lists_without_progress_and_logs():
    printed = [
        "  0 wall: 0.25 s", "", "/a/file.urdf: a warning", 'states {"lost": 0}', "10 of 10 solved",
        "robot     samples  touching", "panda     999,950         0",
        "what | measured", "trials | 12",
    ]  # fmt: skip
    solved, first, second = everything.results(printed)
    assert solved == "- 10 of 10 solved"
    assert first == "| robot | samples | touching |\n| --- | --- | --- |\n| panda | 999,950 | 0 |"
    assert second == "| what | measured |\n| --- | --- |\n| trials | 12 |"
    assert everything.results(["waits    0.5  at most 1"]) == [
        "| what | measured | bar |\n| --- | --- | --- |\n| waits | 0.5 | at most 1 |"
    ]
