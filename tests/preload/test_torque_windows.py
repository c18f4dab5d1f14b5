"""Friction and orders from torque and position alone, on travels whose friction, orders and ripples are known."""

import re
from datetime import UTC, datetime

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from monitor_core.errors import OutsideValidityError
from monitor_core.recording import Conditions, ExcitationQuantity, Rejection, ResponseQuantity, Window
from monitor_core.torque_windows import Screw, TorqueReading, ball_pass_orders, read_torque
from service.cli.main import command_named
from tests.conftest import PROJECT_ROOT, canary
from tests.fitting.emps import emps_record
from tests.plant.constant_speed import Travels, go

START = datetime(2026, 3, 1, tzinfo=UTC)
BALL, CIRCLE = 0.00635, 0.040  # [m]


def window(torque, position, rate, **rest):
    return Window(
        torque, np.zeros_like(torque), rate, START, Conditions(0.3), "strokes", position_trace=position, **rest
    )


def screw_of(how):
    return Screw(how.lead, BALL, CIRCLE)


def read(how, rng):
    reading = read_torque([window(*go(how, rng), how.rate)], screw_of(how))
    assert isinstance(reading, TorqueReading)
    return reading


def lines(reading):
    return {line.name: line for line in reading.spectrum.lines if line.name}


def mean_friction(how, profile):
    """Return the mean of what the generator says, over the places of a profile [N·m]."""
    half = 0.5 * np.diff(profile.position).mean()
    low, high = (2.0 * np.pi / how.stroke * (profile.position[end] + half * side) for end, side in ((0, -1), (-1, 1)))
    return how.drag * (1.0 + how.of_place * (np.sin(high) - np.sin(low)) / (high - low))


# ---- where balls pass -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lead", [0.005, 0.010, 0.040])
@pytest.mark.parametrize("angle", [0.6, np.pi / 4, 0.9])
def test_balls_pass_as_often_as_rolling_without_sliding_has_it(lead, angle):
    # the nut stands; the screw turns and goes along its own helix, as its groove must to stay on that of the nut
    def screwed(turn, point):
        return Rotation.from_euler("z", turn).apply(point) + lead * turn / (2.0 * np.pi) * np.array([0.0, 0.0, 1.0])

    centre, little = np.array([0.5 * CIRCLE, 0.0, 0.0]), 1e-6
    tangent = screwed(little, centre) - screwed(-little, centre)
    along = tangent / np.linalg.norm(tangent)
    axial = np.cross(along, [1.0, 0.0, 0.0])  # in the section across the groove
    touched = centre - 0.5 * BALL * (np.cos(angle) * np.array([1.0, 0.0, 0.0]) + np.sin(angle) * axial)
    of_screw = (screwed(little, touched) - screwed(-little, touched)) @ along / (2.0 * little)
    way_of_ball = 0.5 * of_screw * 2.0 * np.pi  # in a turn: the other contact rests
    whole_way = np.linalg.norm(tangent) / (2.0 * little) * 2.0 * np.pi
    nut, screw = ball_pass_orders(lead, BALL, CIRCLE, angle)
    assert nut == pytest.approx(way_of_ball / BALL, rel=1e-6)
    assert screw == pytest.approx((whole_way - way_of_ball) / BALL, rel=1e-6)


def test_a_screw_that_cannot_be_is_refused():
    for wrong in ({"lead": 0.0}, {"ball_diameter": 0.006}, {"ball_diameter": 0.05, "pitch_circle": 0.04}):
        with pytest.raises(OutsideValidityError):
            Screw(**{"lead": 0.01} | wrong)


