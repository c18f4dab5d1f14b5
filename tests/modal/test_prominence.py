"""Peaks and their prominences are those of SciPy, whatever the values are."""

import itertools

import numpy as np
import pytest
import scipy.signal

from monitor_core.modal.averaging import prominent_peaks

_RNG = np.random.default_rng(7)
_CASES = {
    "noise": _RNG.standard_normal(801),
    "walk": np.cumsum(_RNG.standard_normal(801)),
    "levels, so that many neighbours and many peaks are equal": np.round(_RNG.standard_normal(801)),
    "rising": np.arange(9.0),
    "flat": np.zeros(9),
    "flat top of two": np.array([0.0, 1.0, 1.0, 0.5, 1.0, 0.0]),
    "flat to the end": np.array([0.0, 1.0, 1.0]),
    "a line without response": np.array([-np.inf, 1.0, 0.0, 2.0, -np.inf]),
    "two values": np.array([1.0, 0.0]),
    "one value": np.array([1.0]),
    "none": np.empty(0),
}


def test_peaks_and_prominences_are_those_of_scipy(subtests: pytest.Subtests) -> None:
    for values, least in itertools.product(list(_CASES.values()), [0.0, 0.1, 2.5]):
        with subtests.test(values=values, least=least):
            expected, properties = scipy.signal.find_peaks(values, prominence=least)
            peaks, prominences = prominent_peaks(values, least)
            np.testing.assert_array_equal(peaks, expected)
            np.testing.assert_array_equal(prominences, properties["prominences"])
