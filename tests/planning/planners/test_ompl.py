"""OMPL's planners: parameters by OMPL's names, ompl_planning.yaml, nothing replaced in silence."""

from __future__ import annotations

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import pytest
import yaml
from tests.planning.helpers import judge, panda_wall, request
from tests.planning.test_plan import beyond_panda

from armcell.core import InputError, PoseGoal, UnknownNameError
from armcell.planning import pipelines, plan
from armcell.planning.planners.ompl import declared_parameters, set_parameters, trial_planner


def asked(planner_id: str, **options):
    return plan(panda_wall(), request(beyond_panda(), pipeline_id="ompl", planner_id=planner_id, **options))


def test_every_geometric_planner_of_the_wheel_is_there():
    wheel = {
        name for name, kind in vars(og).items() if isinstance(kind, type) and issubclass(kind, ob.Planner)
    }
    assert wheel == set(pipelines["ompl"]) and {"PRM", "RRTConnect", "AORRTC", "SORRTstar"} <= wheel


@pytest.mark.parametrize("name", ["EST", "geometric::BiTRRT", "TRRTkConfigDefault"])
def test_planners_that_the_wheel_lacks_are_refused(name):
    with pytest.raises(UnknownNameError, match="known: AORRTC, BFMT, .*SORRTstar"):
        asked(name)


@pytest.mark.parametrize(
    ("spelt", "name"), [("geometric::KPIECE", "KPIECE1"), ("LBKPIECEkConfigDefault", "LBKPIECE1")]
)
def test_moveit_s_names_of_the_same_planner(spelt, name):
    result = asked(spelt)
    assert result.ok and result.planner_id == name


# --- parameters ---


@pytest.mark.parametrize("name", sorted(pipelines["ompl"]))
def test_every_declared_parameter_can_be_set_or_says_that_it_cannot(name):
    with trial_planner(name) as planner:
        check_parameters(planner, name)


# Without a method in the wheel, or without any effect in OMPL itself.
STUCK = {
    "BFMT": {"balanced", "optimality"},
    "BITstar": {
        "delay_rewiring_to_first_solution",
        "use_just_in_time_sampling",
        "use_strict_queue_ordering",
    },
}


def check_parameters(planner, name):
    stuck = []
    for key, text in declared_parameters(planner, name).items():
        if (name, key) == ("AORRTC", "range"):  # not declared by OMPL, so not printed
            set_parameters(planner, name, {key: 0.3})
            assert planner.getRange() == pytest.approx(0.3)
            continue
        number = float(text)
        other = 1.0 - number if number in (0.0, 1.0) else number * 0.5
        if key == "radius_multiplier":
            other = 2.5
        if key in ("ordering_batch_size", "num_samples", "samples_per_batch", "max_nearest_neighbors"):
            other = 7
        try:
            set_parameters(planner, name, {key: int(other) if other == int(other) else other})
        except InputError as error:
            stuck.append(key)
            assert "cannot be" in str(error)
            continue
        assert float(declared_parameters(planner, name)[key]) == pytest.approx(other), key
    assert set(stuck) == STUCK.get(name, set())


@pytest.mark.slow
def test_an_unknown_parameter_lists_those_there_are_with_their_values():
    with pytest.raises(UnknownNameError) as error:
        asked("RRT", parameters={"goal_bais": 0.1})
    text = str(error.value)
    assert "unknown parameter of planner 'RRT' 'goal_bais'" in text and "did you mean 'goal_bias'" in text
    assert "goal_bias = 0.05" in text and "range = 0" in text and "intermediate_states = 0" in text


@pytest.mark.parametrize(
    ("planner", "parameters", "words"),
    [
        ("RRT", {"goal_bias": "often"}, "'goal_bias' of planner 'RRT' is 'often', a number"),
        ("FMT", {"num_samples": 2.5}, "a whole number"),
        ("RRTstar", {"delay_collision_checking": 3}, "true or false"),
        ("BFMT", {"balanced": 1}, "cannot be changed"),
    ],
)
def test_values_of_the_wrong_kind(planner, parameters, words):
    with pytest.raises(InputError, match=words):
        asked(planner, parameters=parameters)


