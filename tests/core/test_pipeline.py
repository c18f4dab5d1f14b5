"""What the pipeline adds to its parts: which band, which level, and what is kept out of the charts."""

import itertools
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
import pytest

from monitor_core.axis_state import AxisState, advance, advance_estimate, scatter_with_history
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import (
    AxisSettings,
    calibrate_from_measurements,
    check_window,
    judge_measurement,
    measure_response,
)
from monitor_core.preload import (
    Calibration,
    ModalReading,
    PreloadEstimate,
    PreloadFeatureCoefficients,
    axial_frequency,
    calibrate,
    estimate_preload,
    systematic_uncertainty_between,
)
from monitor_core.recording import Conditions, Rejection, RejectionReason, Window
from monitor_core.recordings import read_session
from monitor_core.trend import DetectorDesign, DetectorSettings, LossDirection, design_detector, reset
from monitor_core.uncertainty import Estimate
from tests.conftest import PROJECT_ROOT

SETTINGS = AxisSettings(search_band=(140.0, 230.0))
#: Refit of Nguyen's Table 2: the axis that is simulated where no waveform is needed.
TRUTH = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)


@cache
def charts() -> DetectorDesign:
    return design_detector(DetectorSettings(loss=LossDirection.RISE))


def simulated_calibration(rng: np.random.Generator) -> Calibration:
    """Five positions by five preloads with 0.03 Hz of scatter, 0.02 Hz of it stated."""
    readings = [
        ModalReading(
            float(axial_frequency(x, preload, TRUTH)) + rng.normal(0.0, 0.03), Conditions(x, 0.0, 22.0, preload), 0.02
        )
        for x in (0.15, 0.32, 0.5, 0.67, 0.85)
        for preload in (50.0, 100.0, 170.0, 270.0, 400.0)
    ]
    return calibrate(readings, weighting="none", excitation_source=None)


@pytest.fixture(scope="module")
def measurements() -> list[tuple[Window, ...]]:
    session = read_session(PROJECT_ROOT / "replay_data" / "calibration.session.h5")
    return [session.windows_of(name) for name in session.measurements[:30]]


@pytest.fixture(scope="module")
def calibration(measurements: list[tuple[Window, ...]]) -> Calibration:
    modes = [judge_measurement(windows, SETTINGS, None).modal for windows in measurements]
    return calibrate_from_measurements([m for m in modes if isinstance(m, ModalMeasurement)], settings=SETTINGS)


def refusal_of(window: Window, calibration: Calibration | None) -> RejectionReason | None:
    outcome = check_window(window, SETTINGS, calibration)
    return outcome.reason if isinstance(outcome, Rejection) else None


def test_a_standstill_is_refused_for_little_excitation(measurements, calibration) -> None:
    window = measurements[0][0]
    quiet = np.random.default_rng(1).normal(0.0, 1e-3, window.n_samples)
    assert refusal_of(window, calibration) is None
    assert refusal_of(replace(window, excitation=quiet), calibration) is RejectionReason.LITTLE_EXCITATION


def test_every_window_of_the_calibration_has_the_level_it_asks_for(measurements, calibration) -> None:
    assert {refusal_of(window, calibration) for windows in measurements for window in windows} == {None}


def test_a_rate_too_low_for_the_band_is_refused_by_name(measurements) -> None:
    slow = [replace(window, sample_rate=400.0) for window in measurements[0]]
    assert refusal_of(slow[0], None) is RejectionReason.SAMPLE_RATE_MISMATCH
    refusal = judge_measurement(slow, SETTINGS, None).refusal  # windows that another calibration was in force for
    assert refusal is not None
    assert refusal.reason is RejectionReason.SAMPLE_RATE_MISMATCH


def test_another_payload_needs_its_moving_mass(measurements, calibration) -> None:
    loaded = [replace(w, conditions=replace(w.conditions, payload_mass=5.0)) for w in measurements[20]]
    outcome = judge_measurement(loaded, SETTINGS, calibration)
    # all 30 readings were taken with an empty table, so the calibration knows no moving mass
    assert outcome.refusal is not None
    assert outcome.refusal.reason in (RejectionReason.OUTSIDE_CALIBRATION, RejectionReason.NO_PEAK_IN_BAND)


