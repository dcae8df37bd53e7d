"""Contacts by body name, a monitor that checks them in every step, and the contact wrench on a gripper."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from armcell.core import UnknownNameError
from armcell.sim.mujoco_model import BuiltModel
from armcell.sim.step_kernel import add_about, hand_contacts

F64 = NDArray[np.float64]

_FEW, _KEPT = 30, 10_000
"""Limits of the monitor's cache: up to `_KEPT` contact lists of at most `_FEW` contacts.

Such lists recur often.
"""
_NO_END = 1 << 20


@dataclass(frozen=True)
class PhysicsContact:
    """One contact point of the last physics step, with the names of the links or objects that touch."""

    body_a: str
    body_b: str
    position: tuple[float, float, float]  # world frame [m]
    depth: float  # [m] penetration depth
    force: float  # [N] normal force


@dataclass(frozen=True)
class UnwantedContact:
    """A pair of bodies that touched in the physics simulation although the contact monitor forbids this."""

    body_a: str
    body_b: str
    time: float  # [s] simulation time of the first contact
    depth: float  # [m] largest penetration depth so far
    count: int  # physics steps in which the pair touched


def read_contacts(built: BuiltModel, data: mujoco.MjData) -> list[PhysicsContact]:
    """Return all contacts of the last physics step, deepest first."""
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


class ContactMonitor:
    """Monitor that checks every physics step for unwanted contacts and records them.

    A contact is unwanted if a robot link touches a body that it must not touch, or if a watched (held) object
    touches an object other than its supports. MuJoCo detects contacts at the beginning of a step, so the
    monitor has not yet checked the state after the last step.

    Attributes:
        unwanted_geoms: (ngeom, ngeom) True where two geoms must not touch.
        pairs: (n, 2) geoms of each contact, a live view of MuJoCo's memory.
        readable: number of rows of `pairs` that may be read.
    """

    def __init__(self, built: BuiltModel):
        self._built = built
        self._allowed: set[frozenset[str]] = set()
        self._watched: set[str] = set()
        self._found: dict[frozenset[str], UnwantedContact] = {}
        self._data: mujoco.MjData | None = None  # owner of the contact list that `pairs` shows
        self.pairs, self.readable = np.zeros((2, 4), np.int32)[:, :2], 0
        self.pairs.flags.writeable = False
        scene = built.scene
        for pair, allow in scene.allowed.items():
            if allow:
                self._allowed.add(pair)
        for name, body in scene.attached.items():
            self._allowed |= {frozenset((name, link)) for link in body.touch_links}
        for gripper in scene.model.grippers.values():  # the fingers of an empty gripper touch each other
            self._allowed.add(frozenset(gripper.contact_links))
        self._rule()

    @property
    def unwanted(self) -> tuple[UnwantedContact, ...]:
        """Return the unwanted contacts that the monitor has recorded, in the order in which they first
        occurred.
        """
        return tuple(self._found.values())

    @property
    def allowed(self) -> frozenset[frozenset[str]]:
        return frozenset(self._allowed)

    def allow(self, a: str, b: str | Iterable[str]) -> None:
        """Allow contact between a body and other bodies (links or objects) in the contact monitor."""
        self._change(a, b, True)

    def forbid(self, a: str, b: str | Iterable[str]) -> None:
        """Forbid contact between a body and other bodies in the contact monitor. This reverses `allow`."""
        self._change(a, b, False)

    def watch(self, item: str, supports: Iterable[str] = ()) -> None:
        """Treat all contacts of an object as unwanted in the contact monitor,
        except contacts with its supports.

        Contact with the supports stays allowed until `forbid` revokes it.
        """
        self._check(item)
        self._watched.add(item)
        self.allow(item, supports)

    def unwatch(self, item: str) -> None:
        self._check(item)
        self._watched.discard(item)
        self._rule()

    def clear(self) -> None:
        """Clear the contacts that the monitor has recorded. Its rules about allowed contacts stay."""
        self._found = {}

    def update(self, data: mujoco.MjData) -> None:
        """Check the contacts of the last physics step with the monitor and record those that are unwanted."""
        count = data.ncon
        if count == 0:
            return
        if data is not self._data:
            self._attach(data)
        seen = self.pairs[:count].tobytes()
        if seen in self._fine:
            return
        geoms = data.contact.geom
        hits = self.unwanted_geoms[geoms[:, 0], geoms[:, 1]]
        if hits.any():
            self._record(data, geoms[hits], data.contact.dist[hits])
        elif count <= _FEW:
            if len(self._fine) >= _KEPT:
                self._fine.clear()
            self._fine.add(seen)

    def _attach(self, data: mujoco.MjData) -> None:
        """Connect the contact monitor to mjData: `pairs` becomes a view of the geom pairs in MuJoCo's contact
        list, so it always shows the current contacts.

        The list starts at the arena's base, whatever its length.
        """
        self._data, geoms = data, data.contact.geom
        self.pairs = as_strided(geoms, (_NO_END, 2), geoms.strides, writeable=False)
        self.readable = _NO_END

    # --- private ---
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
        """Rebuild the contact monitor's table (ngeom, ngeom) of the geom pairs whose contact is unwanted.

        With the table, a contact check needs one lookup.
        """
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
        self.unwanted_geoms = (
            bad[owner[:, None], owner[None, :]] & (owner[:, None] >= 0) & (owner[None, :] >= 0)
        )
        self._fine: set[bytes] = set()  # contact lists, as bytes, that contain no unwanted contact

    def _record(self, data: mujoco.MjData, geoms: NDArray[np.int32], distances: F64) -> None:
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

    def get_state(self) -> tuple:
        return set(self._allowed), set(self._watched), dict(self._found)

    def set_state(self, state: tuple) -> None:
        allowed, watched, found = state
        self._allowed, self._watched, self._found = set(allowed), set(watched), dict(found)
        self._rule()


def hand_wrench(built: BuiltModel, data: mujoco.MjData, gripper: str) -> F64:
    """Return the wrench (6,) of all contacts on a gripper, as a six-axis sensor measures it: force [N], then
    torque [Nm] about the tcp.

    The wrench has world axes and belongs to the last step. It excludes the hand's own weight, like a sensor
    that compensates the tool's weight.
    """
    count, index, total = data.ncon, built.grippers[gripper], np.zeros(6)
    if count == 0:
        return total
    contact = data.contact
    which, signs, wrenches = np.empty(count, np.int64), np.empty(count), np.empty((count, 6))
    found = hand_contacts(
        built.mj._address, data._address, contact.geom, built.geom_owner, index.hand, which, signs, wrenches
    )
    which = which[:found]
    axes = contact.frame[which].reshape(-1, 3, 3)  # axes as rows; the first points from geom 1 to geom 2
    felt = signs[:found, None, None] * (wrenches[:found].reshape(-1, 2, 3) @ axes)
    add_about(which, contact.pos, data.xpos[index.tcp_body], felt, total)
    return total
