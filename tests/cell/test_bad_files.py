"""Broken cell files: one line that names the file, the place in it and the reason."""

from __future__ import annotations

import sys

import pytest
from tests import programs

import armcell
from armcell.core import InputError

HEAD = "robot: panda\nstart: {arm: home}\n"
CUBE = (
    "objects:\n  table: {box: [1, 1, 0.1], pose: [0.5, 0, -0.051]}\n  cube: {sphere: 0.02, movable: true}\n"
)


def thing(text: str) -> str:
    """A cell with one object `a` of these keys."""
    return HEAD + f"objects: {{a: {{{text}}}}}\n"


# text of the file, place named, reason named
BAD = {
    "unknown key": ("robot: panda\nobjecs: {}\n", "objecs", "did you mean 'objects'"),
    "unknown object key": (thing("sphere: 1, frction: 1"), "objects/a", "did you mean 'friction'"),
    "unknown shape key": (thing("shapes: [{sphere: 1, posse: 1}]"), "objects/a/shapes/0", "mean 'pose'"),
    "unknown task key": (HEAD + CUBE + "task: [{pik: cube}]\n", "task/0", "did you mean 'pick'"),
    "unknown randomize key": (HEAD + CUBE + "randomize: {cube: {dz: [0, 1]}}\n", "randomize/cube", "'dz'"),
    "dynamic friction above static": (
        HEAD + "objects: {a: {sphere: 0.1, friction: {static: 0.4, dynamic: 0.6}}}\n",
        "objects/a/friction", "dynamic (0.6) is above static (0.4)",
    ),
    "unknown friction": (
        HEAD + "objects: {a: {sphere: 0.1, friction: {statc: 0.4, dynamic: 0.3}}}\n",
        "objects/a/friction", "did you mean 'static'",
    ),
    "friction of words": (
        HEAD + "objects: {a: {sphere: 0.1, friction: rough}}\n", "objects/a/friction", "valid number",
    ),
    "unknown setting": (HEAD + "settings: {atempts: 3}\n", "settings", "did you mean 'attempts'"),
    "unknown speed": (HEAD + "settings: {free: {speed: 1}}\n", "settings/free", "'speed'"),
    "unknown physics": (HEAD + "physics: {gravitiy: [0, 0, 0]}\n", "physics", "did you mean 'gravity'"),
    "two shapes": (thing("box: [1, 1, 1], sphere: 1"), "objects/a", "box, sphere"),
    "no shape": (thing("pose: [1, 1, 1]"), "objects/a", "has none"),
    "shape and shapes": (thing("sphere: 1, shapes: [{sphere: 1}]"), "objects/a", "one or the other"),
    "zero box": (thing("box: [1, 0, 1]"), "objects/a", "positive"),
    "zero box in shapes": (thing("shapes: [{box: [1, 0, 1]}]"), "objects/a", "positive"),
    "negative radius": (thing("cylinder: [-1, 1]"), "objects/a", "radius"),
    "infinite sphere": (thing("sphere: .inf"), "objects/a/sphere", "finite"),
    "negative mass": (thing("sphere: 1, mass: -1"), "objects/a", "mass"),
    "mass not a number": (thing("sphere: 1, mass: .nan"), "objects/a", "mass"),
    "negative friction": (thing("sphere: 1, friction: -0.1"), "objects/a", "friction"),
    "movable plane": (thing("plane: true, movable: true"), "objects/a", "plane"),
    "long quaternion": (
        thing("sphere: 1, pose: {xyz: [0, 0, 0], quat_xyzw: [1, 1, 0, 0]}"), "objects/a", "norm",
    ),
    "pose is a word": (thing("sphere: 1, pose: here"), "objects/a", "not a pose"),
    "pose of letters": (thing("sphere: 1, pose: [a, b, c]"), "objects/a", "pose"),
    "pose of two": (thing("sphere: 1, pose: [0, 0]"), "objects/a", "not a pose"),
    "pose key": (thing("sphere: 1, pose: {xzy: [0, 0, 0]}"), "objects/a", "not a pose"),
    "pose not finite": (thing("sphere: 1, pose: [.nan, 0, 0]"), "objects/a", "not finite"),
    "pose of a shape": (thing("shapes: [{sphere: 1, pose: [0]}]"), "objects/a", "not a pose"),
    "pose of the robot": ("robot: {model: panda, pose: [0]}\n", "robot", "not a pose"),
    "robot": ("robot: pnda\n", "robot", "did you mean 'panda'"),
    "no robot": ("objects: {}\n", "robot", "required"),
    "start group": ("robot: panda\nstart: {leg: home}\n", "start", "unknown planning group 'leg'"),
    "start state": ("robot: panda\nstart: {arm: hone}\n", "start", "did you mean 'home'"),
    "randomize object": (HEAD + CUBE + "randomize: {cub: {dx: [0, 1]}}\n", "randomize", "mean 'cube'"),
    "randomize fixed": (HEAD + CUBE + "randomize: {table: {dx: [0, 1]}}\n", "randomize/table", "fixed"),
    "empty range": (HEAD + CUBE + "randomize: {cube: {dx: [1, 0]}}\n", "randomize/cube/dx", "empty"),
    "range of no mass": (HEAD + CUBE + "randomize: {cube: {mass: [0, 1]}}\n", "randomize/cube/mass", "posit"),
    "pick object": (HEAD + CUBE + "task: [{pick: cub}]\n", "task/0", "did you mean 'cube'"),
    "place on": (HEAD + CUBE + "task: [{place: {object: cube, on: tabel}}]\n", "task/0", "mean 'table'"),
    "place without on": (HEAD + CUBE + "task: [{place: {object: cube}}]\n", "task/0/place/on", "required"),
    "transfer": (HEAD + CUBE + "task: [{transfer: {object: cub, on: cube}}]\n", "task/0", "mean 'cube'"),
    "transfer look": (
        HEAD + CUBE + "task: [{transfer: {object: cube, on: cube, look: eye}}]\n", "task/0", "camera 'eye'"),
    "unknown arm": (HEAD + CUBE + "task: [{pick: cube, arm: arn}]\n", "task/0", "did you mean 'arm'"),
    "state of the hand": (HEAD + "task: [{move: open, arm: arm}]\n", "task/0", "named state 'open'"),
    "arm of a look": (HEAD + "task: [{look: eye, arm: arm}]\n", "task/0", "'look' has no 'arm'"),
    "two steps in one": (HEAD + CUBE + "task: [{pick: cube, hold: 1}]\n", "task/0", "exactly one"),
    "negative hold": (HEAD + "task: [{hold: -1}]\n", "task/0/hold", "greater"),
    "wrong type": (thing("sphere: big"), "objects/a/sphere", "number"),
    "list for mapping": (HEAD + "objects: [1]\n", "objects", "dictionary"),
    "nothing for list": (HEAD + "task:\n", "task", "list"),
    "padding": (HEAD + "padding: -0.01\n", "padding", "greater"),
    "grip mode": (HEAD + "physics: {grip_mode: glue}\n", "physics", "friction, hybrid, weld"),
    "timestep": (HEAD + "physics: {timestep: 0}\n", "physics", "timestep"),
    "blind camera": (HEAD + "cameras: {c: {eye: [0, 0, 1], target: [0, 0, 1]}}\n", "cameras/c", "same point"),
    "name of a link": (HEAD + "objects: {panda_link3: {sphere: 1}}\n", "objects/panda_link3", "link"),
    "missing mesh": (thing("mesh: none.stl"), "objects/a", "none.stl"),
    "missing package": (thing("mesh: 'package://none/none.stl'"), "objects/a", "package://none/none.stl"),
    "mesh from the net": (thing("mesh: 'http://example.org/a.stl'"), "objects/a", "only package"),
    "empty file": ("", "", "mapping"),
    "a list": ("- 1\n", "", "mapping"),
    "alias bomb": (
        "robot: panda\na0: &a0 [x, x]\n"
        + "".join(f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 10)}]\n" for i in range(9)),
        "", "aliases",
    ),
    "python object": ("robot: !!python/object/apply:os.getcwd []\n", "", "not valid YAML"),
    "bottomless": ("robot: " + "[" * 2_000 + "\n", "", "nested deeper"),
}  # fmt: skip


