"""The C# example in docs/with_unity.md compiles against the generated messages."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from tests.ros.test_csharp import CONNECTOR, HANDWRITTEN

from armcell.ros.message_generators import generate_csharp, write
from armcell.ros.schema import schema

PAGE = Path(__file__).parents[2] / "docs" / "with_unity.md"


@pytest.mark.slow
def test_the_script_compiles(tmp_path):
    if not shutil.which("mcs"):
        pytest.skip("Mono is not installed (apt install mono-mcs)")
    (code,) = re.findall(r"```csharp\n(.*?)```", PAGE.read_text(), flags=re.S)
    script = tmp_path / "ArmcellClient.cs"
    script.write_text(code)
    packages = ["geometry_msgs", "sensor_msgs", "std_msgs", "trajectory_msgs"]
    files = [f for f in write(generate_csharp(schema(), packages), tmp_path) if f.name not in HANDWRITTEN]
    sources = [script, *files, CONNECTOR, CONNECTOR.with_name("Unity.cs")]
    done = subprocess.run(
        ["mcs", "-target:library", f"-out:{tmp_path / 'out.dll'}", *map(str, sources)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
