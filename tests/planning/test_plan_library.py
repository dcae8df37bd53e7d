"""The plan library: nothing is reused unproven; what is broken is repaired or planned anew."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.planning.helpers import down, ends_at, judge, panda_wall, request
from tests.scene.helpers import box

from armcell.core import (
    Constraints,
    ErrorCode,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    NamedGoal,
    PoseGoal,
)
from armcell.planning.plan_library import PlanLibrary, fingerprint
from armcell.scene import PlanningScene

ACROSS = JointGoal(JointState(("panda_joint1",), [0.46]))


def counts(library: PlanLibrary) -> tuple[int, int, int]:
    s = library.statistics
    return s.hits, s.repairs, s.misses


def in_the_way(scene: PlanningScene, waypoints: np.ndarray) -> PlanningScene:
    """A post where the tip is in the middle of a path."""
    names = scene.model.group("arm").joint_names
    lengths = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    i = int(np.argmax(np.cumsum(lengths) >= lengths.sum() / 2))
    there = scene.with_state(JointState(names, (waypoints[i] + waypoints[i + 1]) / 2))
    at = there.frame_pose("panda_hand").translation
    return scene.with_object(box("post", (0.05, 0.05, 0.05), tuple(at)))


@pytest.mark.slow
@pytest.mark.parametrize("goal", [ACROSS, PoseGoal(down(0.45, 0.25, 0.25)), NamedGoal("ready")])
def test_a_motion_is_found_again(goal, tmp_path):
    scene = panda_wall()
    if isinstance(goal, NamedGoal) and goal.name not in scene.model.named_states["arm"]:
        goal = NamedGoal(next(iter(scene.model.named_states["arm"])))
    library = PlanLibrary(tmp_path)
    first = library.plan(scene, request(goal))
    again = library.plan(panda_wall(), request(goal))
    assert first.ok and again.ok and counts(library) == (1, 0, 1)
    assert (first.evidence["library"], again.evidence["library"]) == ("planned", "hit")
    np.testing.assert_array_equal(first.path.waypoints, again.path.waypoints)
    judge(scene, again.trajectory)
    other = PlanLibrary(tmp_path).plan(scene, request(goal))  # another run finds it in the folder
    assert other.evidence["library"] == "hit"


def test_from_a_start_nearby(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    assert library.plan(scene, request(ACROSS)).ok
    moved = scene.with_state(JointState(("panda_joint1",), [-0.49]))
    result = library.plan(moved, request(ACROSS))
    assert result.evidence["library"] == "hit"
    judge(moved, result.trajectory)
    far = scene.with_state(JointState(("panda_joint1",), [-0.8]))
    assert library.plan(far, request(ACROSS)).evidence["library"] == "planned"
    # A joint that the goal does not name stays where it is: the stored end is another one's.
    turned = scene.with_state(JointState(("panda_joint7",), [scene.state["panda_joint7"] + 0.05]))
    result = library.plan(turned, request(ACROSS))
    assert result.evidence["library"] == "planned"
    assert ends_at(turned, result).state["panda_joint7"] == pytest.approx(turned.state["panda_joint7"])


def test_something_new_in_the_way_is_planned_around(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    first = library.plan(scene, request(ACROSS))
    blocked = in_the_way(scene, first.path.waypoints)
    result = library.plan(blocked, request(ACROSS))
    assert result.ok and result.evidence["library"] == "repaired" and counts(library) == (0, 1, 1)
    judge(blocked, result.trajectory)
    assert library.plan(blocked, request(ACROSS)).evidence["library"] == "hit"  # the repaired one
    assert library.plan(scene, request(ACROSS)).evidence["library"] == "hit"


def test_a_goal_that_is_blocked_fails_as_ever(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    result = library.plan(scene, request(ACROSS))
    at = ends_at(scene, result).frame_pose("panda_hand").translation
    blocked = scene.with_object(box("post", (0.1, 0.1, 0.1), tuple(at)))
    failed = library.plan(blocked, request(ACROSS))
    assert failed.code is ErrorCode.GOAL_IN_COLLISION and failed.path is None


def test_another_robot_group_or_goal_is_another_problem(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    library.plan(scene, request(ACROSS))
    other = JointGoal(JointState(("panda_joint1",), [0.45]))
    assert library.plan(scene, request(other)).evidence["library"] == "planned"


@pytest.mark.slow
def test_speed_is_the_requests(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    fast = library.plan(scene, request(ACROSS))
    slow = library.plan(scene, request(ACROSS, velocity_scaling=0.2, acceleration_scaling=0.2))
    assert slow.evidence["library"] == "hit" and slow.trajectory.duration > 2 * fast.trajectory.duration
    judge(scene, slow.trajectory, 0.2, 0.2)


def edited(folder, **changes):
    (file,) = folder.glob("*.json")
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


def test_a_tampered_motion_is_never_driven(tmp_path):
    """Straight through the wall: it is not proven, so it is repaired or planned anew."""
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    path = library.plan(scene, request(ACROSS)).path.waypoints
    edited(tmp_path, waypoints=[path[0].tolist(), path[-1].tolist()])
    result = library.plan(scene, request(ACROSS))
    assert result.evidence["library"] in ("repaired", "planned")
    judge(scene, result.trajectory)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{"waypoints": [[1, 2]]}, {"waypoints": []}, {"waypoints": "x"}, {"waypoints": [[float("nan")] * 7]},
     {"waypoints": [[9.0] * 7]}, {"joint_names": ["a"]}, {"version": 99}, {"waypoints": {"a": 1}}],
)  # fmt: skip
def test_broken_files_are_left_out(changes, tmp_path, caplog):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    assert library.plan(scene, request(ACROSS)).ok
    edited(tmp_path, **changes)
    result = library.plan(scene, request(ACROSS))
    assert result.evidence["library"] == "planned" and library.statistics.unreadable == 1
    assert "left out" in caplog.text


@pytest.mark.parametrize("data", [b"", b"[", b"\x80\x04pickle", b"[" * 100_000, b"{}", b"null"])
def test_files_that_are_no_json(data, tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    assert library.plan(scene, request(ACROSS)).ok
    next(tmp_path.glob("*.json")).write_bytes(data)
    assert library.plan(scene, request(ACROSS)).ok and library.statistics.unreadable == 1


def test_only_so_many_are_kept(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path, start_region=0.0, most=2)
    for turn in (-0.46, -0.48, -0.5, -0.52):
        assert library.plan(scene.with_state(JointState(("panda_joint1",), [turn])), request(ACROSS)).ok
    assert len(list(tmp_path.glob("*.json"))) == 2 and not list(tmp_path.glob("*.part"))


def test_misuse(tmp_path):
    scene, library = panda_wall(), PlanLibrary(tmp_path)
    assert library.plan(scene, request(ACROSS)).ok  # said also where the answer is known
    for options, text in (
        ({"velocity_scaling": 0.0}, "velocity scaling"), ({"planner_id": "RRTDisconnect"}, "RRTDisconnect")
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            library.plan(scene, request(ACROSS, **options))
    with pytest.raises(InputError, match="start_region"):
        PlanLibrary(tmp_path, start_region=-1)
    with pytest.raises(InputError, match="at least one"):
        PlanLibrary(tmp_path, most=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="folder"):
        PlanLibrary(tmp_path / "file")


def test_fingerprints():
    scene = panda_wall()
    assert fingerprint(scene.model) == fingerprint(panda_wall().model)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    different = [1, 1.0, "1", True, None, (1,), ((1,),), {"a": 1}, np.array([1.0]), np.array([[1.0]]),
                 Constraints(), Constraints((JointConstraint("a", 0, 0, 0),))]  # fmt: skip
    assert len({fingerprint(v) for v in different}) == len(different)
    with pytest.raises(TypeError):
        fingerprint(object())
