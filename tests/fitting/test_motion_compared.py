"""Motion records compared with a rigid axis: the EMPS of others, simulated axes, noise, strokes, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from monitor_core.effects import MOTION_EFFECTS, sized_for, with_effects
from monitor_core.effects.effect import ConditionAxis
from monitor_core.effects.sizes import motion_sizes
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.residuals.motion.comparison import MotionComparison, strokes_of
from monitor_core.fitting.residuals.motion.sampling import repetition_shift
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics
from monitor_core.recording import ExcitationQuantity, MotionRecord
from tests.fitting.emps import emps_record
from tests.models.simulated_motion import Motion, Truth, simulated_record

STATED = MotionParameters(moving_mass=95.0, viscous_friction=200.0)
#: As the EMPS was recorded.
SIZES = motion_sizes(force=53.6, change=53.5, velocity=0.0875, cutoff=100.0)
EFFECTS = {effect.key: effect for effect in sized_for(MOTION_EFFECTS, SIZES)}


def fitted(comparison, keys, chosen):
    """Return the axis with these effects at their least squares over the chosen values, and the effects' values."""
    unknowns = [(key, parameter) for key in keys for parameter in EFFECTS[key].parameters]

    def physics(u):
        values = {key: {} for key in keys}
        for (key, parameter), at in zip(unknowns, u[2:], strict=True):
            values[key][parameter.name] = parameter.null + parameter.scale * at
        stated = MotionParameters(moving_mass=80.0 * np.exp(u[0]), viscous_friction=200.0 * np.exp(u[1]))
        return with_effects(MotionModel.of(stated), values).physics, values

    bounds = [(-3.0, 3.0)] * 2 + [
        ((parameter.lower - parameter.null) / parameter.scale, (parameter.upper - parameter.null) / parameter.scale)
        for _, parameter in unknowns
    ]
    found = optimize.least_squares(
        lambda u: comparison.misfit(physics(u)[0])[chosen],
        np.clip([0.0, 0.0, *(0.5 * (parameter.null == 0.0) for _, parameter in unknowns)], *np.transpose(bounds)),
        bounds=tuple(np.transpose(bounds)),
        diff_step=1e-4,
        x_scale="jac",
    )
    return physics(found.x)


def gaps(comparison, physics):
    """Return the gap on the fitted and on the held-out half [%]."""
    (held_out,) = comparison.layout.held_out
    misfit = comparison.misfit(physics)
    return [comparison.gap(misfit, misfit, chosen) for chosen in (~held_out, held_out)]


# --- the EMPS --------------------------------------------------------------------------------------------------------

LADDER = {
    "mass and viscous friction": ((), (17.90, 17.88)),
    "Coulomb friction": (("coulomb-friction",), (6.90, 7.30)),
    "an offset": (("coulomb-friction", "force-offset"), (3.93, 4.13)),
    "the direction": (("coulomb-friction", "direction-dependent-friction"), (3.03, 3.08)),
    "a delay": (("coulomb-friction", "direction-dependent-friction", "force-delay"), (2.84, 2.91)),
    "low speed": (
        ("coulomb-friction", "direction-dependent-friction", "force-delay", "stribeck-friction"),
        (2.06, 2.09),
    ),
}


@pytest.fixture(scope="module")
def emps(measured_data):
    return MotionComparison.of(emps_record(measured_data), STATED)


def test_published_identification_of_the_emps(emps) -> None:
    """Janot et al. (2019): 95.1089 kg, 203.5034 N·s/m, 20.3935 N, −3.1648 N; relative force error 4.0834 %."""
    unit_mass = MotionPhysics(moving_mass=1.0)
    zero = emps.misfit(unit_mass)
    units = {"moving_mass": 2.0, "viscous_friction": 1.0, "coulomb_friction": 1.0, "force_offset": 1.0}
    columns = np.transpose([emps.misfit(replace(unit_mass, **{name: value})) - zero for name, value in units.items()])
    found, *_ = np.linalg.lstsq(columns, emps.force)
    assert found == pytest.approx([95.1089, 203.5034, 20.3935, -3.1648], rel=3e-3)
    every = np.ones(emps.force.size, dtype=bool)
    misfit = columns @ found - emps.force
    # how the ends are left out is not published: trimmed before the filter instead of after it, 4.04 %
    assert emps.gap(misfit, misfit, every) == pytest.approx(4.0834, abs=0.07)


