"""One session for a module's tests: a Panda that follows exactly, twenty times as fast as the clock."""

from __future__ import annotations

import pytest

from armcell.cell import load
from armcell.moveit import Session
from armcell.moveit.run import shims_installed


@pytest.fixture(scope="module")
def session():
    live = load("panda_table").connect("fake", None, time_scale=20.0)
    with Session(live, quiet=True) as opened, shims_installed(opened.messages):
        yield opened


@pytest.fixture
def mc(session):
    import moveit_commander

    moveit_commander.roscpp_initialize([])
    return moveit_commander


@pytest.fixture
def arm(mc):
    """The arm, at home, as fast as it can."""
    group = mc.MoveGroupCommander("panda_arm")
    group.set_max_velocity_scaling_factor(1.0)
    group.set_max_acceleration_scaling_factor(1.0)
    group.set_named_target("home")
    assert group.go()
    yield group
    mc.PlanningSceneInterface().remove_attached_object()
    for name in mc.PlanningSceneInterface().get_known_object_names():
        if name not in ("table", "cube"):
            mc.PlanningSceneInterface().remove_world_object(name)


@pytest.fixture
def scene(mc):
    return mc.PlanningSceneInterface()
