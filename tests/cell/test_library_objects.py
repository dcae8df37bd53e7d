"""Objects by name and mesh files in cell files: what they become, and what is said of bad ones."""

from __future__ import annotations

import pytest
import trimesh
import yaml

from armcell.cell import load_objects
from armcell.core import InputError


def written(folder, entry: dict) -> str:
    (folder / "things.yaml").write_text(yaml.safe_dump({"objects": {"thing": entry}}))
    return str(folder / "things.yaml")


def test_a_library_object_with_its_own_name_mass_and_size(tmp_path):
    entry = {"model": "can", "pose": [0.4, 0, 0], "movable": True, "sizes": {"radius": 0.02}, "scale": 2.0}
    (can,) = load_objects(written(tmp_path, entry))
    assert can.name == "thing" and can.movable
    assert can.bounds()[1] == pytest.approx([0.04, 0.04, 0.23])
    assert can.mass_kg == pytest.approx(900 * can.volume) and can.material.friction == 0.4
    (light,) = load_objects(written(tmp_path, {**entry, "density": 50.0, "friction": 0.9}))
    assert light.mass_kg == pytest.approx(50 * can.volume) and light.material.friction == 0.9


def test_a_mesh_in_millimeters_names_file_object_and_cure(tmp_path):
    trimesh.creation.box((50, 50, 50)).export(tmp_path / "cube.stl")
    with pytest.raises(InputError, match=r"cube\.stl.*50 m large.*scale: 0\.001"):
        load_objects(written(tmp_path, {"mesh": "cube.stl", "movable": True}))
    (cube,) = load_objects(written(tmp_path, {"mesh": "cube.stl", "movable": True, "scale": 0.001}))
    assert cube.volume == pytest.approx(0.05**3)


@pytest.mark.parametrize(
    "entry, says",
    [
        ({"model": "cann"}, "did you mean 'can'"),
        ({"model": "can", "box": [1, 1, 1]}, "give one or the other"),
        ({"box": [1, 1, 1], "sizes": {"radius": 1}}, "needs 'model'"),
        ({"model": "can", "mass": 1, "density": 1}, "a mass and a density"),
    ],
)
def test_what_does_not_go_together(entry, says, tmp_path):
    with pytest.raises(InputError, match=says):
        load_objects(written(tmp_path, entry))
