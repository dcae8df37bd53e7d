"""Rendering of RGB and depth images of a world with OpenGL or, as a fallback, ray casting."""

from __future__ import annotations

import zlib
from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, CameraImage, InputError
from armcell.scene import WORLD
from armcell.sim.camera import Camera
from armcell.sim.decals import geom_name
from armcell.sim.gl import GLRenderer, gl_backend
from armcell.sim.mujoco_model import RENDER_CAMERA, BuiltModel, body_pose, build
from armcell.sim.objects import COLLISION_GROUP, OBJECT_GROUP, VISUAL_GROUP
from armcell.sim.world import SimWorld

_MAX_DEPTH = 50.0  # [m] largest depth in an image
_SKY_TOP, _SKY_LOW = np.array([[0.62, 0.74, 0.88], [0.93, 0.95, 0.98]], dtype=np.float32)
_SUN = (np.array([0.3, -0.45, 0.85]) / np.linalg.norm([0.3, -0.45, 0.85])).astype(np.float32)  # to the sun
_AMBIENT, _HEAD, _SUNLIGHT = 0.38, 0.32, 0.38
_TILE = 160  # [px]
_MAX_RENDERERS = 4
_CHECKER = 0.5  # [m] edge length of the checkerboard squares on an infinite plane


def has_gl() -> bool:
    """Return whether images of simulated cameras are rendered with OpenGL on this machine by default, instead
    of by ray casting.

    The result is cached.
    """
    return gl_backend() is not None


def render_depth(world: SimWorld, camera: Camera) -> NDArray[np.float32]:
    """Render the depth image (height, width) [m] of a simulated camera by ray casting.
    Depth is measured along the optical axis.

    Pixels where the rays hit nothing are 0. Links appear as their collision shapes, which enclose the visual
    meshes. The function never needs OpenGL.
    """
    rays = _rays(camera)
    distance, _, _ = _cast(world.mj_model, world.mj_data, camera, rays, (OBJECT_GROUP, COLLISION_GROUP))
    depth = np.where(distance >= 0, distance * rays[:, 2], 0.0)
    return depth.astype(np.float32).reshape(camera.height, camera.width)


def take_image(
    world: SimWorld, camera: Camera, gl: bool | None = None, rgb: bool = True, depth: bool | None = None
) -> CameraImage:
    """Render the image of a simulated camera at its current pose, with color, depth and depth noise.

    The image shows the visual meshes. The noise depends only on the world's seed, the camera's name, and the
    time, so two images of the same instant are identical.

    Args:
        gl: True uses OpenGL, False casts rays; by default OpenGL if it works on this machine.
        rgb: whether to render the RGB image.
        depth: whether to render the depth image; by default if the camera has depth.
    """
    placed = camera if camera.link is None else camera.at(world.link_pose(camera.link) @ _mount(camera))
    with_depth = camera.has_depth if depth is None else depth
    scene = _drawn(world)
    draw = scene.gl if (has_gl() if gl is None else gl) else scene.rays
    picture, far = draw(placed, rgb, with_depth)
    if with_depth and not camera.noise.is_none:
        moment = (world.seed, zlib.crc32(camera.name.encode()), round(world.time / world.timestep))
        far = camera.noise.applied(far, np.random.default_rng(moment))
    return CameraImage(
        camera.name, camera.model, placed.T_world_camera, world.time, picture if rgb else None,
        far if with_depth else None,
    )  # fmt: skip


def _mount(camera: Camera) -> SE3:
    assert camera.T_link_camera is not None  # a camera with a link has one
    return camera.T_link_camera


def render_rgb(world: SimWorld, camera: Camera, gl: bool | None = None) -> NDArray[np.uint8]:
    """Render an RGB image (height, width, 3) of a simulated camera.

    Args:
        gl: True uses OpenGL, False casts rays; by default OpenGL if it works on this machine.
    """
    scene = _drawn(world)
    if has_gl() if gl is None else gl:
        return scene.gl(camera, True, False)[0]
    return scene.rays(camera, True, False)[0]


Drawing = tuple[NDArray[np.uint8], NDArray[np.float32]]
"""RGB and depth image; an image that was not requested is an empty array."""


