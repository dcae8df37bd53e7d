"""What an object offers, also by way of another."""

from pathlib import Path

import armcell
from armcell.core.protocols import offers
from armcell.drivers import Follower
from armcell.ros.nodes.conductor import Conductor


class Robot:
    now, name = 0.0, "robot"

    def follow(self, trajectory): ...

    def hold(self, joint_names): ...

    def fault(self): ...


def test_a_driver_behind_another_is_of_its_kind():
    robot = Robot()
    assert offers(robot, Follower) and offers(Conductor(robot), Follower)
    assert not offers(object(), Follower)


def test_nothing_is_asked_by_isinstance_that_python_3_12_does_not_find():
    files = Path(armcell.__file__).parent.rglob("*.py")
    assert not [f for f in files if "runtime_checkable" in f.read_text(encoding="utf-8")]
