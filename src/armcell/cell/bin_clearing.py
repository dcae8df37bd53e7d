"""Bin clearing with the arm and cameras of a cell, including a count of the cleared objects.

In physics, the count uses the true object poses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armcell.cell.live_cameras import LiveCamera
from armcell.core import CameraImage, ErrorCode, InputError, Outcome
from armcell.grasping import support_surface
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.sim import SimWorld
from armcell.tasks import TaskContext
from armcell.tasks.bin_clearing import BinClearingSettings, clear_bin

LOST = -1.0  # [m] height; an object below has fallen off the floor


def clear_with(
    ctx: TaskContext, scene: PlanningScene, gripper: Gripper, bin: str, tray: str, table: str,
    eye: LiveCamera, eye_on_tray: LiveCamera, settings: BinClearingSettings = BinClearingSettings(),
) -> Outcome:  # fmt: skip
    """Run bin clearing with an arm of the cell: move all objects from a bin into a tray. In the physics
    simulation, also count the objects in the tray, in the bin and elsewhere.

    The evidence has the true counts `cleared`, `left` and `beside`. In physics, the outcome is also a FAILURE
    if the cameras see no more objects but an object is not in the tray.

    Args:
        scene: with all objects of the cell, also those whose poses only cameras measure.
        eye: the camera that looks at the bin.
        eye_on_tray: the camera that looks at the tray.
    Raises:
        InputError: the planner already knows an object's pose, or the bin or tray has no level floor.
    """
    things = [name for name, item in scene.objects.items() if item.movable]
    known = [name for name in things if name in ctx.base.objects]
    if known:
        raise InputError(
            f"the poses of {', '.join(known[:3])} are known without a camera",
            hint="name them under 'perception: objects' in the cell file",
        )
    for link in gripper.hand_links:  # in a heap, the hand touches neighboring objects
        ctx.driver.expect_contact(link, things)

    def look(camera: LiveCamera) -> CameraImage:
        if not camera.frozen:
            ctx.advance(1.0 / camera.camera.rate)  # wait for a picture of the arm's present pose
        return camera.take(ctx.advance, rgb=False)

    outcome = clear_bin(
        ctx, gripper, bin, tray, table, lambda: look(eye), lambda: look(eye_on_tray), settings
    )
    world = ctx.driver.world
    if world is None:
        return outcome
    in_tray, in_bin = (_inside(world, scene, name, things) for name in (tray, bin))
    truth = {"things": len(things), "cleared": len(in_tray), "left": len(in_bin)}
    truth["beside"] = len(things) - len(in_tray) - len(in_bin)
    outcome = replace(outcome, evidence={**outcome.evidence, **truth})
    if not outcome.ok or len(in_tray) == len(things):
        return outcome
    where = ", ".join(_where(world, name) for name in things if name not in in_tray)
    text = f"the cameras see nothing more, yet {len(things) - len(in_tray)} of {len(things)} things"
    return replace(outcome, code=ErrorCode.FAILURE, message=f"{text} are not in {tray!r}: {where}")


def _where(world: SimWorld, name: str) -> str:
    x, y, z = world.object_pose(name).translation
    return f"{name} rolled off the floor" if z < LOST else f"{name} at ({x:.2f}, {y:.2f}, {z:.2f})"


def _inside(world: SimWorld, scene: PlanningScene, container: str, things: list[str]) -> list[str]:
    """Return the objects whose center is above the floor of a container, to count the objects in the bin and
    in the tray during bin clearing.
    """
    frame, size_x, size_y = support_surface(scene.object(container))
    found = []
    for name in things:
        low, high = scene.object(name).bounds()
        local = frame.inverse().apply(world.object_pose(name).apply((low + high) / 2))
        if np.all(np.abs(local[:2]) < np.array([size_x, size_y]) / 2) and local[2] > -0.01:
            found.append(name)
    return found