# --- copy of a world for rendering ---
class _DrawnScene:
    """Copy of a simulated world with visual meshes, from which camera images are rendered.

    The copy is separate from the physics, so rendering has no effect on the simulation.
    """

    def __init__(self, world: SimWorld):
        self.source = world.built.mj
        self.decals = world.decals
        awake = replace(world.settings, sleep=False)  # with sleeping, MuJoCo would not update cameras either
        self.built: BuiltModel = build(world.built.scene, awake, visuals=True, decals=self.decals)
        self.data = mujoco.MjData(self.built.mj)
        model, names = self.built.mj, world.built.objects
        self._bodies = [self.built.body[n] for n in names], [world.built.body[n] for n in names]
        self._camera = model.camera(RENDER_CAMERA).id
        self._renderers: dict[tuple[int, int, bool], GLRenderer] = {}  # by size and kind

    def follow(self, world: SimWorld) -> None:
        own, theirs = self._bodies  # fixed bodies may have new poses, too
        self.built.mj.body_pos[own] = world.mj_model.body_pos[theirs]
        self.built.mj.body_quat[own] = world.mj_model.body_quat[theirs]
        self.data.qpos[:] = world.mj_data.qpos
        mujoco.mj_kinematics(self.built.mj, self.data)
        mujoco.mj_comPos(self.built.mj, self.data)
        mujoco.mj_camlight(self.built.mj, self.data)

    def gl(self, camera: Camera, rgb: bool, depth: bool) -> Drawing:
        model, backend = self.built.mj, gl_backend()
        if backend is None:
            raise InputError("OpenGL does not work here", hint="leave gl to its default, or cast rays")
        # MuJoCo's camera looks along its -z axis with y up
        T = camera.T_world_camera @ SE3(SO3(np.diag([1.0, -1.0, -1.0])), np.zeros(3))
        model.cam_pos[self._camera], model.cam_quat[self._camera] = T.translation, T.quat_wxyz
        model.cam_fovy[self._camera] = camera.fovy_deg
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_camlight(model, self.data)
        m = camera.model
        sides = (
            -(m.cx + 0.5) / m.fx, (m.width - 0.5 - m.cx) / m.fx,
            -(m.height - 0.5 - m.cy) / m.fy, (m.cy + 0.5) / m.fy,
        )  # fmt: skip
        picture, far = np.empty((0, 0, 3), np.uint8), np.empty((0, 0), np.float32)
        if rgb:
            renderer = self._renderer(camera, backend, smooth=True)
            picture = renderer.render(self.data, self._camera, sides)
        if depth:
            renderer = self._renderer(camera, backend, smooth=False)
            far = renderer.depth(self.data, self._camera, sides)
            far[far > _MAX_DEPTH] = 0.0
        return picture, far

    def _renderer(self, camera: Camera, backend: str, smooth: bool) -> GLRenderer:
        key = (camera.width, camera.height, smooth)
        if key not in self._renderers:
            if len(self._renderers) >= _MAX_RENDERERS:
                self._renderers.pop(next(iter(self._renderers))).close()
            self._renderers[key] = GLRenderer(self.built.mj, camera.width, camera.height, backend, smooth)
        return self._renderers[key]

    def rays(self, camera: Camera, rgb: bool, depth: bool) -> Drawing:
        model = self.built.mj
        rays = _rays(camera)
        distance, geom, normal = _cast(model, self.data, camera, rays, (OBJECT_GROUP, VISUAL_GROUP))
        far = np.where(distance >= 0, distance * rays[:, 2], 0.0).astype(np.float32)
        far = far.reshape(camera.height, camera.width)
        if not rgb:
            return np.empty((0, 0, 3), np.uint8), far
        R = camera.T_world_camera.rotation.matrix.astype(np.float32)
        seen, n = rays.astype(np.float32) @ R.T, normal.astype(np.float32)
        facing = seen[:, 0] * n[:, 0] + seen[:, 1] * n[:, 1] + seen[:, 2] * n[:, 2]
        sun = n @ _SUN
        sun = np.where(facing > 0, -sun, sun)  # open visual meshes are visible from the inside, too
        light = _AMBIENT + _HEAD * np.abs(facing) + _SUNLIGHT * np.maximum(sun, 0.0)
        for plane in np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)):
            rows = np.flatnonzero(geom == plane)
            light[rows] *= self._checker(camera, distance[rows], seen[rows], int(plane))
        for decal in self.decals:
            number = model.geom(geom_name(decal)).id
            rows = np.flatnonzero(geom == number)
            points = camera.T_world_camera.translation + distance[rows, None] * seen[rows]
            # not the geom's own frame: MuJoCo aligns this frame with the mesh's principal axes
            T = self._frame(decal.frame) @ decal.T_frame_decal
            light[rows] *= decal.brightness(T.inverse().apply(points))
        palette = np.vstack([model.geom_rgba[:, :3], [0.0, 0.0, 0.0]]).astype(np.float32)
        color = palette[geom] * light[:, None]  # geom -1, nothing hit, takes the last row
        sky = np.flatnonzero(geom < 0)
        height = np.clip(seen[sky, 2:3] * 1.5 + 0.2, 0.0, 1.0)
        color[sky] = _SKY_LOW + height * (_SKY_TOP - _SKY_LOW)
        np.clip(color, 0.0, 1.0, out=color)
        return (color * 255).astype(np.uint8).reshape(camera.height, camera.width, 3), far

    def _frame(self, name: str) -> SE3:
        return SE3.identity() if name == WORLD else body_pose(self.data, self.built.body[name])

    def _checker(self, camera: Camera, distance: NDArray, seen: NDArray, plane: int) -> NDArray:
        """Return the brightness factors (n,) of points on an infinite plane. The factors give the plane a
        checkerboard pattern in rendered images.

        The checkerboard fades with the distance from the camera.
        """
        axes = self.data.geom_xmat[plane].reshape(3, 3)[:, :2].astype(np.float32)
        start = ((camera.T_world_camera.translation - self.data.geom_xpos[plane]) @ axes).astype(np.float32)
        distance = distance.astype(np.float32)
        local = start + distance[:, None] * (seen @ axes)
        odd = np.floor(local / _CHECKER).astype(np.int32).sum(1) & 1
        return 1.0 - 0.14 * odd * np.clip(1.0 - distance / 12.0, 0.0, 1.0)


