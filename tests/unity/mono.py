"""The Unity package compiled with Mono against our stubs of Unity and its connector; a cell played in it."""

from __future__ import annotations

import shutil
import subprocess
from collections import defaultdict
from pathlib import Path

import pytest
from tests.ros.test_csharp import CONNECTOR, HANDWRITTEN, SHIPPED

from armcell.ros.codec import cdr_codec, ros1_codec
from armcell.ros.message_generators import NOT_SHIPPED, generate_csharp, write
from armcell.ros.schema import schema

PACKAGE = Path(__file__).parents[2] / "unity"
STUBS = Path(__file__).parent / "stubs"
PACKAGES = [*NOT_SHIPPED, *SHIPPED, "rosgraph_msgs"]


def need_mono():
    if not (shutil.which("mcs") and shutil.which("mono")):
        pytest.skip("Mono is not installed (apt install mono-mcs mono-runtime)")


def compiled(out, sources, *options):
    """Compile with warnings as errors. 649: fields that only Unity's inspector fills."""
    command = ["mcs", "-warnaserror", "-nowarn:618,649", f"-out:{out}", "-r:System.Xml.dll", *options]
    done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


def sources(*folders):
    return [f for folder in folders for f in sorted((PACKAGE / folder).glob("*.cs"))]


def stubs(*names):
    return [STUBS / f"{name}.cs" for name in names]


class Player:
    """The compiled package with the stubs, for one protocol."""

    def __init__(self, folder, ros2):
        self.ros2, self.codec = ros2, cdr_codec() if ros2 else ros1_codec()
        files = [f for f in write(generate_csharp(schema(), PACKAGES), folder) if f.name not in HANDWRITTEN]
        listed = folder / "sources"
        listed.write_text("\n".join(f'"{s}"' for s in [*files, CONNECTOR]))
        define = ["-define:ROS2"] if ros2 else []
        messages = compiled(folder / "messages.dll", [f"@{listed}"], "-target:library", *define)
        self.exe = compiled(
            folder / "player.exe",
            sources("Logic", "Runtime", "Planning", "Editor")
            + stubs("UnityEngine", "UnityEditor", "ROSConnection", "Engine", "Player"),
            "-main:Player", f"-r:{messages}", *define,
        )  # fmt: skip

    def message(self, at, topic, message):
        """A line that gives the player a message at a time [s]."""
        return f"in {at} {topic} {bytes(self.codec.encode(message)).hex()}"

    def play(self, scene, lines, until):
        """Everything the player wrote: by kind, rows of (time, words)."""
        done = subprocess.run(
            ["mono", str(self.exe), str(scene)], input="\n".join([*lines, f"until {until}"]) + "\n",
            capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        rows = defaultdict(list)
        for line in done.stdout.splitlines():
            kind, time, *words = line.split(" ")
            rows[kind].append((float(time), words))
        return rows

    def received(self, rows, topic):
        """(time, decoded message) of a topic."""
        return [
            (t, self.codec.decode(kind, bytes.fromhex(data)))
            for t, (name, kind, data) in rows["out"] if name == topic
        ]  # fmt: skip

    def said(self, rows, topic="/trajectory_status"):
        return [m.data for _, m in self.received(rows, topic)]

    def join(self, scene, address, speed):
        """The player in real time times `speed`, joined to a server. Close its stdin to end it."""
        where = f"{address[0]}:{address[1]}"
        return subprocess.Popen(
            ["mono", str(self.exe), str(scene), where, str(speed)], stdin=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