# ---- amplitudes and friction ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("lead", [0.005, 0.016, 0.040])
@pytest.mark.parametrize("rate", [1000.0, 4000.0])
def test_without_noise_amplitudes_and_friction_are_those_of_the_generator(lead, rate):
    nut = Screw(lead, BALL, CIRCLE).names["balls past the nut"]
    orders = {1: 0.05, 2: 0.02, 0.99 * nut: 0.03}
    how = Travels(
        lead, 12 * lead, 4 * lead, 3, rate, count=1e-7, spread=0.1, speed_ripple=0.05, orders=orders, noise=1e-5
    )  # fmt: skip
    reading = read(how, np.random.default_rng(3))
    named = lines(reading)
    for name, amplitude in (("screw", 0.05), ("screw × 2", 0.02), ("balls past the nut", 0.03)):
        # half a percent: the speed is not the same at the ends of a stretch, and the top lies between lines
        assert named[name].amplitude == pytest.approx(amplitude, rel=5e-3)
        assert named[name].is_there
    assert named["balls past the nut"].order == pytest.approx(0.99 * nut, rel=2e-3)
    profile = reading.profile
    assert profile.drag.value == pytest.approx(mean_friction(how, profile), rel=2e-3)
    assert profile.mean_offset.value == pytest.approx(how.weight, abs=2e-3)
    there = how.drag * (1.0 + how.of_place * np.cos(2.0 * np.pi * profile.position / how.stroke))
    np.testing.assert_allclose(profile.friction, there, atol=0.01 * how.drag)


def drawn(rng):
    """Return an axis as different as axes are, with the amplitudes that it has."""
    lead = float(rng.choice([0.005, 0.010, 0.016, 0.020, 0.040]))
    nut = Screw(lead, BALL, CIRCLE).names["balls past the nut"]
    of_screw, of_balls = (10.0 ** rng.uniform(-3.5, -1.5) for _ in range(2))
    passes = int(rng.choice([1, 2, 3, 5]))
    how = Travels(
        lead, max(0.25, 10.0 * lead), lead * rng.uniform(3.0, 8.0), passes, float(rng.choice([1000.0, 2000.0])),
        float(rng.choice([1e-7, 1e-6, 5e-6])), speed_ripple=rng.uniform(0.0, 0.05), ripple_hz=rng.uniform(0.3, 3.0),
        spread=rng.uniform(0.0, 0.1), noise=10.0 ** rng.uniform(-2.3, -1.0), colour=float(rng.choice([0.0, 0.5, 0.9])),
        of_pass=0.005 if passes >= 3 else 0.0, mains=float(rng.choice([0.0, 0.02])),
        orders={1: of_screw, 2: 0.003, nut * rng.uniform(0.975, 1.015): of_balls},
    )  # fmt: skip
    return how, {"screw": of_screw, "screw × 2": 0.003, "balls past the nut": of_balls}


@pytest.mark.parametrize("draws", canary([3, 200]))
def test_intervals_cover_friction_and_amplitudes_in_95_of_100(draws):
    rng = np.random.default_rng(2026)
    friction, amplitudes, false = [], [], []
    for _ in range(draws):
        how, truth = drawn(rng)
        reading = read(how, rng)
        drag = reading.profile.drag
        friction.append(abs(drag.value - mean_friction(how, reading.profile)) <= drag.expanded_uncertainty)
        named = lines(reading)
        amplitudes += [named[name].lower <= size <= named[name].upper for name, size in truth.items() if name in named]
        false += [named[name].is_there for name in ("screw × 3", "balls past the screw") if name in named]
    # 200 draws of 95 % lie above 92 % in 97 of 100
    assert np.mean(friction) >= (0.92 if draws >= 200 else 0.6)
    assert np.mean(amplitudes) >= (0.92 if draws >= 200 else 0.6)
    assert np.mean(false) <= 0.02


# ---- what is none ---------------------------------------------------------------------------------------------------


def test_the_mains_are_no_order_where_the_speed_varies():
    # at 5.4 rev/s 50 Hz are order 9.3, where balls pass the screw
    how = Travels(speed=0.054, spread=0.08, mains=0.05)
    at = Screw(how.lead, BALL, 0.033)
    reading = read_torque([window(*go(how, np.random.default_rng(5)), how.rate)], at)
    assert at.names["balls past the screw"] == pytest.approx(50.0 / 5.4, rel=0.01)
    assert [line.name for line in reading.spectrum.lines if line.order > 2.0 and line.is_there] == []
    ((frequency, amplitude),) = reading.spectrum.ripples
    assert frequency == pytest.approx(50.0, abs=0.01)
    assert amplitude == pytest.approx(0.05, rel=0.01)


