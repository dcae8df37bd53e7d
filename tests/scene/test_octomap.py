"""Maps of log-odds and octomap files, against OctoMap's own programs (coal brings them) and coal's reader."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import coal
import numpy as np
import pytest

from armcell.core import InputError, Octree
from armcell.scene.octomap import OccupancyMap, SensorModel, log_odds
from armcell.scene.octree_file import load_octree, octree_bytes, save_octree

RESOLUTION = 0.05


def tool(name: str, *arguments) -> None:
    prefix = next(Path(p, "cmeel.prefix") for p in sys.path if Path(p, "cmeel.prefix", "bin", name).is_file())
    env = {**os.environ, "LD_LIBRARY_PATH": str(prefix / "lib")}
    subprocess.run(
        [prefix / "bin" / name, *map(str, arguments)], env=env, check=True, capture_output=True, timeout=60
    )


def scans(count: int = 4) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where the sensor was and what it saw: a bumpy ball that changes, so that voxels are hit and missed."""
    rng, found = np.random.default_rng(0), []
    for k in range(count):
        eye = np.round(rng.uniform(-0.2, 0.2, 3), 6)
        rays = rng.normal(size=(800, 3))
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        found.append((eye, np.round(rays * (1 + 0.3 * np.sin(4 * rays[:, :1] + k)), 6)))
    return found


@pytest.fixture(scope="module")
def octomaps(tmp_path_factory) -> Path:
    """A folder with what OctoMap makes of the scans: a.bt, a.bt.ot, a.bt_ml.ot."""
    folder = tmp_path_factory.mktemp("octomap")
    lines = []
    for eye, points in scans():
        lines.append("NODE {:.6f} {:.6f} {:.6f} 0 0 0".format(*eye))
        lines += ["{:.6f} {:.6f} {:.6f}".format(*p) for p in points - eye]
    (folder / "a.log").write_text("\n".join(lines) + "\n")
    tool("log2graph", folder / "a.log", folder / "a.graph")
    tool("graph2tree", "-i", folder / "a.graph", "-o", folder / "a.bt", "-res", RESOLUTION)
    return folder


def voxels(tree: Octree, size: float = RESOLUTION) -> set[tuple[int, int, int]]:
    found = set()
    for center, edge in zip(tree.centers, tree.sizes, strict=True):
        low = np.round((center - edge / 2) / size).astype(int)
        found |= {tuple(low + step) for step in np.ndindex(*[round(edge / size)] * 3)}
    return found


@pytest.mark.slow
def test_the_map_is_octomaps(octomaps):
    mine = OccupancyMap(RESOLUTION)
    for eye, points in scans():
        mine = mine.updated(points, eye)
    assert len(voxels(mine.octree())) > 2000
    assert voxels(mine.octree()) == voxels(load_octree(octomaps / "a.bt.ot"))


@pytest.mark.slow
def test_readers_agree_with_coals(octomaps):
    boxes = np.array([list(b) for b in coal.MeshLoader().loadOctree(str(octomaps / "a.bt")).toBoxes()])
    mine = load_octree(octomaps / "a.bt")
    assert len(mine.sizes) == len(boxes)
    key = lambda rows: np.array(sorted(map(tuple, np.round(rows, 4))))  # noqa: E731
    np.testing.assert_allclose(key(np.column_stack([mine.centers, mine.sizes])), key(boxes[:, :4]), atol=2e-4)
    for full in ("a.bt.ot", "a.bt_ml.ot"):
        assert voxels(load_octree(octomaps / full)) == voxels(mine)


@pytest.mark.slow
def test_what_is_written_coal_reads(octomaps, tmp_path):
    """A map with cells of several sizes goes out and comes back, through OctoMap's own reader."""
    ball = load_octree(octomaps / "a.bt")
    block = Octree.from_grid(np.ones((9, 8, 20), bool), RESOLUTION, (2.0, 0.4, -0.8))
    mine = Octree(np.vstack([ball.centers, block.centers]), np.concatenate([ball.sizes, block.sizes]))
    save_octree(mine, tmp_path / "mine.bt")
    theirs = np.array([list(b) for b in coal.MeshLoader().loadOctree(str(tmp_path / "mine.bt")).toBoxes()])
    assert len(set(mine.sizes)) > 1
    assert voxels(Octree(theirs[:, :3], theirs[:, 3])) == voxels(mine)
    tool("bt2vrml", tmp_path / "mine.bt")


