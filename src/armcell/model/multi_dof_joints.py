"""Planar and floating joints of a URDF, each as a chain of joints with one degree of freedom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armcell.core import SE3
from armcell.model.robot import Joint, JointLimits, Link

Step = tuple[str, str, tuple[float, float, float]]

FLOATING_STEPS: list[Step] = [
    ("trans_x", "prismatic", (1.0, 0.0, 0.0)),
    ("trans_y", "prismatic", (0.0, 1.0, 0.0)),
    ("trans_z", "prismatic", (0.0, 0.0, 1.0)),
    ("yaw", "continuous", (0.0, 0.0, 1.0)),
    ("pitch", "continuous", (0.0, 1.0, 0.0)),
    ("roll", "continuous", (1.0, 0.0, 0.0)),
]


def single_joints(joint: Joint, links: dict[str, Link]) -> list[Joint]:
    """Return the chain of single joints that replaces a planar or floating joint of a URDF. The chain of any
    other joint contains only the joint itself.

    The joints are named `joint/x` and so on, as MoveIt names the variables of a multi-DOF joint. The
    function adds the massless links of the chain to `links`.
    """
    if joint.type == "planar":
        steps = planar_steps(np.array(joint.axis))
    elif joint.type == "floating":
        steps = FLOATING_STEPS
    else:
        return [joint]
    chain, parent, T = [], joint.parent, joint.T_parent_joint
    for i, (suffix, type_, axis) in enumerate(steps):
        child = joint.child if i == len(steps) - 1 else f"{joint.name}/{suffix}_link"
        if child != joint.child:
            links[child] = Link(child)
        chain.append(
            replace(
                joint, name=f"{joint.name}/{suffix}", type=type_, parent=parent, child=child,
                T_parent_joint=T, axis=axis, limits=JointLimits(), mimic=None,
            )
        )  # fmt: skip
        parent, T = child, SE3.identity()
    return chain


def planar_steps(normal: np.ndarray) -> list[Step]:
    """Return the three single joints that replace a planar joint of a URDF, given the normal (3,) of its
    plane.

    Returns:
        (suffix, type, axis) of two prismatic joints in the plane and one continuous joint about the normal.
    """
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = np.cross(np.cross(normal, helper), normal)
    x /= np.linalg.norm(x)
    if abs(normal[2]) > 0.999:
        x = np.array([1.0, 0.0, 0.0])
    y = np.cross(normal, x)
    return [
        ("x", "prismatic", tuple(x.tolist())),
        ("y", "prismatic", tuple(y.tolist())),
        ("theta", "continuous", tuple(normal.tolist())),
    ]
