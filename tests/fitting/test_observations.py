"""Records of what was measured cannot exist in a wrong state."""

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.observations import (
    FrequencyResponseObservation,
    ModalObservation,
    conditions_in_order,
)
from monitor_core.models.protocol import DriveConditions
from tests.identification import tian

AT = DriveConditions(1.0)


def test_tian_s_table_is_read_whole():
    table = tian.measured(*tian.POSITIONS)
    assert len(table) == 23  # six positions, four orders, order 3 of l4 blank
    assert sum(observation.amplitude is not None for observation in table) == 12
    first = table[0]
    assert (first.frequency, first.amplitude, first.order) == (24.0, pytest.approx(2.44e-7), 1)
    assert [conditions.position for conditions in conditions_in_order(reversed(table))] == sorted(
        tian.POSITIONS.values()
    )


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"frequency": 0.0}, "frequency must be positive and finite; got 0.0 Hz"),
        ({"frequency": float("nan")}, "frequency must be positive"),
        ({"frequency": 24.0, "amplitude": -1e-7}, "amplitude must be positive and finite; got -1e-07 m/N"),
        ({"frequency": 24.0, "amplitude_uncertainty": 1e-8}, "an amplitude must be stated with its uncertainty"),
        ({"frequency": 24.0, "frequency_uncertainty": 0.0}, "frequency_uncertainty must be positive"),
        ({"frequency": 24.0, "order": 0}, "order must count from 1"),
    ],
)
def test_impossible_peaks_are_refused(values, sentence):
    with pytest.raises(OutsideValidityError, match=sentence):
        ModalObservation(AT, **values)


@pytest.mark.parametrize(
    ("frequency", "response", "deviation", "sentence"),
    [
        ([1.0, 2.0], [1.0], [1.0, 1.0], "must be of one length"),
        ([2.0, 1.0], [1.0, 1.0], [1.0, 1.0], "positive, finite and rising"),
        ([0.0, 1.0], [1.0, 1.0], [1.0, 1.0], "positive, finite and rising"),
        ([1.0, 2.0], [1.0, np.nan], [1.0, 1.0], "a response must be finite"),
        ([1.0, 2.0], [1.0, 1.0], [1.0, 0.0], "standard_deviation must be positive"),
        ([], [], [], "at least 1"),
    ],
)
def test_impossible_responses_are_refused(frequency, response, deviation, sentence):
    with pytest.raises(OutsideValidityError, match=sentence):
        FrequencyResponseObservation(AT, np.array(frequency), np.array(response), np.array(deviation))


@pytest.mark.parametrize("resolution", [-1.0, np.inf, np.nan])
def test_an_impossible_resolution_is_refused(resolution):
    lines = np.array([1.0, 2.0])
    with pytest.raises(OutsideValidityError, match="resolution must be finite and not negative"):
        FrequencyResponseObservation(AT, lines, lines, lines, resolution=resolution)


def test_a_record_keeps_its_own_copy():
    frequency = np.array([1.0, 2.0])
    observation = FrequencyResponseObservation(AT, frequency, np.array([1.0, 1j]), np.array([0.1, 0.1]))
    frequency[0] = 5.0
    assert observation.frequency[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        observation.response[0] = 0.0
