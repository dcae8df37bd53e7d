"""The twin guard against an emulated arm in physics, over its real protocols."""

import time

import numpy as np
import pytest
from tests.control.ur.emulated import dashboard, emulator, free_hosts

from armcell.cell import load
from armcell.cell.twin import bands_file, learn_bands
from armcell.control import execute
from armcell.core import InputError
from benchmarks import twin_guard as bench

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A cell with bands that were learned on an emulated arm."""
    (host,) = free_hosts(1)
    file = tmp_path_factory.mktemp("twin") / "cell.yaml"
    file.write_text(bench.CELL.replace(bench.HOST, host))
    with emulator("--cell", str(file), hosts=[host]):
        learn_bands(load(file), 6).save(bands_file(load(file)))
    return file, host


def test_faults_are_found_and_clean_motions_are_not(cell):
    file, host = cell
    rng = np.random.default_rng(3)
    faults = {
        "payload 3": "current",
        f"offset 1 {np.deg2rad(2.0)}": "shoulder_lift_joint: position",
        "block 0": "shoulder_pan_joint",
    }
    for fault, said in faults.items():
        with emulator("--cell", str(file), hosts=[host]), load(file).connect("real") as live:
            clean = execute(live.driver, bench.motion(live, rng, 0.4))
            assert clean.ok and not bench.deviations(live), bench.deviations(live)
            at = []

            def switch_on(fraction, at=at, fault=fault):
                if fraction > 0.35 and not at:
                    dashboard(host, f"armcell fault {fault}")
                    at.append(time.monotonic())

            result = execute(live.driver, bench.motion(live, rng, 0.4), progress=switch_on)
            found = bench.deviations(live)
            assert not result.ok and "twin" in result.message, (fault, result.message)
            assert [kind for _, kind, _ in found][-1] == "twin deviation"
            assert said in found[-1][2], (fault, found)
            assert found[-1][0] - at[0] < 1.5  # the machine may be busy; docs/real_ur.md has the figures


def test_bands_of_another_model_are_void(cell):
    file, host = cell
    text = file.read_text()
    try:
        file.write_text(text + "physics: {arm_kp: 4000}\n")
        with pytest.raises(InputError, match="what changed is: physics"):
            load(file).connect("real")
    finally:
        file.write_text(text)
    again = ("--cell", str(file), "--calibration", "3")
    with emulator(*again, hosts=[host]), pytest.raises(InputError, match="learned on calibration"):
        load(file).connect("real").__enter__()
