"""A measurement as a whole: what it is made from, what it refuses, and what it says."""

import itertools
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import scipy.stats

from monitor_core.errors import InvalidWindowError, NotIdentifiableError, OutsideValidityError
from monitor_core.modal import ModalMeasurement, ModeGate, PhaseReference, calibrate_phase, measure_mode
from monitor_core.modal.gates import averages_needed
from monitor_core.recording import (
    Conditions,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    Window,
)
from monitor_core.response import ModalParameters
from monitor_core.spectral import random_error
from monitor_core.uncertainty import Estimate
from tests.modal.simulated_axis import RATE, clean_windows

BAND = (120.0, 240.0)
GATE = ModeGate()
START = datetime(2026, 2, 3, 8, 0, tzinfo=UTC)


def windows_of(seed=1, modes=((175.0, 0.02, 1.0),), n_windows=15, noise=0.02, **settings):
    rng = np.random.default_rng(seed)
    torque, response = clean_windows(rng, list(modes), n_windows)
    response = response + noise * rng.standard_normal(response.shape)
    return [
        Window(
            torque[i],
            response[i],
            RATE,
            START + timedelta(seconds=3 * i),
            Conditions(position=0.4 + 1e-4 * i, payload_mass=5.0, temperature=20.0 + 0.1 * i),
            "m-7",
            **settings,
        )
        for i in range(n_windows)
    ]


def measured(windows, **settings):
    outcome = measure_mode(windows, **({"band": BAND, "gate": GATE} | settings))
    assert isinstance(outcome, ModalMeasurement), outcome
    return outcome


def assert_refused(windows, reason, **settings):
    outcome = measure_mode(windows, **({"band": BAND, "gate": GATE} | settings))
    assert isinstance(outcome, Rejection), outcome
    assert outcome.reason is reason, outcome


def test_a_good_measurement_says_what_it_rests_on():
    result = measured(windows_of())
    error = result.mode.frequency.value - 175.0
    assert abs(error) < 4.0 * result.mode.frequency.standard_uncertainty < 0.2
    assert result.mode.damping_ratio.value == pytest.approx(0.02, rel=0.05)
    assert result.coherence > 0.95
    assert result.n_averages == 15.0
    assert (result.n_modes, result.tones, result.refused_windows) == (1, (), ())
    assert result.conditions.position == pytest.approx(0.4007)
    assert result.conditions.payload_mass == 5.0
    assert result.conditions.temperature == pytest.approx(20.7)
    assert result.conditions.preload is None
    assert (result.started_at, result.measurement) == (START, "m-7")
    assert result.excitation_source is ExcitationSource.SENSOR
    response = result.frequency_response
    assert response.quantity == "torque_accelerance"
    assert (response.frequency[0], response.frequency[-1]) == BAND
    assert any("not calibrated" in warning for warning in result.warnings)


def test_a_force_makes_an_accelerance():
    result = measured(windows_of(excitation_quantity=ExcitationQuantity.FORCE))
    assert result.frequency_response.quantity == "accelerance"


def test_single_precision_gives_the_same_frequency():
    windows = windows_of()
    single = [
        replace(w, excitation=w.excitation.astype(np.float32), response=w.response.astype(np.float32)) for w in windows
    ]
    double = measured(windows).mode.frequency
    assert measured(single).mode.frequency.value == pytest.approx(double.value, abs=0.01 * double.standard_uncertainty)


def test_the_unit_of_neither_channel_matters():
    windows = windows_of()
    scaled = [replace(w, excitation=w.excitation * 1e-3, response=w.response * 1e4) for w in windows]
    first, second = measured(windows).mode, measured(scaled).mode
    assert second.frequency.value == pytest.approx(first.frequency.value, rel=1e-9)
    assert second.frequency.standard_uncertainty == pytest.approx(first.frequency.standard_uncertainty, rel=1e-5)
    assert second.residue == pytest.approx(1e7 * first.residue, rel=1e-6)


def test_too_few_windows():
    assert_refused(windows_of(n_windows=1), RejectionReason.TOO_FEW_AVERAGES)
    assert_refused([], RejectionReason.TOO_FEW_AVERAGES)
    assert_refused(windows_of(n_windows=7), RejectionReason.TOO_FEW_AVERAGES, gate=ModeGate(minimum_averages=8))
    with pytest.raises(OutsideValidityError, match="one average is never judged"):
        ModeGate(minimum_averages=1)


@pytest.mark.parametrize("n_windows", [3, 5])
def test_few_windows_of_high_coherence_are_enough_and_their_intervals_cover(n_windows):
    results = [measured(windows_of(seed=seed, n_windows=n_windows)) for seed in range(40)]
    assert min(result.coherence for result in results) > 0.9
    reach = [
        scipy.stats.t.ppf(0.975, f.degrees_of_freedom) * f.standard_uncertainty
        for f in (result.mode.frequency for result in results)
    ]
    covered = [abs(result.mode.frequency.value - 175.0) < limit for result, limit in zip(results, reach, strict=True)]
    # 40 trials: 95 % less three standard deviations of 3.4 %
    assert np.mean(covered) > 0.84


