"""The Unity package: its layout, that it compiles as Unity would, and its own tests, under Mono."""

import json
import subprocess

import pytest
from tests.unity.mono import PACKAGE, compiled, need_mono, sources, stubs


def test_its_own_tests_pass(tmp_path):
    """The same tests that Unity's Test Runner shows."""
    need_mono()
    exe = compiled(tmp_path / "tests.exe", sources("Logic", "Tests") + stubs("NUnit"), "-nowarn:219")
    done = subprocess.run(["mono", str(exe)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout
    run, failed = (int(part.split()[0]) for part in done.stdout.split(","))
    assert run >= 26 and failed == 0


def test_layout():
    package = json.loads((PACKAGE / "package.json").read_text())
    assert package["name"] == "com.armcell.unity" and package["version"].count(".") == 2
    definitions = {p.parent: json.loads(p.read_text()) for p in PACKAGE.rglob("*.asmdef")}
    own = {d["name"] for d in definitions.values()}
    for source in PACKAGE.rglob("*.cs"):
        assert source.parent in definitions, source
        assert f"class {source.stem}" in source.read_text() or source.stem in (
            "Axes", "Joints", "Words", "Motion", "Grip", "LogicTests",
        )  # fmt: skip
    for definition in definitions.values():
        for name in definition.get("references", []):
            assert name in own or name.startswith(("Unity", "UnityEngine", "UnityEditor")), name
    # logic is free of Unity, so that it runs anywhere
    assert definitions[PACKAGE / "Logic"]["noEngineReferences"]
    assert not any("UnityEngine" in f.read_text() for f in sources("Logic"))


@pytest.mark.slow
@pytest.mark.parametrize("defines", ["ROS2", "UNITY_2022_2_OR_NEWER"])
def test_it_compiles_for_other_settings(player, defines, tmp_path):
    """The player of this protocol is compiled by its fixture; here with what newer Unity switches on."""
    messages = player(defines == "ROS2").exe.with_name("messages.dll")
    files = sources("Logic", "Runtime", "Planning", "Editor")
    files += stubs("UnityEngine", "UnityEditor", "ROSConnection")
    compiled(
        tmp_path / "package.dll", files, "-target:library", f"-r:{messages}", f"-define:{defines}",
        "-langversion:7",
    )  # fmt: skip
