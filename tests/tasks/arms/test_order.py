"""Which arm brings what when: judged by the arms at work, and by all orders of another reckoning."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from tests.planning.multi_arm.dual import LEFT, RIGHT, Judge
from tests.sizes import seeds, sizes

import armcell
from armcell.core import InputError, JointState, UnknownNameError
from armcell.planning import RunningMotion
from armcell.tasks import TaskSettings, checked
from armcell.tasks.arms import CycleTimes, orders
from armcell.tasks.arms.object_order import ConflictCache, TourEstimator, TourSegment, best_order

TRAYS = ("red_tray", "blue_tray")


def tray_of(cube):
    return "red_tray" if "_red_" in cube else "blue_tray"


def streams_of(scene, seed):
    cubes = [n for n, o in scene.objects.items() if o.movable]
    cubes = np.random.default_rng(seed).permutation(cubes).tolist()
    return {arm: [c for c in cubes if c.startswith(arm.removesuffix("_arm"))] for arm in (LEFT, RIGHT)}


@pytest.fixture(scope="module")
def cell():
    return armcell.load("dual_ur10_sort")


def by_the_tick(streams, fetch, bring, step=0.05):
    """When both arms have ended [s]: tick by tick, a tray for one at a time, who comes first first."""
    todo = {arm: list(stream) for arm, stream in streams.items()}
    phase = {arm: ("fetch", fetch) for arm, s in todo.items() if s}
    queue = {tray: [] for tray in TRAYS}
    now = 0.0
    while phase:
        now += step
        for arm in list(phase):
            what, left = phase[arm]
            item = todo[arm][0]
            line = queue[tray_of(item)]
            if what == "wait" and line[0] == arm:
                what, left = "bring", bring
            left -= step
            if what == "fetch" and left <= 1e-9:
                line.append(arm)
                what, left = "wait", np.inf
                if line[0] == arm:
                    what, left = "bring", bring
            elif what == "bring" and left <= 1e-9:
                line.remove(arm)
                todo[arm].pop(0)
                if not todo[arm]:
                    del phase[arm]
                    continue
                what, left = "fetch", fetch
            phase[arm] = what, left
    return now


def by_trays_alone(streams):
    """The orders where every way takes two seconds and every piece of work three, and arms never meet."""

    def segments(order):
        return tuple(
            segment
            for item in order
            for segment in (TourSegment(2.0, 3.0), TourSegment(2.0, 3.0, tray_of(item)))
        )

    best = best_order((streams[LEFT], streams[RIGHT]), (segments, segments))
    return dict(zip((LEFT, RIGHT), best, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 6])
def test_of_all_orders_none_is_done_earlier(cell, seed):
    streams = streams_of(cell.scene(seed), seed)

    found = by_trays_alone(streams)
    assert {arm: sorted(order) for arm, order in found.items()} == {a: sorted(s) for a, s in streams.items()}
    best = min(
        by_the_tick({LEFT: a, RIGHT: b}, 5.0, 5.0)
        for a in permutations(streams[LEFT])
        for b in [streams[RIGHT], *list(permutations(streams[RIGHT]))[::5]]
    )
    assert by_the_tick(found, 5.0, 5.0) <= best + 0.2
    assert by_the_tick(streams, 5.0, 5.0) >= best  # and the order given is not always as good:
    same_first = {LEFT: sorted(streams[LEFT]), RIGHT: sorted(streams[RIGHT])}
    assert by_the_tick(same_first, 5.0, 5.0) > best + 2.0


def test_far_ways_are_saved(cell):
    """One arm alone: it does not go from end to end and back."""
    scene = cell.scene(0)
    names = ["left_red_1", "left_red_2", "left_blue_1", "left_blue_2"]  # at x = -0.55, 0.2, -0.2, 0.55
    found = orders(scene, {LEFT: names, RIGHT: []}, tray_of)[LEFT]
    x = {n: scene.frame_pose(n).translation[0] for n in (*names, *TRAYS)}

    def way(order):
        at, total = 0.0, 0.0
        for item in order:
            total += abs(x[item] - at) + abs(x[tray_of(item)] - x[item])
            at = x[tray_of(item)]
        return total

    every = sorted(way(order) for order in permutations(names))
    assert way(found) <= every[3] < every[-1]


def test_long_streams_are_ordered_too():
    names = [f"{color}_{k}" for color in ("blue", "red") for k in range(5)]  # both: all blue ones first
    streams = {arm: [f"{arm}_{name}" for name in names] for arm in (LEFT, RIGHT)}
    found = by_trays_alone(streams)
    assert {a: sorted(o) for a, o in found.items()} == streams
    assert by_the_tick(found, 5.0, 5.0) <= 10 * 10.0 + 0.6  # nobody waits
    assert by_the_tick(streams, 5.0, 5.0) > 10 * 10.0 + 3.0


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(1, [1, 12]))
def test_an_arm_takes_as_long_as_estimated(cell, seed):
    """Orders of an arm that works alone, against its motions; it is not told where on a tray a thing goes."""
    took, thought = [], []
    for group in (LEFT, RIGHT):
        scene = cell.scene(seed)
        stream = streams_of(scene, seed)[group]
        rounds = TourEstimator(scene, group, {i: tray_of(i) for i in stream}, cell.settings, CycleTimes())
        for order in list(permutations(stream))[::4]:
            with cell.connect("fake", seed=seed) as live:
                free = {tray: [-0.11, 0.0, 0.11] for tray in TRAYS}
                arm = live[group]
                for item in order:
                    checked(arm.pick(item))
                    at = (free[tray_of(item)].pop(1), 0.08 if group == LEFT else -0.08)
                    checked(arm.place(item, on=tray_of(item), at=at))
                checked(arm.move_to("home"))
                took.append(live.driver.now)
            thought.append(sum(segment.motion + segment.work for segment in rounds(order)))
    took, thought = np.array(took), np.array(thought)
    off = np.abs(thought / took - 1)
    assert off.mean() < 0.02 and off.max() < 0.06
    assert np.corrcoef(took, thought)[0, 1] > 0.7


@pytest.mark.long
def test_where_arms_meet(cell):
    """Against coal's distances between the two arms, along ways over the trays."""
    scene, rng = cell.scene(1), np.random.default_rng(0)
    conflicts, judge = ConflictCache(scene, (LEFT, RIGHT)), Judge(scene)
    names = {g: scene.model.group(g).joint_names for g in (LEFT, RIGHT)}
    segments: dict[str, list[TourSegment]] = {}
    for group, stream in streams_of(scene, 1).items():
        rounds = TourEstimator(scene, group, {i: tray_of(i) for i in stream}, TaskSettings(), CycleTimes())
        segments[group] = [
            segment for _ in range(6) for segment in rounds(tuple(rng.permutation(stream).tolist()))
        ]

    def stands(group, q):
        return RunningMotion.at_rest(scene.with_state(JointState(names[group], q)), group)

    met = 0
    for k in range(40):
        segment, other = segments[RIGHT][int(rng.integers(54))], segments[LEFT][int(rng.integers(54))]
        share = conflicts.conflict_section(1, segment, 0, other)
        begin, end = segment.motion_ends
        there = stands(LEFT, other.motion_ends[1])
        along = np.linspace(0.0, 1.0, 61)
        near = [judge.nearest(stands(RIGHT, begin + s * (end - begin)), there) for s in along]
        close = along[np.array(near) < 0.02]
        if share is None:
            assert min(near) > 0.019, k
            continue
        met += 1
        assert len(close) and share[0] <= close[0] + 1e-6 and share[1] >= close[-1] - 1e-6
        assert close[0] - share[0] < 0.15 and share[1] - close[-1] < 0.15
    assert 3 <= met <= 37


