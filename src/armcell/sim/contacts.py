"""Contacts by name, and a monitor that sees every physics step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import UnknownNameError
from armcell.sim.build import BuiltModel

Array = NDArray[np.float64]

_FEW = 30
"""Contacts up to which a plain loop is quicker than NumPy; this runs at every physics step."""


@dataclass(frozen=True)
class PhysicsContact:
    """One contact point of the last step. Bodies are link or object names."""

    body_a: str
    body_b: str
    position: tuple[float, float, float]  # world frame [m]
    depth: float  # [m], how far the bodies overlap
    force: float  # [N], normal


@dataclass(frozen=True)
class UnwantedContact:
    """A pair that touched and should not have."""

    body_a: str
    body_b: str
    time: float  # [s] when it was first seen
    depth: float  # [m], deepest so far
    count: int  # physics steps in which the pair touched


def read_contacts(built: BuiltModel, data: mujoco.MjData) -> list[PhysicsContact]:
    """All contacts of the last step, deepest first."""
    found = []
    wrench = np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        a, b = (built.geom_owner[g] for g in contact.geom)
        mujoco.mj_contactForce(built.mj, data, i, wrench)
        x, y, z = contact.pos
        found.append(
            PhysicsContact(
                built.owners[a],
                built.owners[b],
                (float(x), float(y), float(z)),
                -contact.dist,
                float(wrench[0]),
            )
        )
    return sorted(found, key=lambda c: -c.depth)


def contact_forces_on(
    built: BuiltModel, data: mujoco.MjData, owners: Iterable[int]
) -> dict[tuple[int, int], Array]:
    """Force (3,) [N, world frame] on each of `owners` by what touches it: (owner, other) -> force."""
    wanted = set(owners)
    forces: dict[tuple[int, int], Array] = {}
    if data.ncon == 0:
        return forces
    pairs = built.geom_owner[data.contact.geom]  # (ncon, 2)
    wrench = np.zeros(6)
    for i, (a, b) in enumerate(pairs.tolist()):
        if a not in wanted and b not in wanted:
            continue
        mujoco.mj_contactForce(built.mj, data, i, wrench)
        on_b = data.contact[i].frame.reshape(3, 3).T @ wrench[:3]  # the frame's x axis points from a to b
        if b in wanted:
            forces[b, a] = forces.get((b, a), 0.0) + on_b
        if a in wanted:
            forces[a, b] = forces.get((a, b), 0.0) - on_b
    return forces


class ContactMonitor:
    """Collects unwanted contacts at every physics step.

    Unwanted is: a robot link touching anything it is not allowed to touch, and a watched (held) object
    touching any object it is not allowed to rest on. MuJoCo finds contacts at the beginning of a step, so
    the state after the very last step has not been looked at yet.
    """

    def __init__(self, built: BuiltModel):
        self._built = built
        self._allowed: set[frozenset[str]] = set()
        self._watched: set[str] = set()
        self._found: dict[frozenset[str], UnwantedContact] = {}
        scene = built.scene
        for pair, allow in scene.allowed.items():
            if allow:
                self._allowed.add(pair)
        for name, body in scene.attached.items():
            self._allowed |= {frozenset((name, link)) for link in body.touch_links}
        for gripper in scene.model.grippers.values():  # an empty gripper closes on itself
            self._allowed.add(frozenset(gripper.finger_links))
        self._rule()

    @property
    def unwanted(self) -> tuple[UnwantedContact, ...]:
        """What has been seen so far, in order of first sight."""
        return tuple(self._found.values())

    @property
    def allowed(self) -> frozenset[frozenset[str]]:
        return frozenset(self._allowed)

    def allow(self, a: str, b: str | Iterable[str]) -> None:
        """Let two bodies (links or objects) touch."""
        self._change(a, b, True)

    def forbid(self, a: str, b: str | Iterable[str]) -> None:
        """Take back `allow`."""
        self._change(a, b, False)

    def watch(self, item: str, supports: Iterable[str] = ()) -> None:
        """From now on a contact of an object with other objects is unwanted, but for its supports.

        Supports are allowed until `unwatch` or `forbid`.
        """
        self._check(item)
        self._watched.add(item)
        self.allow(item, supports)

    def unwatch(self, item: str) -> None:
        self._check(item)
        self._watched.discard(item)
        self._rule()

    def clear(self) -> None:
        """Forget what has been seen; the rule stays."""
        self._found = {}

    def update(self, data: mujoco.MjData) -> None:
        """Look at the contacts of the step just taken."""
        count = data.ncon
        if count == 0:
            return
        geoms = data.contact.geom
        if count <= _FEW:
            table = self._unwanted_rows
            for a, b in geoms.tolist():
                if table[a][b]:
                    break
            else:
                return
        hits = self._unwanted[geoms[:, 0], geoms[:, 1]]
        if hits.any():
            self._record(data, geoms[hits], data.contact.dist[hits])

    # --- inside ---
    def _check(self, *names: str) -> None:
        for name in names:
            if name not in self._built.owner_index:
                raise UnknownNameError("link or object", name, self._built.owners)

    def _change(self, a: str, b: str | Iterable[str], allow: bool) -> None:
        others = (b,) if isinstance(b, str) else tuple(b)
        self._check(a, *others)
        for other in others:
            (self._allowed.add if allow else self._allowed.discard)(frozenset((a, other)))
        self._rule()

    def _rule(self) -> None:
        """Make the table (ngeom, ngeom) of unwanted geom pairs, so that a step needs one look-up."""
        built = self._built
        n = len(built.owners)
        bad = np.zeros((n, n), dtype=bool)
        bad[: built.link_count] = bad[:, : built.link_count] = True
        for name in self._watched:
            i = built.owner_index[name]
            bad[i] = bad[:, i] = True
        for pair in self._allowed:
            names = tuple(pair)
            if all(name in built.owner_index for name in names):
                a, b = built.owner_index[names[0]], built.owner_index[names[-1]]
                bad[a, b] = bad[b, a] = False
        owner = built.geom_owner
        self._unwanted = bad[owner[:, None], owner[None, :]] & (owner[:, None] >= 0) & (owner[None, :] >= 0)
        self._unwanted_rows = self._unwanted.tolist()

    def _record(self, data: mujoco.MjData, geoms: NDArray[np.int32], distances: Array) -> None:
        deepest: dict[frozenset[str], tuple[str, str, float]] = {}
        for (ga, gb), distance in zip(geoms.tolist(), distances.tolist(), strict=True):
            a, b = (self._built.owners[self._built.geom_owner[g]] for g in (ga, gb))
            pair = frozenset((a, b))
            if pair not in deepest or -distance > deepest[pair][2]:
                deepest[pair] = (a, b, -distance)
        for pair, (a, b, depth) in deepest.items():
            old = self._found.get(pair)
            if old is None:
                self._found[pair] = UnwantedContact(a, b, float(data.time), depth, 1)
            else:
                self._found[pair] = replace(old, depth=max(old.depth, depth), count=old.count + 1)

    def _get_state(self) -> tuple:
        return set(self._allowed), set(self._watched), dict(self._found)

    def _set_state(self, state: tuple) -> None:
        allowed, watched, found = state
        self._allowed, self._watched, self._found = set(allowed), set(watched), dict(found)
        self._rule()