def test_at_an_even_speed_it_is_said_that_the_two_cannot_be_told_apart():
    how = Travels(speed=0.050, speed_ripple=0.0, mains=0.05)
    reading = read(how, np.random.default_rng(6))
    (line,) = [line for line in reading.spectrum.lines if line.is_there]
    assert line.order == pytest.approx(10.0, abs=0.02)
    assert not line.told_from_time
    assert reading.spectrum.ripples == ()


def test_two_names_too_near_each_other_are_one_line():
    screw = Screw(0.010, 0.0142, 0.0370)  # three balls or so pass in a turn
    order = screw.names["balls past the nut"]
    reading = read_torque([window(*go(Travels(stroke=0.1, orders={3: 0.03}), np.random.default_rng(7)), 2000.0)], screw)
    assert abs(order - 3.0) < 2.0 / reading.spectrum.turns
    assert [line.name for line in reading.spectrum.lines if line.is_there] == ["screw × 3 or balls past the nut"]


def test_the_larger_of_two_lines_in_the_range_of_one_name_has_it():
    balls = Screw(0.010, 0.003, 0.036).names["balls past the nut"]
    how = Travels(stroke=0.3, orders={0.985 * balls: 0.03, 1.01 * balls: 0.006})
    torque = window(*go(how, np.random.default_rng(10)), how.rate)
    found = [line for line in read_torque([torque], Screw(0.010, 0.003, 0.036)).spectrum.lines if line.order > 10.0]
    named, other = (line for line in found if line.is_there)
    assert (named.name, other.name) == ("balls past the nut", "")
    assert named.lower <= 0.03 <= named.upper
    assert other.lower <= 0.006 <= other.upper


@pytest.mark.parametrize("draws", canary([8, 300]))
@pytest.mark.parametrize("passes", [1, 4])
def test_a_screw_that_is_rough_over_the_place_has_no_orders(draws, passes):
    rng, false, covered = np.random.default_rng(2), 0, 0
    for _ in range(draws):
        lead = float(rng.choice([0.005, 0.010, 0.020]))
        how = Travels(
            lead, lead * float(rng.choice([12, 15, 25, 45])), 5.0 * lead, passes, rate=500.0, spread=0.1,
            orders={1: 0.01}, texture=0.02, grain=lead / 40.0, noise=0.002,
        )  # fmt: skip
        spectrum = read_torque([window(*go(how, rng), how.rate)], Screw(lead)).spectrum
        covered += sum(line.lower <= 0.01 <= line.upper for line in spectrum.lines if line.name == "screw")
        false += sum(line.is_there for line in spectrum.lines if line.name != "screw")
    # two names and the whole spectrum: three judgements at one in a thousand each; of 300 draws four in 99 of 100
    assert false <= (4 if draws >= 300 else 0)
    assert covered >= 0.92 * draws


# ---- wiring, refusals, a real axis ----------------------------------------------------------------------------------


def test_signs_units_and_where_the_position_stands_change_nothing():
    how = Travels(orders={1: 0.03})
    torque, position = go(how, np.random.default_rng(8))
    whole = read_torque([window(torque, position, how.rate)], Screw(how.lead))
    turned = read_torque(
        [window(-2.0 * torque, position, how.rate, excitation_quantity=ExcitationQuantity.CURRENT)], Screw(how.lead)
    )
    angle = 2.0 * np.pi * position / how.lead
    of_motor = Window(
        torque, angle, how.rate, START, Conditions(0.3), "strokes", response_quantity=ResponseQuantity.MOTOR_ANGLE
    )
    by_angle = read_torque([of_motor], Screw(how.lead))
    for other, factor in ((turned, 2.0), (by_angle, 1.0)):
        # rounding puts a sample in a hundred thousand on the other side of an edge
        assert other.profile.drag.value == pytest.approx(factor * whole.profile.drag.value, rel=1e-6)
        assert lines(other)["screw"].amplitude == pytest.approx(factor * lines(whole)["screw"].amplitude, rel=1e-6)
    assert turned.profile.mean_offset.value == pytest.approx(-2.0 * whole.profile.mean_offset.value, rel=1e-9)
    assert (whole.unit, turned.unit) == ("N·m", "A")


