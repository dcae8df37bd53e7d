"""A hand holds an object without creep at rest and without drift in motion, and only as friction allows."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sim.helpers import Grasping

from armcell.sim import PhysicsSettings
from armcell.sim import friction as held_object_correction

PLAIN = PhysicsSettings(holding_impratio=10.0)


def _moved(grasp: Grasping) -> float:
    """Distance [mm] that the cube moves in the hand during a lift at 0.5 m/s."""
    grasp.close(force=60.0)
    grasp.world.watch_slip("cube", grasp.gripper.name)
    grasp.lift(seconds=0.6, settle=0.0)
    return grasp.world.slip()[0] * 1e3


@pytest.mark.slow
@pytest.mark.parametrize("robot", ("panda", "ur10_gripper"))
def test_two_kilograms_do_not_creep_in_a_hand_at_rest(robot):
    creep = {}
    for name, settings in (("held", None), ("plain", PLAIN)):
        grasp = Grasping(robot, 2.0, settings=settings)
        grasp.close(force=60.0)
        grasp.lift(settle=1.0)
        grasp.world.watch_slip("cube", grasp.gripper.name)
        grasp.world.step(round(2.0 / grasp.world.timestep))
        creep[name] = grasp.world.slip()[0] / 2.0 * 1e6  # [um/s]
    assert creep["held"] < 0.1 and creep["plain"] > 20.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "values",
    (
        {},
        {"timestep": 0.001},
        {"integrator": "implicitfast", "timestep": 0.001},
        {"object_solref": (0.01, 1.0)},
    ),
)
def test_a_carried_object_stays_where_the_hand_took_it(values, monkeypatch):
    settings = PhysicsSettings(**values)
    moved = _moved(Grasping(settings=settings))
    monkeypatch.setattr(held_object_correction, "lag", lambda _: 0.0)
    assert moved < 0.06 and moved < 0.5 * _moved(Grasping(settings=settings))


def test_the_setting_applies_only_while_a_hand_at_rest_holds_an_object():
    grasp = Grasping()
    world, option = grasp.world, grasp.world.mj_model.opt
    world.step(50)
    assert option.impratio == 10.0  # nothing in the hand
    grasp.close()
    assert option.impratio == 1e5
    start = world.arm_target().reindexed(grasp.arm).positions
    for k in range(100):
        world.set_arm_target(grasp.arm, start + 2e-3 * k, np.full(len(start), 1.0))
        world.step()
    assert option.impratio == 10.0
    grasp.open()
    assert option.impratio == 10.0


def test_friction_that_does_not_suffice_lets_the_object_slip():
    grasp = Grasping(mass=2.0, friction=0.3)
    grasp.close(force=25.0)  # 2 x 0.3 x 25 N hold 1.5 kg
    grasp.world.watch_slip("cube", "hand")
    grasp.lift()
    assert grasp.world.slip()[0] > 0.05


def test_a_carry_continues_from_a_snapshot_bit_for_bit():
    grasp = Grasping()
    world = grasp.world
    grasp.close()
    start = world.arm_target().reindexed(grasp.arm).positions
    speed = np.full(len(start), 0.4)

    def move(first: int) -> bytes:
        for k in range(first, first + 60):
            world.set_arm_target(grasp.arm, start + k * world.timestep * speed, speed)
            world.step()
        return world.mj_data.qpos.tobytes()

    move(0)
    snapshot = world.snapshot()
    once = move(60)
    world.restore(snapshot)
    assert move(60) == once


def test_the_place_of_the_option_in_memory_is_known():
    grasp = Grasping()
    world = grasp.world
    world.mj_model.opt.impratio = 42.0
    assert world._stepper.holding.arrays[0].item() == 42.0
