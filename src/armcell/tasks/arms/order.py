"""In which order two arms bring their things, so that both are done early and neither waits for a zone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, permutations, product

import numpy as np

from armcell.collision.arms import check_two
from armcell.core import SE3, InputError
from armcell.core.checks import require
from armcell.scene import PlanningScene

Order = tuple[str, ...]
Way = tuple[str, str]  # from a place to another, by their names

START = ""  # the name of where an arm begins
ALL = 4  # things of one arm whose orders are all looked at; of more those near the one given


@dataclass(frozen=True)
class Pace:
    """How long an arm is taken to need: a motion between two places turns it about its base.

    By default as 64 picks and 64 placings of two UR10 took, at the speeds that a task has by default.
    """

    way: float = 1.4  # [s] of each, to speed up and to slow down
    turn: float = 0.9  # [s/rad] more
    fetch: float = 3.5  # [s] to approach, close and lift
    put: float = 3.0  # [s] to lower, open and draw back

    def __post_init__(self) -> None:
        for name in ("way", "turn", "fetch", "put"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")


def orders(
    scene: PlanningScene,
    streams: Mapping[str, Sequence[str]],
    to: Callable[[str], str],
    pace: Pace = Pace(),
) -> dict[str, list[str]]:
    """Orders in which two arms that take turns at each zone are done earliest, by an estimate.

    Up to four things an arm all orders are compared, of more those that exchanges of two, or all the other
    way round, lead to. The order given stays where none is better.

    Args:
        streams: what each arm has to bring, by planning group.
        to: the object that a thing goes to: a zone that one arm at a time may reserve.
    Raises:
        InputError: not two arms that share no joint, or a thing twice.
        UnknownNameError: no such group or object.
    """
    if len(streams) != 2:
        raise InputError(f"{len(streams)} streams given, two arms have two")
    one, two = streams
    check_two(scene.model, (one, two))
    named = [item for stream in streams.values() for item in stream]
    twice = sorted({item for item in named if named.count(item) > 1})
    if twice:
        raise InputError(f"{', '.join(twice)} given twice", cure="name each thing once, for one arm")
    zone = {item: to(item) for item in named}
    places = [_places(scene, group, streams[group], zone) for group in streams]
    ways = [_ways(scene, group, at, pace) for group, at in zip(streams, places, strict=True)]

    def late(pair: tuple[Order, Order]) -> tuple[float, float]:
        ends = _ends([_errands(order, way, zone, pace) for order, way in zip(pair, ways, strict=True)])
        return round(max(ends), 6), round(sum(ends), 6)

    best = tuple(streams[one]), tuple(streams[two])
    while True:
        found = min(_near(*best), key=late)
        if late(found) >= late(best):
            return {one: list(best[0]), two: list(best[1])}
        best = found


def _near(one: Order, two: Order) -> Iterable[tuple[Order, Order]]:
    """Orders of both arms: these, and all others or those that one change makes of them."""
    if max(len(one), len(two)) <= ALL:
        return product(permutations(one), permutations(two))
    return chain(((o, two) for o in _changed(one)), ((one, o) for o in _changed(two)))


def _changed(order: Order) -> Iterator[Order]:
    yield order
    yield order[::-1]
    for i, k in combinations(range(len(order)), 2):
        yield (*order[:i], order[k], *order[i + 1 : k], order[i], *order[k + 1 :])


def _places(
    scene: PlanningScene, group: str, items: Sequence[str], zone: Mapping[str, str]
) -> dict[str, SE3]:
    """Where an arm's hand has to go."""
    places = {name: scene.frame_pose(name) for name in (*items, *(zone[item] for item in items))}
    return places | {START: scene.frame_pose(scene.model.gripper(arm_group=group).tcp_link)}


def _ways(scene: PlanningScene, group: str, places: Mapping[str, SE3], pace: Pace) -> dict[Way, float]:
    """How long an arm takes from a place to another [s], by their names."""
    T_base = scene.frame_pose(scene.model.group(group).base_link or scene.model.root_link)
    seen = {name: (T_base.inv() @ T).translation for name, T in places.items()}
    angle = {name: float(np.arctan2(p[1], p[0])) for name, p in seen.items()}
    return {
        (a, b): pace.way + pace.turn * abs((angle[a] - angle[b] + np.pi) % (2 * np.pi) - np.pi)
        for a, b in product(places, places)
    }


@dataclass(frozen=True)
class _Errand:
    """A thing's way, after the one before."""

    zone: str
    fetch: float  # [s] until the zone is asked for
    bring: float  # [s] from then, if it is free, until it is left


def _errands(order: Order, ways: Mapping[Way, float], zone: Mapping[str, str], pace: Pace) -> list[_Errand]:
    at, found = START, []
    for item in order:
        to = zone[item]
        found.append(_Errand(to, ways[at, item] + pace.fetch, ways[item, to] + pace.put))
        at = to
    return found


def _ends(arms: Sequence[Sequence[_Errand]]) -> list[float]:
    """When each arm has done its errands [s]; a zone is one arm's, in the order they asked."""
    now, done, free = [0.0] * len(arms), [0] * len(arms), dict[str, float]()
    while True:
        asks = [(now[k] + arm[done[k]].fetch, k) for k, arm in enumerate(arms) if done[k] < len(arm)]
        if not asks:
            return now
        time, k = min(asks)
        errand = arms[k][done[k]]
        now[k] = free[errand.zone] = max(time, free.get(errand.zone, 0.0)) + errand.bring
        done[k] += 1
