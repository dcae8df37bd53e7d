"""Bin clearing with the arms and cameras of a cell, including a count of the cleared objects.

In physics, the count uses the true object poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from armcell.cell.live_cameras import LiveCamera
from armcell.core import CameraImage, ErrorCode, InputError, Outcome
from armcell.grasping import support_surface
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.sim import SimWorld
from armcell.tasks import TaskContext
from armcell.tasks.arms import side_by_side
from armcell.tasks.bin_clearing import BinClearingCounts, BinClearingSettings, clear_bin

LOST = -1.0  # [m] height; an object below has fallen off the floor


@dataclass(frozen=True)
class Destination:
    """Tray of one arm in bin clearing, and the camera that looks at it."""

    gripper: Gripper
    tray: str
    camera: LiveCamera


def clear_with(
    ctx: TaskContext, scene: PlanningScene, bin: str, table: str, eye: LiveCamera,
    destinations: Sequence[Destination], settings: BinClearingSettings = BinClearingSettings(),
) -> Outcome:  # fmt: skip
    """Run bin clearing with one or several arms of the cell: move all objects from a bin into the arms'
    trays. In the physics simulation, also count the objects in the trays, in the bin and elsewhere.

    The evidence has the true counts `cleared`, `left` and `beside`. In physics, the outcome is also a FAILURE
    if the cameras see no more objects but an object is not in a tray.

    Args:
        scene: with all objects of the cell, also those whose poses only cameras measure.
        eye: the camera that looks at the bin.
        destinations: one per arm; several arms work side by side.
    Raises:
        InputError: the planner already knows an object's pose, or the bin or a tray has no level floor.
    """
    things = [name for name, item in scene.objects.items() if item.movable]
    known = [name for name in things if name in ctx.base.objects]
    if known:
        raise InputError(
            f"the poses of {', '.join(known[:3])} are known without a camera",
            hint="name them under 'perception: objects' in the cell file",
        )
    trays = list(dict.fromkeys(d.tray for d in destinations))
    for destination in destinations:  # in a heap, the hands touch neighboring objects
        for link in destination.gripper.hand_links:
            ctx.driver.expect_contact(link, things)
    counts = BinClearingCounts()
    found: dict[str, Outcome] = {}

    def clear(destination: Destination, ctx: TaskContext) -> None:
        def look(camera: LiveCamera) -> CameraImage:
            if not camera.frozen:
                ctx.advance(1.0 / camera.camera.rate)  # wait for a picture of the arm's present pose
            return camera.take(ctx.advance, rgb=False)

        gripper, tray = destination.gripper, destination.tray
        found[gripper.name] = clear_bin(
            ctx, gripper, bin, tray, table, partial(look, eye), partial(look, destination.camera), settings,
            [other for other in trays if other != tray], counts,
        )  # fmt: skip

    if len(destinations) == 1:
        clear(destinations[0], ctx)
    else:  # an arm that gives up does not stop the others, which may hold an object
        side_by_side(ctx, {d.gripper.arm_group: partial(clear, d) for d in destinations})
    outcome = next((o for o in found.values() if not o.ok), Outcome(ErrorCode.SUCCESS))
    outcome = replace(outcome, evidence=counts.as_dict())
    world = ctx.driver.world
    if world is None:
        return outcome
    in_tray = [thing for tray in trays for thing in _inside(world, scene, tray, things)]
    in_bin = _inside(world, scene, bin, things)
    truth = {"things": len(things), "cleared": len(in_tray), "left": len(in_bin)}
    truth["beside"] = len(things) - len(in_tray) - len(in_bin)
    outcome = replace(outcome, evidence={**outcome.evidence, **truth})
    if not outcome.ok or len(in_tray) == len(things):
        return outcome
    where = ", ".join(_where(world, name) for name in things if name not in in_tray)
    where_to = " or ".join(map(repr, trays))
    text = f"the cameras see nothing more, yet {len(things) - len(in_tray)} of {len(things)} things"
    return replace(outcome, code=ErrorCode.FAILURE, message=f"{text} are not in {where_to}: {where}")


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
