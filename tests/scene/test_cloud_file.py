"""Point clouds from files, against trimesh's writer, liblzf's packing and files written out by hand."""

from __future__ import annotations

import base64

import numpy as np
import pytest
import trimesh

from armcell.core import InputError, PointCloud
from armcell.scene.point_clouds import load_obstacle, load_points

POINTS = np.random.default_rng(0).normal(size=(50, 3))

# What liblzf (python-lzf 0.2.6) makes of 60 points, field after field: x = i / 8, y = 1,
# z = 0.25 (i mod 3) as float32, and a byte that is always 7.
PACKED = base64.b85decode(
    "0RRAC00TY%0DvF^0Kgyv1OPt(03aX(06-uE0AL^k0DvF^0FWR90H7cP0I(nf0Kgyv0MH-<0N@}40Pr9K1OPw)00<xh01zMp02m+x"
    "03aX(04N{>05Bi}05~8606-uE07xJM08k(U09YUc0AL^k0B9fs0B|4!0C*q+0DvF^0E8d|0Ei$10E{350FWR90F)pD0GJ>H0GuEL"
    "0H7cP0Hh!T0H`1X0IVPb0I(nf0JI<j0JtCn0K6ar0Kgyv0K^~z0LUN%0L&l*0MH-<0MsA@0N5Y{0Nfx00N@}40OTM80O%kC0PG+G"
    "K+oXg13&;l+d<br0N~XN00-bO009RF"
)  # fmt: skip
PCD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {n}\n"
    "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {data}\n"
)


def pcd(data: str, n: int = 50, fields="x y z", sizes="4 4 4", types="F F F", counts="1 1 1") -> bytes:
    return PCD.format(data=data, n=n, fields=fields, sizes=sizes, types=types, counts=counts).encode()


def ascii_rows(points) -> bytes:
    return "".join(" ".join(map(repr, map(float, p))) + "\n" for p in points).encode()


def save(tmp_path, name: str, data: bytes):
    (tmp_path / name).write_bytes(data)
    return tmp_path / name


def test_xyz_and_npy(tmp_path):
    text = b"# a comment\n\n" + ascii_rows(POINTS)
    np.testing.assert_array_equal(load_points(save(tmp_path, "a.xyz", text)), POINTS)
    with_more = b"\n".join(b"1,2,3,255,0,0" for _ in range(4))
    np.testing.assert_array_equal(load_points(save(tmp_path, "a.xyz", with_more)), [[1, 2, 3]] * 4)
    np.save(tmp_path / "a.npy", POINTS)
    np.testing.assert_array_equal(load_points(tmp_path / "a.npy"), POINTS)
    np.save(tmp_path / "a.npy", np.zeros((4, 5, 6), np.float32))  # as from a camera, with colors
    assert load_points(tmp_path / "a.npy").shape == (20, 3)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply(tmp_path, encoding):
    trimesh.PointCloud(POINTS).export(tmp_path / "a.ply", encoding=encoding)
    np.testing.assert_allclose(load_points(tmp_path / "a.ply"), POINTS, atol=1e-6)


def test_ply_of_a_mesh_gives_its_vertices(tmp_path):
    mesh = trimesh.creation.icosphere(1)
    mesh.export(tmp_path / "a.ply")
    found = load_points(tmp_path / "a.ply")
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(mesh.vertices, axis=0), atol=1e-6)


def test_pcd_ascii(tmp_path):
    file = save(tmp_path, "a.pcd", pcd("ascii") + ascii_rows(POINTS))
    np.testing.assert_array_equal(load_points(file), POINTS)


def test_pcd_binary_with_other_fields_between(tmp_path):
    record = np.dtype([("z", "<f8"), ("n", "<f4", (3,)), ("x", "<f4"), ("rgb", "u1"), ("y", "<i2")])
    rows = np.zeros(50, record)
    rows["x"], rows["y"], rows["z"] = POINTS[:, 0], np.arange(50), POINTS[:, 2]
    rows["n"] = 9
    head = pcd("binary", 50, "z n x rgb y", "8 4 4 1 2", "F F F U I", "1 3 1 1 1")
    found = load_points(save(tmp_path, "a.pcd", head + rows.tobytes()))
    expected = np.column_stack([POINTS[:, 0].astype("f4"), np.arange(50), POINTS[:, 2]])
    np.testing.assert_array_equal(found, expected)