def test_what_tells_neither_is_refused():
    how = Travels(passes=1, stroke=0.03)
    torque, position = go(how, np.random.default_rng(9))
    still = window(torque, np.zeros_like(position), how.rate)
    commanded = window(torque, position, how.rate, excitation_quantity=ExcitationQuantity.ACCELERATION)
    lost = Window(torque, torque, how.rate, START, Conditions(0.3), "strokes")
    holed = window(np.where(np.arange(torque.size) == 500, np.nan, torque), position, how.rate)
    nowhere = window(torque, np.where(np.arange(torque.size) < 2, np.nan, position), how.rate)
    for wrong, expected in (
        (holed, "got 1 that are not"),
        (nowhere, "got 2 that are not"),
        (still, "got none"),
        (commanded, "got a commanded"),
        (lost, "got acceleration"),
    ):
        refusal = read_torque([wrong], Screw(how.lead))
        assert isinstance(refusal, Rejection)
        assert expected in refusal.detail
    current = window(torque, position, how.rate, excitation_quantity=ExcitationQuantity.CURRENT)
    assert "got several" in read_torque([window(torque, position, how.rate), current], Screw(how.lead)).detail
    short = read_torque([window(torque, position, how.rate)], Screw(how.lead))
    assert "got 1 each way over 2.5 turns" in short.profile.detail
    assert "got 2.5 turns" in short.spectrum.detail
    half = position.size // 2
    one_way = read_torque([window(torque[:half], position[:half], how.rate)], Screw(how.lead))
    assert "got 1 forward and 0 back" in one_way.profile.detail


def test_a_real_axis_has_the_friction_that_others_published(measured_data):
    record = emps_record(measured_data)
    emps = window(record.drive, record.position, record.sample_rate, excitation_quantity=ExcitationQuantity.FORCE)
    reading = read_torque([emps], Screw(0.010))
    profile = reading.profile
    # Janot et al. (2019): Fc + Fv v, with a relative force error of 4.08 %; there and back they differ in Fv
    assert profile.drag.value == pytest.approx(20.3935 + 203.5034 * profile.speed, rel=0.0408)
    assert profile.mean_offset.value == pytest.approx(0.5 * (166.8 - 240.5) * profile.speed, rel=0.15)
    # a ripple of 2.5 mm, and one of half of that, which nothing here presumes
    others = [line for line in reading.spectrum.lines if line.is_there and not line.name]
    highest = max(others, key=lambda line: line.amplitude).order
    assert min(abs(line.order - 2.0 * highest) for line in others) < 0.25 / reading.spectrum.turns


# ---- the page -------------------------------------------------------------------------------------------------------


def write_log(folder):
    """Write the log of the page: strokes at other speeds each, with a ripple of the screw and one of the balls."""
    how = Travels(spread=0.08, orders={1: 0.03, 7.05: 0.012})
    torque, position = go(how, np.random.default_rng(1))
    columns = np.column_stack([0.5 * np.arange(torque.size), torque, 1e3 * position])
    header = "t [ms],Torque [N.m],Position [mm]"
    np.savetxt(folder / "strokes.csv", columns, ["%.1f", "%.5f", "%.4f"], ",", header=header, comments="")


def test_the_page_shows_what_the_command_prints(tmp_path, monkeypatch):
    page = (PROJECT_ROOT / "docs/how-to/drive-signals.md").read_text(encoding="utf-8")
    write_log(tmp_path)
    (tmp_path / "strokes.toml").write_text(re.search(r'```toml title="strokes.toml"\n(.*?)```', page, re.DOTALL)[1])
    monkeypatch.chdir(tmp_path)
    command, printed = re.search(r"\$ \.venv/bin/preload torque ([^\n]*)\n(.*?)```", page, re.DOTALL).groups()
    done = CliRunner().invoke(command_named("torque"), command.split())
    assert done.exit_code == 0, done.output
    assert [line.split() for line in done.stdout.strip().splitlines()] == [
        line.split() for line in printed.strip().splitlines()
    ]
    assert (tmp_path / "strokes.svg").read_text(encoding="utf-8").count('class="curve measured"') == 2
