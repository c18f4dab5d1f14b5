"""What is refused before any averaging, and what must not be."""

from datetime import UTC, datetime

import numpy as np
import pytest
import scipy.signal

from monitor_core.quality import QualityGate, gate_window
from monitor_core.recording import Conditions, ExcitationQuantity, Rejection, RejectionReason, Window

RATE, N_SAMPLES = 2000.0, 2000
BAND = (120.0, 240.0)


def window(excitation, response, *, rate=RATE, quantity=ExcitationQuantity.TORQUE, span=0.0, trace=None):
    return Window(
        excitation,
        response,
        rate,
        datetime(2026, 1, 5, tzinfo=UTC),
        Conditions(position=0.4),
        "m-1",
        quantity,
        position_span=span,
        position_trace=trace,
    )


def move(*, noise=0.0, at=500, n_samples=N_SAMPLES):
    """Torque pulses of a short move and the ringing they leave, at rest before; noise-free unless told."""
    torque = np.zeros(n_samples)
    torque[at : at + 12] += 0.4
    torque[at + 60 : at + 72] -= 0.4
    mode = scipy.signal.cont2discrete(([2.0, 0, 0], [1, 2 * 0.02 * 1100, 1100**2]), 1.0 / RATE)
    response = scipy.signal.lfilter(mode[0].ravel(), mode[1], torque)
    rng = np.random.default_rng(0)
    return torque + noise * rng.standard_normal(n_samples), response + noise * rng.standard_normal(n_samples)


def quantised(samples, step):
    return np.round(samples / step) * step


def assert_refused(w, reason, gate=None, band=None):
    outcome = gate_window(w, gate or QualityGate(), band=band)
    assert isinstance(outcome, Rejection), outcome
    assert outcome.reason is reason
    assert outcome.detail


def assert_passes(w, gate=None, band=None):
    outcome = gate_window(w, gate or QualityGate(), band=band)
    assert outcome is None, outcome


def test_a_noise_free_move_from_rest_passes():
    # Exact zeros for a quarter of the window, in both channels.
    assert_passes(window(*move()), band=BAND)


@pytest.mark.parametrize("step", [1e-4, 1e-2, 0.1, 0.3])
def test_coarsely_quantised_records_pass(step):
    # A response of ±1 to 2 m/s² down to a handful of steps: long silences and flat crests are then honest.
    torque, response = move(noise=1e-3)
    assert_passes(window(quantised(torque, step), quantised(response, step)))


@pytest.mark.parametrize("n_levels", [3, 10, 100])
def test_a_quantised_sine_is_not_clipped(n_levels):
    t = np.arange(N_SAMPLES) / RATE
    sine = quantised(np.sin(2 * np.pi * 174.9 * t), 1.0 / n_levels)
    assert_passes(window(move()[0], sine))


def test_a_noise_free_sine_that_meets_its_crest_in_every_period_is_not_clipped():
    t = np.arange(N_SAMPLES) / RATE
    assert_passes(window(move()[0], np.round(np.sin(2 * np.pi * 125.0 * t), 12)))


def test_white_noise_in_few_steps_is_not_clipped():
    rng = np.random.default_rng(1)
    for _ in range(200):
        assert_passes(window(move()[0], np.round(4.0 * rng.standard_normal(N_SAMPLES))))


def test_torque_at_the_limit_of_its_drive_passes_but_a_force_at_the_end_of_its_range_does_not():
    torque, response = move(noise=1e-3)
    limited = np.clip(torque, -0.2, 0.2)
    limited[800:1100] = 0.2
    assert_passes(window(limited, response))
    assert_refused(window(limited, response, quantity=ExcitationQuantity.FORCE), RejectionReason.CLIPPED)


