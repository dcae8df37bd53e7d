"""The words that our style guide rejects appear nowhere in the sources, docs and examples."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REJECTED = (
    "told", "gone into", "anew", "shall", "by so much", "nobody", "somebody", "whoever", "as it is", "lends",
    "cure",
)  # fmt: skip
BRITISH = ("colour", "neighbour", "centre", "metre", "optimise", "organise", "normalise")
WORDS = re.compile(rf"\b({'|'.join(REJECTED)})\b|{'|'.join(BRITISH)}", re.IGNORECASE)
OTHERS = re.compile(r"nobody@localhost|>nobody<|FrameTree")  # catkin's maintainer; a camel case
NOT_OURS = ("docs/glossary.md", "src/armcell/_renamed.py")  # list old words


def files() -> list[Path]:
    try:
        listed = subprocess.run(
            ["git", "ls-files", "src", "docs", "examples", "README.md", "CONTRIBUTING.md"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git repository")
    names = [name for name in listed.stdout.split() if name.endswith((".py", ".md", ".yaml"))]
    return [ROOT / name for name in names if name not in NOT_OURS and (ROOT / name).exists()]


def rejected(text: str) -> list[str]:
    """Return the rejected words of a text, each with its line number."""
    return [
        f"{n}: {found[0]}"
        for n, line in enumerate(text.splitlines(), 1)
        for found in WORDS.finditer(OTHERS.sub("", line))
    ]


def test_the_check_finds_words():
    assert rejected("one\nNobody is told anew") == ["2: Nobody", "2: told", "2: anew"]
    assert rejected("its colours") == ["1: colour"]
    assert not rejected("thousand, shallow, storytold, obtain")


@pytest.mark.slow
def test_no_rejected_word_is_used():
    found = [f"{file.relative_to(ROOT)}:{word}" for file in files() for word in rejected(file.read_text())]
    assert not found, "\n".join(found)
