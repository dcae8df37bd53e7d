"""Which base links get a finer sphere cover: those that another link often passes at a small distance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from tests.model.helpers import MBM

from armcell.collision.kernel.bodies import LINK_OVERSHOOT, narrow_gaps
from armcell.kinematics import kinematic_tree
from armcell.model import Link, load_robot


def _surface(link: Link) -> np.ndarray:
    """Points (20000, 3) on the link's mesh, in its frame."""
    mesh = link.collisions[0].shape
    points, _ = trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces), 20_000, seed=0)
    return link.collisions[0].T_link_shape.apply(points)


@pytest.mark.long
def test_the_upper_arm_of_a_ur5_passes_its_base():
    urdf = MBM / "ur5" / "ur5.urdf"
    if not urdf.exists():
        pytest.skip(f"{urdf} is not there")
    model = load_robot(urdf)
    assert narrow_gaps(model) == {"base_link"}
    # The reference: points on both surfaces, whose distance is at least the distance of the links.
    tree, rng, near = kinematic_tree(model), np.random.default_rng(1), 0
    base, arm = (_surface(model.links[name]) for name in ("base_link", "upper_arm_link"))
    for _ in range(40):
        T_base, T_arm = tree.link_poses(rng.uniform(-3.0, 3.0, model.dof), ("base_link", "upper_arm_link"))
        near += cKDTree(base).query((T_base.inverse() @ T_arm).apply(arm))[0].min() < 2 * LINK_OVERSHOOT
    assert near > 20


def test_a_base_without_a_near_neighbor_keeps_the_usual_cover():
    assert narrow_gaps(load_robot("panda")) == frozenset()
