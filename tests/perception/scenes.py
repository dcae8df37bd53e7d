"""Random scenes of primitives on a table, in physics, with the truth beside what a camera sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armcell.core import SE3, SO3, Box, CameraImage, Cylinder, Shape, Sphere
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, DepthNoise, SimWorld, look_at, take_image

KINDS = ("box", "standing", "lying", "ball")
TABLE = CollisionObject.single("table", Box(1.2, 1.2, 0.04), SE3.from_xyz(0.6, 0, -0.02))


@dataclass
class RandomScene:
    """Objects at random places with a camera that looks at them from a random side."""

    world: SimWorld
    objects: dict[str, CollisionObject]
    image: CameraImage

    def truth(self, name: str) -> SE3:
        return self.world.object_pose(name)


def random_object(kind: str, name: str, rng: np.random.Generator) -> CollisionObject:
    """Of a size that a hand can hold, at height zero."""
    x, y, yaw = *rng.uniform((0.45, -0.2), (0.75, 0.2)), rng.uniform(-np.pi, np.pi)
    turn = SO3.exp([0, 0, yaw])
    shape: Shape
    if kind == "box":
        shape = Box(*rng.uniform(0.03, 0.1, 3))
        z = shape.z / 2
    elif kind == "ball":
        shape = Sphere(rng.uniform(0.02, 0.045))
        z = shape.radius
    else:
        shape = Cylinder(rng.uniform(0.015, 0.04), rng.uniform(0.05, 0.14))
        z = shape.length / 2
        if kind == "lying":
            turn, z = turn @ SO3.exp([0, np.pi / 2, 0]), shape.radius
    return CollisionObject.single(name, shape, SE3(turn, np.array([x, y, z])), movable=True)


def random_scene(
    seed: int, count: int = 4, noise: DepthNoise = DepthNoise(), apart: float = 0.02, gl: bool | None = None
) -> RandomScene:
    """`count` objects at least `apart` [m] from each other, seen by 320 x 240 pixels from 0.6 to 0.9 m."""
    rng = np.random.default_rng(seed)
    objects: dict[str, CollisionObject] = {}
    while len(objects) < count:
        item = random_object(str(rng.choice(KINDS)), f"thing{len(objects)}", rng)
        reach = lambda o: np.linalg.norm(o.shapes[0][0].half_extents[:3])  # noqa: E731
        at = item.T_world_object.translation
        if all(
            np.linalg.norm((o.T_world_object.translation - at)[:2]) > reach(o) + reach(item) + apart
            for o in objects.values()
        ):
            objects[item.name] = item
    scene = PlanningScene.of(load_robot("parallel_gripper"), objects=[TABLE, *objects.values()])
    angle, rise = rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(35, 85))
    far = rng.uniform(0.6, 0.9)
    target = np.array([0.6, 0.0, 0.02])
    eye = target + far * np.array([np.cos(angle) * np.cos(rise), np.sin(angle) * np.cos(rise), np.sin(rise)])
    camera = Camera("eye", look_at(eye, target), 320, 240, 45.0, noise=noise)
    world = SimWorld(scene, cameras=[camera], seed=seed)
    return RandomScene(world, objects, take_image(world, camera, gl))
