"""Lost motion and play from the slow reversals of a plant with a dead zone that obeys Newton."""

import numpy as np
import pytest
from scipy.special import stdtrit

from monitor_core.errors import OutsideValidityError
from monitor_core.preload.lost_motion import LostMotion, estimate_lost_motion
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.uncertainty import Estimate
from tests.plant.dead_zone import SlowAxis, go_to_and_fro

MICROMETRE = 1e-6


def axes(rng, play, **rest):
    """Axes with so much play each, as different as machines are."""
    n = len(play)
    drawn = {"stiffness": rng.uniform(5e7, 2e8, n), "table_friction": rng.uniform(60.0, 300.0, n)}
    return SlowAxis(np.array(play), **drawn, screw_friction=rng.uniform(20.0, 150.0, n), **rest)


def lost_motions(axis, record):
    for angle, scale, torque in zip(record.angle, record.scale, record.torque, strict=True):
        yield estimate_lost_motion(angle * axis.lead / (2.0 * np.pi) - scale, scale, torque)


def covers(estimate, truth):
    half = stdtrit(estimate.degrees_of_freedom, 0.975) * estimate.standard_uncertainty
    return abs(estimate.value - truth) <= half


def test_play_is_told_from_wind_up():
    rng = np.random.default_rng(54)
    plays = [0.0, 0.0, 2 * MICROMETRE, 5 * MICROMETRE, 20 * MICROMETRE]
    axis = axes(rng, plays)
    found = list(lost_motions(axis, go_to_and_fro(axis, rng, turns=6, period=1.5)))
    assert all(isinstance(lost, LostMotion) and isinstance(lost.play, Estimate) for lost in found)
    assert [lost.has_play for lost in found] == [play > 0.0 for play in plays]
    assert all(covers(lost.play, play) for lost, play in zip(found, plays, strict=True))
    # friction winds the drive up whether there is play or not
    reversal = axis.play + 2.0 * axis.table_friction / axis.stiffness
    assert np.allclose([lost.reversal_value.value for lost in found], reversal, rtol=0.03)


@pytest.mark.release
@pytest.mark.parametrize("step", [10e-9, 100e-9, 1e-6], ids=["10 nm", "100 nm", "1 µm"])
@pytest.mark.parametrize("exponent", [1.0, 1.5], ids=["preloaded pair", "Hertz"])
def test_the_interval_of_the_play_covers_it(step, exponent):
    rng = np.random.default_rng(5454)
    plays = np.concatenate([np.zeros(40), np.geomspace(1.0, 50.0, 160) * MICROMETRE])
    axis = axes(rng, plays, exponent=exponent)
    record = go_to_and_fro(axis, rng, encoder_step=step, scale_step=step, torque_noise=float(rng.uniform(2e-3, 2e-2)))
    found = list(lost_motions(axis, record))
    assert np.mean([covers(lost.play, play) for lost, play in zip(found, plays, strict=True)]) >= 0.93
    assert not any(lost.has_play for lost in found[:40])


def test_without_a_drive_signal_the_reversal_value_is_all_that_is_said():
    rng = np.random.default_rng(1)
    axis = axes(rng, [5 * MICROMETRE])
    record = go_to_and_fro(axis, rng, turns=5, period=0.5)
    relative = record.angle[0] * axis.lead / (2.0 * np.pi) - record.scale[0]
    lost = estimate_lost_motion(relative, record.scale[0])
    assert isinstance(lost, LostMotion)
    assert isinstance(lost.play, Rejection)
    assert not lost.has_play
    one_way = estimate_lost_motion(*(samples[:200] for samples in (relative, record.scale[0], record.torque[0])))
    assert isinstance(one_way, Rejection)
    assert one_way.reason is RejectionReason.TOO_FEW_AVERAGES
    still = estimate_lost_motion(np.zeros(400), np.zeros(400), np.zeros(400))
    assert isinstance(still, Rejection)
    with pytest.raises(OutsideValidityError, match="drive must be finite"):
        estimate_lost_motion(relative, record.scale[0], np.full_like(relative, np.nan))