def test_what_cannot_be_ordered(cell):
    scene = cell.scene(0)
    with pytest.raises(InputError, match="given twice"):
        orders(scene, {LEFT: ["left_red_1"], RIGHT: ["left_red_1"]}, tray_of)
    with pytest.raises(InputError, match="two arms need one each"):
        orders(scene, {LEFT: ["left_red_1"]}, tray_of)
    with pytest.raises(UnknownNameError):
        orders(scene, {LEFT: ["left_red_9"], RIGHT: []}, tray_of)
    with pytest.raises(InputError, match="put is -1"):
        CycleTimes(put=-1.0)
    assert orders(scene, {LEFT: [], RIGHT: []}, tray_of) == {LEFT: [], RIGHT: []}


@pytest.mark.long
@pytest.mark.parametrize("batches", sizes(1, 3))
def test_the_arms_are_done_earlier(cell, batches):
    """The same batches at work, in the order as the cubes come and in the one chosen."""
    ends = {"given": 0.0, "chosen": 0.0}
    waited = dict(ends)
    for seed in range(batches):
        for how in ends:
            with cell.connect("fake", seed=seed) as live:
                streams = streams_of(live.scene(), seed)
                if how == "chosen":
                    streams = live.orders(tray_of, **streams)
                free = {(arm, tray): [-0.11, 0.0] for arm in streams for tray in TRAYS}

                def sort(arm, streams=streams, free=free):
                    row = 0.08 if arm.group == LEFT else -0.08
                    for cube in streams[arm.group]:
                        tray = tray_of(cube)
                        checked(arm.pick(cube))
                        with arm.reserve(tray):
                            checked(arm.place(cube, on=tray, at=(free[arm.group, tray].pop(), row)))

                result = checked(live.side_by_side(left_arm=sort, right_arm=sort))
            ends[how] += result.makespan
            waited[how] += sum(result.waited.values())
    assert ends["chosen"] < 0.95 * ends["given"]
    assert waited["chosen"] < 0.5 * waited["given"]
