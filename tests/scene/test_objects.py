"""Collision objects and materials: what they must be, volumes and bounds against trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.scene.helpers import box, mesh_of, open_bin

from armcell.core import SE3, Box, Capsule, Cone, Cylinder, InputError, Plane, Sphere
from armcell.scene import DEFAULT_DENSITY, CollisionObject, Material, shape_volume


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf")])
def test_mass_must_be_positive(mass):
    with pytest.raises(InputError, match="object 'cube': mass is"):
        box("cube", (1, 1, 1), mass=mass)


def test_name_and_shape_are_needed():
    with pytest.raises(InputError, match="needs a name"):
        box("", (1, 1, 1))
    with pytest.raises(InputError, match="object 'nothing' has no shape"):
        CollisionObject("nothing", ())
    with pytest.raises(InputError, match="a plane cannot move"):
        CollisionObject.single("floor", Plane(), movable=True)


@pytest.mark.parametrize("name", ["friction", "torsional_friction", "rolling_friction"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_friction_is_checked(name, value):
    with pytest.raises(InputError, match=name):
        Material(**{name: value})


BIN = open_bin()
VOLUMES = [
    (Box(0.1, 0.2, 0.3), trimesh.creation.box((0.1, 0.2, 0.3))),
    (Sphere(0.2), trimesh.creation.icosphere(subdivisions=5, radius=0.2)),
    (Cylinder(0.2, 0.6), trimesh.creation.cylinder(0.2, 0.6, sections=400)),
    (Capsule(0.2, 0.6), trimesh.creation.capsule(0.6, 0.2, count=(200, 200))),
    (Cone(0.2, 0.6), trimesh.creation.cone(0.2, 0.6, sections=400)),
    (mesh_of(BIN), BIN),
]


@pytest.mark.parametrize(("shape", "surface"), VOLUMES, ids=lambda x: type(x).__name__)
def test_volumes(shape, surface):
    assert surface.is_watertight and surface.volume > 0
    assert shape_volume(shape) == pytest.approx(surface.volume, rel=2e-3)


def test_an_open_mesh_has_its_hull_s_volume_and_a_plane_none():
    lidless = trimesh.creation.box((1, 1, 1))
    lidless.update_faces(np.arange(10))
    assert shape_volume(mesh_of(lidless)) == pytest.approx(1.0)
    assert shape_volume(Plane()) == 0.0


def test_mass_is_given_or_from_density():
    assert box("a", (0.1, 0.1, 0.1), mass=3.0).mass_kg == 3.0
    two = CollisionObject(
        "b", ((Box(0.1, 0.1, 0.1), SE3.identity()), (Box(0.2, 0.1, 0.1), SE3.from_xyz(1, 0, 0)))
    )
    assert two.mass_kg == pytest.approx(DEFAULT_DENSITY * 0.003)


def test_bounds_hold_every_shape_tightly():
    T = SE3.from_xyz_rpy((0.3, -0.2, 0.1), (0.4, 0.5, 0.6))
    item = CollisionObject("a", ((Box(0.1, 0.2, 0.3), T), (Box(0.4, 0.1, 0.1), SE3.identity())))
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    points = np.vstack([T.apply(corners * (0.1, 0.2, 0.3)), corners * (0.4, 0.1, 0.1)])
    low, high = item.bounds()
    np.testing.assert_allclose(low, points.min(0))
    np.testing.assert_allclose(high, points.max(0))


def test_moving_gives_another_object():
    item = box("a", (1, 1, 1))
    assert item.at(SE3.from_xyz(1, 0, 0)).T_world_object.translation[0] == 1.0
    assert item.T_world_object.translation[0] == 0.0
