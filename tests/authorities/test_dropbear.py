"""DROPBEAR: a cantilever with a movable support, frequency against *measured* position. Real; made by others.

The closest public analogue of frequency against table position: 1/f² quadratic in the position is Eq. (8) of Nguyen et
al. (2018) at one preload. There is no excitation channel, so the frequencies are spectral peaks of the response.
"""

from pathlib import Path

import numpy as np
import pytest

from monitor_core.arrays import FloatArray
from monitor_core.preload.regression import weighted_least_squares

SAMPLE_RATE = 5000.0  # [Hz], from the header of the records
HALF_WINDOW = 250  # 50 ms: the support takes 0.1 s for a step of 0.4 V
STILL = 0.02  # the support's reading scatters by 1 mV, a step is 400 mV [V]


def dwells(position: FloatArray) -> list[slice]:
    """Where the support stands still for half a second or more, after a first move has made the beam ring."""
    sums = np.concatenate([[0.0], np.cumsum(position)])
    mean = (sums[HALF_WINDOW:] - sums[:-HALF_WINDOW]) / HALF_WINDOW
    still = np.abs(mean[HALF_WINDOW:] - mean[:-HALF_WINDOW]) < STILL
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    found = [slice(a, b + 2 * HALF_WINDOW - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [d for d in found if d.start > 0 and d.stop - d.start >= 0.5 * SAMPLE_RATE]


def spectral_peak(acceleration: FloatArray) -> float:
    """Highest line of the Hann spectrum from 18 to 60 Hz, refined by a parabola through its logarithm [Hz]."""
    n = acceleration.size
    spectrum = np.abs(np.fft.rfft((acceleration - acceleration.mean()) * np.hanning(n)))
    frequency = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE)
    band = np.flatnonzero((frequency > 18.0) & (frequency < 60.0))
    i = band[np.argmax(spectrum[band])]
    left, centre, right = np.log(spectrum[i - 1 : i + 2])
    shift = 0.5 * (left - right) / (left - 2.0 * centre + right)
    return float(frequency[i] + shift * frequency[1])


@pytest.fixture(scope="module")
def readings(measured_data: Path) -> FloatArray:
    """Rows of record number, support position [V], natural frequency [Hz]."""
    rows = []
    for record in range(7):
        path = measured_data / "dropbear" / f"slow10_test{record}.txt"
        acceleration, position = np.loadtxt(path, skiprows=9, usecols=(1, 2), unpack=True)
        rows += [(record, position[d].mean(), spectral_peak(acceleration[d])) for d in dwells(position)]
    return np.array(rows)


def test_every_record_dwells_ten_times_after_its_first_move(readings: FloatArray) -> None:
    assert np.bincount(readings[:, 0].astype(int)).tolist() == [10] * 7
    # six positions, passed out and back, 26 to 42 Hz
    assert np.unique(np.round(readings[:, 1], 1)).size == 6
    assert 26.0 < readings[:, 2].min() < readings[:, 2].max() < 42.5


def test_quadratic_of_position_predicts_the_records_it_has_not_seen(readings: FloatArray) -> None:
    record, position, frequency = readings.T
    design = np.column_stack([position**2, position, np.ones_like(position)])
    seen = record <= 4
    fit = weighted_least_squares(design[seen], frequency[seen] ** -2.0, np.ones(np.count_nonzero(seen)))
    error = frequency[~seen] - (design[~seen] @ fit.parameters.values) ** -0.5
    # 0.076 Hz when written; 0.1 Hz is a tenth of a spectral line (1.1 s dwells)
    assert error.std() <= 0.1
    assert abs(error.mean()) < 0.05


def test_a_straight_line_of_position_does_not(readings: FloatArray) -> None:
    record, position, frequency = readings.T
    design = np.column_stack([position, np.ones_like(position)])
    seen = record <= 4
    fit = weighted_least_squares(design[seen], frequency[seen] ** -2.0, np.ones(np.count_nonzero(seen)))
    assert (frequency[~seen] - (design[~seen] @ fit.parameters.values) ** -0.5).std() > 0.3