def compressed(packed: bytes = PACKED, announced: int | None = None, size: int = 780) -> bytes:
    sizes = np.array([len(packed) if announced is None else announced, size], "<u4").tobytes()
    return pcd("binary_compressed", 60, "x y z i", "4 4 4 1", "F F F U", "1 1 1 1") + sizes + packed


@pytest.mark.slow
def test_pcd_compressed(tmp_path):
    found = load_points(save(tmp_path, "a.pcd", compressed()))
    i = np.arange(60)
    np.testing.assert_array_equal(found, np.column_stack([i / 8, np.ones(60), i % 3 * 0.25]))


def test_points_that_a_camera_did_not_see(tmp_path, caplog):
    points = POINTS.copy()
    points[::5] = np.nan
    found = load_points(save(tmp_path, "a.xyz", ascii_rows(points)))
    assert len(found) == 40 and "10 of 50 points" in caplog.text


def test_as_obstacles(tmp_path):
    cloud = load_obstacle(save(tmp_path, "a.xyz", ascii_rows(POINTS)), 0.01)
    assert isinstance(cloud, PointCloud) and cloud.radius == 0.01
    with pytest.raises(InputError, match="needs a radius"):
        load_obstacle(tmp_path / "a.xyz")


NPY = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (9000000, 3), }"
PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\n" + b"".join(
    b"property float %c\n" % axis for axis in b"xyz"
)
BAD = {
    "a.xyz": [
        (b"", "is empty"), (b"# nothing\n", "has no points"), (b"1 2 3\n1 2\n", ":2: has 2 numbers"),
        (b"1 2 3\n\n1 b 3\n", ":3: .*'b'"), (b"nan nan nan\n", "none of its 1 points is finite"),
        (b"\xff\xfe\x00", "not text"),
    ],
    "a.npy": [
        (b"hello", "NumPy array"), (NPY.ljust(127) + b"\n" + bytes(80), "NumPy array"),
    ],
    "a.ply": [
        (b"solid", "does not begin"), (b"ply\nend_header\n", "element vertex"),
        (PLY + b"end_header\n" + bytes(47), "a.ply"),
        (PLY.replace(b" 4\n", b" 0\n") + b"end_header\n", "no points"),
        (PLY.replace(b" 4\n", b" 99999999999\n") + b"end_header\n", "at most"),
    ],
    "a.pcd": [
        (b"VERSION 0.7\n", "no DATA line"), (pcd("binary") + bytes(599), "599 of 600 bytes"),
        (pcd("ascii") + b"1 2 3\n", "announces 50 points, the file has 1"),
        (pcd("ascii") + b"1 2\n" * 50, ":12: has 2 numbers"), (pcd("zip"), "unknown PCD encoding 'zip'"),
        (pcd("ascii", fields="a b c") + b"1 2 3\n", "no x, y, z"), (pcd("ascii", types="F F X"), "broken"),
        (pcd("ascii", sizes="4 4"), "broken"), (pcd("binary", -3), "-3 points"),
        (pcd("binary", 10**12), "1000000000000 points"), (pcd("binary", counts="1 1 999999"), "bytes"),
        (compressed()[:-1], "cut off"), (compressed(PACKED[:-20]), "unpacked"),
        (compressed(size=781), "holds 781 bytes"), (compressed(b"\x3f" * 264), "unpacked"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("name", "k"), [(n, k) for n, some in BAD.items() for k in range(len(some))])
def test_bad_files(name, k, tmp_path):
    data, text = BAD[name][k]
    with pytest.raises(InputError, match=text) as error:
        load_points(save(tmp_path, name, data))
    assert name in str(error.value)


def test_objects_are_not_unpickled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[print, 1, 2]], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="NumPy array"):
        load_points(tmp_path / "a.npy")


@pytest.mark.parametrize("array", [np.zeros(3), np.zeros((4, 2)), np.array(1.0), np.array([["a", "b", "c"]])])
def test_arrays_of_another_kind(array, tmp_path):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(InputError, match="points need"):
        load_points(tmp_path / "a.npy")


def test_unknown_format(tmp_path):
    with pytest.raises(InputError, match=r"unknown point cloud format '.las'.*\.pcd, \.ply"):
        load_points(save(tmp_path, "a.las", b"LASF"))