def test_a_preload_set_on_purpose_never_enters_the_charts(measurements, calibration) -> None:
    outcome = judge_measurement(measurements[0], SETTINGS, calibration)
    assert isinstance(outcome.preload, PreloadEstimate)
    at = measurements[0][0].started_at
    assert advance(AxisState(), outcome, at, calibration=calibration, design=charts()) == AxisState()


def test_errors_of_the_fitted_model_do_not_blind_charts_without_a_calibration(measurements) -> None:
    """They are the same in each measurement: 0.2 Hz of them hide no fall by five of the 0.02 Hz that sessions scatter.

    The interval of a measurement holds them all the same.
    """
    rng, state, start = np.random.default_rng(12), AxisState(), datetime(2025, 1, 1, tzinfo=UTC)
    outcome = judge_measurement([unset(window) for window in measurements[0]], SETTINGS, None)
    modal = outcome.modal
    assert isinstance(modal, ModalMeasurement)
    healthy, fallen = 40, 20
    for day in range(healthy + fallen):
        frequency = Estimate(180.0 + rng.normal(0.0, 0.02) - 0.1 * (day >= healthy), 0.2)
        mode = replace(modal.mode, frequency=frequency)
        of_day = replace(outcome, modal=replace(modal, mode=mode, random_uncertainty=0.005))
        state = advance(state, of_day, start + timedelta(days=day), calibration=None, design=charts())
        if day == healthy - 1:
            assert state.detector.baseline is not None
            assert state.detector.alarm is None
    assert state.detector.alarm is not None
    assert state.detector.alarm.onset >= start + timedelta(days=healthy - 1)


def unset(window: Window) -> Window:
    """Return a window whose preload nobody has set."""
    return replace(window, conditions=replace(window.conditions, preload=None))


@pytest.mark.release
def test_false_alarms_of_the_whole_road_agree_with_the_design_rate() -> None:
    """A hundred axis-years of healthy frequencies at random places through calibration, estimate and charts.

    Each axis has its own calibration, so that errors of k1 and k2, common to all its measurements, are in. The count
    may differ from 100 by the Poisson scatter, widened by the dispersion of 1.4 that misjudged baselines cause
    (``tests/trend/test_detector.py``): 1.96·√140 = 23.
    """
    rng = np.random.default_rng(30)
    alarms = 0
    for _ in range(100):
        calibration = simulated_calibration(rng)
        state, start = AxisState(), datetime(2025, 1, 1, tzinfo=UTC)
        healthy_days = 0
        for day in itertools.count():
            x = rng.uniform(0.25, 0.75)
            frequency = float(axial_frequency(x, 300.0, TRUTH)) + rng.normal(0.0, 0.03)
            conditions = Conditions(x, 0.0, 22.0)
            estimate = estimate_preload(Estimate(frequency, 0.02), conditions, calibration)
            assert isinstance(estimate, PreloadEstimate)
            watching = state.detector.baseline is not None
            state = advance_estimate(
                state, estimate, conditions, start + timedelta(days=day), calibration=calibration, design=charts()
            )
            healthy_days += watching
            if state.detector.alarm is not None:
                alarms += 1
                state = AxisState(detector=reset(state.detector))
            if healthy_days == 365:
                break
    assert abs(alarms - 100) <= 23


def test_dead_zone_opens_only_where_the_baseline_has_not_been() -> None:
    calibration, feature = simulated_calibration(np.random.default_rng(4)), 2.9e-6

    def doubt(position: float, baseline: list[float]) -> float:
        places = [Conditions(x, 0.0, 22.0) for x in baseline]
        return systematic_uncertainty_between(feature, Conditions(position, 0.0, 22.0), places, calibration)

    at_one_place, all_over = [0.3] * 5, [0.2, 0.35, 0.5, 0.65, 0.8]
    assert doubt(0.3, at_one_place) == 0.0
    assert 0.0 < doubt(0.4, at_one_place) < doubt(0.8, at_one_place)
    # its scatter holds the errors of k1 and k2 already, so they are not counted again
    assert [doubt(x, all_over) for x in all_over] == [0.0] * 5
    assert doubt(1.2, all_over) > 0.0


