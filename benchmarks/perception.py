"""What the perception of docs/perception.md measures: `python -m benchmarks.perception [--scenes 50]`.

Poses of random primitives in 320 x 240 depth images against the simulator's truth, processor time of a look,
of a picture into the map, and marker poses. Poses of known meshes: `benchmarks.mesh_poses`.
"""

from __future__ import annotations

import argparse

import numpy as np
from tests.perception.scenes import random_scene
from tests.perception.test_look import errors

from armcell.core import SE3, SO3
from armcell.model import load_robot
from armcell.perception import (
    CameraMap,
    MapSettings,
    find_markers,
    look,
    marker_picture,
    picture_size,
)
from armcell.scene import PlanningScene
from armcell.sim import Camera, Decal, DepthNoise, SimWorld, look_at, take_image


def poses(scenes: int) -> None:
    print(
        "what | n | not found | mm: median, 95 % | deg: median, 95 % | size mm: median, 95 % | ms per picture"
    )
    for title, first, count, apart in (("apart", 5000, 4, 0.02), ("hidden in part", 6000, 9, -0.025)):
        made = [random_scene(first + s, count, DepthNoise.for_stereo(), apart) for s in range(scenes)]
        for known in (False, True):
            rows, lost = errors(made, known)
            cpu = [
                look(s.image, s.world.built.scene, tuple(s.objects.values()) if known else ()).cpu_time
                for s in made
            ]
            middle, high = np.median(rows, axis=0), np.percentile(rows, 95, axis=0)
            numbers = " | ".join(f"{a:.2f}, {b:.2f}" for a, b in zip(middle, high, strict=True))
            what = f"{title}, {'known shapes' if known else 'unknown'}"
            print(f"{what} | {len(rows) + lost} | {lost} | {numbers} | {1000 * np.median(cpu):.0f}")


def maps() -> None:
    print("pixels | voxel | every | ms per picture")
    made = random_scene(1, 4, DepthNoise.for_stereo())
    known = made.world.built.scene.without_object("thing0")
    for width, height in ((320, 240), (640, 480)):
        camera = Camera("eye", made.image.T_world_camera, width, height, noise=DepthNoise.for_stereo())
        image = take_image(made.world, camera, rgb=False)
        for resolution in (0.02, 0.01):
            for every in (1, 2):
                seen = CameraMap(MapSettings(resolution=resolution, every=every))
                cpu = [seen.update(image, known).cpu_time for _ in range(15)][3:]
                print(
                    f"{width} x {height} | {resolution * 1000:.0f} mm | {every} | {1000 * np.median(cpu):.0f}"
                )


def markers() -> None:
    print("marker of 60 mm, 640 x 480, 0.55 to 0.75 m | mm: median, 95 % | deg: median, 95 %")
    rng = np.random.default_rng(0)
    for family in ("apriltag_36h11", "aruco_4x4_50"):
        off = []
        for _ in range(10):
            truth = {
                n: SE3(
                    SO3.exp([0, 0, rng.uniform(-3, 3)]), np.array([0.5 + 0.1 * (n % 3), 0.1 * (n // 3), 0.0])
                )
                for n in range(9)
            }
            decals = [
                Decal(f"m{n}", "world", T, picture_size(family, 0.06), marker_picture(family, n))
                for n, T in truth.items()
            ]
            world = SimWorld(PlanningScene.of(load_robot("parallel_gripper")), decals=decals)
            eye = [0.6, 0.1, 0] + rng.uniform(0.55, 0.75) * _direction(rng)
            sight = find_markers(
                take_image(world, Camera("eye", look_at(eye, [0.6, 0.1, 0]), 640, 480)), family, 0.06
            )
            off += [m.T_world_marker.distance_to(truth[m.id].shifted(z=0.0005)) for m in sight.markers]
        p, a = np.array(off).T * [[1000], [180 / np.pi]]
        print(f"{family} ({len(off)}) | {np.median(p):.2f}, {np.percentile(p, 95):.2f} | ", end="")
        print(f"{np.median(a):.2f}, {np.percentile(a, 95):.2f}")


def _direction(rng: np.random.Generator) -> np.ndarray:
    angle, rise = rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(35, 80))
    return np.array([np.cos(angle) * np.cos(rise), np.sin(angle) * np.cos(rise), np.sin(rise)])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=50)
    poses(parser.parse_args().scenes)
    maps()
    markers()
