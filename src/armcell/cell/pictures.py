"""Pictures of a run for reports (stage ends, first contact), and of a gripper, open and closed.

The picture of a gripper marks its tool center, pads and closing direction.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from armcell.cell.live import LiveCell
from armcell.core import SE3, SO3, CameraImage, Event, JointTrajectory, StateSample
from armcell.core.geometry import local_bounds
from armcell.grasping import Hand, hand_of
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel, SuctionGripper, hand_alone
from armcell.scene import PlanningScene, extent
from armcell.sim import Camera, SimWorld, render_rgb

logger = logging.getLogger(__name__)

Picture = NDArray[np.uint8]

FROM = np.array([0.75, -0.6, 0.45])  # direction from the scene's center to the viewer
FIELD = 45.0  # [deg]
Array = NDArray[np.float64]
Point = tuple[float, float]
VIEW = np.array([1.0, 0.3, -0.25])  # direction from the hand to the viewer, tcp frame
_GRIPPER_FIELD = 30.0  # [deg]
SIZE = 480  # [px] width and height of one picture
AXES = {"x": (220, 40, 40), "y": (30, 150, 30), "z": (40, 80, 230)}


def overview(scene: PlanningScene) -> Camera:
    """Return a camera for pictures of a run, placed such that it shows the robot and all objects near it."""
    middle, radius = extent(scene)
    away = 1.3 * radius / np.sin(np.deg2rad(FIELD / 2))
    eye = middle + away * FROM / np.linalg.norm(FROM)
    return Camera.looking_at("overview", eye, middle, fovy_deg=FIELD)


class Pictures:
    """Observer that takes pictures during a run, for reports.

    It uses the cell's first camera that is not mounted on a link; without such a camera, an overview from the
    side in front. If the driver runs in real time, another process draws the pictures and they arrive later,
    in another thread (`CellRenderer`).

    Args:
        take: receives the time [s], a description and the picture (h, w, 3).
        stages: also take a picture at the end of each stage.
    """

    def __init__(self, live: LiveCell, take: Callable[[float, str, Picture], None], stages: bool = True):
        self._driver: Any = live.driver  # has a `world` once it is connected
        self._scene, self._take, self._stages = live.scene_at_start, take, stages
        self._touched = self._broken = False
        self._renderer = next((c.renderer for c in live.cameras.values()), None)
        self._number = 0

    @cached_property
    def _camera(self) -> Camera:
        still = (camera for camera in self._driver.world.cameras.values() if camera.link is None)
        return next(still, None) or overview(self._scene)

    def now(self) -> Picture:
        return render_rgb(self._driver.world, self._camera)

    def on_event(self, event: Event) -> None:
        touches = event.kind == "contact" and not self._touched
        if touches or (self._stages and event.kind == "stage" and event.data.get("phase") == "end"):
            self._touched = self._touched or touches
            self._try(event)

    def _try(self, event: Event) -> None:
        if self._broken:
            return
        if self._driver.is_paced and self._renderer is not None:
            self._number += 1
            key = "key moment", self._number
            self._renderer.ask(key, self._camera, partial(self._give, event), depth=False, keep=True)
            return
        try:
            picture = self.now()
        except Exception as error:  # the run continues on machines without graphics
            self._broken = True
            logger.warning("no more pictures of this run: %s", error)
        else:
            self._take(event.time, event.text, picture)

    def _give(self, event: Event, image: CameraImage) -> None:
        if image.rgb is not None:
            self._take(event.time, event.text, image.rgb)

    def on_state(self, sample: StateSample) -> None:
        pass

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass


PAD, CLOSING, TEXT = (245, 150, 20), (190, 20, 160), (20, 20, 20)


def gripper_picture(model: RobotModel, gripper: Gripper) -> Image.Image:
    """Return a picture of a hand; jaws are open on the left and closed on the right.

    Lines mark the axes of the tcp frame (x red, y green, z blue), the pads or the rings of suction cups
    (orange) and the direction in which the jaws close (purple arrows).

    Raises:
        InputError: MuJoCo rejects the hand, or its links have no collision shapes.
    """
    hand = hand_of(model, gripper)
    alone = hand_alone(model, gripper)
    if isinstance(gripper, SuctionGripper):
        points = _points(alone, alone.default_positions(), gripper.tcp_link)
        return _view(alone, hand, gripper.max_width, points, gripper.summary)
    picture = Image.new("RGB", (2 * SIZE, SIZE))
    points = _points(alone, _positions(alone, gripper, gripper.max_width), gripper.tcp_link)
    for column, width in enumerate((gripper.max_width, hand.closed_width)):
        name = f"{'closed' if column else 'open'}: {1000 * width:.0f} mm"
        picture.paste(_view(alone, hand, width, points, name), (column * SIZE, 0))
    return picture


def _positions(alone: RobotModel, gripper: Gripper, width: float) -> Array:
    q = alone.default_positions()
    columns = alone.columns(gripper.joint_names)
    # Jaws that cannot close completely stop at their joint's limit.
    q[columns] = np.clip(gripper.joint_position(width), alone.lower[columns], alone.upper[columns])
    return q


def _view(alone: RobotModel, hand: Hand, width: float, points: Array, title: str) -> Image.Image:
    """Render a picture of a gripper that is open by `width` [m]. All `points` (n, 3) [m, tcp frame] are in
    view.
    """
    gripper = hand.gripper
    q = _positions(alone, gripper, width)
    T_world_tcp = kinematic_tree(alone).link_pose(q, gripper.tcp_link)
    camera = _camera(T_world_tcp, points)
    with SimWorld(PlanningScene(alone, q)) as world:
        image = Image.fromarray(render_rgb(world, camera))
    draw, length = ImageDraw.Draw(image), 0.2 * float(np.ptp(points, axis=0).max())

    def pixels(at: Array) -> list[Point]:
        """Project points (n, 3) [m, tcp frame] into the picture of a gripper; return their pixels (u, v)."""
        there = camera.T_world_camera.inverse().apply(T_world_tcp.apply(np.atleast_2d(at)))
        return [(float(u), float(v)) for u, v in camera.model.project(there)]

    def line(at: Array, color: tuple[int, int, int], arrow: bool = False) -> None:
        ends = pixels(at)
        draw.line(ends, fill=color, width=3)
        if arrow:
            (u0, v0), (u1, v1) = ends
            along = np.array([u1 - u0, v1 - v0]) / max(np.hypot(u1 - u0, v1 - v0), 1e-9)
            across = np.array([-along[1], along[0]])
            tip = np.array([u1, v1])
            corners = [tip, tip - 9 * along + 5 * across, tip - 9 * along - 5 * across]
            draw.polygon([(float(u), float(v)) for u, v in corners], fill=color)

    if isinstance(gripper, SuctionGripper):
        angle = np.linspace(0.0, 2 * np.pi, 49)[:, None]
        for cup, middle in zip(gripper.cups, hand.cups, strict=True):
            line(middle + cup.radius * np.hstack([np.cos(angle), np.sin(angle), 0 * angle]), PAD)
    center = gripper.center(width).translation
    (x0, z0), (x1, z1) = hand.pad
    for side in () if isinstance(gripper, SuctionGripper) else (1.0, -1.0):
        y = side * width / 2
        corners = np.array([(x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1), (x0, y, z0)]) + center
        line(corners, PAD)
        middle = np.array([(x0 + x1) / 2, 0.0, (z0 + z1) / 2]) + center
        far, near = (np.array([0.0, side * (width / 2 + d * length), 0.0]) for d in (1.6, 0.7))
        line(np.stack([middle + far, middle + near]), CLOSING, arrow=True)
    for k, (name, color) in enumerate(AXES.items()):
        end = 0.8 * length * np.eye(3)[k]
        line(np.stack([np.zeros(3), end]), color, arrow=True)
        draw.text(pixels(1.2 * end)[0], name, fill=color, font=_font(14))
    draw.text((10, 8), title, fill=TEXT, font=_font(18))
    return image


def _points(alone: RobotModel, q: Array, tcp_link: str) -> Array:
    """Return the corners (n, 3) [m, tcp frame] of the boxes around a gripper's shapes, so that the gripper's
    picture shows all of them.
    """
    tree = kinematic_tree(alone)
    into = tree.link_pose(q, tcp_link).inverse()
    found = [np.zeros((1, 3))]
    for name, link in alone.links.items():
        for solid in link.collisions:
            center, half = local_bounds(solid.shape)
            corners = center + half * np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
            found.append((into @ tree.link_pose(q, name) @ solid.T_link_shape).apply(corners))
    return np.concatenate(found)


def _camera(T_world_tcp: SE3, points: Array) -> Camera:
    """Return a camera for the picture of a gripper. It sees the points (n, 3) [m, tcp frame], with the tcp's
    z axis downward in the image.
    """
    middle = (points.min(0) + points.max(0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    forward = -VIEW / np.linalg.norm(VIEW)
    down = np.array([0.0, 0.0, 1.0]) - forward[2] * forward
    down /= np.linalg.norm(down)
    right = np.asarray(np.cross(down, forward), dtype=float)
    R = SO3(np.stack([right, down, forward], axis=1))
    eye = middle - forward * 1.05 * radius / np.sin(np.deg2rad(_GRIPPER_FIELD / 2))
    return Camera("gripper", T_world_tcp @ SE3(R, eye), width=SIZE, height=SIZE, fovy_deg=_GRIPPER_FIELD)


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