@pytest.mark.parametrize("limit", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("polarity", [1, -1])
def test_clipped_response(limit, polarity):
    torque, response = move(noise=1e-3)
    # Ringing decays: only its first crests reach the limit.
    top = np.sort(np.abs(response))[-1 - int(40 * (1 - limit))]
    assert_refused(window(torque, polarity * np.clip(response, -np.inf, 0.9 * top)), RejectionReason.CLIPPED)


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_not_finite(channel, value):
    channels = [c.copy() for c in move()]
    channels[channel][700] = value
    assert_refused(window(*channels), RejectionReason.NOT_FINITE)


def test_position_that_is_not_finite():
    trace = np.full(N_SAMPLES, 0.4)
    trace[3] = np.nan
    assert_refused(window(*move(), trace=trace), RejectionReason.NOT_FINITE)


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("value", [0.0, 1.25])
def test_dead_channel(channel, value):
    channels = list(move(noise=1e-3))
    channels[channel] = np.full(N_SAMPLES, value)
    assert_refused(window(*channels), RejectionReason.DEAD_CHANNEL)


@pytest.mark.parametrize("channel", [0, 1])
def test_channel_that_freezes_off_its_rest_level(channel):
    channels = [c.copy() for c in move(noise=0.01)]
    channels[channel][520:900] = 0.5 * channels[channel].max()
    assert_refused(window(*channels), RejectionReason.STUCK_CHANNEL)


def test_too_short_and_wrong_rate():
    torque, response = move()
    assert_refused(window(torque[:255], response[:255]), RejectionReason.TOO_SHORT)
    gate = QualityGate(sample_rate=RATE)
    assert_passes(window(torque, response, rate=RATE * (1 + 1e-7)), gate)
    assert_refused(window(torque, response, rate=RATE * 1.001), RejectionReason.SAMPLE_RATE_MISMATCH, gate)


def test_travel_is_read_from_the_trace_where_there_is_one():
    trace = np.linspace(0.40, 0.43, N_SAMPLES)
    assert_refused(window(*move(), trace=trace), RejectionReason.POSITION_SPAN_TOO_WIDE)
    assert_refused(window(*move(), span=0.021), RejectionReason.POSITION_SPAN_TOO_WIDE)
    assert_passes(window(*move(), span=0.021, trace=np.linspace(0.40, 0.41, N_SAMPLES)))


# Measured on the machine that wrote this: 20 481 and 20 479 samples take 10 to 14 times as long as 20 480; 20 449
# (= 11² · 13²) takes 1.2 times, 20 001 2.8 times, and below some thousands nobody waits.
@pytest.mark.parametrize("n_samples", [20_481, 20_479, 20_011, 51_197])
def test_slow_length_names_a_good_one_nearby(n_samples):
    w = window(*np.random.default_rng(2).standard_normal((2, n_samples)))
    outcome = gate_window(w, QualityGate())
    assert isinstance(outcome, Rejection)
    assert outcome.reason is RejectionReason.SLOW_LENGTH
    good = int(outcome.detail.split()[-2])
    assert 0.97 * n_samples < good < n_samples
    assert_passes(window(w.excitation[:good], w.response[:good]))


@pytest.mark.parametrize("n_samples", [1024, 2003, 20_000, 20_449, 20_480, 25_600, 51_200])
def test_fast_lengths_and_short_ones_pass(n_samples):
    assert_passes(window(*np.random.default_rng(3).standard_normal((2, n_samples))))


def test_excitation_in_the_band_is_its_rms_there():
    t = np.arange(N_SAMPLES) / RATE
    torque = 0.3 * np.sin(2 * np.pi * 180.0 * t) + 5.0 * np.sin(2 * np.pi * 20.0 * t) + 1.0
    w = window(torque, move(noise=1e-3)[1])
    rms = 0.3 / np.sqrt(2.0)
    assert_passes(w, QualityGate(minimum_band_excitation=rms * (1.0 - 1e-9)), band=BAND)
    assert_refused(
        w, RejectionReason.LITTLE_EXCITATION, QualityGate(minimum_band_excitation=rms * (1.0 + 1e-9)), band=BAND
    )