@pytest.mark.parametrize("what", LADDER)
def test_ladder_of_the_emps(emps, what) -> None:
    """Recomputed from the record with the published recipe in other code; to its last digit."""
    keys, expected = LADDER[what]
    (held_out,) = emps.layout.held_out
    physics, _ = fitted(emps, keys, ~held_out)
    assert gaps(emps, physics) == pytest.approx(expected, abs=0.01)


def test_floor_of_the_emps_is_its_repeatability_from_lap_to_lap(emps) -> None:
    """Two laps of 6.24 s apart, which is how far its halves are; 0.69 by the rms, which rare differences make."""
    assert emps.noise_floor == pytest.approx(0.645, abs=0.005)


@pytest.mark.release
def test_effects_of_the_emps_come_one_after_the_other(emps) -> None:
    """By the gap on the fitted half; the last step that helps the held-out half by a fiftieth is the Stribeck one."""
    (held_out,) = emps.layout.held_out
    before = gaps(emps, fitted(emps, (), ~held_out)[0])
    accepted = ()
    while True:
        rest = [key for key in EFFECTS if key not in accepted and EFFECTS[key].applies(MotionModel.of(STATED).physics)]
        trials = {key: gaps(emps, fitted(emps, (*accepted, key), ~held_out)[0]) for key in rest}
        best = min(trials, key=lambda key: trials[key][0])
        if trials[best][1] > 0.98 * before[1]:
            break
        accepted, before = (*accepted, best), trials[best]
    assert accepted == ("coulomb-friction", "direction-dependent-friction", "force-delay", "stribeck-friction")
    assert before[1] < 2.4


# --- simulated axes --------------------------------------------------------------------------------------------------

HIDDEN = {
    "coulomb-friction": (Truth(coulomb=15.0), {"friction_n": 15.0}),
    "force-offset": (Truth(coulomb=15.0, offset=-4.0), {"force_n": -4.0}),
    "direction-dependent-friction": (
        Truth(coulomb=15.0, towards_higher=40.0, towards_lower=-40.0),
        {"viscous_difference_ns_per_m": 80.0},
    ),
    "stribeck-friction": (
        Truth(coulomb=15.0, low_speed=8.0, low_speed_width=0.02),
        {"friction_n": 8.0, "velocity_m_per_s": 0.02},
    ),
    "force-delay": (Truth(coulomb=15.0, delay=2e-3), {"delay_s": 2e-3}),
}


@pytest.mark.parametrize("key", HIDDEN)
def test_a_hidden_effect_is_recovered(key) -> None:
    truth, values = HIDDEN[key]
    comparison = MotionComparison.of(simulated_record(truth), STATED)
    keys = dict.fromkeys(("coulomb-friction", key))
    (held_out,) = comparison.layout.held_out
    physics, found = fitted(comparison, tuple(keys), ~held_out)
    # noise of 0.3 N leaves a hundredth of it on a mean of thousands; the rest is the filter at the reversals
    assert found[key] == pytest.approx(values, rel=0.05)
    assert physics.moving_mass == pytest.approx(truth.mass, rel=0.01)
    assert gaps(comparison, physics)[1] < 1.3 * comparison.noise_floor


@pytest.mark.parametrize("rate", [250.0, 4000.0])
def test_a_record_of_another_sample_rate_tells_the_same(rate) -> None:
    truth = Truth(coulomb=15.0, towards_higher=40.0, towards_lower=-40.0)
    comparison = MotionComparison.of(simulated_record(truth, rate=rate, duration=32.0), STATED)
    keys = ("coulomb-friction", "direction-dependent-friction")
    physics, found = fitted(comparison, keys, ~comparison.layout.held_out[0])
    assert physics.moving_mass == pytest.approx(80.0, rel=0.01)
    assert physics.viscous_friction == pytest.approx(300.0, rel=0.02)
    assert found["coulomb-friction"]["friction_n"] == pytest.approx(15.0, rel=0.02)
    assert found["direction-dependent-friction"]["viscous_difference_ns_per_m"] == pytest.approx(80.0, rel=0.02)


