"""The one preload of a session, on axes of finite elements whose days, places and readings are drawn apart."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from monitor_core.arrays import FloatArray
from monitor_core.preload import (
    Calibration,
    ModalReading,
    PreloadEstimate,
    calibrate,
    estimate_preload,
    session_preload,
)
from monitor_core.preload.fit import BETWEEN_SESSIONS
from monitor_core.recording import Conditions
from monitor_core.uncertainty import Estimate
from tests.plant.chain import natural_frequency

PLACES = np.linspace(0.2, 0.8, 6)
PRELOADS = (100.0, 200.0, 300.0, 400.0)
TEMPERATURES = (14.0, 17.0, 23.0, 26.0)
#: Of one reading beyond its stated uncertainty, of a fit, of a thermometer, of a home switch, of a lubrication.
SCATTER, OF_FIT, THERMOMETER, HOME, GREASE = 0.06, 0.02, 1.5, 2e-3, 7.5e-4  # [Hz], [Hz], [K], [m], [-]
HEALTHY = 300.0
SETTINGS = [(x, p, 20.0) for p in PRELOADS for x in PLACES] + [(0.5, HEALTHY, t) for t in TEMPERATURES]


@cache
def _frequencies_at_calibration() -> FloatArray:
    x, p, t = np.array(SETTINGS).T
    return natural_frequency(x, p, 0.0, t)


def _calibration(rng: np.random.Generator) -> Calibration:
    true = _frequencies_at_calibration()
    measured = true + SCATTER * rng.standard_normal(true.size)
    readings = [
        ModalReading(float(value), Conditions(place, 0.0, temperature, preload), OF_FIT)
        for value, (place, preload, temperature) in zip(measured, SETTINGS, strict=True)
    ]
    return calibrate(readings, weighting="none", excitation_source=None, between_sessions=BETWEEN_SESSIONS)


def _session(
    rng: np.random.Generator, calibration: Calibration, places: Sequence[float], of_fit: Sequence[float]
) -> list[PreloadEstimate]:
    """Measure on another day: its mounting, its temperature, its home switch and its grease are those of all places."""
    x = np.array(places) + HOME * rng.standard_normal()
    warmer = THERMOMETER * rng.standard_normal()
    f = natural_frequency(x, HEALTHY, 0.0, 20.0 + warmer)
    f *= 1.0 + BETWEEN_SESSIONS * rng.standard_normal() + GREASE * rng.standard_normal()
    f += np.hypot(SCATTER, of_fit) * rng.standard_normal(x.size)
    answers = [
        estimate_preload(Estimate(float(value), own), Conditions(place, 0.0, 20.0), calibration)
        for value, own, place in zip(f, of_fit, places, strict=True)
    ]
    return [answer for answer in answers if isinstance(answer, PreloadEstimate)]


def _drawn(n_axes: int, seed: int) -> tuple[float, float, float]:
    """Return how often the joint interval covers, and its width over that of one measurement, and over their best."""
    covered, widths = [], []
    for axis in range(n_axes):
        rng = np.random.default_rng([seed, axis])
        calibration = _calibration(rng)
        places = rng.uniform(0.2, 0.8, 5).round(3).tolist()
        estimates = _session(rng, calibration, places, rng.uniform(0.01, 0.3, 5).tolist())
        joint = session_preload(estimates, places, calibration)
        assert joint is not None
        covered.append(joint.interval.lower <= HEALTHY <= joint.interval.upper)
        single = [e.interval.upper - e.interval.lower for e in estimates]
        width = joint.interval.upper - joint.interval.lower
        widths.append((width / float(np.median(single)), width / min(single)))
    return float(np.mean(covered)), *np.mean(widths, axis=0).tolist()


def test_a_session_of_five_places_covers_and_is_narrower_than_one_of_them():
    covered, of_one, of_best = _drawn(40, 53118)
    assert covered >= 0.85  # of 40 intervals of .95, 5 or fewer miss in 98.6 % of all draws
    assert of_one < 0.9
    assert of_best < 1.0


@pytest.mark.release
def test_joint_intervals_cover_what_they_state():
    covered, _, _ = _drawn(400, 53119)
    assert 0.93 <= covered <= 0.99


def test_what_a_session_has_in_common_is_not_averaged_away():
    rng = np.random.default_rng(531)
    calibration = _calibration(rng)
    places = [0.5] * 40
    estimates = _session(rng, calibration, places, [0.02] * 40)
    joint = session_preload(estimates, places, calibration)
    single = estimates[0]
    assert joint is not None
    width, of_one = joint.interval.upper - joint.interval.lower, single.interval.upper - single.interval.lower
    # frequency is all that is new at a place that has been measured before
    assert width / joint.preload == pytest.approx(
        of_one / single.preload * (1.0 - single.shares.frequency) ** 0.5, rel=0.03
    )


def test_measurements_weigh_as_much_as_they_know():
    rng = np.random.default_rng(532)
    calibration = _calibration(rng)
    places, of_fit = [0.3, 0.5, 0.7, 0.701], [0.02, 0.5, 0.02, 0.02]
    joint = session_preload(_session(rng, calibration, places, of_fit), places, calibration)
    assert joint is not None
    alone, noisy, *together = joint.weights
    assert sum(joint.weights) == pytest.approx(1.0)
    assert noisy < 0.1 * alone
    assert max(together) < 0.7 * alone < sum(together) < 1.3 * alone


def test_one_measurement_is_no_session():
    rng = np.random.default_rng(533)
    calibration = _calibration(rng)
    estimates = _session(rng, calibration, [0.4], [0.05])
    assert session_preload(estimates, [0.4], calibration) is None
