"""Zeros between two places of different sign: the numbers of SciPy's own method, which takes longer."""

import numpy as np
import pytest
import scipy.optimize.elementwise

from monitor_core.models.poles import zeros_between

N = 40
CENTRES = np.random.default_rng(1).normal(0.0, 2.0, N)
FUNCTIONS = {
    "smooth": lambda x, i: np.sin(3.0 * x) - CENTRES[i] / 4.0,
    "flat": lambda x, i: (x - CENTRES[i]) ** 3,
    "jump": lambda x, i: np.where(x > CENTRES[i], 1.0, -1.0),
    "exact": lambda x, i: np.round(4.0 * x) - 1.0 + 0.0 * CENTRES[i],
    "partly none": lambda x, i: np.where(CENTRES[i] > 0.0, x - CENTRES[i], np.nan),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_zeros_are_those_of_scipy_to_the_bit(name):
    which = np.arange(N)
    low, high = np.full(N, -2.0), np.linspace(0.0, 3.0, N)
    function = FUNCTIONS[name]
    zeros = zeros_between(function, (low, high), (function(low, which), function(high, which)), which)
    tolerances = {"xrtol": 1e-15, "xatol": 0.0, "fatol": 0.0, "frtol": 0.0}
    expected = scipy.optimize.elementwise.find_root(function, (low, high), args=(which,), tolerances=tolerances)
    np.testing.assert_array_equal(zeros, expected.x)
    assert np.any(np.isfinite(zeros))


def test_no_interval_has_no_zero():
    none = np.zeros(0)
    assert zeros_between(FUNCTIONS["flat"], (none, none), (none, none), np.zeros(0, dtype=np.intp)).size == 0
