"""The table of UR models against the vendor's descriptions, and against a driver that asks the robot."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.drivers.ur.emulated import emulator, free_hosts

from armcell.drivers.ur.identity import identify
from armcell.drivers.ur.wire.kinematics import frames_of
from armcell.drivers.ur.wire.models import MODELS, ur_model

CONFIG = Path(__file__).parents[4] / "shared/data/robots/ur_description/config"
KEYS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def loaded(name: str, file: str):
    path = CONFIG / name.lower() / file
    if not path.exists():
        pytest.skip(f"needs {path}")
    return yaml.safe_load(re.sub(r"!degrees +([-\d.]+)", r"{degrees: \1}", path.read_text()))


def origin(values) -> np.ndarray:
    """The pose [m] of a joint's frame in its parent, from the description's x, y, z, roll, pitch, yaw."""
    r, p, y = (float(values[k]) for k in ("roll", "pitch", "yaw"))
    c, s = np.cos, np.sin
    about_z = np.array([[c(y), -s(y), 0], [s(y), c(y), 0], [0, 0, 1]])
    about_y = np.array([[c(p), 0, s(p)], [0, 1, 0], [-s(p), 0, c(p)]])
    about_x = np.array([[1, 0, 0], [0, c(r), -s(r)], [0, s(r), c(r)]])
    T = np.eye(4)
    T[:3, :3] = about_z @ about_y @ about_x
    T[:3, 3] = [float(values[k]) for k in "xyz"]
    return T


@pytest.mark.parametrize("name", ["UR5e", "UR10e"])
def test_the_tool_is_where_the_vendor_s_description_puts_it(name):
    """Chain of the description's joint origins; each joint turns about its own z axis."""
    joints = loaded(name, "default_kinematics.yaml")["kinematics"]
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, T = rng.uniform(-3, 3, 6), np.eye(4)
        for key, angle in zip(KEYS, q, strict=True):
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            T = T @ origin(joints[key]) @ turn
        np.testing.assert_allclose(T, frames_of(ur_model(name).dh, q)[6], atol=1e-6)


@pytest.mark.parametrize("name", ["UR5e", "UR10e"])
def test_masses_speeds_and_torques_are_the_vendor_s(name):
    model = ur_model(name)
    inertia = loaded(name, "physical_parameters.yaml")["inertia_parameters"]
    assert model.link_masses == tuple(inertia[f"{key}_mass"] for key in KEYS)
    centers = inertia["center_of_mass"]
    upper, fore = (centers[f"{key}_cog"] for key in ("upper_arm", "forearm"))
    assert model.link_centers[1][0] == pytest.approx(upper["x"] - model.dh.a[1])
    assert model.link_centers[2][0] == pytest.approx(fore["x"] - model.dh.a[2])
    limits = loaded(name, "joint_limits.yaml")["joint_limits"].values()
    assert model.torque == tuple(limit["max_effort"] for limit in limits)
    degrees = [limit["max_velocity"]["degrees"] for limit in limits]
    np.testing.assert_allclose(np.degrees(model.velocity), degrees)


@pytest.mark.slow
@pytest.mark.cases("UR10", "UR30", "UR5e", "UR3")
@pytest.mark.parametrize("name", MODELS)
def test_a_driver_tells_the_models_apart_by_their_geometry(name):
    """Also with the deviations that a factory calibration finds."""
    (host,) = free_hosts(1)
    with emulator("--model", name, "--calibration", "3", hosts=[host]):
        assert identify(host).model.name == name
