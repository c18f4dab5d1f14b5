"""Zeros by their number: those of Bessel functions, as SciPy tabulates them, from wherever the search starts."""

import numpy as np
import pytest
from scipy.special import jn_zeros, jv, jvp

from monitor_core.models.poles import NumberedZeros, numbered_zeros

N_ORDERS, N_ZEROS = 6, 12
TABLE = np.array([jn_zeros(order, N_ZEROS) for order in range(N_ORDERS)])
HIGHEST = 38.0  # some orders have eleven zeros below, some ten or fewer


def count(place, which):
    return np.sum(TABLE[which] < place[:, None], axis=1)


def look(place, which):
    return count(place, which), jv(which, place) / jvp(which, place)


def sought():
    below = [int(np.sum(zeros < HIGHEST)) for zeros in TABLE]
    which = np.repeat(np.arange(N_ORDERS), below)
    number = np.concatenate([np.arange(1, n + 1) for n in below])
    zeros = NumberedZeros(which, number, np.full(which.size, 1e-3), np.full(which.size, HIGHEST))
    return zeros, TABLE[which, number - 1]


@pytest.mark.parametrize(
    "start",
    [
        lambda zeros, rng: zeros * (1.0 + 1e-3 * rng.standard_normal(zeros.size)),
        lambda zeros, _: zeros,
        lambda zeros, _: np.roll(zeros, 1),  # each where the one before it is
        lambda zeros, rng: rng.permutation(zeros),
        lambda zeros, rng: rng.uniform(0.0, HIGHEST, zeros.size),
        lambda zeros, _: np.full(zeros.size, np.nan),
        lambda zeros, _: np.full(zeros.size, 10.0),
    ],
)
def test_zeros_are_those_of_the_table_wherever_the_search_starts(start) -> None:
    zeros, expected = sought()
    found = numbered_zeros(look, count, zeros, start(expected, np.random.default_rng(2)))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("apart", [0.0, 1e-13, 1e-7, 1e-3])
def test_zeros_that_meet_are_found_both(apart) -> None:
    """Two that cross: nothing but the count tells that there are two, and a slope leads to neither from between."""
    at = np.array([1.0, 2.0, 2.0 + apart, 4.0])

    def values(place, _):
        differences = place[:, None] - at
        with np.errstate(divide="ignore"):
            return np.sum(at < place[:, None], axis=1), 1.0 / np.sum(1.0 / differences, axis=1)

    zeros = NumberedZeros(np.zeros(4, dtype=np.intp), np.arange(1, 5), np.full(4, 0.1), np.full(4, 5.0))
    found = numbered_zeros(values, lambda x, which: values(x, which)[0], zeros, np.array([1.1, 1.9, 2.1, 3.0]))
    np.testing.assert_allclose(found, at, rtol=1e-9)
