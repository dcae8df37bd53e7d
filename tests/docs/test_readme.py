"""The README stays short, its links lead somewhere, and its Chinese version has the same content."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from armcell.cli.main import app

ROOT = Path(__file__).parents[2]
ENGLISH = (ROOT / "README.md").read_text()
CHINESE = (ROOT / "README.zh-CN.md").read_text()
COMMANDS = (ROOT / "docs/commands.md").read_text()


def outline(text: str) -> dict:
    """What both languages share: headings, table rows, list items, links, and code without comments."""
    code = [
        re.sub(r"\s*#.*", "", line)
        for block in re.findall(r"```.*?```", text, re.S)
        for line in block.splitlines()
    ]
    prose = re.sub(r"```.*?```", "", text, flags=re.S)
    links = re.findall(r"\]\(([^)]+)\)", prose)
    return {
        "headings": [len(mark) for mark in re.findall(r"^(#+) ", prose, re.M)],
        "rows": len(re.findall(r"^\|", prose, re.M)),
        "items": len(re.findall(r"^- ", prose, re.M)),
        "links": sorted(link for link in links if not link.startswith("README")),
        "numbers": set(re.findall(r"\d[\d,.]*\d|\d", re.sub(r"\]\([^)]*\)", "]", prose))),
        "code": code,
    }


@pytest.mark.parametrize("part", ["headings", "rows", "items", "links", "numbers", "code"])
def test_both_languages_have_the_same_content(part):
    assert outline(CHINESE)[part] == outline(ENGLISH)[part]


@pytest.mark.parametrize("text", [ENGLISH, CHINESE], ids=["english", "chinese"])
def test_it_is_short(text):
    assert len(text.splitlines()) <= 90


def test_its_links_lead_to_files():
    for link in outline(ENGLISH)["links"]:
        path, _, anchor = link.partition("#")
        assert (ROOT / path).exists(), link
        if anchor:
            assert f"## {anchor}" in (ROOT / path).read_text().lower(), link


def test_every_command_is_described():
    commands = get_command(app).commands  # type: ignore[attr-defined]
    missing = [
        name for name, command in commands.items() if not command.hidden and f"armcell {name}" not in COMMANDS
    ]
    assert not missing