def test_history_takes_the_place_of_what_was_declared_but_not_where_a_temperature_has_jumped() -> None:
    rng, start = np.random.default_rng(5), datetime(2025, 1, 1, tzinfo=UTC)
    k_t = 1e-8
    readings = [
        ModalReading(float(axial_frequency(x, p, TRUTH)) + rng.normal(0.0, 0.01), Conditions(x, 0.0, 22.0, p), 0.01)
        for x in (0.15, 0.32, 0.5, 0.67, 0.85)
        for p in (50.0, 100.0, 170.0, 270.0, 400.0)
    ]
    calibration = calibrate(
        readings, weighting="none", excitation_source=None, between_sessions=3e-4,
        temperature_coefficient=Estimate(k_t, 1e-10),
    )  # fmt: skip
    state, winter = AxisState(), Conditions(0.5, 0.0, 14.0)
    frequency = (float(axial_frequency(0.5, 300.0, TRUTH)) ** -2.0 - 8.0 * k_t) ** -0.5
    estimate = estimate_preload(Estimate(frequency, 0.01), winter, calibration)
    assert isinstance(estimate, PreloadEstimate)
    declared = estimate.feature_scatter
    assert scatter_with_history(state, start, winter, declared, calibration, amplification=1.0) is None
    for day in range(60):
        scattered = Estimate(frequency + rng.normal(0.0, 0.02), 0.01)
        of_day = estimate_preload(scattered, winter, calibration)
        assert isinstance(of_day, PreloadEstimate)
        at = start + timedelta(days=day)
        state = advance_estimate(state, of_day, winter, at, calibration=calibration, design=charts())
    later = start + timedelta(days=60)
    # eight kelvin below the calibration's for two months: the structure has followed
    steady = scatter_with_history(state, later, winter, declared, calibration, amplification=1.0)
    hot = Conditions(0.5, 0.0, 30.0)  # as far from the calibration's, and sixteen kelvin from the day before
    jumped = scatter_with_history(state, later, hot, declared, calibration, amplification=1.0)
    much_later = later + timedelta(days=30)
    after_a_stop = scatter_with_history(state, much_later, winter, declared, calibration, amplification=1.0)
    # what the structure no longer lags behind is 8 K at 45 %, and the half kelvin or so that yesterday's air leaves; of
    # an amplified budget it is amplified alike
    k_part = k_t * math.sqrt((0.45 * 8.0) ** 2 + 1.5**2 - 1.0**2)
    base = math.sqrt(declared**2 - k_part**2)
    amplified = math.hypot(base, 1.1 * k_part)
    same = scatter_with_history(state, later, winter, amplified, calibration, amplification=1.1)
    assert same == pytest.approx(steady, rel=1e-6)
    assert steady is not None
    assert jumped is not None
    assert after_a_stop is not None
    assert steady < 0.75 * declared
    assert after_a_stop > 1.2 * steady
    assert jumped > 1.2 * steady


def ringing(modes: list[tuple[float, float]], template: tuple[Window, ...]) -> list[Window]:
    """Return windows of white excitation of an axis with modes of 2 % damping, at frequencies with amplitudes."""
    rng, n, rate = np.random.default_rng(1), template[0].n_samples, template[0].sample_rate
    omega = 2.0 * np.pi * np.fft.rfftfreq(2 * n, 1.0 / rate)
    accelerance = sum(
        -amplitude * omega**2 / ((2.0 * np.pi * f) ** 2 - omega**2 + 0.04j * 2.0 * np.pi * f * omega)
        for f, amplitude in modes
    )
    made = []
    for window in template:
        excitation = rng.standard_normal(2 * n)
        response = np.fft.irfft(np.fft.rfft(excitation) * accelerance, 2 * n)[n:]
        noise = 0.3 * np.std(response) * rng.standard_normal(n)
        made.append(replace(window, excitation=excitation[n:], response=response + noise))
    return made


def test_response_has_all_lines_though_its_mode_is_looked_for_in_a_band(measurements) -> None:
    """Two close modes above the band, which nobody wants, refuse the measurement where no band says so."""
    windows = ringing([(180.0, 1.0), (350.0, 1.0), (358.0, 1.0)], measurements[0])
    banded, free = (measure_response(windows, AxisSettings(search_band=band)) for band in ((140.0, 230.0), None))
    assert isinstance(banded, ModalMeasurement)
    assert banded.mode.frequency.value == pytest.approx(180.0, abs=0.5)
    lines, rate = banded.frequency_response.frequency, windows[0].sample_rate
    assert lines[0] == pytest.approx(0.02 * rate, abs=2.0)
    assert lines[-1] == pytest.approx(0.4 * rate, abs=2.0)
    assert isinstance(free, Rejection)
