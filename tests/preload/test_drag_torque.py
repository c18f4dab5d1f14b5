"""Friction and drag torque from ramp moves whose friction, inertia and offset are known."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.special import stdtrit

from monitor_core.preload.drag_torque import (
    DragTorque,
    Friction,
    estimate_drag_torque,
    estimate_friction,
    friction_torque,
)
from monitor_core.recording import (
    Conditions,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    Window,
)
from tests.plant.chain import Condition
from tests.plant.measurements import Scatter
from tests.plant.shop import MEDIUM, recorded_session

RATE = 1000.0  # [Hz]
SPEED = 0.06  # [m/s]
START = datetime(2025, 1, 1, tzinfo=UTC)


def window(rng, *, drag=0.45, offset=0.08, scatter=0.0, noise=0.004, speed=SPEED):
    """One second with a move back and one forth: 4 ms ramps, 30 to 60 ms between them, ringing after each ramp."""
    t = np.arange(1000) / RATE
    velocity, acceleration = np.zeros_like(t), np.zeros_like(t)
    for begin, sign in ((rng.uniform(0.06, 0.18), -1.0), (rng.uniform(0.52, 0.66), 1.0)):
        for edge, slope in ((begin, sign), (begin + 0.004 + rng.uniform(0.03, 0.06), -sign)):
            velocity += slope * speed * np.clip((t - edge) / 0.004, 0.0, 1.0)
            acceleration += slope * speed / 0.004 * ((t >= edge) & (t < edge + 0.004))
            since = np.clip(t - edge - 0.004, 0.0, None)
            acceleration += slope * 3.0 * np.exp(-since / 0.02) * np.sin(2.0 * np.pi * 178.0 * since)
    friction = drag + scatter * rng.standard_normal()
    # 0.1 N·m per m/s²: inertia behind a 10 mm lead; a resting axis may hold any torque below its friction
    torque = (
        offset + friction * np.sign(np.round(velocity, 6)) + 0.1 * acceleration + noise * rng.standard_normal(t.size)
    )
    position = np.round((0.5 + np.cumsum(velocity) / RATE) / 2.0**-23) * 2.0**-23  # an encoder of 0.12 µm
    return Window(torque, np.zeros_like(t), RATE, START, Conditions(0.5), "m1", position_trace=position)


def test_friction_and_offset_are_told_apart_and_inertia_is_left_out():
    rng = np.random.default_rng(1)
    estimate = estimate_drag_torque([window(rng, scatter=0.01) for _ in range(16)])
    assert isinstance(estimate, DragTorque)
    assert estimate.n_pairs == 16
    assert estimate.speed == pytest.approx(SPEED, rel=1e-3)
    # 3 standard uncertainties; the accelerating torque, 1.5 N·m, would show at once
    assert abs(estimate.drag.value - 0.45) < 3.0 * estimate.drag.standard_uncertainty
    assert abs(estimate.offset.value - 0.08) < 3.0 * estimate.offset.standard_uncertainty
    assert estimate.drag.standard_uncertainty < 0.01


@pytest.mark.release
@pytest.mark.parametrize("quantity", ["drag", "offset"])
def test_stated_uncertainty_covers_in_95_percent(quantity):
    # friction and zero error that differ from window to window are common to the travels there and back
    rng = np.random.default_rng(2)
    n_trials, covered = 200, 0
    for _ in range(n_trials):
        windows = [window(rng, offset=0.08 + 0.01 * rng.standard_normal(), scatter=0.02) for _ in range(8)]
        outcome = estimate_drag_torque(windows)
        estimate = getattr(outcome, quantity)
        half = stdtrit(estimate.degrees_of_freedom, 0.975) * estimate.standard_uncertainty
        covered += abs(estimate.value - {"drag": 0.45, "offset": 0.08}[quantity]) < half
    assert covered / n_trials == pytest.approx(0.95, abs=0.05)  # three standard deviations of a binomial share


def test_another_sign_of_the_torque_channel_changes_the_sign_of_both():
    rng = np.random.default_rng(3)
    windows = [window(rng) for _ in range(5)]
    turned = [replace(w, excitation=-w.excitation) for w in windows]
    estimate, other = estimate_drag_torque(windows), estimate_drag_torque(turned)
    assert (other.drag.value, other.offset.value) == pytest.approx((-estimate.drag.value, -estimate.offset.value))


def test_windows_of_one_direction_each_serve_as_well():
    rng = np.random.default_rng(4)
    halves = []
    for _ in range(6):
        w = window(rng)
        for part in (slice(0, 450), slice(450, 1000)):
            halves.append(
                replace(
                    w, excitation=w.excitation[part], response=w.response[part], position_trace=w.position_trace[part]
                )
            )
    whole = estimate_drag_torque(halves)
    assert whole.n_pairs == 6
    assert whole.drag.value == pytest.approx(0.45, abs=0.02)


def refused(windows, reason):
    outcome = estimate_drag_torque(windows)
    assert isinstance(outcome, Rejection)
    assert outcome.reason is reason
    return outcome.detail


def test_an_axis_at_rest_is_refused():
    rng = np.random.default_rng(5)
    resting = [
        replace(w, position_trace=0.5 + 1e-7 * rng.standard_normal(1000)) for w in (window(rng) for _ in range(5))
    ]
    assert "got 0 forward and 0 back in 5 windows" in refused(resting, RejectionReason.TOO_FEW_AVERAGES)


def test_an_axis_that_only_accelerates_is_refused():
    rng = np.random.default_rng(6)
    t = np.arange(1000) / RATE
    triangle = np.abs((4.0 * t) % 4.0 - 2.0) - 1.0  # of the speed: never constant
    swinging = [replace(window(rng), position_trace=0.5 + 0.1 * np.cumsum(triangle) / RATE) for _ in range(5)]
    refused(swinging, RejectionReason.TOO_FEW_AVERAGES)


def test_windows_without_position_are_refused():
    rng = np.random.default_rng(7)
    refused([replace(window(rng), position_trace=None) for _ in range(5)], RejectionReason.TOO_FEW_AVERAGES)
    refused([], RejectionReason.TOO_FEW_AVERAGES)


def test_a_force_and_mixed_sources_are_refused():
    rng = np.random.default_rng(8)
    windows = [window(rng) for _ in range(5)]
    force = [replace(w, excitation_quantity=ExcitationQuantity.FORCE) for w in windows]
    assert "torque in N·m; got force" in refused(force, RejectionReason.EXCITATION_SOURCE_MISMATCH)
    mixed = [*windows, replace(windows[0], excitation_source=ExcitationSource.DRIVE)]
    refused(mixed, RejectionReason.EXCITATION_SOURCE_MISMATCH)


def test_travels_at_another_speed_are_left_out():
    rng = np.random.default_rng(9)
    windows = [window(rng) for _ in range(8)] + [window(rng, drag=0.9, speed=0.12) for _ in range(3)]
    estimate = estimate_drag_torque(windows)
    assert estimate.n_pairs == 8
    assert estimate.drag.value == pytest.approx(0.45, abs=0.02)


@pytest.mark.release
def test_work_of_the_moves_knows_friction_better_than_their_constant_velocity():
    # on the plant, whose friction is known: 20 % more of all friction between two halves of the measurements
    tagged = [Condition(x) for x in MEDIUM.positions(5) for _ in range(4)]
    true = [replace(c, friction_scale=1.0 if i % 2 else 1.2) for i, c in enumerate(tagged)]
    scatter = Scatter(0.0, 0.0, 0.0, 0.0)
    session = recorded_session(MEDIUM, tagged, true, np.random.default_rng(14), scatter=scatter).session
    measured = [session.windows_of(name) for name in session.measurements]
    by_work = np.log([friction_torque(windows).value for windows in measured])
    by_velocity = np.log([estimate_drag_torque(windows).drag.value for windows in measured])
    noise, other = (np.hypot(v[::2].std(), v[1::2].std()) for v in (by_work, by_velocity))
    assert noise < 0.2 * other
    # damping of the structure takes its share, which does not grow with the friction
    assert 0.7 < (by_work[::2].mean() - by_work[1::2].mean()) / np.log(1.2) < 1.0


def test_friction_torque_leaves_an_offset_out():
    # the same moves twice, once with a zero error of the torque channel
    plain, offset = (
        friction_torque([window(np.random.default_rng(12 + i), offset=zero) for i in range(15)]) for zero in (0.0, 0.5)
    )
    assert plain.value == pytest.approx(offset.value, rel=1e-3)


def test_friction_torque_scatters_as_it_says():
    rng = np.random.default_rng(15)
    found = [friction_torque([window(rng, scatter=0.02) for _ in range(6)]) for _ in range(150)]
    stated = np.mean([torque.standard_uncertainty**2 for torque in found])
    # a variance of 150 is known to 12 %, that of 6 windows each to 6 %
    assert np.var([torque.value for torque in found], ddof=1) == pytest.approx(stated, rel=0.4)


def test_friction_is_that_of_the_work_and_of_few_windows_the_drag():
    rng = np.random.default_rng(16)
    windows = [window(rng) for _ in range(4)]
    steps = np.concatenate([np.diff(w.position_trace, append=w.position_trace[-1]) for w in windows])
    torque = np.concatenate([w.excitation for w in windows])
    longer = replace(windows[0], excitation=torque, response=np.zeros_like(torque), position_trace=np.cumsum(steps))
    of_work, of_drag = estimate_friction(windows), estimate_friction([longer])
    assert isinstance(of_work, Friction)
    assert isinstance(of_drag, Friction)
    assert of_work.torque == friction_torque(windows)
    assert of_drag.torque == of_drag.drag.drag
    assert of_drag.torque.value == pytest.approx(of_work.torque.value, rel=0.1)  # ringing works, too
    assert isinstance(estimate_friction([replace(w, position_trace=None) for w in windows]), Rejection)


@pytest.mark.parametrize("delay", [-2, 2])
def test_channels_that_are_apart_leave_the_drag_torque(delay):
    # two milliseconds between torque and position: what accelerates works, too
    rng = np.random.default_rng(18)
    windows = [window(rng, drag=0.1) for _ in range(8)]
    apart = [replace(w, excitation=np.roll(w.excitation, delay)) for w in windows]
    assert not 0.05 < friction_torque(apart).value < 0.15
    friction = estimate_friction(apart)
    assert isinstance(friction, Friction)
    assert friction.torque == friction.drag.drag
    assert friction.torque.value == pytest.approx(0.1, abs=0.02)


def test_friction_that_noise_hides_is_none():
    rng = np.random.default_rng(19)
    refusal = estimate_friction([window(rng, drag=0.0, offset=0.0, noise=0.5) for _ in range(6)])
    assert isinstance(refusal, Rejection)
    assert "must exceed 4 of its standard uncertainties" in refusal.detail


def test_motion_in_one_direction_tells_no_friction_torque():
    rng = np.random.default_rng(17)
    forth = [
        replace(w, excitation=w.excitation[450:], response=w.response[450:], position_trace=w.position_trace[450:])
        for w in (window(rng) for _ in range(6))
    ]
    refusal = friction_torque(forth)
    assert isinstance(refusal, Rejection)
    assert "in both directions" in refusal.detail


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"position_trace": None}, RejectionReason.TOO_FEW_AVERAGES),
        ({"position_trace": np.full(1000, 0.5)}, RejectionReason.TOO_FEW_AVERAGES),
        ({"excitation_quantity": ExcitationQuantity.FORCE}, RejectionReason.EXCITATION_SOURCE_MISMATCH),
    ],
    ids=["no position", "standstill", "a force"],
)
def test_friction_torque_needs_motion_position_and_torque(change, reason):
    refusal = friction_torque([replace(window(np.random.default_rng(13)), **change) for _ in range(5)])
    assert isinstance(refusal, Rejection)
    assert refusal.reason is reason
