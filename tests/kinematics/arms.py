"""Arms built like Universal Robots', from the maker's published table, and others that are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.model.helpers import joint, link, model_of

from armcell.model import Group, RobotModel

# Universal Robots, "DH Parameters for calculations of kinematics and dynamics": d1, a2, a3, d4, d5, d6 [m].
UR = {
    "UR3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "UR5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "UR10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "UR3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "UR5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "UR10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "UR16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "UR20": (0.2363, -0.862, -0.7287, 0.2010, 0.1593, 0.1543),
}
NAMES = tuple(f"j{k}" for k in range(1, 7))


def dh_rows(name: str) -> list[tuple[float, float, float]]:
    """(d, a, alpha) of the six joints."""
    d1, a2, a3, d4, d5, d6 = UR[name]
    right = np.pi / 2
    return [(d1, 0, right), (0, a2, 0), (0, a3, 0), (d4, 0, right), (d5, 0, -right), (d6, 0, 0)]


def dh_pose(name: str, q: np.ndarray) -> np.ndarray:
    """T_base_tool (4, 4) by the textbook's product of Denavit-Hartenberg matrices."""
    T = np.eye(4)
    for (d, a, alpha), theta in zip(dh_rows(name), q, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return T


def arm(
    rows: list[tuple[float, float, float]],
    types: str = "rrrrrr",
    signs: tuple[int, ...] = (1,) * 6,
    limit: float = 2 * np.pi,
    torso: bool = False,
    limits: dict[int, tuple[float, float]] | None = None,
) -> RobotModel:
    """A model with group "arm" from DH rows: l0, j1, l1, ... j6, l6, and "tool" after the last row.

    Args:
        types: "r"evolute, "p"rismatic or "c"ontinuous.
        signs: direction of each axis.
        torso: put it on a joint "torso" that is not of the group and tilts the base.
        limits: of single joints, by index.
    """
    parts, before = [link("l0")], "0 0 0.1"
    turn = "0.3 0.2 0.1"
    if torso:
        parts = [link("ground"), link("l0"), joint("torso", "ground", "l0", inside='<axis xyz="0 1 0"/>')]
    for k, (d, a, alpha) in enumerate(rows):
        kind = {"r": "revolute", "p": "prismatic", "c": "continuous"}[types[k]]
        low, high = (limits or {}).get(k, (-limit, limit))
        parts.append(link(f"l{k + 1}"))
        parts.append(
            joint(
                f"j{k + 1}", f"l{k}", f"l{k + 1}", kind,
                f'<origin xyz="{before}" rpy="{turn}"/><axis xyz="0 0 {signs[k]}"/>',
                f'<limit lower="{low!r}" upper="{high!r}" velocity="1" effort="1"/>',
            )
        )  # fmt: skip
        before, turn = f"{a!r} 0 {d!r}", f"{float(alpha)!r} 0 0"
    parts += [
        link("tool"),
        joint(
            "flange", f"l{len(rows)}", "tool", "fixed", f'<origin xyz="{before}" rpy="{turn}"/>'
        ),
    ]  # fmt: skip
    model = model_of(*parts)
    names = tuple(f"j{k + 1}" for k in range(len(rows)))
    groups = {"arm": Group("arm", names, tuple(model.links), "l0", "tool")}
    return replace(model, groups=groups)
