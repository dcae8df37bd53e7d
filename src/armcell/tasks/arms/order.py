"""In which order two arms bring their things, so that both are done early and neither waits for the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain, combinations, permutations, product
from operator import itemgetter

from armcell.collision.arms import check_two
from armcell.core import InputError
from armcell.scene import PlanningScene
from armcell.tasks.arms.errands import Errands, Leg, Pace
from armcell.tasks.arms.meetings import Meetings
from armcell.tasks.settings import TaskSettings

Order = tuple[str, ...]
Round = tuple[Leg, ...]
Span = tuple[float, float, float]  # when a leg begins, its motion ends, its work ends [s]

ALL = 4  # things of one arm whose orders are all looked at; of more those near the one given
ROUND = 1.2  # [s] that an arm loses by going round the other: mean of ten in batches of dual_ur10_sort
SLACK = 0.5  # [s] by which an estimated time may be off


def orders(
    scene: PlanningScene,
    streams: Mapping[str, Sequence[str]],
    to: Callable[[str], str],
    settings: TaskSettings = TaskSettings(),
    pace: Pace = Pace(),
) -> dict[str, list[str]]:
    """Orders in which two arms that take turns at each zone are done and back earliest, by an estimate.

    Up to four things an arm all orders are compared, of more those that exchanges of two, or all the other
    way round, lead to. The order given stays where none is better.

    Args:
        streams: what each arm has to bring, by planning group.
        to: the object that a thing goes to: a zone that one arm at a time may reserve.
        settings: speeds and distances of the picks and places to come.
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
    first, second = (
        Errands(scene, group, {item: to(item) for item in stream}, settings, pace)
        for group, stream in streams.items()
    )
    best = earliest((streams[one], streams[two]), (first, second), Meetings(scene, (one, two)))
    return {one: list(best[0]), two: list(best[1])}


def earliest(
    streams: tuple[Sequence[str], Sequence[str]],
    rounds: tuple[Callable[[Order], Round], Callable[[Order], Round]],
    meetings: Meetings | None = None,
) -> tuple[Order, Order]:
    """Of the orders of two streams those that are done first.

    Args:
        rounds: what an arm does in an order.
        meetings: where an arm's motion would meet the other at work; nowhere, where None.
    """
    one, two = cache(rounds[0]), cache(rounds[1])

    def late(pair: tuple[Order, Order], meetings: Meetings | None = None) -> tuple[float, float]:
        legs = one(pair[0]), two(pair[1])
        tables = timetable(legs)
        lost = (0.0, 0.0) if meetings is None else detours(legs, tables, meetings)
        ends = [(spans[-1][2] if spans else 0.0) + more for spans, more in zip(tables, lost, strict=True)]
        return round(max(ends), 6), round(sum(ends), 6)

    best = tuple(streams[0]), tuple(streams[1])
    least = late(best, meetings)
    while True:
        found = best
        for undisturbed, pair in sorted(((late(pair), pair) for pair in _near(*best)), key=itemgetter(0)):
            if undisturbed >= least:
                break  # detours make none of the others earlier
            if (ends := late(pair, meetings)) < least:
                found, least = pair, ends
        if found == best:
            return best
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


def timetable(arms: Sequence[Round]) -> list[list[Span]]:
    """When each arm does each leg [s]; a zone is one arm's at a time, in the order they asked."""
    now, free = [0.0] * len(arms), dict[str, float]()
    spans: list[list[Span]] = [[] for _ in arms]
    while True:
        asks = [(now[k], k) for k, legs in enumerate(arms) if len(spans[k]) < len(legs)]
        if not asks:
            return spans
        time, k = min(asks)
        leg = arms[k][len(spans[k])]
        begin = max(time, free.get(leg.zone, 0.0)) if leg.zone else time
        there = begin + leg.motion
        now[k] = there + leg.work
        if leg.zone:
            free[leg.zone] = now[k]
        spans[k].append((begin, there, now[k]))


def detours(arms: tuple[Round, Round], tables: Sequence[Sequence[Span]], meetings: Meetings) -> list[float]:
    """What each arm loses [s], in all, by going round the other where that is at work on its way."""
    lost = [0.0, 0.0]
    for k in (0, 1):
        for leg, (begin, there, _) in zip(arms[k], tables[k], strict=True):
            for other, (_, since, until) in zip(arms[1 - k], tables[1 - k], strict=True):
                if other.work == 0.0 or since > there + SLACK or until < begin - SLACK:
                    continue
                if leg.zone and leg.zone == other.zone:
                    continue  # they take turns
                share = meetings.share(k, leg, other)
                if share is None:
                    continue
                first, last = (begin + s * leg.motion for s in share)
                if first < until + SLACK and last > since - SLACK:
                    lost[k] += ROUND
    return lost
