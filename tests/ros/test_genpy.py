"""Our ROS 1 bytes and sums against Debian's own generated classes (genpy), run by the system's Python."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.ros.helpers import random_message

from armcell.ros.codec import ros1_codec
from armcell.ros.schema import schema

pytestmark = pytest.mark.interop
SYSTEM_PYTHON = "/usr/bin/python3"
PACKAGES = (
    "actionlib_msgs", "geometry_msgs", "rosgraph_msgs", "sensor_msgs", "shape_msgs",
    "std_msgs", "tf2_msgs", "trajectory_msgs", "visualization_msgs",
)  # fmt: skip
ECHO = """
import importlib, io, json, sys
for line in sys.stdin:
    name, text = line.rstrip("\\n").split(" ")
    package, item = name.split("/")
    try:
        cls = getattr(importlib.import_module(package + ".msg"), item)
    except (ImportError, AttributeError):
        print(json.dumps(None)); continue
    message = cls(); message.deserialize(bytes.fromhex(text))
    out = io.BytesIO(); message.serialize(out)
    print(json.dumps([cls._md5sum, cls._full_text, out.getvalue().hex()]))
"""


@pytest.fixture(scope="module")
def genpy():
    found = (
        Path(SYSTEM_PYTHON).exists()
        and not subprocess.run(
            [SYSTEM_PYTHON, "-c", "import genpy, sensor_msgs.msg"], capture_output=True
        ).returncode
    )
    if not found:
        pytest.skip(
            "Debian's ROS messages are not installed (apt install python3-sensor-msgs python3-tf2-msgs)"
        )


def test_real_classes_read_and_write_our_bytes(genpy):
    rng = np.random.default_rng(2)
    names = [n for n in schema().messages if n.split("/")[0] in PACKAGES]
    sent = [
        (n, bytes(ros1_codec().encode(random_message(schema(), n, rng)))) for n in names for _ in range(3)
    ]
    done = subprocess.run(
        [SYSTEM_PYTHON, "-c", ECHO],
        input="".join(f"{n} {data.hex()}\n" for n, data in sent),
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    compared = 0
    for (name, data), line in zip(sent, done.stdout.splitlines()):
        answer = json.loads(line)
        if answer is None:
            continue
        md5, _, back = answer
        assert md5 == schema().md5(name), name
        assert back == data.hex(), name
        compared += 1
    assert compared > 300
