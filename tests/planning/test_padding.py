"""The padding is kept all along a motion where that can be, not only at the configurations looked at."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.helpers import panda_wall, request
from tests.planning.test_plan import beyond_panda

from armcell.collision import ExactChecker
from armcell.planning import plan

PADDING, STEP = 0.005, 2e-3  # [m], [rad]


def room_kept(scene, trajectory) -> bool:
    """By exact meshes, every 2 mrad of the timed motion."""
    checker = ExactChecker(scene, trajectory.joint_names)
    for a, b in zip(trajectory.positions, trajectory.positions[1:]):
        n = max(int(np.ceil(np.abs(b - a).max() / STEP)), 1)
        if not all(checker.is_free(a + k / n * (b - a)) for k in range(1, n + 1)):
            return False
    return True


@pytest.mark.slow
def test_padding_is_kept_all_along():
    scene = panda_wall().with_padding(PADDING)
    kept = []
    for seed in range(30):
        result = plan(scene, request(beyond_panda(), seed=seed))
        assert result.ok
        kept.append(room_kept(scene, result.trajectory))
    assert all(kept), kept
