"""Kernel bodies of a robot's links, with finer sphere covers for fingers and at narrow gaps."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from armcell.collision.kernel.bodies import FINE_OVERSHOOT, LINK_OVERSHOOT, Body, link_body, narrow_gaps
from armcell.kinematics import kinematic_tree
from armcell.model import Link, RobotModel


@lru_cache(maxsize=32)
def links_of(model: RobotModel, scales: tuple[tuple[str, float], ...]) -> tuple[tuple[str, int, Body], ...]:
    """Return the name, index and kernel body of each link with a collision shape."""
    scale_of, tree = dict(scales), kinematic_tree(model)
    return tuple(
        (link.name, tree.link_index[link.name], link_body(link, scale_of.get(link.name, 1.0), overshoot))
        for link, overshoot in _overshoots(model)
    )


def fit_links(model: RobotModel) -> Iterator[float]:
    """Compute the sphere covers and convex pieces of a robot's links, which take most of the time of the
    robot's first checker, and keep them in the cache. Yield the finished share of the links.
    """
    links = _overshoots(model)
    for count, (link, overshoot) in enumerate(links, 1):
        link_body(link, 1.0, overshoot)
        yield count / len(links)


def _overshoots(model: RobotModel) -> list[tuple[Link, float]]:
    """Return the links with collision shapes, and how far [m] the spheres of each may extend beyond it."""
    fine = fine_links(model)
    return [
        (link, FINE_OVERSHOOT if link.name in fine else LINK_OVERSHOOT)
        for link in model.links.values()
        if link.collisions
    ]


def fine_links(model: RobotModel) -> set[str]:
    """Return the robot links that need a fine sphere cover: the contact links of grippers, and base links
    with a narrow gap to another link.
    """
    return {f for g in model.grippers.values() for f in g.contact_links} | narrow_gaps(model)
