"""Names that no file can have, from a file or a user: an error of the project, never one of the system."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import armcell
from armcell.campaigns import CampaignSpec
from armcell.core import ArmcellError
from armcell.model import load_robot
from armcell.records import read_record

SOURCE = Path(armcell.__file__).parent
LONG = "a" * 5000


def spec_of(name: str) -> None:
    file = Path("campaign.yaml")
    file.write_text(f"cell: {name}\ntrials: 3\n")
    armcell.load(CampaignSpec.read(file).cell)


@pytest.mark.parametrize("name", [LONG, f"{LONG}.urdf", f"{LONG}.xml", f"x/{LONG}", f"{LONG}.yaml"])
@pytest.mark.parametrize("take", [spec_of, load_robot, armcell.load, read_record])
def test_a_name_that_is_too_long(take, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArmcellError):
        take(name)


def test_files_are_looked_up_by_os_path():
    """os.path returns False for names that no file can have, where the methods of Path raise OSError."""
    methods = re.compile(r"\.(is_file|is_dir|exists)\(\)")
    found = [
        f"{file.relative_to(SOURCE)}:{number}"
        for file in SOURCE.rglob("*.py")
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if methods.search(line)
    ]
    assert not found, found