def test_parameters_are_checked_even_where_no_planner_is_needed():
    scene = panda_wall()
    here = PoseGoal(scene.frame_pose("panda_hand_tcp"))
    for pipeline in ("native", "ompl"):
        with pytest.raises(UnknownNameError, match="unknown parameter"):
            plan(scene, request(here, pipeline_id=pipeline, parameters={"nonsense": 1}))


def test_parameters_have_an_effect():
    """With edges of 0.05 rad RRT-Connect needs many more states than with its own range."""
    short, own = (asked("RRTConnect", parameters=p) for p in ({"range": 0.05}, {}))
    assert short.ok and own.ok
    assert short.evidence["checks"] > 3 * own.evidence["checks"]


# --- native parameters ---


def test_native_parameters():
    scene, goal = panda_wall(), beyond_panda()
    plain, short = (plan(scene, request(goal, parameters=p)) for p in ({}, {"range": 0.1}))
    assert plain.ok and short.ok and short.evidence["nodes"] > plain.evidence["nodes"]
    judge(scene, short.trajectory)
    with pytest.raises(UnknownNameError, match=r"it has: .*max_nodes = 60000, .*step = 0.03125"):
        plan(scene, request(goal, parameters={"goal_bias": 0.1}))
    with pytest.raises(InputError, match="must be positive"):
        plan(scene, request(goal, parameters={"range": -1.0}))
    with pytest.raises(InputError, match="a whole number"):
        plan(scene, request(goal, parameters={"max_nodes": "many"}))


def test_a_limit_of_iterations_is_kept():
    result = plan(panda_wall(), request(beyond_panda(), parameters={"max_iterations": 1}, planning_time=30.0))
    assert not result.ok and "no path found" in result.message and result.planning_time < 20.0
    assert result.evidence["iterations"] <= 5


# --- ompl_planning.yaml ---

YAML = """
planner_configs:
  RRTConnectkConfigDefault:
    type: geometric::RRTConnect
    range: 0.0
  fine:
    type: geometric::RRTConnect
    range: 0.05
  PRMkConfigDefault:
    type: geometric::PRM
    max_nearest_neighbors: 7
  BFMTkConfigDefault:
    type: geometric::BFMT
    num_samples: 1000
    radius_multiplier: 1.0
    nearest_k: 1
    balanced: 0
    optimality: 1
    heuristics: 1
    cache_cc: 1
    extended_fmt: 1
  FMTkConfigDefault:
    type: geometric::FMT
    num_samples: 1000
    radius_multiplier: 1.1
    nearest_k: 1
    cache_cc: 1
    heuristics: 0
    extended_fmt: 1
  KPIECEkConfigDefault:
    type: geometric::KPIECE
    range: 0.0
    goal_bias: 0.05
    border_fraction: 0.9
    failed_expansion_score_factor: 0.5
    min_valid_path_fraction: 0.5
  ESTkConfigDefault:
    type: geometric::EST
    range: 0.0
arm:
  default_planner_config: fine
  planner_configs: [RRTConnectkConfigDefault, fine, PRMkConfigDefault, KPIECEkConfigDefault]
  projection_evaluator: joints(panda_joint1,panda_joint2)
  longest_valid_segment_fraction: 0.005
  enforce_joint_model_state_space: true
"""


def configs(change=None):
    tables = yaml.safe_load(YAML)
    if change:
        change(tables)
    return tables


@pytest.mark.cases("fine-*", "arm*", "KPIECE*")
@pytest.mark.parametrize(
    ("planner_id", "name"),
    [
        ("RRTConnectkConfigDefault", "RRTConnect"), ("fine", "RRTConnect"), ("arm[fine]", "RRTConnect"),
        ("KPIECEkConfigDefault", "KPIECE1"), ("BFMTkConfigDefault", "BFMT"), ("FMTkConfigDefault", "FMT"),
        ("PRMkConfigDefault", "PRM"), ("", "RRTConnect"), ("geometric::BKPIECE", "BKPIECE1"),
    ],
)  # fmt: skip
def test_configurations_by_name(planner_id, name):
    result = asked(planner_id, planner_configs=configs())
    assert result.ok and result.planner_id == name, result.message
    assert result.evidence["settings_without_effect"] == ("enforce_joint_model_state_space",)


