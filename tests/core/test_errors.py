"""Error codes, messages of one line, and the registry."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from armcell.core import ErrorCode, InputError, MissingExtraError, Outcome, Registry, UnknownNameError

FACTS = Path(__file__).parents[3] / "shared" / "facts" / "moveit_api.md"


@pytest.mark.skipif(not FACTS.exists(), reason="needs the project's fact sheets")
def test_error_codes_are_moveit_s():
    section = FACTS.read_text().split("## MoveItErrorCodes", 1)[1].split("##", 1)[0]
    listed = {name: int(value) for name, value in re.findall(r"([A-Z][A-Z_]+) (-?\d+)", section)}
    assert len(listed) > 25
    assert {code.name: code.value for code in ErrorCode} == listed


def test_only_success_is_ok():
    for code in ErrorCode:
        assert code.ok == bool(Outcome(code)) == Outcome(code).ok == (code.name == "SUCCESS")


def test_message_names_file_line_element_reason_and_cure():
    error = InputError("is odd", file="a.urdf", line=7, element="<link>", hint="make it even")
    assert str(error) == "a.urdf:7: <link>: is odd (make it even)"
    assert str(InputError("is odd", file="a.urdf")) == "a.urdf: is odd"
    assert str(InputError("is odd")) == "is odd"


def test_unknown_names_list_the_known_and_suggest():
    error = UnknownNameError("link", "panda_hnad", ["panda_hand", "panda_link0"])
    assert str(error) == (
        "unknown link 'panda_hnad'; known: panda_hand, panda_link0 (did you mean 'panda_hand'?)"
    )
    assert "did you mean" not in str(UnknownNameError("link", "zzz", ["panda_hand"]))
    assert "known: none" in str(UnknownNameError("link", "zzz", []))
    many = UnknownNameError("link", "x", [f"l{i}" for i in range(1000)])
    assert len(str(many)) < 400 and len(many.known) == 1000
    assert isinstance(error, InputError)


def test_a_missing_extra_says_what_to_install():
    assert "pip install 'armcell[vision]'" in str(MissingExtraError("opencv", "vision"))


def test_registry_finds_lists_and_refuses():
    table: Registry[int] = Registry("color")
    assert table.register("red")(1) == 1
    table.register("green")(2)
    assert (table["red"], len(table), list(table), "red" in table, "blue" in table) == (
        1, 2, ["green", "red"], True, False,
    )  # fmt: skip
    with pytest.raises(
        UnknownNameError, match=r"unknown color 'gren'; known: green, red \(did you mean 'green'"
    ):
        table["gren"]
    with pytest.raises(ValueError, match="twice"):
        table.register("red")(3)
    assert table["red"] == 1
