"""What the kernel keeps between scenes is what it would work out anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.scene.helpers import box
from tests.scene.helpers import panda as new_panda

from armcell.cell import load
from armcell.collision.kernel import robot_arrays as module
from armcell.collision.kernel.lru_cache import LruCache
from armcell.collision.kernel.robot_arrays import RobotPart, robot_part
from armcell.scene import CollisionObject, PlanningScene

ARM = tuple(f"panda_joint{i}" for i in range(1, 8))
HELD = box("held", (0.04, 0.04, 0.04), (0.0, 0.0, 0.3))
BASE = new_panda()


def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_parts", "_held", "_placed", "_near_found", "_meetings"):
        monkeypatch.setattr(module, name, LruCache(64))


def _bits(part: RobotPart) -> dict[str, bytes]:
    return {name: np.asarray(value).tobytes() for name, value in part.arrays.items()}


def panda(*objects: CollisionObject, **positions: float) -> PlanningScene:
    """The same robot each time."""
    q = BASE.positions.copy()
    q[BASE.model.columns([f"panda_{name}" for name in positions])] = list(positions.values())
    return PlanningScene.of(BASE.model, q, objects)


def _holding(*touch_links: str) -> PlanningScene:
    return panda(HELD).with_attached("held", "panda_hand", touch_links)


SCENES = {
    "as it is": panda(),
    "fingers": panda(finger_joint1=0.011),
    "elsewhere": panda(joint2=0.4, joint4=-1.9),
    "allowed": panda().with_allowed("panda_link1", "panda_link5"),
    "scaled": panda().with_padding(link_scale={"panda_link1": 1.3}),
    "padded": panda().with_padding(link_padding={"panda_link5": 0.02}),
    "holding": _holding("panda_leftfinger"),
    "holding, allowed": _holding("panda_leftfinger", "panda_link5"),
    "larger": panda(box("held", (0.2, 0.1, 0.1), (0.0, 0.0, 0.3))).with_attached("held", "panda_hand"),
    "two of seven joints": panda(joint2=0.4),
}


def test_a_robots_part_is_never_of_another_state(monkeypatch):
    _forget(monkeypatch)
    joints = {name: ARM[:2] if name.startswith("two") else ARM for name in SCENES}
    kept = {name: _bits(robot_part(scene, joints[name])) for name, scene in SCENES.items()}
    for name, scene in SCENES.items():
        _forget(monkeypatch)
        assert _bits(robot_part(scene, joints[name])) == kept[name], name
    assert len({tuple(bits.items()) for bits in kept.values()}) >= len(kept) - 1  # an arm that is elsewhere


def test_what_can_meet_is_not_looked_for_again_where_only_fingers_moved():
    first = robot_part(panda(finger_joint1=0.012), ARM)
    again = robot_part(panda(finger_joint1=0.013), ARM)
    assert again is not first and again.arrays["sphere"].tobytes() != first.arrays["sphere"].tobytes()
    assert again.arrays["near_groups"] is first.arrays["near_groups"]


@pytest.mark.slow
def test_what_can_meet_is_not_looked_for_beside_an_arm_that_rests_elsewhere(monkeypatch):
    """Planning and proofs for one arm: the search took 10 ms for each new place of the other."""
    scene = load("dual_ur10").scene()
    left, right = (scene.model.group(g).joint_names for g in ("left_arm", "right_arm"))
    robot_part(scene, left)
    sought = []
    monkeypatch.setattr(module.near_groups, "cached_near_groups", lambda *a: sought.append(a))
    q = scene.positions.copy()
    q[scene.model.columns(right)] += 0.1
    robot_part(replace(scene, positions=q), left)
    assert not sought
