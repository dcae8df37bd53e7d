"""The generated C# compiles with Mono and reads and writes the same bytes as our codecs."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.ros.helpers import random_message

from armcell.core import UnknownNameError
from armcell.ros.codec import cdr_codec, ros1_codec
from armcell.ros.definitions import nested_types
from armcell.ros.message_generators import NOT_SHIPPED, csharp_class, generate_csharp, namespace, write
from armcell.ros.schema import schema

SHIPPED = (
    "actionlib_msgs", "geometry_msgs", "object_recognition_msgs", "octomap_msgs",
    "sensor_msgs", "shape_msgs", "std_msgs", "trajectory_msgs",
)  # fmt: skip
HANDWRITTEN = ("HeaderMsg.cs", "TimeMsg.cs", "DurationMsg.cs")  # in csharp/Connector.cs
CONNECTOR = Path(__file__).parent / "csharp" / "Connector.cs"


def test_names_are_the_connectors():
    assert namespace("object_recognition_msgs") == "ObjectRecognition"
    assert namespace("std_srvs") == "Std" and namespace("rosgraph") == "Rosgraph"
    text = csharp_class(schema(), "moveit_msgs/GetPositionIKResponse")
    assert 'k_RosMessageName = "moveit_msgs/GetPositionIK"' in text
    assert "Register(k_RosMessageName, Deserialize, MessageSubtopic.Response)" in text


def test_unknown_package():
    with pytest.raises(UnknownNameError, match="moveit_msgs"):
        generate_csharp(schema(), ["moveit_msg"])


def test_every_nested_type_is_generated_or_shipped():
    generated = {f.path for f in generate_csharp(schema())}
    assert (
        "Moveit/msg/PlanningSceneMsg.cs" in generated
        and "Control/action/GripperCommandActionGoal.cs" in generated
    )
    for name in set(schema().messages) - schema().ros2_only:
        if name.split("/")[0] in NOT_SHIPPED:
            used = {n.split("/")[0] for n in nested_types(schema().definition(name))}
            assert used <= {*NOT_SHIPPED, *SHIPPED, "builtin_interfaces"}


@pytest.fixture(scope="module", params=["ROS1", "ROS2"])
def program(request, tmp_path_factory):
    """The generated classes and the echo program, compiled for one protocol."""
    if not (shutil.which("mcs") and shutil.which("mono")):
        pytest.skip("Mono is not installed (apt install mono-mcs mono-runtime)")
    folder = tmp_path_factory.mktemp(request.param)
    files = write(generate_csharp(schema(), [*NOT_SHIPPED, *SHIPPED]), folder)
    sources = [str(f) for f in files if f.name not in HANDWRITTEN]
    (folder / "sources").write_text("\n".join(f'"{s}"' for s in [*sources, str(CONNECTOR)]))
    exe = folder / "echo.exe"
    define = ["-define:ROS2"] if request.param == "ROS2" else []
    done = subprocess.run(
        ["mcs", "-warnaserror", "-nowarn:618", *define, f"-out:{exe}", f"@{folder / 'sources'}"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return exe, (cdr_codec() if request.param == "ROS2" else ros1_codec())


@pytest.mark.slow
@pytest.mark.cases("ROS2")
def test_csharp_reads_and_writes_our_bytes(program):
    exe, codec = program
    rng = np.random.default_rng(1)
    lines, sent = [], []
    for name in schema().messages:
        if name.split("/")[0] not in NOT_SHIPPED or name in schema().ros2_only:
            continue
        key = f"{name}:Default"
        for service in schema().services:
            if name in (f"{service}Request", f"{service}Response"):
                key = f"{service}:{'Default' if name.endswith('Request') else 'Response'}"
        for _ in range(3):
            data = bytes(codec.encode(random_message(schema(), name, rng)))
            lines.append(f"{key} {data.hex()}")
            sent.append((name, data))
    done = subprocess.run(
        ["mono", str(exe)], input="\n".join(lines) + "\n", capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    answers = done.stdout.split("\n")[:-1]
    assert len(answers) == len(sent) > 300
    for (name, data), answer in zip(sent, answers):
        assert answer.lower() == f"0 {data.hex()}", name
