"""Clearing a bin with a cell's arm and cameras, and counting what really came of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armcell.cell.seeing import LiveCamera
from armcell.core import CameraImage, ErrorCode, InputError, Outcome
from armcell.grasping import support_surface
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.sim import SimWorld
from armcell.tasks import TaskContext
from armcell.tasks.clearing import ClearSettings, clear_bin

LOST = -1.0  # [m] below this it falls, for ever


def clear_with(
    ctx: TaskContext, scene: PlanningScene, gripper: Gripper, bin: str, tray: str, table: str,
    eye: LiveCamera, eye_on_tray: LiveCamera, settings: ClearSettings = ClearSettings(),
) -> Outcome:  # fmt: skip
    """Clear a bin; the evidence says by the simulator's truth how many are `cleared`, `left` and `beside`.

    In physics it is a FAILURE, too, when no camera sees anything more and something is not in the tray.

    Args:
        scene: with every object of the cell, also those that only cameras know.
    Raises:
        InputError: the planner knows the things' poses already, or bin or tray have no level floor.
    """
    things = [name for name, item in scene.objects.items() if item.movable]
    known = [name for name in things if name in ctx.base.objects]
    if known:
        raise InputError(
            f"the poses of {', '.join(known[:3])} are known without a camera",
            cure="name them under 'perception: objects' in the cell file",
        )
    for link in gripper.hand_links:  # in a heap the hand touches what lies there
        ctx.driver.expect_contact(link, things)

    def look(camera: LiveCamera) -> CameraImage:
        if not camera.frozen:
            ctx.advance(1.0 / camera.camera.rate)  # the next picture, of the arm as it stands
        return camera.take(ctx.advance, rgb=False)

    outcome = clear_bin(
        ctx, gripper, bin, tray, table, lambda: look(eye), lambda: look(eye_on_tray), settings
    )
    world = getattr(ctx.driver, "world", None)
    if not isinstance(world, SimWorld):
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
    """The things whose middle is above a container's floor."""
    frame, size_x, size_y = support_surface(scene.object(container))
    found = []
    for name in things:
        low, high = scene.object(name).bounds()
        local = frame.inv().apply(world.object_pose(name).apply((low + high) / 2))
        if np.all(np.abs(local[:2]) < np.array([size_x, size_y]) / 2) and local[2] > -0.01:
            found.append(name)
    return found