def test_written_and_read_again(tmp_path):
    rng = np.random.default_rng(0)
    grid = rng.random((17, 9, 12)) < 0.6
    grid[:8, :8, :8] = True
    tree = Octree.from_grid(grid, 0.1, (-0.4, -0.8, 1.6))
    save_octree(tree, tmp_path / "a.bt")
    assert voxels(load_octree(tmp_path / "a.bt"), 0.1) == voxels(tree, 0.1)
    twice = Octree(np.vstack([tree.centers] * 2), np.concatenate([tree.sizes] * 2))
    assert octree_bytes(twice) == octree_bytes(tree)
    beside = Octree(tree.centers + 0.03, tree.sizes)  # off the grid: every voxel that is reached into
    save_octree(beside, tmp_path / "b.bt")
    reached = {tuple(np.array(v) + s) for v in voxels(tree, 0.1) for s in np.ndindex(2, 2, 2)}
    assert voxels(load_octree(tmp_path / "b.bt"), 0.1) == reached
    save_octree(Octree(np.zeros((0, 3)), np.zeros(0)), tmp_path / "none.bt")
    assert len(load_octree(tmp_path / "none.bt").sizes) == 0
    with pytest.raises(InputError, match="farther than 327.68 m"):
        octree_bytes(Octree([[400.0, 0, 0]], [0.01]))


def test_one_ray_by_hand():
    """Along x from the middle of voxel 0 to the middle of voxel 3."""
    once = OccupancyMap(0.1).updated([[0.35, 0.05, 0.05]], [0.05, 0.05, 0.05])
    line = np.array([[x, 0.05, 0.05] for x in (-0.05, 0.05, 0.15, 0.25, 0.35, 0.45)])
    hit, miss = log_odds(0.7), log_odds(0.4)
    np.testing.assert_allclose(once.at(line), [np.nan, miss, miss, miss, hit, np.nan], rtol=1e-6)
    many = once
    for _ in range(20):
        many = many.updated([[0.35, 0.05, 0.05]], [0.05, 0.05, 0.05])
    np.testing.assert_allclose(many.at(line[[1, 4]]), [log_odds(0.1192), log_odds(0.971)], rtol=1e-6)
    assert np.array_equal(once.at(line[4:5]), [hit])  # the first map is what it was


def test_what_is_seen_through_is_cleared():
    """An obstacle is seen and goes away: rays to the wall behind it clear it."""
    rng = np.random.default_rng(1)
    eye = np.zeros(3)
    wall = np.column_stack([np.full(4000, 1.01), rng.uniform(-0.3, 0.3, (4000, 2))])
    ball = wall * 0.5
    seen = OccupancyMap(0.02).updated(ball, eye)
    assert np.all(seen.at(ball) > 0)
    for _ in range(3):  # 0.85 - 3 * 0.41 < 0
        seen = seen.updated(wall, eye)
    assert np.all(seen.at(ball) < 0) and np.all(seen.octree().centers[:, 0] > 0.9)


def test_far_points_only_clear():
    seen = OccupancyMap(0.1).updated([[5.05, 0.05, 0.05]], [0.05, 0.05, 0.05], max_range=1.0)
    assert len(seen.octree().sizes) == 0
    assert seen.at([[0.95, 0.05, 0.05]])[0] < 0 and np.isnan(seen.at([[1.35, 0.05, 0.05]])[0])


def test_cubes_of_eight_are_put_together():
    rng = np.random.default_rng(2)
    keys = np.array([k for k in np.ndindex(8, 8, 8) if rng.random() < 0.95]) - 4
    seen = OccupancyMap(0.1).updated((keys + 0.5) * 0.1, [9.0, 9.0, 9.0])
    seen = OccupancyMap(0.1, codes=seen.codes[seen.values > 0], values=seen.values[seen.values > 0])
    tree = seen.octree()
    assert voxels(tree, 0.1) == {tuple(k) for k in keys}
    assert len(tree.sizes) < len(keys) and tree.sizes.max() >= 0.2
    assert np.sum(np.round(tree.sizes / 0.1) ** 3) == len(keys)  # nothing twice


