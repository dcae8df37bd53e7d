"""What may be asked of a campaign, and the draws that come of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from armcell.campaigns import CampaignSpec
from armcell.campaigns.campaign import trial
from armcell.campaigns.spec import (
    BLOCK,
    adaptive_draw,
    checked_cell,
    distribution,
    distributions,
    latin_hypercube_draw,
    random_draw,
)
from armcell.core import InputError


@pytest.mark.slow
@pytest.mark.cases("data0*", "data1*", "data2*", "data5*")
@pytest.mark.parametrize(
    ("data", "reference"),
    [
        ([2, 5], stats.uniform(2, 3)),
        ({"uniform": [-1, 1]}, stats.uniform(-1, 2)),
        ({"log_uniform": [0.1, 10]}, stats.loguniform(0.1, 10)),
        ({"normal": [3, 0.5]}, stats.truncnorm(-3, 3, loc=3, scale=0.5)),
        ({"normal": [3, 0.5, 1]}, stats.truncnorm(-1, 1, loc=3, scale=0.5)),
        ({"whole": [2, 4]}, stats.randint(2, 5)),
    ],
)
def test_values_are_distributed_as_asked(data, reference):
    found = distribution(data, "here")
    values = [found.at(u) for u in np.random.default_rng(0).random(4000)]
    if isinstance(values[0], int):
        counts = [values.count(v) for v in (2, 3, 4)]
        assert sum(counts) == 4000 and stats.chisquare(counts).pvalue > 0.001
    else:
        assert stats.kstest(values, reference.cdf).pvalue > 0.001


@pytest.mark.parametrize(("low", "high"), [(1, 3), (1, 4), (3, 4), (-5, -2), (10**9, 10**9 + 7)])
def test_whole_numbers_keep_to_their_ends(low, high):
    found = distribution({"whole": [low, high]}, "here")
    assert found.at(0.0) == low and found.at(1.0 - 2.0**-53) == high


def test_choices():
    found = distribution({"choice": ["a", 2, None]}, "here")
    assert [found.at(u) for u in (0.0, 0.5, 0.999)] == ["a", 2, None]


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ("often", "is no distribution"),
        ({"unifrom": [1, 2]}, "did you mean 'uniform'"),
        ([5, 1], "low first"),
        ({"log_uniform": [0, 1]}, "positive"),
        ({"normal": [1, -1]}, "not negative"),
        ({"normal": [1]}, "standard deviation"),
        ({"choice": []}, "not empty"),
        ({"whole": [0.5, 2]}, "whole numbers"),
        ([float("nan"), 1], "no finite number"),
        ([True, 1], "no finite number"),
    ],
)
def test_what_is_no_distribution_is_told(data, told):
    with pytest.raises(InputError, match="parameters/p") as caught:
        CampaignSpec("panda_pick", {"p": data})
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"trials": 0}, "trials is 0"),
        ({"trials": True}, "trials is True"),
        ({"sampling": "sobol"}, "latin_hypercube"),
        ({"half_width": 0.7}, "below 0.5"),
        ({"max_seconds": -1.0}, "positive"),
        ({"values": {"p": 1}, "parameters": {"p": [0, 1]}}, "one or the other"),
        ({"values": {"p.q": 1}, "parameters": {"p": {"choice": [{"q": 2}]}}}, "p.q is a part of p"),
        ({"parameters": {"p.q.x": [0, 1], "p.q": {"choice": [[0, 0]]}}}, "p.q.x is a part of p.q"),
        ({"values": {"p.q.x": 1, "p": {}}}, "p.q.x is a part of p"),
        ({"values": {"p.x": 1}, "parameters": {"p.0": [0, 1]}}, "the same as"),
        ({"parameters": [1]}, "mapping"),
        ({"parameters": {5: [0, 1]}}, "mapping from paths"),
    ],
)
def test_what_cannot_be_asked_is_told(options, told):
    with pytest.raises(InputError) as caught:
        CampaignSpec("panda_pick", **options)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        ({"objects.cub.mass": [0.1, 1]}, "did you mean 'objects.cube.mass'"),
        ({"objects.cube.mass": [-1, 1]}, "mass"),
        ({"physics.timestep": [0, 0.002]}, "timestep"),
        ({"objects.cube.mass": {"choice": [0.1, -1, 0.2, 0.3, 0.4, 0.5]}}, "mass"),
        ({"settings.attempts": [1, 3]}, "{settings.attempts: {whole: [1, 3]}}"),
        ({"settings.attempts": [1.2, 3.9]}, "{settings.attempts: {whole: [2, 3]}}"),
        ({"settings.attempts": [1.2, 1.9]}, "give a whole number"),
    ],
)
def test_a_range_is_tried_on_the_cell_before_anything_runs(parameters, told):
    with pytest.raises(InputError) as caught:
        checked_cell(CampaignSpec("panda_pick", parameters))
    assert told in str(caught.value)


def test_a_part_of_a_value_may_vary():
    push = {"on": "panda_hand", "at": 1.0, "duration": 0.1, "force": [0, 1, 0]}
    paths = {"disturbances.pushes.bump.force.y": [0, 30], "disturbances.pushes.bump.force.x": [0, 3]}
    spec = CampaignSpec(
        "panda_pick", paths, values={"disturbances.pushes.bump": push, "objects.cube.mass": 0.1}
    )
    assert checked_cell(spec).disturbances.pushes[0].force == (0, 1, 0)
    checked_cell(CampaignSpec("panda_pick", {"settings.attempts": {"whole": [1, 3]}}))
    by_default = {"disturbances.moved.wall.by.y": [-0.1, 0.1], "disturbances.moved.wall.turn_deg": [-5, 5]}
    checked_cell(CampaignSpec("panda_pick", by_default))
    similar = {"objects.cube.mass": [0.1, 0.2], "objects.cube.mas": [1, 2]}  # no part of one another
    assert set(distributions(CampaignSpec("panda_pick", similar))) == set(similar)


def test_a_file(tmp_path):
    file = tmp_path / "c.yaml"
    file.write_text("cell: panda_pick\ntrials: 7\nparameters: {objects.cube.mass: {uniform: [0.1, 1]}}\n")
    spec = CampaignSpec.read(file)
    assert (spec.trials, spec.cell) == (7, "panda_pick") and "objects.cube.mass" in distributions(spec)
    for text, told in (("trials: 3\n", "has no cell"), ("cell: a\ntrails: 3\n", "did you mean 'trials'")):
        file.write_text(text)
        with pytest.raises(InputError, match=str(file)) as caught:
            CampaignSpec.read(file)
        assert told in str(caught.value)


def test_a_hypercube_meets_every_hundredth_once():
    draws = np.array([latin_hypercube_draw(3, k, 4) for k in range(2 * BLOCK)])
    for block in (draws[:BLOCK], draws[BLOCK:]):
        for column in block.T:
            assert sorted((column * BLOCK).astype(int)) == list(range(BLOCK))
    assert not np.array_equal(draws[:BLOCK], draws[BLOCK:])


def test_half_of_the_adaptive_draws_are_near_a_failure():
    failure = np.array([0.05, 0.98])
    draws = [adaptive_draw(1, k, [failure], 2) for k in range(400)]
    near = np.array([u for u, is_near in draws if is_near])
    assert 160 <= len(near) <= 240
    assert np.all((near >= 0) & (near < 1)) and np.abs(near - failure).mean() < 0.1
    assert np.array_equal(adaptive_draw(1, 5, [], 2)[0], random_draw(1, 5, 2))


def test_a_trial_does_not_depend_on_how_many_there_are():
    for sampling in ("random", "latin_hypercube"):
        few = CampaignSpec("panda_pick", {"padding": [0, 1]}, sampling=sampling, trials=5, seed=9)
        many = CampaignSpec("panda_pick", {"padding": [0, 1]}, sampling=sampling, trials=500, seed=9)
        assert trial(few, distributions(few), 3) == trial(many, distributions(many), 3)
        assert trial(few, distributions(few), 3).seed == 12