def failure(tmp_path, text: str) -> str:
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as raised:
        armcell.load(file)
    message = str(raised.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(("text", "place", "reason"), BAD.values(), ids=BAD)
def test_says_file_place_and_reason(tmp_path, text, place, reason):
    message = failure(tmp_path, text)
    assert message.startswith(f"{tmp_path / 'cell.yaml'}:")
    if place:
        assert f": {place}" in message
    assert reason in message


@pytest.mark.parametrize(
    ("text", "line"),
    [("robot: panda\nobjects: {a: [1\nb: 2\n", 3), ("robot: panda\n\n\tx: 1\n", 3), ("robot: 'panda\n", 2)],
)
def test_yaml_errors_name_the_line(tmp_path, text, line):
    assert f"cell.yaml:{line}: is not valid YAML" in failure(tmp_path, text)


@pytest.mark.slow
def test_a_deep_file_does_not_crash_the_process(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("robot: " + "[" * 25_000 + "]" * 25_000 + "\n")
    loads = f"import armcell; armcell.load({str(file)!r})"
    process = programs.run([sys.executable, "-c", loads], capture_output=True, text=True, timeout=60)
    assert process.returncode == 1  # negative: killed by a signal
    assert "InputError" in process.stderr.splitlines()[-1]


def test_a_missing_robot_file_names_the_cell_that_asks_for_it(tmp_path):
    message = failure(tmp_path, "robot: arms/none.urdf\n")
    assert "none.urdf" in message and "cell.yaml: robot" in message


def test_a_broken_mesh_is_named_by_its_own_file(tmp_path):
    (tmp_path / "part.stl").write_bytes(b"solid x\n nonsense")
    assert f"{tmp_path / 'part.stl'}: " in failure(tmp_path, thing("mesh: part.stl"))


def test_a_file_that_is_not_text(tmp_path):
    (tmp_path / "cell.yaml").write_bytes(b"\xff\xfe\x00robot")
    with pytest.raises(InputError, match="cell.yaml: is not UTF-8"):
        armcell.load(tmp_path)


def test_no_file_and_no_cell_in_the_folder(tmp_path):
    for path in (tmp_path, tmp_path / "none.yaml"):
        with pytest.raises(InputError, match="not found"):
            armcell.load(path)


def test_a_huge_file_is_not_read(tmp_path):
    assert "larger than" in failure(tmp_path, HEAD + "# " + "x" * 3_000_000)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("settings: {free: {velocity: 0.5}}", "settings/free"),
        ("settings: {free: {velocity: 2, acceleration: 1}}", "settings/free"),
        ("settings: {attempts: three}", "settings"),
        ("settings: {attempts: 0}", "settings"),
        ("settings: {lift_distance: -1}", "settings"),
        ("settings: {planner_id: RTTConnect}", "settings"),
        ("settings: {execution: {path_tolerance: wide}}", "settings/execution"),
        ("physics: {timestep: fast}", "physics"),
        ("physics: {gravity: 5}", "physics"),
        ("physics: {iterations: 1.5}", "physics"),
        ("physics: {object_solref: [1]}", "physics"),
        ("task: [{move: nowhere}]", "task/0"),
        ("task: [{hold: .inf}]", "task/0"),
        ("randomize: {cube: {dx: [.inf, .inf]}}", "randomize/cube"),
        ("cameras: {c: {eye: [.nan, 0, 1], target: [0, 0, 0]}}", "cameras/c"),
    ],
)
def test_values_are_checked_when_the_file_is_read(tmp_path, text, place):
    message = failure(tmp_path, HEAD + CUBE + text + "\n")
    assert f": {place}" in message


def test_a_mesh_scaled_to_nothing(tmp_path):
    import trimesh

    trimesh.creation.box((1, 1, 1)).export(tmp_path / "part.stl")
    assert "objects/a" in failure(tmp_path, thing("mesh: part.stl, mesh_scale: 0"))


def test_a_key_given_twice_is_said_with_its_line(tmp_path):
    message = failure(tmp_path, HEAD + CUBE + "task: []\ntask: []\n")
    assert "key 'task' is given twice" in message
