"""The files of armcell stay short enough to read from top to bottom."""

from pathlib import Path

SOURCES = Path(__file__).parents[2] / "src/armcell"
MOST_LINES = 500  # CONTRIBUTING.md: a file seldom exceeds 400 lines


def test_no_source_file_has_more_than_500_lines():
    lines = {file: len(file.read_text().splitlines()) for file in SOURCES.rglob("*.py")}
    assert len(lines) > 100
    assert {str(file.relative_to(SOURCES)): n for file, n in lines.items() if n > MOST_LINES} == {}