def test_few_windows_of_middling_coherence_are_too_few_and_many_are_not():
    gate = ModeGate(maximum_random_error=0.12, maximum_outlying_share=0.0)
    windows = windows_of(n_windows=60, noise=1.0)
    assert_refused(windows[:6], RejectionReason.TOO_FEW_AVERAGES, gate=gate)
    assert measured(windows, gate=gate).coherence < 0.9


@pytest.mark.parametrize("coherence", [0.3, 0.6, 0.9, 0.99])
def test_number_of_averages_needed_reaches_the_error_that_is_asked_for(coherence):
    gate = ModeGate(maximum_random_error=0.1)
    # of so many averages that the coherence has no bias left
    needed = averages_needed(coherence, 1e9, gate)
    assert random_error(coherence, needed) <= 0.1
    assert needed == gate.minimum_averages or random_error(coherence, needed - 1) > 0.1
    assert averages_needed(coherence, 4, gate) >= needed


def test_no_number_of_averages_is_enough_without_coherence():
    assert averages_needed(0.2, 5, GATE) == averages_needed(0.1, 5, GATE) == 1000


def test_windows_that_do_not_go_together():
    windows = windows_of()
    other_rate = [*windows[:-1], replace(windows[-1], sample_rate=2 * RATE)]
    assert_refused(other_rate, RejectionReason.SAMPLE_RATE_MISMATCH)
    shorter = replace(windows[-1], excitation=windows[-1].excitation[:-1], response=windows[-1].response[:-1])
    assert_refused([*windows[:-1], shorter], RejectionReason.LENGTH_MISMATCH)
    other_source = [*windows[:-1], replace(windows[-1], excitation_source=ExcitationSource.DRIVE)]
    assert_refused(other_source, RejectionReason.EXCITATION_SOURCE_MISMATCH)


def test_no_mode_in_the_band():
    rng = np.random.default_rng(2)
    unrelated = [replace(w, response=rng.standard_normal(w.n_samples)) for w in windows_of()]
    assert_refused(unrelated, RejectionReason.NO_PEAK_IN_BAND)
    with pytest.raises(OutsideValidityError, match="half the sampling rate"):
        measure_mode(windows_of(), band=(120.0, 1200.0), gate=GATE)


def test_a_band_between_two_lines_holds_no_peak():
    assert_refused(windows_of(), RejectionReason.NO_PEAK_IN_BAND, band=(175.1, 175.2))


def test_low_coherence_is_refused_and_middling_coherence_warned_about():
    assert_refused(windows_of(noise=1.5), RejectionReason.LOW_COHERENCE, gate=ModeGate(minimum_coherence=0.9))
    result = measured(windows_of(), gate=ModeGate(warn_coherence=0.9999))
    assert any("mean coherence" in warning for warning in result.warnings)


def test_frequency_that_is_not_known_well_enough():
    gate = ModeGate(maximum_frequency_uncertainty=1e-6)
    assert_refused(windows_of(), RejectionReason.UNCERTAIN_FREQUENCY, gate=gate)


@pytest.mark.parametrize(("other", "leaves"), [((), False), (((181.0, 0.02, 0.3),), True)])
def test_fit_of_one_mode_says_whether_it_leaves_what_the_excitation_explains(other, leaves):
    modes = ((175.0, 0.02, 1.0), *other)
    assert [measured(windows_of(seed=seed, modes=modes), maximum_modes=1).leaves_response for seed in range(5)] == 5 * [
        leaves
    ]


def test_two_overlapping_modes_of_like_height():
    modes = ((175.0, 0.01, 1.0), (181.0, 0.01, 0.9))
    assert_refused(windows_of(modes=modes, n_windows=30), RejectionReason.AMBIGUOUS_MODES)
    # A band that ends between the two says which is meant.
    result = measured(windows_of(modes=modes, n_windows=30), band=(120.0, 178.0))
    assert result.mode.frequency.value == pytest.approx(175.0, abs=0.3)
    assert result.n_modes == 2


def test_a_null_of_the_excitation_makes_no_mode():
    # The torque hardly holds anything near 210 Hz; noise on the response makes a high false peak of H1 there.
    windows = []
    for w in windows_of(n_windows=30, noise=0.05):
        spectrum = np.fft.rfft(w.excitation)
        frequency = np.fft.rfftfreq(w.n_samples, 1.0 / RATE)
        spectrum[np.abs(frequency - 210.0) < 1.0] *= 1e-3
        windows.append(replace(w, excitation=np.fft.irfft(spectrum, w.n_samples)))
    result = measured(windows)
    frf = result.frequency_response
    assert frf.frequency[np.argmax(np.abs(frf.response))] == pytest.approx(210.0, abs=1.5)
    assert result.mode.frequency.value == pytest.approx(175.0, abs=0.3)