def _drawn(world: SimWorld) -> _DrawnScene:
    scene = world.render_cache
    if scene is None or scene.source is not world.built.mj:
        scene = world.render_cache = _DrawnScene(world)
    scene.follow(world)
    return scene


# --- rays ---
def _rays(camera: Camera) -> NDArray[np.float64]:
    """Return unit directions (height * width, 3) through the centers of a camera's pixels, to render depth by
    ray casting.
    """
    m = camera.model
    x = (np.arange(camera.width) - m.cx) / m.fx
    y = (np.arange(camera.height) - m.cy) / m.fy
    rays = np.empty((camera.height, camera.width, 3))
    rays[..., 0], rays[..., 1], rays[..., 2] = x[None, :], y[:, None], 1.0
    rays = rays.reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


@lru_cache(maxsize=8)
def _tiles(width: int, height: int) -> tuple[NDArray[np.int64], ...]:
    """Return the pixel indices of each rectangular tile of an image that is rendered by ray casting.

    Casting rays tile by tile takes half the time of one big cast, because most geoms are outside a tile's
    view.
    """
    pixels = np.arange(width * height).reshape(height, width)
    return tuple(
        pixels[y : y + _TILE, x : x + _TILE].ravel()
        for y in range(0, height, _TILE)
        for x in range(0, width, _TILE)
    )


def _cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: Camera,
    rays: NDArray[np.float64],
    groups: tuple[int, ...],
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Cast rays from a camera onto MuJoCo geoms, to render a depth image.

    Returns:
        Distance (n,) [m] along each ray, -1 where a ray hits nothing; geom id (n,), or -1; surface normal (n,
        3), world frame.
    """
    T = camera.T_world_camera
    n = len(rays)
    directions = np.ascontiguousarray(rays @ T.rotation.matrix.T)
    shown = np.zeros(6, dtype=np.uint8)
    shown[list(groups)] = 1
    geom = np.full(n, -1, dtype=np.int32)
    distance = np.full(n, -1.0)
    normal = np.zeros((n, 3))
    eye = T.translation.reshape(3, 1)
    for tile in _tiles(camera.width, camera.height):
        k = len(tile)
        g, d, m = np.full(k, -1, dtype=np.int32), np.full(k, -1.0), np.zeros(3 * k)
        toward = directions[tile].reshape(-1, 1)
        mujoco.mj_multiRay(model, data, eye, toward, shown, True, -1, g, d, m, k, _MAX_DEPTH)
        geom[tile], distance[tile], normal[tile] = g, d, m.reshape(k, 3)
    beyond = distance > _MAX_DEPTH  # MuJoCo's ray cutoff does not apply to infinite planes
    distance[beyond], geom[beyond] = -1.0, -1
    return distance, geom, normal
