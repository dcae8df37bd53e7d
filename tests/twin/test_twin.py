"""The twin: what it refuses, what its bands learn and find. Over connections: benchmarks/twin_guard.py."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from armcell.core import SE3, Box, ErrorCode, InputError, JointTrajectory, Outcome
from armcell.drivers.motion_guard import ArmSample
from armcell.drivers.safety import Fault
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import PhysicsSettings
from armcell.twin import UNWATCHED, DryRun, ResidualThresholds, TwinGuard, TwinSimulation, fit_thresholds
from armcell.twin.guard import SLOW, STOP_AFTER
from armcell.twin.residual_thresholds import SMOOTHED, TwinSample

MODEL = load_robot("ur10_gripper")
ARM = MODEL.group("arm").joint_names
HOME = MODEL.named_state("arm", "home")
GAIN, FRICTION, LAG = 0.1, 0.3, -0.008


def turn(angle: float, seconds: float = 1.0, joints=np.eye(6)[0]) -> JointTrajectory:
    """The base joint by an angle [rad] from home, or `joints` by shares of it; at rest at both ends."""
    t = np.linspace(0.0, seconds, 50)
    w, d = np.pi / seconds, angle * joints
    q0 = HOME.reindexed(ARM).positions
    shape = ((1 - np.cos(w * t)) / 2, w / 2 * np.sin(w * t), w * w / 2 * np.cos(w * t))
    q, v, a = (s[:, None] * d for s in shape)
    return JointTrajectory(ARM, t, q0 + q, v, a)


def stage(*objects: CollisionObject) -> tuple[TwinSimulation, PlanningScene]:
    scene = PlanningScene.of(MODEL, objects=list(objects)).with_state(HOME)
    return TwinSimulation(scene, PhysicsSettings()), scene


def test_what_touches_in_physics_is_refused():
    bare, scene = stage()
    free = bare.play(turn(0.6), scene.state, {}, {})
    assert free.outcome.ok
    np.testing.assert_allclose(free.positions[-1], turn(0.6).positions[-1], atol=2e-3)
    k = len(free.times) // 2
    np.testing.assert_allclose(free.at(free.times[k])[0], turn(0.6).sample(free.times[k])[0], atol=5e-3)
    tip = scene.with_state(turn(0.6).end).frame_pose("gripper_tcp").translation
    wall = CollisionObject.single("wall", Box(0.15, 0.15, 0.15), SE3.from_xyz(*tip))
    with_wall, scene = stage(wall)
    refused = with_wall.play(turn(0.6), scene.state, {}, {}).outcome
    assert refused.code is ErrorCode.CONTROL_FAILED and "touches wall" in refused.message
    assert 0.3 < refused.evidence["time_s"] < 1.0
    # Told that it is part of the task, it is none; taken back, it is one again.
    links = {name for name in refused.evidence["pair"] if name != "wall"} | set(MODEL.gripper().hand_links)
    for link in links:
        with_wall.expect_contact("wall", (link,), True)
    assert "touches" not in with_wall.play(turn(0.6), scene.state, {}, {}).outcome.message
    for link in links:
        with_wall.expect_contact("wall", (link,), False)
    assert "touches wall" in with_wall.play(turn(0.6), scene.state, {}, {}).outcome.message


def test_what_is_held_goes_along_and_is_felt():
    _, scene = stage()
    tcp = scene.frame_pose("gripper_tcp")
    block = CollisionObject.single("block", Box(0.04, 0.04, 0.04), tcp, movable=True, mass=3.0)
    loaded, scene = stage(block)
    for link in MODEL.gripper().hand_links:
        loaded.expect_contact(link, ("block",), True)
    gripper = MODEL.gripper().name
    held = loaded.play(turn(0.4), scene.state, {"block": tcp}, {gripper: "block"})
    empty = stage()[0].play(turn(0.4), scene.state, {}, {})
    assert held.outcome.ok, held.outcome.message
    # Statics of the last instant: 3 kg at the hand's distance from the shoulder's axis, which is level.
    at = scene.with_state(turn(0.4).end)
    shoulder, hand = (at.frame_pose(n).translation for n in ("upper_arm_link", "gripper_tcp"))
    level = float(np.linalg.norm((hand - shoulder)[:2]))
    more = abs(held.efforts[-1][1]) - abs(empty.efforts[-1][1])
    assert more == pytest.approx(3.0 * 9.81 * level, rel=0.15)


def watched(twin: DryRun, rng, fault=lambda seen: seen, scaling=1.0) -> list[TwinSample]:
    """Looks at an arm that is what its twin says, a step ahead, with noise; `fault` spoils each."""
    looks = []
    for t in np.arange(0.02, twin.times[-1] - 0.02, 0.01):
        q, v, effort = twin.at(t - LAG)
        current = GAIN * effort + FRICTION * np.tanh(v / 0.02) + rng.normal(0, 0.4, 6)  # ripple
        looks.append(fault(TwinSample(t, scaling, q + rng.normal(0, 5e-4, 6), v * scaling, current, 0.004)))
    return looks


@pytest.fixture(scope="module")
def twins():
    bare, scene = stage()
    return [bare.play(turn(a, 1.5), scene.state, {}, {}) for a in (0.6, -0.8, 0.3, 0.9)]


@pytest.fixture(scope="module")
def bands(twins):
    rng = np.random.default_rng(0)
    return fit_thresholds([(twin, range(6), watched(twin, rng)) for twin in twins])


@pytest.mark.slow
def test_lag_and_current_are_fitted(bands):
    assert bands.lag == pytest.approx(LAG, abs=1e-3)
    assert bands.gain[0] == pytest.approx(GAIN, abs=0.02)
    assert (bands.current < 0.8).all() and (bands.position < np.deg2rad(0.5)).all()
    with pytest.raises(InputError, match="looks at a moving arm"):
        fit_thresholds([])


def test_bands_are_kept_and_void_for_another(bands, tmp_path):
    file = tmp_path / "b.json"
    ResidualThresholds({"arm": bands}, {"robot": "x", "calibration.arm": "c1"}).save(file)
    again = ResidualThresholds.load(file)
    np.testing.assert_array_equal(again.arms["arm"].current, bands.current)
    assert again.arms["arm"].lag == bands.lag
    guard = TwinGuard(stage()[0], again)
    guard.check_calibration({"arm": "c1"})
    with pytest.raises(InputError, match="learned on calibration c1, this robot has c2"):
        guard.check_calibration({"arm": "c2"})
    for text in ("{", "[]", '{"format": 1}', '{"format": 9}'):
        file.write_text(text)
        with pytest.raises(InputError, match=r"b\.json"):
            ResidualThresholds.load(file)


class Followed:
    """A motion whose clock a test turns."""

    def __init__(self):
        self.t, self.how = 0.0, "running"

    def trajectory_time(self):
        return self.t

    def state(self):
        return self.how

    def paused(self):
        return False

    def cancel(self):
        pass


class Robot:
    name, joint_names = "arm", ARM

    def __init__(self, ramp):
        self.sliders, self.seen, self.ramp, self.now = [], None, ramp, 1.0

    @property
    def speed_scaling(self):
        if self.sliders:
            self.now = max(self.now - self.ramp, self.sliders[-1])
        return self.now

    def sample(self):
        s = self.seen
        return ArmSample(s.q, s.v, s.current, s.clock, speed_fraction=0.8)

    def set_slider(self, fraction):
        self.sliders.append(fraction)


def driven(bands, twin, fault=lambda seen: seen, begin=0.7, ramp=0.0, arm=None):
    """(seconds until slowed, until stopped, robot, notes); the fault begins in the middle.

    With `ramp`, a slider takes the speed down by that much at each look. With `arm`, the robot does that.
    """
    notes, trips, robot, motion = [], [], Robot(ramp), Followed()
    guard = TwinGuard(SimpleNamespace(play=lambda *_: twin), ResidualThresholds({"arm": bands}, {}),
                      note=lambda arm, kind, text: notes.append((motion.t, kind, text)))  # fmt: skip
    trajectory = turn(0.1)
    assert guard.dry_run(trajectory, HOME, {}, {}) is None
    guard.trips = {"arm": lambda: robot.seen.trip}
    following = guard.monitor(motion, trajectory, [robot], lambda f: trips.append((motion.t, f)))
    for seen in watched(arm or twin, np.random.default_rng(5), lambda s: fault(s) if s.clock >= begin else s):
        motion.t, robot.seen = seen.clock, seen
        following.trajectory_time()
        if trips:
            break
    motion.how = "done"
    assert following.state() == "done"
    slowed = next((t - begin for t, kind, _ in notes if kind == "twin slowed"), None)
    return slowed, trips[0][0] - begin if trips else None, trips[0][1] if trips else None, robot, notes


def moved(**change):
    return lambda s: TwinSample(**{**s.__dict__, **{k: f(getattr(s, k)) for k, f in change.items()}})


STUCK = {}


def blocked(seen: TwinSample) -> TwinSample:
    at = STUCK.setdefault("q", seen.q.copy())
    return moved(q=lambda q: np.r_[at[0], q[1:]], v=lambda v: np.r_[0.0, v[1:]])(seen)


FAULTS = {
    "payload": (moved(current=lambda i: i + np.r_[0, 1.4, 0, 0, 0, 0]), "current", "payload"),
    "offset": (moved(q=lambda q: q + np.r_[0, 0, np.deg2rad(2.0), 0, 0, 0]), "elbow_joint", "calibrated"),
    "delay": (moved(trip=lambda t: t + 0.05), "the network: timing", "network"),
    "blocked": (blocked, "shoulder_pan_joint", "blocked"),
}


@pytest.mark.parametrize("ramp", [0.0, 0.01])
@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_slows_and_stops(bands, twins, name, ramp):
    STUCK.clear()
    fault, said, hint = FAULTS[name]
    slowed, stopped, trip, robot, _ = driven(bands, twins[3], fault, ramp=ramp)
    assert slowed is not None and stopped is not None and 0 <= slowed <= stopped < 0.45
    assert isinstance(trip, Fault) and trip.kind == "twin deviation"
    assert said in trip.text and hint in trip.hint
    assert robot.sliders == [SLOW, 0.8]  # and back, once it is stopped


ALL = np.array([1.0, 0.5, -0.6, 0.8, 0.7, 1.0])  # joints that move together, so that all currents are learned


@pytest.fixture(scope="module")
def swings():
    bare, scene = stage()
    return [bare.play(turn(a, 1.5, ALL), scene.state, {}, {}) for a in (0.6, -0.4, 0.4, 0.8)]


@pytest.fixture(scope="module")
def swing_bands(swings):
    rng = np.random.default_rng(0)
    return fit_thresholds([(twin, range(6), watched(twin, rng)) for twin in swings])


@pytest.fixture(scope="module")
def loaded():
    """The last of `swings` with 2 kg on the last link, in physics."""
    hung, scene = stage()
    hung.play(turn(0.1), scene.state, {}, {})  # makes its world
    hung._world.add_load("wrist_3_link", 2.0)
    return hung.play(turn(0.8, 1.5, ALL), scene.state, {}, {})


def test_what_a_kilogram_adds_is_what_physics_says(swings, loaded):
    bare = swings[3]
    assert bare.outcome.ok and loaded.outcome.ok
    for t in (0.4, 0.75, 1.1):
        kilo = bare.efforts_at(t, 1.0)[1]
        np.testing.assert_allclose(2.0 * kilo, loaded.at(t)[2] - bare.at(t)[2], atol=1.5)
        assert abs(kilo[1]) > 4.0
    assert np.abs(bare.demand.inertia[:, 0]).max() > 0.5  # the base feels no weight, but the acceleration
    # Statics: the upper arm turns about its own y axis, which is level.
    at = PlanningScene.of(MODEL).with_state(HOME)
    upper, last = at.frame_pose("upper_arm_link"), at.frame_pose("wrist_3_link").translation
    lever = np.cross(upper.rotation.matrix[:, 1], last - upper.translation)
    assert abs(bare.demand.weight[0, 1]) == pytest.approx(9.81 * abs(lever[2]), rel=1e-3)


def test_efforts_of_a_slowed_arm_are_what_physics_says(swings):
    fast = swings[3]
    bare, scene = stage()
    slow = bare.play(turn(0.8, 3.0, ALL), scene.state, {}, {})
    times = np.linspace(0.3, 1.2, 19)
    truth = np.array([slow.at(2.0 * t)[2] for t in times])
    naive = np.abs([fast.at(t)[2] for t in times] - truth).max(axis=0)
    reckoned = np.abs([fast.efforts_at(t, 0.5)[0] for t in times] - truth).max(axis=0)
    assert naive[0] > 5.0 and naive[1] > 1.5  # where the arm's own mass is accelerated
    assert (reckoned[:2] < 0.7 * naive[:2]).all() and (reckoned < naive + 0.5).all()


@pytest.mark.slow
def test_a_payload_is_told_in_kilograms(swing_bands, swings, loaded):
    slowed, stopped, trip, _, notes = driven(swing_bands, swings[3], begin=0.0, arm=loaded)
    assert slowed < 0.5 and stopped < 0.6 and "payload" in trip.hint
    assert "kg more than its model says" in trip.text
    load = float(notes[-1][2].split("load ")[1].split()[0])
    assert load == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("scaling", [1.0, 0.5])
def test_loads_have_signs_and_touches_are_none(swing_bands, swings, scaling):
    def load(off) -> float:
        currents, twin = deque(maxlen=SMOOTHED), swings[3]
        for t in np.arange(0.3, 0.6, 0.01):
            q, v, _ = twin.at(t - LAG * scaling)
            effort, kilo = twin.efforts_at(t - LAG * scaling, scaling)
            current = GAIN * effort + FRICTION * np.tanh(v * scaling / 0.02) + off(GAIN * kilo)
            seen = TwinSample(t, scaling, q, v * scaling, current, 0.004)
            found = swing_bands.residuals(seen, twin, range(6), currents)
        return float(found["load"][0] * swing_bands.load)

    told = [load(lambda kilo, mass=mass: mass * kilo) for mass in (-2.0, 2.0)]
    assert told[0] == pytest.approx(-2.0, abs=0.4) and told[1] == pytest.approx(2.0, abs=0.4)
    assert load(lambda kilo: np.eye(6)[3] * 1.5) == 0.0  # at a wrist alone: no mass does that


def test_clean_motions_are_left_alone_and_a_moment_is_no_stop(bands, twins):
    for twin in twins:
        slowed, stopped, _, robot, notes = driven(bands, twin)
        assert slowed is stopped is None and robot.sliders == []
        assert [kind for _, kind, _ in notes] == ["twin"]  # how near it came is written down
    for looks, slows in ((2, False), (STOP_AFTER - 3, True)):
        left = [looks]

        def moment(seen, left=left):
            left[0] -= 1
            return moved(q=lambda q: q + 0.01)(seen) if left[0] >= 0 else seen

        slowed, stopped, _, robot, _ = driven(bands, twins[0], moment)
        assert stopped is None and (slowed is not None) == slows
        assert robot.sliders == ([SLOW, 0.8] if slows else [])  # the slider is put back at the end


def test_a_clock_that_may_be_wrong_hides_no_offset(bands, twins):
    """A motion whose points are sent: 15 ms off is forgiven, 2 degrees of a joint that turns are not."""
    twin, t = twins[3], 0.75
    q, v, effort = twin.at(t + 0.015 - LAG)
    assert abs(v[0]) * 0.015 > 2 * bands.position[0]
    for offset, late, outside in ((0.0, 0.0, True), (0.0, 0.02, False), (np.deg2rad(2.0), 0.02, True)):
        seen = TwinSample(t, 1.0, q + np.r_[0, offset, 0, 0, 0, 0], v, GAIN * effort, 0.004, True, late)
        found = bands.residuals(seen, twin, range(6), deque(maxlen=SMOOTHED))
        assert (found["position"].max() > 1.0) == outside


def test_refused_is_told_and_nothing_of_before_is_compared(bands, twins):
    bad = replace(twins[0], outcome=Outcome(ErrorCode.CONTROL_FAILED, "in physics a touches b"))
    notes = []
    guard = TwinGuard(SimpleNamespace(play=lambda *_: bad), None, note=lambda *note: notes.append(note))
    refused = guard.dry_run(turn(0.1), HOME, {}, {})
    assert refused.message == "the twin refuses it: in physics a touches b" and refused.evidence["twin"]
    assert notes == [("all", "twin refused", "in physics a touches b")]
    motion = Followed()
    assert guard.monitor(motion, turn(0.2), [], lambda f: None) is motion  # another trajectory


def test_a_twin_without_bands_says_once_that_it_compares_nothing(twins):
    notes = []
    guard = TwinGuard(SimpleNamespace(play=lambda *_: twins[0]), note=lambda *note: notes.append(note))
    for _ in range(2):
        trajectory = turn(0.1)
        guard.dry_run(trajectory, HOME, {}, {})
        guard.monitor(Followed(), trajectory, [Robot(0.0)], lambda f: None)
    assert notes == [("all", "twin", UNWATCHED)]
    assert guard.motions == []  # nor does it keep them
    guard.learning = True
    guard.monitor(Followed(), trajectory, [Robot(0.0)], lambda f: None)
    assert len(guard.motions) == 1


def test_currents_are_judged_by_the_mean_of_some_looks(bands, twins):
    currents = deque(maxlen=SMOOTHED)
    looks = watched(twins[0], np.random.default_rng(3))
    kinds = [set(bands.residuals(seen, twins[0], range(6), currents)) for seen in looks]
    assert all("current" not in k for k in kinds[: SMOOTHED - 1]) and "current" in kinds[-1]