def test_a_configuration_s_parameters_have_an_effect():
    coarse, fine, default = (
        asked(name, planner_configs=configs()) for name in ("RRTConnectkConfigDefault", "fine", "")
    )
    assert fine.evidence["checks"] > 3 * coarse.evidence["checks"]
    np.testing.assert_array_equal(fine.trajectory.positions, default.trajectory.positions)


def test_a_request_s_own_parameters_come_before_the_configuration_s():
    fine = asked("fine", planner_configs=configs(), parameters={"range": 0.0})
    plain = asked("RRTConnectkConfigDefault", planner_configs=configs())
    assert fine.evidence["checks"] == plain.evidence["checks"]


@pytest.mark.long
def test_without_simplifying_the_raw_path_is_returned_proven():
    def keep(tables):
        tables["arm"]["simplify_solutions"] = False

    raw = asked("RRT", planner_configs=configs(keep), planning_time=20.0)
    short = asked("RRT", planner_configs=configs(), planning_time=20.0)
    assert raw.ok and short.ok and raw.path.length > short.path.length
    judge(panda_wall(), raw.trajectory)


BROKEN = {
    "type that the wheel lacks": ("ESTkConfigDefault", None, "unknown planner of pipeline 'ompl' 'EST'"),
    "unknown parameter": (
        "fine", lambda t: t["planner_configs"]["fine"].update(goal_bias=0.1), "'goal_bias'; it has: inter"),
    "no type": ("fine", lambda t: t["planner_configs"]["fine"].pop("type"), "fine has no type"),
    "not a mapping": ("fine", lambda t: t["planner_configs"].update(fine="RRT"), "fine is 'RRT', a mapping"),
    "list": ("fine", lambda t: t.update(planner_configs=[1]), "a mapping is needed"),
    "group's list": ("fine", lambda t: t["arm"].update(planner_configs=["fine", "gone"]),
                     "unknown planner configuration of group 'arm' 'gone'"),
    "fraction": ("fine", lambda t: t["arm"].update(longest_valid_segment_fraction=0), r"in \(0, 1\]"),
    "projection": ("fine", lambda t: t["arm"].update(projection_evaluator="link(tip)"), "joints\\("),
    "objective": ("fine", lambda t: t["arm"].update(optimization_objective="Mechanical"), "objective"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", BROKEN)
def test_broken_configurations_are_named(case):
    planner_id, change, words = BROKEN[case]
    with pytest.raises(InputError, match=words):
        asked(planner_id, planner_configs=configs(change))


def test_a_projection_of_unknown_joints_is_named():
    def change(tables):
        tables["arm"]["projection_evaluator"] = "joints(elbow,panda_joint2)"

    with pytest.raises(UnknownNameError, match="joint of the projection 'elbow'"):
        asked("KPIECEkConfigDefault", planner_configs=configs(change))


# --- roadmaps, whose second thread used to wait for ever ---


def test_prm_with_several_goals_ends():
    from tests.planning.helpers import down

    goals = (PoseGoal(down(0.5, 0.25, 0.12)), PoseGoal(down(0.45, 0.3, 0.2)))
    for seed in range(5):
        result = plan(panda_wall(), request(goals, pipeline_id="ompl", planner_id="PRM", seed=seed))
        assert result.ok, result.message


def test_attempts_of_ompl_follow_each_other_and_repeat():
    a, b = (asked("RRTConnect", attempts=3, seed=2) for _ in range(2))
    assert a.ok and a.evidence["solved"] == 3 and len(set(a.evidence["lengths"])) > 1
    assert a.path.length == pytest.approx(min(a.evidence["lengths"]))
    np.testing.assert_array_equal(a.trajectory.positions, b.trajectory.positions)