@pytest.mark.parametrize("bad", [[3], [0, 9]])
def test_bad_impacts_are_named_and_do_not_move_the_result(bad):
    windows = windows_of()
    expected = measured([w for i, w in enumerate(windows) if i not in bad])
    for i in bad:
        windows[i] = replace(windows[i], response=-windows[i].response)
    result = measured(windows)
    assert [i for i, _ in result.refused_windows] == bad
    assert all(refusal.reason is RejectionReason.OUTLYING_WINDOW for _, refusal in result.refused_windows)
    assert result.n_averages == 15.0 - len(bad)
    assert result.mode.frequency.value == pytest.approx(expected.mode.frequency.value, abs=1e-9)


def test_windows_that_have_not_settled_are_said(monkeypatch):
    # A window half as high again: too near its fellows for the first look, but not for the first fit.
    windows = windows_of()
    windows[4] = replace(windows[4], response=1.5 * windows[4].response)
    result = measured(windows)
    assert [i for i, _ in result.refused_windows] == [4]
    assert not any("settled" in warning for warning in result.warnings)
    monkeypatch.setattr("monitor_core.modal.averaging._PASSES", 1)
    hasty = measured(windows)
    assert hasty.refused_windows == ()
    assert any("not settled in 1 passes: 15 of 15 are kept" in warning for warning in hasty.warnings)


def test_a_fit_that_the_lines_cut_short_says_so():
    # ± 8 ζ f are ± 84 Hz; a band up to 180 Hz brings lines up to 225 Hz only.
    windows = windows_of(modes=((175.0, 0.06, 1.0),))
    cut = [warning for warning in measured(windows, band=(120.0, 180.0)).warnings if "were wanted" in warning]
    assert len(cut) == 1
    assert "to 225" in cut[0]
    wide = measured(windows, band=(60.0, 300.0))
    assert not any("were wanted" in warning for warning in wide.warnings)


def test_conditions_must_be_finite(subtests):
    for value, name in itertools.product(
        [math.inf, -math.inf, math.nan], ["position", "payload_mass", "temperature", "preload"]
    ):
        refused = pytest.raises(InvalidWindowError, match=f"{name} must be finite")
        with subtests.test(value=value, name=name), refused:
            Conditions(**({"position": 0.4} | {name: value}))


def test_strong_and_weak_windows_are_not_outlying():
    windows = windows_of(n_windows=30)
    scale = np.random.default_rng(5).uniform(0.2, 5.0, 30)
    varied = [
        replace(w, excitation=k * w.excitation, response=k * w.response) for w, k in zip(windows, scale, strict=True)
    ]
    assert measured(varied).refused_windows == ()


def test_half_the_windows_cannot_be_outlying():
    windows = windows_of(n_windows=16)
    mixed = [replace(w, response=-w.response) if i % 2 else w for i, w in enumerate(windows)]
    outcome = measure_mode(mixed, band=BAND, gate=GATE)
    assert isinstance(outcome, Rejection)
    assert outcome.reason in (RejectionReason.LOW_COHERENCE, RejectionReason.NO_PEAK_IN_BAND)


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("samples_late", [0, 1, 2])
def test_phase_is_calibrated_once_and_then_judged(polarity, samples_late):
    def wired(seed):
        return [
            replace(w, response=polarity * np.roll(w.response, samples_late))
            for w in windows_of(seed=seed, n_windows=20)
        ]

    reference = calibrate_phase([measured(wired(seed)).mode for seed in (1, 2)])
    assert reference.polarity == polarity
    # The torque is held between samples: half a sample on top.
    assert reference.delay == pytest.approx((samples_late + 0.5) / RATE, abs=0.1 / RATE)
    result = measured(wired(3), phase=reference)
    assert not any("phase" in warning for warning in result.warnings)
    assert_refused(wired(3), RejectionReason.WRONG_PHASE, phase=PhaseReference(-reference.polarity, reference.delay))


def mode_with_phase(frequency, phase):
    residue = complex(math.cos(phase), math.sin(phase))
    return ModalParameters(Estimate(frequency, 0.01), Estimate(0.02, 1e-4), 0.0, residue)


def test_phase_reference_takes_the_smaller_of_the_two_delays():
    # −120° may be a delay of a third of a period, or the other polarity leading by a sixth.
    reference = calibrate_phase([mode_with_phase(180.0, math.radians(-120.0))])
    assert reference.polarity == -1
    assert reference.delay == pytest.approx(-1.0 / 6.0 / 180.0)
    with pytest.raises(NotIdentifiableError):
        calibrate_phase([mode_with_phase(180.0, 0.0), mode_with_phase(180.0, math.pi)])
    with pytest.raises(NotIdentifiableError):
        calibrate_phase([])


def test_conditions_that_differ_are_said():
    windows = windows_of()
    heavier = replace(windows[0], conditions=replace(windows[0].conditions, payload_mass=6.0))
    assert any("payload_mass differs" in warning for warning in measured([heavier, *windows[1:]]).warnings)
    unstated = replace(windows[0], conditions=replace(windows[0].conditions, temperature=None))
    result = measured([unstated, *windows[1:]])
    assert result.conditions.temperature is None
    assert any("temperature is stated for 14 of 15" in warning for warning in result.warnings)
