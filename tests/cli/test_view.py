"""`armcell view`: what it refuses, in one line, and real arms by the page. More: tests/viewer."""

from __future__ import annotations

import math
import re
import signal
import time

import pytest
from tests.cli.helpers import call, start
from tests.drivers.ur.emulated import emulator, free_hosts, free_port
from tests.viewer.client import change, login, refusal, wait_for, websocket, widgets

from armcell.cell.built_in import LIBRARY
from armcell.records import read_record

WRONG = {
    "no such cell": (("view", "nowhere"), 1, "unknown cell 'nowhere'"),
    "no such mode": (("view", "panda_pick", "--mode", "dream"), 1, "unknown mode 'dream'"),
    "no such port": (("view", "panda_pick", "--port", "70000"), 2, "--port"),
    "real arms without a gate record": (
        ("view", "dual_ur10", "--mode", "real", "--port", "0"), 1, "no campaign can show what is planned in",
    ),
    "real arms without a reason": (
        ("view", "dual_ur10", "--mode", "real", "--port", "0", "--without-gate", " "), 1, "--without-gate",
    ),
    "a host that is not ours": (("view", "panda_table", "--host", "203.0.113.1"), 1, "cannot listen on"),
    "a name that is none": (("view", "panda_table", "--allow-host", "http://x"), 1, "is not a host name"),
}  # fmt: skip


@pytest.mark.parametrize(("arguments", "status", "words"), WRONG.values(), ids=WRONG)
def test_wrong_use(capsys, within, arguments, status, words):
    with within(120):  # one that is not refused would serve for ever
        said = call(capsys, *arguments)
    assert said.status == status and words in said.err


@pytest.mark.realtime
@pytest.mark.slow
def test_a_real_arm_moves_for_the_operator_alone_and_the_reason_is_recorded(tmp_path):
    (host,) = free_hosts(1)
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    text += "\nreal:\n  max_state_age: 0.3\n  watchdog: 0.5\n  arms:\n"
    text += f"    arm: {{host: {host}, port: {free_port()}, model: UR10, gripper: {{kind: socket}}}}\n"
    (tmp_path / "cell.yaml").write_text(text)
    options = ("--mode", "real", "--port", "0", "--without-gate", "an emulator", "--runs", tmp_path / "runs")
    with emulator("--cell", "six_axis_pick", hosts=[host]):
        process = start("view", tmp_path, *options)
        try:
            assert process.stdout is not None
            url = ""
            while not url:
                line = process.stdout.readline()
                assert line, process.communicate()
                url = (re.search(r"view: (http://127\.0\.0\.1:\d+/\?token=\S+)", line) or ["", ""])[1]
            me = login(url)
            assert refusal(url, me, Origin="http://evil.example") == 403
            assert refusal(url.partition("?")[0]) == 403
            joint = "shoulder_pan_joint [deg]"
            with websocket(url, me) as link:
                ids = widgets(link, "Plan", "Execute", joint)
                change(link, ids[joint], 40.0)
                time.sleep(2.0)  # the goal was free before, too: nothing says that it has changed
                change(link, ids["Plan"], True)
                wait_for(link, "SUCCESS")
                change(link, ids["Execute"], True)
                wait_for(link, "executed")
        finally:
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=30)
    assert "armcell: without a gate record: an emulator" in errors and "Traceback" not in errors
    (folder,) = (tmp_path / "runs").iterdir()
    record = read_record(folder)
    assert (
        record.metadata["gate"]["reason"] == "an emulator" and record.metadata["by"] == "the user of the page"
    )
    angle = record.states[-1].sample().joints.as_dict()["shoulder_pan_joint"]
    assert math.degrees(angle) == pytest.approx(40.0, abs=0.5)
