"""Benchmark of the poses of known meshes: one or two cameras with stereo noise, random stable rests and yaws.

`python -m benchmarks.mesh_poses --set "held out" [--poses 10]`. The sets "tune" and "held out" are the halves
of `benchmarks.grasp_objects`; `--folder FOLDER` takes every mesh below a folder, such as scans of YCB.

The reference is independent of armcell: trimesh computes the stable rests, MuJoCo casts the camera's rays at
the exact mesh, and a self-alignment of the exact mesh (iterated closest points) decides which poses are equal
by the object's own symmetry.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import KDTree

from armcell.core import SE3, SO3, CameraImage, Mesh, Pinhole
from armcell.perception import look
from armcell.scene import CollisionObject, mesh_object
from armcell.sim import DepthNoise, look_at
from benchmarks.grasp_objects import HALVES, listed, load

F64 = NDArray[np.float64]

PINHOLE = Pinhole.of_fov(320, 240, 45.0)
VIEWS = ("above", "angle", "two")
RIGHT_MM, RIGHT_DEG = 3.0, 5.0
SYMMETRIC = 0.03
"""Distance between the surfaces of an object in two poses that count as equal, for `SHARE` of the surface, as
a fraction of the object's diameter, and at most `RIGHT_MM`."""
SHARE = 98  # [%]
SAMPLES = 4000
WEAK = 3e-3  # smallest eigenvalue of a direction in which a self-alignment moves


# --- scenes ---
def images(mesh: trimesh.Trimesh, T: SE3, view: str, rng: np.random.Generator) -> list[CameraImage]:
    """Return noisy depth images of a mesh on a table at z = 0."""
    size = float(np.linalg.norm(mesh.extents))
    far = max(0.65, 2.2 * size)
    middle = T.apply(mesh.bounds.mean(axis=0))
    rises = {"above": (88.0,), "angle": (rng.uniform(40, 60),), "two": rng.uniform(40, 65, 2)}[view]
    first, apart = rng.uniform(-np.pi, np.pi), rng.uniform(np.pi / 2, np.pi)
    model, data = _model(mesh, T)
    made = []
    for k, rise in enumerate(np.deg2rad(rises)):
        angle = first + k * apart
        eye = middle + far * np.array(
            [np.cos(angle) * np.cos(rise), np.sin(angle) * np.cos(rise), np.sin(rise)]
        )
        T_camera = look_at(eye, middle + rng.uniform(-0.05, 0.05, 3))
        depth = DepthNoise.for_stereo().applied(_cast(model, data, T_camera), rng)
        made.append(CameraImage(f"camera {k}", PINHOLE, T_camera, 0.0, None, depth))
    return made


def _model(mesh: trimesh.Trimesh, T: SE3) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    shape = spec.add_mesh(name="mesh", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
    shape.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    body = spec.worldbody.add_body(pos=T.translation, quat=T.quat_wxyz)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1.5, 1.5, 0.02], pos=[0, 0, -0.02])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _cast(model: mujoco.MjModel, data: mujoco.MjData, T: SE3) -> NDArray[np.float32]:
    h, w = PINHOLE.height, PINHOLE.width
    v, u = np.mgrid[:h, :w]
    rays = np.stack([(u - PINHOLE.cx) / PINHOLE.fx, (v - PINHOLE.cy) / PINHOLE.fy, np.ones((h, w))], -1)
    rays = rays.reshape(-1, 3)
    long = np.linalg.norm(rays, axis=1)
    toward = np.ascontiguousarray(rays / long[:, None] @ T.rotation.matrix.T)
    n = len(rays)
    far, geom, normal = np.full(n, -1.0), np.full(n, -1, np.int32), np.zeros(3 * n)
    eye = T.translation.reshape(3, 1)
    mujoco.mj_multiRay(model, data, eye, toward.reshape(-1, 1), None, True, -1, geom, far, normal, n, 10.0)
    return np.where(far > 0, far / long, 0.0).reshape(h, w).astype(np.float32)