def test_a_scale_is_seen_where_the_mass_is_known() -> None:
    comparison = MotionComparison.of(simulated_record(Truth(gain=1.05)), STATED)
    known = MotionPhysics(moving_mass=80.0, viscous_friction=300.0)
    wrong = EFFECTS["force-scale"].added_to(known, {"gain_error": 0.05})
    assert gaps(comparison, known)[1] == pytest.approx(100.0 * 0.05 / 1.05, rel=0.05)
    assert gaps(comparison, wrong)[1] < 1.3 * comparison.noise_floor


# --- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("motion", [Motion(), Motion(frequencies=(0.25, 1.2507, 2.031))], ids=["repeats", "does not"])
def test_noise_is_that_which_was_added(reference, motion) -> None:
    """White noise of 0.3 N has 0.3 √(40 Hz / 500 Hz) in the compared band."""
    record = simulated_record(noise=0.3, motion=motion, reference=reference, duration=32.0)
    found = MotionComparison.of(record, STATED).layout.standard_deviation
    assert found == pytest.approx(np.full(found.size, 0.3 * np.sqrt(0.08)), rel=0.05)


def test_no_force_is_known_better_than_a_ten_thousandth() -> None:
    comparison = MotionComparison.of(simulated_record(noise=0.0), STATED)
    rms = np.sqrt(np.mean(comparison.force**2))
    assert comparison.layout.standard_deviation[0] == pytest.approx(1e-4 * rms, rel=1e-12)


def test_a_motion_is_compared_with_itself_half_a_record_later() -> None:
    time = np.arange(2000)
    assert repetition_shift(np.sin(2 * np.pi * time / 500)) == 1000
    assert repetition_shift(np.sin(2 * np.pi * time / 700)) in {700, 1400}
    assert repetition_shift(np.sin(2 * np.pi * time / 1900)) is None  # too late to be compared
    assert repetition_shift(np.sin(2 * np.pi * (time / 500 + (time / 2000) ** 2))) is None
    assert repetition_shift(np.zeros(2000)) is None


# --- strokes, standstill, halves -------------------------------------------------------------------------------------


def test_strokes_turn_where_the_motion_does() -> None:
    way = np.interp(np.arange(100), [0, 20, 50, 60, 99], [0.0, 2.0, -1.0, 0.0, -4.0])
    first, directions = strokes_of(way)
    np.testing.assert_array_equal(first, [0, 20, 50, 60])
    assert directions == (1, -1, 1, -1)


def test_a_hesitation_is_no_reversal() -> None:
    way = np.arange(100.0)
    way[50:] -= 1.9  # a step of 0.9 back, of a way of 97
    assert strokes_of(way)[1] == (1,)


def test_strokes_are_settings_in_time() -> None:
    layout = MotionComparison.of(simulated_record(), STATED).layout
    directions = [setting.values[ConditionAxis.DIRECTION] for setting in layout.settings]
    assert set(directions) == {1.0, -1.0}
    assert directions[0] == -directions[1]
    assert np.all(np.diff(layout.setting) >= 0)
    assert set(layout.setting) == set(range(len(layout.settings)))
    assert layout.settings[0].name.startswith("stroke 1 (0.1 s to ")
    (held_out,) = layout.held_out
    assert np.count_nonzero(held_out) == pytest.approx(layout.n_values / 2, abs=1)
    assert not held_out[0]
    assert held_out[-1]


def test_standstill_is_left_out() -> None:
    """The brake holds 50 N there, which no velocity tells."""
    record = simulated_record(Truth(coulomb=15.0))
    stop = 2000
    position = np.r_[record.position, np.full(stop, record.position[-1])]
    drive = np.r_[record.drive, np.full(stop, 50.0)]
    longer = MotionComparison.of(MotionRecord(1000.0, position, drive), STATED)
    assert longer.sampling.time[-1] < 16.1
    physics = MotionPhysics(moving_mass=80.0, viscous_friction=300.0, coulomb_friction=15.0)
    assert np.max(np.abs(longer.misfit(physics)[:-20])) < 3.0


