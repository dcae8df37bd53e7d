"""Shapes: positive finite sizes, sound meshes, bounds that hold every surface point."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.core import Box, Capsule, Cone, Cylinder, InputError, Mesh, Plane, Sphere
from armcell.core.geometry import local_bounds

SIZES = {Box: 3, Sphere: 1, Cylinder: 2, Capsule: 2, Cone: 2}


@pytest.mark.parametrize("bad", [0.0, -0.1, float("nan"), float("inf"), 1e102])
@pytest.mark.parametrize("kind", SIZES)
def test_every_size_must_be_positive_and_below_1000_km(kind, bad):
    for i in range(SIZES[kind]):
        sizes = [0.1] * SIZES[kind]
        sizes[i] = bad
        with pytest.raises(InputError, match=f"{kind.__name__.lower()} has .* must be a positive"):
            kind(*sizes)


TRIANGLE = np.eye(3)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (TRIANGLE, np.zeros((0, 3))),
        (np.zeros((0, 3)), np.zeros((0, 3))),
        (TRIANGLE[:, :2], [[0, 1, 2]]),
        (TRIANGLE, [[0, 1, 3]]),
        (TRIANGLE, [[0, 1, -1]]),
        (TRIANGLE, [0, 1, 2]),
        (np.array([[0.0, 0.0, np.nan], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]]),
    ],
)
def test_broken_meshes_are_refused(vertices, faces):
    with pytest.raises(InputError, match="mesh"):
        Mesh(vertices, faces)


def test_a_mesh_cannot_be_changed():
    mesh = Mesh(TRIANGLE, [[0, 1, 2]])
    with pytest.raises(ValueError):
        mesh.vertices[0] = 5.0


def surfaces():
    """Shapes with points on their surface, from trimesh's own primitives (cylinder axes along z)."""
    cone = trimesh.creation.cone(0.2, 0.6)
    cone.apply_translation([0, 0, -0.3])  # trimesh puts the base at z = 0
    shifted = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    shifted.apply_translation([1.0, -2.0, 0.5])
    return [
        (Box(0.1, 0.2, 0.3), trimesh.creation.box((0.1, 0.2, 0.3))),
        (Sphere(0.2), trimesh.creation.icosphere(subdivisions=4, radius=0.2)),
        (Cylinder(0.2, 0.6), trimesh.creation.cylinder(0.2, 0.6)),
        (Capsule(0.2, 0.6), trimesh.creation.capsule(0.6, 0.2)),
        (Cone(0.2, 0.6), cone),
        (Mesh(shifted.vertices, shifted.faces), shifted),
    ]


@pytest.mark.parametrize(("shape", "surface"), surfaces(), ids=lambda x: type(x).__name__)
def test_bounds_are_the_tightest_box(shape, surface):
    center, half = local_bounds(shape)
    low, high = surface.bounds
    np.testing.assert_allclose(center, (low + high) / 2, atol=2e-3)
    np.testing.assert_allclose(half, (high - low) / 2, atol=2e-3)
    assert np.all(np.abs(surface.vertices) <= shape.half_extents + 1e-9)


def test_a_plane_s_bounds_lie_below_it():
    center, half = local_bounds(Plane())
    assert center[2] + half[2] == 0.0 and np.all(half >= 50.0)
