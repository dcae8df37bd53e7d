"""The picture of docs/explanations.md: what touches, and the nearest goal that works.

Run: python docs/pictures/plot_explanation.py
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import armcell
from armcell.core import SE3, Box, JointState, PlanRequest, PoseGoal
from armcell.kinematics import kinematic_tree
from armcell.planning import plan
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, PhysicsSettings, render_rgb
from armcell.sim.world import SimWorld

RED, GREEN = (0.9, 0.1, 0.1, 0.8), (0.15, 0.7, 0.35, 0.35)
robot = armcell.load_robot("panda")


def links(
    scene: PlanningScene, state: JointState, names: Iterable[str], color: tuple[float, float, float, float]
) -> Iterator[CollisionObject]:
    """Links as objects where they stand in a state."""
    positions = scene.state.updated(state).positions
    for name in names:
        if name in robot.links and robot.links[name].collisions:
            shapes = tuple((c.shape, c.T_link_shape) for c in robot.links[name].collisions)
            T = kinematic_tree(robot).link_pose(positions, name)
            yield CollisionObject(f"{name} {color}", shapes, T, color)


def main() -> None:
    table = CollisionObject.single(
        "table", Box(1.2, 1.6, 0.04), SE3.from_xyz(0.4, 0.0, -0.03), color=(0.62, 0.52, 0.42, 1.0)
    )
    wall = CollisionObject.single(
        "wall", Box(0.5, 0.02, 0.5), SE3.from_xyz(0.5, 0.0, 0.25), color=(0.35, 0.45, 0.60, 1.0)
    )
    aside = JointState(robot.group("arm").joint_names, np.array([0.6, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8]))
    scene = PlanningScene.of(robot, objects=[table, wall]).with_padding(0.005).with_state(aside)
    target = SE3.from_xyz_rpy((0.5, 0.03, 0.3), (np.pi, 0.0, 0.0))
    why = plan(scene, PlanRequest("arm", (PoseGoal(target),))).explain()
    assert why.state is not None and why.nearest is not None
    touching = sorted({name for c in why.contacts for name in (c.body_a, c.body_b)})
    drawn = replace(scene)
    for item in (*links(scene, why.state, touching, RED), *links(scene, why.nearest, robot.links, GREEN)):
        drawn = drawn.with_object(item)
    camera = Camera.looking_at("why", (1.5, 1.15, 0.95), (0.35, 0.1, 0.3), width=800, height=560, fovy_deg=42)
    picture = render_rgb(SimWorld(drawn, PhysicsSettings()), camera)
    Image.fromarray(picture).save(Path(__file__).with_name("explanation.png"), optimize=True)


main()
