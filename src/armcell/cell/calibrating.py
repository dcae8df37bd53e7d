"""Applies the robots' factory calibration to a cell's model: `real: {calibration: apply}`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from armcell.drivers.ur.calibration import calibrated
from armcell.drivers.ur.identity import Identity, check_identity, check_swapped, identify
from armcell.drivers.ur.settings import RealSettings, real_settings
from armcell.model import RobotModel
from armcell.scene import PlanningScene


def as_the_robots_are(scene: PlanningScene, real: dict) -> PlanningScene:
    """Return the scene with the robots' calibrated kinematics if the cell file requests it.

    Raises:
        InputError: a robot does not answer, is another robot than named in the cell file, or its kinematics
            do not fit the model.
    """
    settings = real_settings(real, scene.model)
    if settings.calibration != "apply":
        return scene
    found = {name: identify(arm.host) for name, arm in settings.arms.items()}
    check_swapped(settings.arms, found)
    return replace(scene, model=with_geometry(scene.model, settings, found))


def with_geometry(model: RobotModel, settings: RealSettings, found: Mapping[str, Identity]) -> RobotModel:
    """Return the model with the calibrated kinematics of every identified arm.

    Args:
        found: the identities of the robots, by planning group.
    Raises:
        InputError: an arm is another robot than named in the cell file, or does not fit the model.
    """
    for group, identity in found.items():
        check_identity(group, settings.arms[group], identity)
        model = calibrated(model, group, identity.model.dh, identity.geometry)
    return model
