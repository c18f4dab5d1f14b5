"""Lost motion and play from the slow reversals of a plant with a dead zone that obeys Newton."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.special import stdtrit

from monitor_core.lost_motion import LostMotion, estimate_lost_motion
from monitor_core.recording import Conditions, ExcitationQuantity, Rejection, ResponseQuantity, Window
from monitor_core.uncertainty import Estimate
from tests.conftest import PROJECT_ROOT
from tests.plant.dead_zone import SlowAxis, go_to_and_fro

MICROMETRE = 1e-6
START = datetime(2026, 1, 1, tzinfo=UTC)


def axes(rng, play, **rest):
    """Axes with so much play each, as different as machines are."""
    n = len(play)
    drawn = {"stiffness": rng.uniform(5e7, 2e8, n), "table_friction": rng.uniform(60.0, 300.0, n)}
    return SlowAxis(np.array(play), **drawn, screw_friction=rng.uniform(20.0, 150.0, n), **rest)


def windows_of(axis, record, *, sense=1.0, quantity=ExcitationQuantity.TORQUE, parts=1):
    """Yield the windows of each axis: its record, in one or several parts."""
    for angle, scale, torque in zip(record.angle, record.scale, record.torque, strict=True):
        relative = angle * axis.lead / (2.0 * np.pi) - scale
        yield [
            Window(
                sense * t, r, record.rate, START, Conditions(0.3), "slow", quantity, position_trace=x,
                response_quantity=ResponseQuantity.RELATIVE_DISPLACEMENT,
            )
            for t, r, x in zip(*(np.array_split(each, parts) for each in (torque, relative, scale)), strict=True)
        ]  # fmt: skip


def lost_motions(axis, record):
    return [estimate_lost_motion(windows) for windows in windows_of(axis, record)]


def covers(estimate, truth):
    half = stdtrit(estimate.degrees_of_freedom, 0.975) * estimate.standard_uncertainty
    return abs(estimate.value - truth) <= half


def test_play_is_told_from_wind_up():
    rng = np.random.default_rng(54)
    plays = [0.0, 0.0, 2 * MICROMETRE, 5 * MICROMETRE, 20 * MICROMETRE]
    axis = axes(rng, plays)
    found = lost_motions(axis, go_to_and_fro(axis, rng, turns=6, period=1.5))
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
    found = lost_motions(axis, record)
    assert np.mean([covers(lost.play, play) for lost, play in zip(found, plays, strict=True)]) >= 0.93
    assert not any(lost.has_play for lost in found[:40])


def test_wiring_windows_and_current_change_nothing_and_a_command_tells_no_play():
    rng = np.random.default_rng(1)
    axis = axes(rng, [5 * MICROMETRE])
    record = go_to_and_fro(axis, rng, turns=9, period=0.8)
    (whole,), (turned,), (parts,), (commanded,) = (
        [estimate_lost_motion(windows) for windows in windows_of(axis, record, **how)]
        for how in (
            {},
            {"sense": -0.5, "quantity": ExcitationQuantity.CURRENT},
            {"parts": 2},
            {"quantity": ExcitationQuantity.ACCELERATION},
        )
    )
    assert isinstance(whole, LostMotion)
    assert turned.play.value == pytest.approx(whole.play.value, rel=1e-3)
    assert covers(parts.play, 5 * MICROMETRE)
    assert isinstance(commanded.play, Rejection)
    assert not commanded.has_play
    assert commanded.reversal_value == whole.reversal_value


def test_what_tells_no_lost_motion_is_refused():
    still = np.zeros(400)
    window = Window(still, still, 1000.0, START, Conditions(0.3), "slow", position_trace=still)
    for windows, expected in (([window], "got acceleration with position"), ([relative(window)], "got 0 in 1 windows")):
        refusal = estimate_lost_motion(windows)
        assert isinstance(refusal, Rejection)
        assert expected in refusal.detail


def relative(window):
    return replace(window, response_quantity=ResponseQuantity.RELATIVE_DISPLACEMENT)


def write_log(path):
    """Write the log of the page: 9 slow reversals of an axis with 5 µm of play."""
    axis = SlowAxis(*(np.array([value]) for value in (5 * MICROMETRE, 1.2e8, 150.0, 60.0)))
    record = go_to_and_fro(axis, np.random.default_rng(7), turns=9, period=1.5)
    time = 1e3 * np.arange(record.angle.shape[1]) / record.rate
    columns = np.column_stack([time, record.angle[0], 1e6 * record.scale[0], record.torque[0]])
    header = "t [ms],Motor angle [rad],Scale [um],Torque [N.m]"
    np.savetxt(path, columns, ["%.0f", "%.8f", "%.2f", "%.5f"], ",", header=header, comments="")


@pytest.mark.release
def test_the_command_of_the_page_leads_to_its_numbers(preload, tmp_path, monkeypatch):
    page = (PROJECT_ROOT / "docs/how-to/lost-motion.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "slow.csv")
    (channels,) = re.findall(r'```toml title="slow.toml"\n(.*?)```', page, re.DOTALL)
    (tmp_path / "slow.toml").write_text(channels, encoding="utf-8")
    ((command, expected),) = re.findall(r"```console\n\$ \.venv/bin/preload (.*?)\n(.*?)```", page, re.DOTALL)
    assert preload(*command.split()).out.split() == expected.split()
    answer = json.loads(preload(*command.split(), "--json").out)["measurements"][0]
    low, high = answer["play_interval_95_um"]
    assert low < 5.0 < high < answer["reversal_value_um"]
