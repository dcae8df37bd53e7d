"""Wilson's interval against scipy's and at its ends."""

from __future__ import annotations

import pytest
from scipy.stats import binomtest

from armcell.core.confidence_interval import wilson


@pytest.mark.parametrize("successes, trials", [(0, 8), (8, 8), (3, 10), (95, 100), (1, 1)])
def test_as_scipys(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(0.95, "wilson")
    assert wilson(successes, trials, z=1.959963984540054) == pytest.approx((expected.low, expected.high))


def test_nothing_known_and_nonsense():
    assert wilson(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError):
        wilson(3, 2)
