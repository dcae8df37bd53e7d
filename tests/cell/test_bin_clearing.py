"""Clearing a bin from pictures only, in physics."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.sizes import seeds
from tests.tasks.helpers import AtStage, notes

import armcell
from armcell.cell import Cell, run_task
from armcell.cell.validation import validated
from armcell.core import ErrorCode, InputError
from armcell.scene import library_object
from armcell.tasks.bin_clearing import BinClearingSettings, clear_bin
from armcell.tasks.bin_clearing.work_regions import (
    floor_of,
    lowest_points,
    table_around,
    view_region,
)

CALL = {"into": "tray", "table": "work_table", "camera": "above_bin", "tray_camera": "above_tray"}


TWO_ARMS = {
    "into": {"left_arm": "left_tray", "right_arm": "right_tray"}, "table": "work_table",
    "camera": "above_bin",
    "tray_camera": {"left_arm": "above_left_tray", "right_arm": "above_right_tray"},
}  # fmt: skip


@cache
def whole(name: str = "bin_clearing") -> Cell:
    return armcell.load(name)


def with_things(cell: Cell | None = None, **poses) -> Cell:
    """The cell with a few things only, where they are told to be."""
    whole_cell = cell or whole()
    data = whole_cell.spec.model_dump(exclude_unset=True)
    drop = data["drop"]["objects"]
    for name in drop:
        if name in poses:
            data["objects"][name]["pose"] = poses[name]
        else:
            del data["objects"][name]
    data["perception"]["objects"] = list(poses)
    del data["drop"]
    return Cell("small", whole_cell.file, validated(data, whole_cell.file))


def with_some(count: int, name: str = "bin_clearing") -> Cell:
    """The cell with some of its things, of as many kinds as can be."""
    data = whole(name).spec.model_dump(exclude_unset=True)
    every = list(data["drop"]["objects"])
    left_out = set(every) - set(every[:: len(every) // count])
    data["objects"] = {name: item for name, item in data["objects"].items() if name not in left_out}
    for names in (data["drop"]["objects"], data["perception"]["objects"]):
        names[:] = [name for name in names if name not in left_out]
    return Cell("some", whole(name).file, validated(data, whole(name).file))


def two_things() -> Cell:
    return with_things(box_1=(0.62, -0.30, 0.2195), can_1=(0.78, -0.36, 0.2195))


def names(cell) -> list[str]:
    return [report.name for report in cell.reports]


def test_the_planner_knows_nothing_of_the_things():
    with two_things().connect("sim", seed=0) as live:
        assert not {"box_1", "can_1"} & set(live.scene().objects)
        assert not {"box_1", "can_1"} & set(live.driver.object_poses())


@pytest.mark.slow
def test_things_whose_poses_are_known_are_refused():
    data = whole().spec.model_dump(exclude_unset=True)
    data["perception"]["objects"] = ["box_1"]
    del data["drop"]
    cell = Cell("known", whole().file, validated(data, whole().file))
    with cell.connect("sim", seed=0) as live, pytest.raises(InputError, match="known without a camera"):
        live.clear("bin", **CALL)


@pytest.mark.long
def test_two_things_are_moved_to_the_tray():
    with two_things().connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert (outcome.evidence["cleared"], outcome.evidence["left"]) == (2, 0)
        assert live.driver.unwanted_contacts() == [] and live.driver.welds() == []


@pytest.mark.long
def test_what_is_dropped_on_the_way_is_found_again():
    with two_things().connect("sim", seed=0) as live:
        fingers = live.model.gripper()

        def let_go() -> None:
            live.driver.world.set_gripper_target(fingers.name, fingers.max_width)

        live.ctx.observers.append(AtStage("move to tray", let_go))
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert outcome.evidence["dropped"] == 1
        assert outcome.evidence["cleared"] == 2
        assert live.driver.unwanted_contacts() == []


@pytest.mark.long
def test_what_is_taken_away_before_the_hand_closes_is_a_miss_and_no_more():
    with two_things().connect("sim", seed=0) as live:
        world = live.driver.world

        def take_away() -> None:
            for name in ("box_1", "can_1"):
                pose = world.object_pose(name)
                world.set_object_pose(name, pose.shifted(y=-0.09 if name == "box_1" else 0.09))

        live.ctx.observers.append(AtStage("approach", take_away))
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert outcome.evidence["missed"] >= 1 and outcome.evidence["cleared"] == 2
        assert any("nothing" in text for text in notes(live, "note"))


@pytest.mark.long
def test_a_frozen_camera_ends_it_with_its_reason():
    with two_things().connect("sim", seed=0) as live:
        live.cameras["above_bin"].image(rgb=False)
        live.ctx.observers.append(
            AtStage("move to tray", lambda: setattr(live.cameras["above_bin"], "frozen", True))
        )
        outcome = live.clear("bin", **CALL)
        assert outcome.code is ErrorCode.SENSOR_INFO_STALE
        assert "frozen" in outcome.message and "above_bin" in outcome.message
        assert names(live).count("close") == 1
        assert outcome.evidence["cleared"] == 1


@pytest.mark.long
def test_what_no_hand_fits_around_is_left_with_a_reason():
    plate = library_object("box", sizes={"length": 0.16, "width": 0.15, "height": 0.03})
    cell = with_things(box_1=(0.70, -0.32, 0.2195))
    data = cell.spec.model_dump(exclude_unset=True)
    low, high = plate.bounds()
    data["objects"]["box_1"] = {
        "box": tuple((high - low).tolist()),
        "pose": (0.7, -0.32, 0.235),
        "movable": True,
    }
    with Cell("plate", cell.file, validated(data, cell.file)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.code is ErrorCode.FAILURE
        assert "given up" in outcome.message and "1 in bin" in outcome.message
        e = outcome.evidence
        assert e["left"] == 1 and e["put"] == e["dropped"] == e["picks"] == 0
        assert not live.driver.unwanted_contacts()


@pytest.mark.long
def test_a_force_on_the_hand_does_not_stop_its_approach_to_a_heap():
    cell = two_things()
    with cell.connect("sim", seed=0, settings=replace(cell.settings, contact_force=0.01)) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.ok and outcome.evidence["missed"] == 0, outcome.message


@pytest.mark.long
def test_a_flat_thing_is_picked_though_the_depth_of_the_floor_is_noisy():
    data = with_things(box_1=(0.70, -0.32, 0.2195)).spec.model_dump(exclude_unset=True)
    data["objects"]["box_1"] = {"box": (0.12, 0.02, 0.012), "pose": (0.7, -0.32, 0.2265), "movable": True}
    with Cell("flat", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert outcome.evidence["cleared"] == 1 and not live.driver.unwanted_contacts()


def with_bar(pose, size=(0.16, 0.044, 0.044)) -> Cell:
    """The cell with one bar that is longer than the gripper opens."""
    data = with_things(box_1=(0.70, -0.32, 0.2195)).spec.model_dump(exclude_unset=True)
    data["objects"]["box_1"] = {"box": size, "pose": pose, "movable": True, "friction": 0.5}
    return Cell("bar", whole().file, validated(data, whole().file))


@pytest.mark.long
@pytest.mark.parametrize(
    ("pose", "size"),
    [
        ((0.66, -0.528, 0.2425), (0.16, 0.044, 0.044)),
        ((0.519, -0.30, 0.249), (0.06, 0.137, 0.06)),  # as tall as the fingers are long
    ],
)
def test_a_bar_beside_a_wall_is_pushed_off_it_and_picked(pose, size):
    with with_bar(pose, size).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert outcome.evidence["pushes"] >= 1 and outcome.evidence["cleared"] == 1
        assert not live.driver.unwanted_contacts()


@pytest.mark.slow
def test_without_pushes_a_bar_beside_a_wall_stays():
    with with_bar((0.66, -0.528, 0.2425)).connect("sim", seed=0) as live:
        settings = BinClearingSettings(most_pushes=0, most_misses=1, tilts=())
        outcome = live.clear("bin", **CALL, settings=settings)
        assert outcome.code is ErrorCode.FAILURE and "1 in bin" in outcome.message
        assert outcome.evidence["pushes"] == outcome.evidence["picks"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("tilts", [(), BinClearingSettings().tilts], ids=["vertical", "slanted"])
def test_a_block_between_tall_walls_is_picked_along_a_slanted_approach(tilts):
    """Beside walls of 120 mm there is no room for the palm above the fingers."""
    data = with_bar((0.531, -0.106, 0.2465), (0.04, 0.04, 0.05)).spec.model_dump(exclude_unset=True)
    data["objects"]["bin"]["sizes"]["height"] = 0.12
    with Cell("deep", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        settings = BinClearingSettings(tilts=tilts, most_pushes=0, most_misses=1)
        outcome = live.clear("bin", **CALL, settings=settings)
        assert outcome.ok == bool(tilts), outcome.message
        assert outcome.evidence["cleared"] == len(tilts[:1])
        assert not live.driver.unwanted_contacts()


@pytest.mark.slow
def test_a_block_beside_the_tray_is_picked_though_it_might_reach_into_the_tray():
    """The arm does not know how the held object lies in the hand, and assumes a large box."""
    with with_bar((0.70, 0.042, 0.2255), (0.06, 0.07, 0.03)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL, settings=BinClearingSettings(most_misses=1))
        assert outcome.ok, outcome.message
        assert outcome.evidence["cleared"] == 1 and outcome.evidence["unplanned"] == 0
        assert not live.driver.unwanted_contacts()


@pytest.mark.long
def test_after_a_miss_the_other_piece_is_picked_first():
    with two_things().connect("sim", seed=0) as live:
        world, nearest = live.driver.world, []

        def note_nearest() -> None:
            hand = live.scene().frame_pose(live.model.gripper().tcp_link).translation
            away = {
                n: np.linalg.norm(world.object_pose(n).translation[:2] - hand[:2]) for n in ("box_1", "can_1")
            }
            nearest.append(min(away, key=away.__getitem__))

        def take_away() -> None:
            note_nearest()
            world.set_object_pose(nearest[0], world.object_pose(nearest[0]).shifted(y=-0.07))

        live.ctx.observers += [AtStage("approach", take_away), AtStage("approach", note_nearest, 2)]
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert outcome.evidence["missed"] >= 1 and nearest[0] != nearest[1]


@pytest.mark.long
def test_pieces_beside_the_bin_are_picked_although_one_in_it_is_stuck():
    data = with_things(box_1=(0.70, -0.32, 0.2195), can_1=(0.62, 0.0, 0.2115)).spec
    data = data.model_dump(exclude_unset=True)
    data["objects"]["box_1"] = {"box": (0.16, 0.15, 0.03), "pose": (0.7, -0.32, 0.235), "movable": True}
    with Cell("both", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.code is ErrorCode.FAILURE and "1 in bin" in outcome.message
        assert [outcome.evidence[k] for k in ("cleared", "left", "beside")] == [1, 1, 0]


@pytest.mark.slow
@pytest.mark.parametrize("y", [-0.055, 0.0, 0.055])
def test_a_flat_piece_between_bin_and_tray_is_seen(y):
    """The arm at its home state hides the space beside the tray from the tray's camera."""
    data = with_things(box_1=(0.70, -0.32, 0.2195)).spec.model_dump(exclude_unset=True)
    data["objects"]["box_1"] = {"box": (0.048, 0.033, 0.013), "pose": (0.73, y, 0.217), "movable": True}
    with Cell("between", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        s = BinClearingSettings()
        region = table_around(live.scene(), "bin", "work_table", ("bin", "tray"), s)
        assert view_region(live.ctx, lambda: live.cameras["above_bin"].image(rgb=False), region, s).count == 1


@pytest.mark.slow
def test_a_view_without_a_place_lacks_the_pieces_there_but_keeps_their_heights():
    with two_things().connect("sim", seed=0) as live:
        s = BinClearingSettings()
        region = floor_of(live.scene(), "bin", s)
        seen = view_region(live.ctx, lambda: live.cameras["above_bin"].image(rgb=False), region, s)
    rest = seen.without([np.array([0.62, -0.30])], 0.10)
    assert (seen.count, rest.count) == (2, 1) and not seen.is_old and rest.is_old
    at = rest.map.at(np.argwhere(rest.labels == 0))[:, :2].mean(axis=0)
    np.testing.assert_allclose(at, (0.78, -0.36), atol=0.01)
    np.testing.assert_array_equal(rest.map.heights, seen.map.heights)
    assert seen.without([np.array([0.70, -0.32])], 0.20).count == 0


@pytest.mark.slow
@pytest.mark.parametrize("y, beside", [(0.47, 0), (0.62, 1)])
def test_an_object_that_leans_over_the_wall_of_the_tray_is_in_it_if_most_of_it_is(y, beside):
    """The bar lies on the wall at y = 0.56; its middle is over the tray or beside it."""
    tilt = (0.16, 0.0, 0.0) if beside == 0 else (0.0, 0.0, 0.0)
    data = with_bar((0.70, -0.32, 0.2425)).spec.model_dump(exclude_unset=True)
    bar = {"box": (0.03, 0.20, 0.02), "movable": False}
    data["objects"]["leaning"] = {**bar, "pose": {"xyz": (0.70, y, 0.262), "rpy": tilt}}
    with Cell("lean", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        s = BinClearingSettings()
        region = table_around(live.scene(), "tray", "work_table", ("bin", "tray"), s)
        seen = view_region(live.ctx, lambda: live.cameras["above_tray"].image(rgb=False), region, s)
        assert seen.count == beside


@pytest.mark.long
def test_sheet_metal_that_the_width_of_the_gripper_does_not_show_is_picked():
    pose = {"xyz": (0.70, -0.32, 0.234), "rpy": (0.0, 0.0, 0.3)}
    with with_bar(pose, (0.05, 0.001, 0.03)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert [outcome.evidence[k] for k in ("picks", "put", "missed", "cleared")] == [1, 1, 0, 1]


@pytest.mark.long
def test_a_ball_in_a_corner_is_dragged_out_of_it():
    data = with_bar((0.70, -0.32, 0.2425)).spec.model_dump(exclude_unset=True)
    ball = {"sphere": 0.02, "pose": (0.5085, -0.1085, 0.2385), "movable": True, "friction": 0.5}
    data["objects"]["box_1"] = ball
    with Cell("ball", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.ok, outcome.message
        assert outcome.evidence["pushes"] >= 1
        assert [outcome.evidence[k] for k in ("cleared", "missed")] == [1, 0]
        assert live.driver.unwanted_contacts() == []


@pytest.mark.slow
def test_an_object_that_leans_over_the_wall_of_the_bin_is_one_piece_on_both_sides_of_the_wall():
    data = with_bar((0.70, -0.32, 0.2425)).spec.model_dump(exclude_unset=True)
    bar = {"box": (0.03, 0.20, 0.02), "movable": False}
    data["objects"]["leaning"] = {**bar, "pose": {"xyz": (0.70, -0.47, 0.262), "rpy": (-0.16, 0.0, 0.0)}}
    data["objects"]["box_1"]["pose"] = (0.70, 0.32, 0.2425)
    with Cell("lean", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        s = BinClearingSettings()
        region = floor_of(live.scene(), "bin", s)
        seen = view_region(live.ctx, lambda: live.cameras["above_bin"].image(rgb=False), region, s)
        assert seen.count == 1
        beyond = seen.map.at(np.argwhere(seen.labels == 0))
        assert beyond[:, 1].min() < -0.562 and beyond[:, 1].max() > -0.40


@pytest.mark.slow
def test_a_large_object_is_released_farther_from_the_walls_of_the_tray():
    with two_things().connect("sim", seed=0) as live:
        s = BinClearingSettings()
        region = floor_of(live.scene(), "tray", s)
        seen = view_region(live.ctx, lambda: live.cameras["above_tray"].image(rgb=False), region, s)
        for extent, margin in ((0.0, s.spot_radius), (0.08, 0.08), (0.5, 0.1)):
            at = np.array(lowest_points(seen, s, extent))[:, :2]
            walls = np.array(region.rectangle)
            assert min((at - walls[0]).min(), (walls[1] - at).min()) > margin - 2 * s.resolution


@pytest.mark.slow
def test_a_full_tray_ends_it_and_what_was_held_is_laid_back():
    data = with_things(box_1=(0.70, -0.32, 0.2195)).spec.model_dump(exclude_unset=True)
    data["objects"]["full"] = {"box": (0.40, 0.44, 0.12), "pose": (0.70, 0.32, 0.2825)}
    with Cell("full", whole().file, validated(data, whole().file)).connect("sim", seed=0) as live:
        was = live.driver.world.object_pose("box_1")
        outcome = live.clear("bin", **CALL)
        assert outcome.code is ErrorCode.FAILURE
        assert "full" in outcome.message and "100 mm are allowed" in outcome.message
        e = outcome.evidence
        assert [e[k] for k in ("picks", "put", "cleared", "left")] == [1, 0, 0, 1]
        assert was.distance_to(live.driver.world.object_pose("box_1"))[0] < 0.03
        assert not live.driver.unwanted_contacts()


@pytest.mark.slow
def test_pictures_without_any_depth_end_it_before_anything_moves():
    with two_things().connect("sim", seed=0) as live:
        eye = live.cameras["above_bin"].image(rgb=False)
        blind = replace(eye, depth=np.full_like(eye.depth, np.nan))
        color = replace(eye, depth=None)
        for image, says in ((blind, "no pixel has a depth"), (color, "has no depth")):
            outcome = clear_bin(
                live.ctx, live.model.gripper(), "bin", "tray", "work_table", lambda i=image: i, lambda: eye
            )
            assert outcome.code is ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA and says in outcome.message
            assert outcome.evidence["picks"] == 0 and set(names(live)) == {"look in bin"}


@pytest.mark.slow
def test_what_lies_where_no_camera_looks_is_told():
    """As physics knows; the task itself sees an empty bin."""
    with with_things(bolt_2=(0.27, 1.40, 0.002)).connect("sim", seed=0) as live:
        outcome = live.clear("bin", **CALL)
        assert outcome.code is ErrorCode.FAILURE
        assert "1 of 1 things" in outcome.message and "bolt_2 at (0.27, 1.40" in outcome.message
        assert [outcome.evidence[k] for k in ("cleared", "left", "beside")] == [0, 0, 1]


def four_things() -> Cell:
    z = 1.0195
    return with_things(
        whole("dual_bin_clearing"),
        box_1=(-0.12, -0.1, z), can_1=(0.12, -0.1, z), can_2=(-0.12, 0.1, z), box_2=(0.12, 0.1, z),
    )  # fmt: skip


def intervals(live, arm: str, first: str, last: str) -> list[tuple[float, float]]:
    """Times [s] from the beginning of one stage of an arm to the end of a later one, for each pick."""
    stages = [r for r in live.reports if r.name.startswith(f"{arm}: ")]
    begin = [r.started_s for r in stages if r.name.endswith(first)]
    end = [r.started_s + r.motion_time_s for r in stages if r.name.endswith(last)]
    return list(zip(begin, end, strict=True))


def overlap(a, b) -> float:
    """Time [s] that intervals of one list have in common with those of another."""
    return sum(max(min(y, v) - max(x, u), 0.0) for x, y in a for u, v in b)


@pytest.mark.long
def test_two_arms_clear_one_bin_in_turns_and_one_picks_while_the_other_puts():
    ends = []
    for _ in range(2):
        with four_things().connect("sim", seed=0) as live:
            outcome = live.clear("bin", **TWO_ARMS)
            assert outcome.ok, outcome.message
            assert [outcome.evidence[k] for k in ("cleared", "left", "beside")] == [4, 0, 0]
            assert live.driver.unwanted_contacts() == [] and live.driver.welds() == []
            arms = ("left_arm", "right_arm")
            picks = [intervals(live, arm, "approach", "close") for arm in arms]
            fetches = [intervals(live, arm, "move to pre-grasp", "close") for arm in arms]
            lifts = [intervals(live, arm, "lift", "lift") for arm in arms]
            puts = [intervals(live, arm, "move to tray", "lower") for arm in arms]
            ends.append((live.driver.now, live.driver.joint_state().positions.tobytes()))
    assert all(len(p) >= 1 for p in picks)
    assert overlap(*picks) == 0.0
    assert overlap(fetches[0], puts[1]) + overlap(fetches[1], puts[0]) > 1.0
    assert overlap(fetches[0], lifts[1]) + overlap(fetches[1], lifts[0]) > 0.2  # from the last image
    assert ends[0] == ends[1]  # the same seed gives the same run


@pytest.mark.slow
def test_each_arm_needs_a_container_and_a_camera():
    with four_things().connect("sim", seed=0) as live:
        with pytest.raises(InputError, match="cameras for"):
            live.clear("bin", **{**TWO_ARMS, "tray_camera": {"left_arm": "above_left_tray"}})
        with pytest.raises(InputError, match="2 arms"):
            live.clear("bin", **{**TWO_ARMS, "into": "left_tray"})


@pytest.mark.long
@pytest.mark.parametrize(("count", "seed"), seeds(1, [(5, 0), (20, 0), (20, 5)]))
def test_mixed_things(count, seed):
    cell = with_some(count)
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    assert result["measures"]["cleared"] >= count - 1
    assert result["unwanted_contacts"] == [] and result["welds"] == []
    assert np.isfinite(result["min_clearance_m"])


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(1, range(3)))
def test_two_arms_clear_mixed_things(seed):
    cell = with_some(10, "dual_bin_clearing")
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    assert result["measures"]["cleared"] >= 9
    assert result["unwanted_contacts"] == [] and result["welds"] == []