# --- torque, pictures, refusals --------------------------------------------------------------------------------------


def test_a_torque_is_compared_as_the_force_it_makes() -> None:
    record = simulated_record()
    lead = 0.02
    torque = MotionRecord(
        1000.0, record.position, record.drive * lead / (2 * np.pi), ExcitationQuantity.TORQUE, record.reference
    )
    with_lead = MotionComparison.of(torque, replace(STATED, screw_lead=lead))
    np.testing.assert_allclose(with_lead.force, MotionComparison.of(record, STATED).force, rtol=1e-9)
    with pytest.raises(OutsideValidityError, match="torque needs screw_lead_m in the motion model"):
        MotionComparison.of(torque, STATED)


def test_pictures_are_of_what_was_held_out() -> None:
    comparison = MotionComparison.of(simulated_record(Truth(coulomb=15.0)), STATED)
    without = MotionPhysics(moving_mass=80.0, viscous_friction=300.0)
    right = replace(without, coulomb_friction=15.0)
    over_time, over_velocity = comparison.panels({"before": without, "after": right})
    (held_out,) = comparison.layout.held_out
    assert over_time.x[0] == comparison.sampling.time[held_out][0]
    for panel in (over_time, over_velocity):
        assert panel.held_out
        assert set(panel.models) == {"before", "after"}
        assert panel.measured.shape == panel.x.shape == panel.models["after"].shape
    assert over_velocity.x.size <= 60  # so that a report draws each measured point
    assert np.all(np.diff(over_velocity.x) > 0.0)
    away = {name: np.max(np.abs(force - over_velocity.measured)) for name, force in over_velocity.models.items()}
    assert away["after"] < 1.0
    assert away["before"] > 10.0


def test_a_comparison_has_no_errors_of_settings() -> None:
    comparison = MotionComparison.of(simulated_record(), STATED)
    physics = MotionPhysics(moving_mass=80.0)
    assert comparison.condition_errors(physics, comparison.misfit(physics)).shape == (0, comparison.layout.n_values)
    assert comparison.condition_error_names == ()
    assert comparison.unit == "%"


@pytest.mark.parametrize(
    ("record", "sentence"),
    [
        (MotionRecord(1000.0, np.zeros(5000), np.ones(5000)), "must last at least 1 s besides .* got 0 s"),
        (simulated_record(duration=0.7), "must last at least 1 s besides 0.1 s at each end and standstill; got 0.5 s"),
        (MotionRecord(1000.0, np.arange(5000.0), np.zeros(5000)), "needs a motor force; got 0 N in every sample"),
    ],
)
def test_what_cannot_be_compared_is_refused(record, sentence) -> None:
    with pytest.raises(OutsideValidityError, match=sentence):
        MotionComparison.of(record, STATED)


def test_a_delay_beyond_the_ends_of_a_record_is_refused() -> None:
    comparison = MotionComparison.of(simulated_record(), STATED)
    with pytest.raises(OutsideValidityError, match=r"force_delay must lie within ±0\.1 s, .*; got 0\.2 s"):
        comparison.misfit(MotionPhysics(moving_mass=80.0, force_delay=0.2))


def test_a_disturbance_that_comes_and_goes_is_no_noise() -> None:
    """With laps known by the reference and without: 40 N at 3 Hz for a tenth of the time hide nothing else."""
    record = simulated_record(Truth(coulomb=15.0), duration=32.0)
    time = np.arange(record.drive.size) / record.sample_rate
    pushed = record.drive + np.where(time % 7.3 < 0.7, 40.0 * np.sin(2.0 * np.pi * 3.0 * time), 0.0)
    quiet, disturbed, unknown = (
        MotionComparison.of(replace(record, drive=drive, reference=reference), STATED).layout.standard_deviation[0]
        for drive, reference in ((record.drive, record.reference), (pushed, record.reference), (pushed, None))
    )
    assert disturbed < 1.6 * quiet
    assert unknown == pytest.approx(disturbed, rel=0.5)