def rests(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> Iterator[SE3]:
    """Yield poses of a mesh at rest on z = 0, with random yaw, each rest as often as its probability."""
    hull = mesh.convex_hull
    Ts, chances = trimesh.poses.compute_stable_poses(hull, center_mass=hull.center_mass, threshold=0.0)
    likely = chances >= min(0.01, 0.5 * chances.max())  # round objects have many rests
    Ts, chances = Ts[likely], chances[likely]
    for k in rng.choice(len(Ts), count, p=chances / chances.sum()):
        R = SO3.exp([0, 0, rng.uniform(-np.pi, np.pi)]) @ SO3(Ts[k][:3, :3])
        turned = mesh.vertices @ R.matrix.T
        middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
        yield SE3(R, np.array([*(rng.uniform(-0.05, 0.05, 2) - middle[:2]), -turned[:, 2].min()]))


# --- the object's own symmetry ---
@dataclass(frozen=True, eq=False)
class Reference:
    """The exact mesh, with samples of its surface for its self-alignment."""

    mesh: trimesh.Trimesh
    points: F64
    tree: KDTree
    normals: F64
    radius: float  # [m]
    tolerance: float  # [m]

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> Reference:
        points, face = trimesh.sample.sample_surface(mesh, 12 * SAMPLES, seed=1)[:2]
        diameter = float(np.linalg.norm(mesh.extents))
        tolerance = min(SYMMETRIC * diameter, RIGHT_MM / 1000)
        return Reference(mesh, points[::12], KDTree(points), mesh.face_normals[face], diameter / 2, tolerance)

    def error(self, T: SE3, T_true: SE3) -> tuple[float, float]:
        """Return the errors [mm, deg] of a pose, from the nearest pose that is equal by symmetry.

        The position error is that of the middle of the mesh.
        """
        away = T_true.inverse() @ T
        own = self._error(away, SE3.identity())
        if own[0] <= RIGHT_MM and own[1] <= RIGHT_DEG:
            return own
        same = self._aligned(away)
        far = self.tree.query(same.apply(self.points))[0]
        return self._error(away, same) if np.percentile(far, SHARE) <= self.tolerance else own

    def _error(self, a: SE3, b: SE3) -> tuple[float, float]:
        middle = self.mesh.bounds.mean(axis=0)
        far = np.linalg.norm(a.apply(middle) - b.apply(middle))
        return 1000 * float(far), float(np.rad2deg(np.linalg.norm((a.rotation.inverse() @ b.rotation).log())))

    def _aligned(self, T: SE3) -> SE3:
        for _ in range(30):
            at = T.apply(self.points)
            far, k = self.tree.query(at)
            keep = far <= np.percentile(far, 95)
            n, p, q = self.normals[k[keep]], at[keep], np.asarray(self.tree.data)[k[keep]]
            J = np.hstack([np.cross(p, n), n])
            J[:, :3] /= self.radius
            values, axes = np.linalg.eigh(J.T @ J / len(J))
            free = values < WEAK  # a symmetry about an axis leaves a direction free
            step = axes @ np.where(
                free, 0.0, axes.T @ (J.T @ np.einsum("ij,ij->i", n, q - p)) / len(J) / values
            )
            step[:3] /= self.radius
            T = SE3(SO3.exp(step[:3]), step[3:]) @ T
            if np.abs(step).max() < 1e-6:
                break
        return T


# --- the benchmark ---
@dataclass(frozen=True)
class Row:
    """One pose of one object: how it was reported, its errors, and the CPU time [s] of the look."""

    name: str
    view: str
    code: str  # right, wrong, ambiguous right, ambiguous other, ambiguous wrong, reported, not found
    mm: float
    deg: float
    cpu: float


def judged(item: CollisionObject, reference: Reference, view: str, T: SE3, rng: np.random.Generator) -> Row:
    made = images(reference.mesh, T, view, rng)
    began = time.thread_time()
    sight = look(made if len(made) > 1 else made[0], None, (item.at(SE3.identity()),))
    cpu = time.thread_time() - began
    found = [o for o in sight.objects if o.name == item.name and o.T_world_object is not None]
    if not found:
        return Row(item.name, view, "not found", np.inf, np.inf, cpu)
    mm, deg = reference.error(found[0].T_world_object, T)
    right = mm <= RIGHT_MM and deg <= RIGHT_DEG
    others = getattr(found[0], "alternatives", ())
    if found[0].ok:
        code = "right" if right else "wrong"
    elif not others:
        code = "reported right" if right else "reported wrong"
    elif right:
        code = "ambiguous right"
    else:
        errors = [reference.error(other, T) for other in others]
        listed_too = any(e[0] <= RIGHT_MM and e[1] <= RIGHT_DEG for e in errors)
        code = "ambiguous other" if listed_too else "ambiguous wrong"
    return Row(item.name, view, code, mm, deg, cpu)


def meshes(which: str, folder: Path | None) -> Iterator[CollisionObject]:
    if folder is not None:
        for inside in sorted(p for p in folder.iterdir() if p.is_dir()):
            files = sorted(inside.glob("*.obj"), key=lambda f: "collision" in f.name)
            yield mesh_object(inside.name, files[0])
        return
    for entry in listed():
        if which in ("all", entry.half):
            yield load(entry)


def run(which: str, folder: Path | None, poses: int, views: tuple[str, ...], names: list[str]) -> list[Row]:
    rows = []
    for number, item in enumerate(meshes(which, folder)):
        if names and item.name not in names:
            continue
        shape = item.shapes[0][0]
        assert isinstance(shape, Mesh)
        mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        reference = Reference.of(mesh)
        mine = []
        rng = np.random.default_rng(1000 + number)
        for k, T in enumerate(rests(mesh, poses + 1, rng)):
            view = views[k % len(views)]
            row = judged(item, reference, view, T, rng)
            if k > 0:  # the first look at an object prepares it
                mine.append(row)
        rows += mine
        bad = [f"{r.view}: {r.code} {r.mm:.0f} mm {r.deg:.0f} deg" for r in mine if r.code != "right"]
        print(f"{item.name:18s} {np.mean([r.code == 'right' for r in mine]):4.0%} "
              f"{np.median([r.cpu for r in mine]):.2f} s  {'; '.join(bad)}", flush=True)  # fmt: skip
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", default="held out", choices=[*HALVES, "all"])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--poses", type=int, default=9)
    parser.add_argument("--views", nargs="+", default=list(VIEWS), choices=VIEWS)
    parser.add_argument("--only", nargs="+", default=[])
    given = parser.parse_args()
    rows = run(given.set, given.folder, given.poses, tuple(given.views), given.only)
    for view in (*given.views, "all"):
        some = [r for r in rows if view in (r.view, "all")]
        counts = Counter(r.code for r in some)
        right = [r for r in some if r.code == "right"]
        cpu = [r.cpu for r in some]
        print(
            f"{view}: {len(some)} poses | "
            + ", ".join(f"{code} {n} ({n / len(some):.1%})" for code, n in counts.most_common())
            + f" | median {np.median([r.mm for r in right]):.2f} mm, "
            + f"{np.median([r.deg for r in right]):.2f} deg"
            + f" | CPU median {np.median(cpu):.2f} s, max {np.max(cpu):.2f} s"
        )
    return int(any(r.code == "wrong" for r in rows))


if __name__ == "__main__":
    sys.exit(main())
