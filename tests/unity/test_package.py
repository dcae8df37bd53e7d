"""The Unity package: its layout, that it compiles as Unity would, and its own tests, under Mono."""

import json
import subprocess

import numpy as np
import pytest
from tests.unity.mono import PACKAGE, compiled, need_mono, sources, stubs

from armcell.core import JointTrajectory


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.cases("5")
@pytest.mark.parametrize("order", [1, 3, 5])
def test_interpolation_is_armcells(tmp_path, order):
    """Positions and velocities of random trajectories, in full precision, to 1e-9."""
    need_mono()
    exe = compiled(tmp_path / "sampler.exe", sources("Logic") + stubs("Sampler"))
    rng = np.random.default_rng(order)
    lines, wanted = [], []
    for _ in range(20):
        k, n = int(rng.integers(2, 12)), int(rng.integers(1, 8))
        times = np.cumsum(rng.uniform(0.01, 1.0, k))
        rows = rng.uniform(-3.0, 3.0, (3, k, n))
        given = ["positions", "velocities", "accelerations"][: (order + 1) // 2]
        at = np.sort(np.concatenate([rng.uniform(-0.1, times[-1] + 0.1, 20), times]))
        data = {"times": times.tolist(), "at": at.tolist(), **{f: r.tolist() for f, r in zip(given, rows)}}
        lines.append(json.dumps(data))
        names = tuple(f"j{i}" for i in range(n))
        trajectory = JointTrajectory(names, times, **dict(zip(given, rows)))
        wanted += [row for t in at for row in trajectory.sample(t)[:2]]
    done = subprocess.run(
        ["mono", str(exe)], input="\n".join(lines) + "\n", capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    answers = [np.array(line.split(), dtype=float) for line in done.stdout.splitlines()]
    assert len(answers) == len(wanted) > 800
    for answer, row in zip(answers, wanted):
        np.testing.assert_allclose(answer, row, rtol=0, atol=1e-9)
