"""The report is one file, says what happened, survives what is missing and escapes what it is given."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
from tests.records.synthetic import panda_result, panda_scene, play

from armcell.core import Event, JointState, StateSample
from armcell.records import RunRecorder, write_report

VOID = {"meta", "link", "img", "br", "hr"}


class Page(HTMLParser):
    """Collects text, tags and attributes, and checks that tags close in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.text, self.links = [], [], [], []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def scene():
    return panda_scene()


@pytest.fixture(scope="module")
def recorder(scene, tmp_path_factory):
    with RunRecorder(tmp_path_factory.mktemp("20260304-050607-panda_pick"), scene) as recorder:
        play(scene, recorder, rate=100.0)
        recorder.add_picture(3.9, "grasped", np.full((30, 40, 3), 99, np.uint8))
        recorder.add_picture(17.0, "placed", np.full((60, 2000, 3), 99, np.uint8))
    return recorder


@pytest.fixture
def empty(scene, tmp_path):
    with RunRecorder(tmp_path, scene) as recorder:
        pass
    return recorder


@pytest.mark.slow
def test_a_success_shows_everything_in_one_file(recorder):
    file = write_report(recorder.folder, panda_result(), recorder)
    html = file.read_text()
    page = Page(html)
    assert sorted(p.name for p in recorder.folder.iterdir()) == ["report.html", "run.mcap"]
    assert (
        all(link.startswith("data:") for link in page.links) and "url(" not in html and "@import" not in html
    )
    assert "script" not in page.tags
    assert page.tags.count("img") == 5  # joints, gripper, height, two pictures
    expected = ["✓ Success", "move to pregrasp", "RRTConnect", "0.063 mm", "0.41 mm", "12.30 mm", "mujoco"]
    expected += [
        "armcell run panda_pick --seed 7 --headless",
        "held by friction",
        "grasped",
        "17.40 s",
        "lift begins",
    ]
    assert [words for words in expected if words not in page.words] == []


@pytest.mark.slow
def test_a_failure_says_the_cause_in_words_and_marks_the_stage(recorder, tmp_path):
    result = panda_result()
    result |= {
        "success": False,
        "error_code": -12,
        "error_name": None,
        "message": "panda_hand touches wall (4.2 mm deep)",
        "unwanted_contacts": [{"time_s": 3.2, "body_a": "panda_hand", "body_b": "wall", "depth_m": 0.0042}],
    }
    result["stages"][6] |= {"ok": False, "error": "GOAL_IN_COLLISION"}
    html = write_report(tmp_path, result, recorder).read_text()
    words = Page(html).words
    assert "✗ Failed: goal in collision (-12)" in words and "4.2 mm deep" in words
    assert "Stage that failed: move to preplace" in words
    assert "depth [mm]" in words and "4.20" in words
    assert html.count("<tr class=bad>") >= 1


@pytest.mark.parametrize(
    "result",
    [
        {},
        {"success": False},
        {"stages": None, "versions": None, "unwanted_contacts": None},
        {
            "stages": [{}],
            "unwanted_contacts": ["hand-wall"],
            "versions": "1.0",
            "welds": 2,
            "command": ["a", "b c"],
        },
        {"stages": ["lift"], "slip_m": "n/a", "min_clearance_m": float("inf"), "seed": float("nan")},
        {"stages": [{"name": None, "planning_time_s": "fast", "error": 0.01, "error_m": None, "ok": None}]},
    ],
)
def test_missing_and_odd_values_do_not_crash(empty, result):
    words = Page(write_report(empty.folder, result, empty).read_text()).words
    assert "Too few states" in words and "nan" not in words and "inf " not in words


def test_every_text_is_escaped(empty):
    evil = "<script>alert('x')</script>\"&"
    result = dict.fromkeys(
        ("error_name", "message", "cell", "task", "mode", "seed", "command", "welds"), evil
    )
    result["stages"] = [{"name": evil, "planner": evil, "error": evil, "planning_time_s": evil, "ok": False}]
    result["unwanted_contacts"] = [{evil: evil, "position_m": [1.0, evil]}]
    result["versions"] = {evil: evil}
    empty.on_event(Event(0.0, evil, evil, {"name": evil}))
    empty.on_event(Event(0.0, "stage", evil, {"name": evil}))
    empty.add_picture(0.0, evil, np.zeros((2, 2, 3), np.uint8))
    html = write_report(empty.folder, result, empty).read_text()
    assert "script" not in Page(html).tags and "<script" not in html
    assert html.count("&lt;script&gt;") > 12


def test_series_with_gaps_one_sample_and_odd_stage_names_are_drawn(scene, tmp_path):
    names = scene.model.joint_names
    with RunRecorder(tmp_path, scene) as recorder:
        recorder.on_event(Event(0.0, "stage", "$bad_{mathtext"))
        for k in range(5):
            recorder.on_state(
                StateSample(0.1 * k, JointState(names[:3], np.zeros(3)), gripper_width={"hand": 0.05})
            )
    page = Page(write_report(tmp_path, {}, recorder).read_text())
    assert page.tags.count("img") == 2 and "could not be drawn" not in page.words


@pytest.mark.slow
def test_two_arms_get_a_figure_each(tmp_path):
    from armcell.core import SE3
    from armcell.model import MountedRobot, compose, load_robot
    from armcell.records.plots import joint_plots
    from armcell.scene import PlanningScene

    panda = load_robot("panda")
    parts = [
        MountedRobot(panda, "left_", "world"),
        MountedRobot(panda, "right_", "world", SE3.from_xyz(0, 1, 0)),
    ]
    scene = PlanningScene.of(compose("dual", parts))
    with RunRecorder(tmp_path, scene) as recorder:
        for k in range(3):
            recorder.on_state(StateSample(0.1 * k, scene.state))
    figures = joint_plots(recorder.series(), scene.model, [])
    assert set(figures) == {"left_arm", "right_arm"}
    assert all(re.match(rb"\x89PNG", png) for png in figures.values())
