"""Application of the robots' factory calibration to the model of a cell.

A cell file requests it by `real: {calibration: apply}`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from armcell.drivers.real import RealSettings, RobotIdentity, identify_all, kind_of, real_settings
from armcell.model import RobotModel
from armcell.scene import PlanningScene


def with_robot_calibration(scene: PlanningScene, real: dict) -> PlanningScene:
    """Return a cell's scene. It uses the calibrated kinematics of the robots if the cell file requests them.

    Raises:
        InputError: a robot does not answer, is another robot than named in the cell file, or its kinematics
            do not fit the model.
    """
    settings = real_settings(real, scene.model)
    if settings.calibration != "apply":
        return scene
    return replace(scene, model=with_geometry(scene.model, settings, identify_all(settings)))


def with_geometry(
    model: RobotModel, settings: RealSettings, found: Mapping[str, RobotIdentity]
) -> RobotModel:
    """Return a cell's model with calibrated kinematics for every arm whose robot has been identified.

    Args:
        found: the identities of the robots, by planning group.
    Raises:
        InputError: an arm is another robot than named in the cell file, or does not fit the model.
    """
    for group, identity in found.items():
        arm = settings.arms[group]
        kind_of(arm).check_identity(group, arm, identity)
        model = kind_of(arm).calibrated(model, group, identity)
    return model