def test_points_that_are_not_finite_and_no_points():
    empty = OccupancyMap(0.1)
    assert len(empty.updated(np.zeros((0, 3)), np.zeros(3)).codes) == 0
    assert len(empty.updated(np.full((5, 3), np.nan), np.zeros(3)).codes) == 0
    assert len(empty.octree().sizes) == 0


@pytest.mark.parametrize(
    ("points", "origin", "options", "text"),
    [
        ([[1, 0, 0]], [0, 0], {}, "origin"),
        ([[1, 0, 0]], [0, 0, np.nan], {}, "origin"),
        ([[1, 0, 0]], [0, 0, 0], {"max_range": 0.0}, "max_range"),
        ([[1e9, 0, 0]], [0, 0, 0], {}, "more than 327.68 m from the map's origin"),
        ([[300, 300, 300]], [0, 0, 0], {}, "too many voxels.*max_range"),
    ],
)
def test_bad_input(points, origin, options, text):
    with pytest.raises(InputError, match=text):
        OccupancyMap(0.01).updated(points, origin, **options)


@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan])
def test_bad_resolution(resolution):
    with pytest.raises(InputError, match="resolution"):
        OccupancyMap(resolution)


def test_bad_sensor_model():
    with pytest.raises(InputError, match="sensor model"):
        SensorModel(hit=0.4)
    with pytest.raises(InputError, match="sensor model"):
        SensorModel(occupied=0.99)


# --- files ---
@pytest.mark.parametrize("name", ["a.bt", "a.bt.ot"])
def test_cut_off_files(octomaps, name, tmp_path):
    data = (octomaps / name).read_bytes()
    for length in (*range(1, 120, 7), *np.linspace(120, len(data) - 1, 25).astype(int)):
        (tmp_path / name).write_bytes(data[:length])
        with pytest.raises(InputError, match=name):
            load_octree(tmp_path / name)


HEADER = b"# Octomap OcTree binary file\nid OcTree\nsize 3\nres 0.1\ndata\n"
BAD = {
    "empty": (b"", "is empty"),
    "text": (b"hello", "is no octomap"),
    "kind": (HEADER.replace(b"id OcTree", b"id QuadTree") + bytes(2), "'QuadTree' is not read"),
    "entry": (HEADER.replace(b"id OcTree", b"color red") + bytes(2), ":2: unknown entry 'color'"),
    "resolution": (HEADER.replace(b"0.1", b"-1") + bytes(2), "resolution"),
    "size": (HEADER.replace(b"3", b"x") + bytes(2), "'size' and 'res'"),
    "left over": (HEADER + bytes(2) + b"abc", "3 bytes too many"),
    "for ever": (HEADER + b"\x03\x00" * 40, "deeper than 16 levels"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(name, tmp_path):
    data, text = BAD[name]
    (tmp_path / "a.bt").write_bytes(data)
    with pytest.raises(InputError, match=text):
        load_octree(tmp_path / "a.bt")


def test_a_tiny_file_by_hand(tmp_path):
    """One node: child 0 free, child 3 (x and y up, z down) occupied: an eighth of the map."""
    (tmp_path / "a.bt").write_bytes(HEADER + bytes([0b10000001, 0]))
    tree = load_octree(tmp_path / "a.bt")
    np.testing.assert_allclose(tree.sizes, [2**15 * 0.1])
    np.testing.assert_allclose(tree.centers, [[1638.4, 1638.4, -1638.4]])


def test_no_file(tmp_path):
    with pytest.raises(InputError, match="not found"):
        load_octree(tmp_path / "a.bt")
    with pytest.raises(InputError, match="regular file"):
        load_octree(tmp_path)
    with pytest.raises(InputError, match="cannot be read: File name too long"):
        load_octree(tmp_path / ("a" * 300 + ".bt"))
