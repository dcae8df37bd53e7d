"""Commit hook: the subject names its area and has at most 72 characters.

python .ci/commit_subject.py FILE-WITH-THE-MESSAGE
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
OTHER_AREAS = {"armcell", "benchmarks", "ci", "docs", "examples", "lint", "tests", "unity", "cache"}


def areas() -> set[str]:
    """The packages of `src/armcell`, and the folders beside it."""
    return OTHER_AREAS | {folder.name for folder in (ROOT / "src/armcell").iterdir() if folder.is_dir()}


def fault(subject: str) -> str | None:
    """What is wrong with a commit subject, or None."""
    if subject.startswith(("Merge ", "Revert ", "fixup! ", "squash! ")):
        return None
    if len(subject) > 72:
        return f"the subject has {len(subject)} characters, the limit is 72"
    match = re.fullmatch(r"([a-z0-9_, ]+): (\S.*)", subject)
    if match is None:
        return "the subject does not start with an area; example: 'collision: report the depth of each pair'"
    unknown = [area for area in match[1].split(", ") if area not in areas()]
    if unknown:
        return f"{unknown[0]!r} is not an area. Areas: {', '.join(sorted(areas()))}"
    if match[2].endswith("."):
        return "the subject ends with a period"
    return None


def main() -> int:
    subject = Path(sys.argv[1]).read_text(encoding="utf-8").split("\n", 1)[0].strip()
    problem = fault(subject)
    if problem:
        print(f"{subject}\n{problem}", file=sys.stderr)
    return 1 if problem else 0


if __name__ == "__main__":
    sys.exit(main())
