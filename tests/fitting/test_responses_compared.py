"""Frequency responses against an axis: what the misfit is, whose errors it shares, how well it is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.conditions.settings import SettingTolerances
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.model_form import FormSpectrum, ModelFormError
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.fitting.solver.linearised import linearise, whitening
from monitor_core.models.extended import ResponseCase, physics_of, prepare_lines, responses
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from tests.discrepancy.axes import AXIS, FORM, LINES, compared, measured, settings, true_subject

PHYSICS = physics_of(AXIS)
ACCELERATION, ANGLE = ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
AT = (DriveConditions(0.21, 150.0), DriveConditions(0.52, 150.0), DriveConditions(0.52, 300.0))
TOLERANCES = SettingTolerances()


def observed(conditions, *, factor=1.0, noise=0.001, point=ACCELERATION, stated=None, physics=PHYSICS):
    """Return a response of the axis times a factor, without noise but with its statement."""
    excitation = ExcitationPoint.TORQUE_AT_MOTOR
    case = ResponseCase(LINES, conditions, excitation, point, MotorEnd.FREE)
    response = factor * responses(physics, prepare_lines([case]))
    return FrequencyResponseObservation(
        stated or conditions, LINES, response, noise * np.abs(response), excitation, point
    )  # fmt: skip


def by_channel(comparison, values):
    return {name: values[comparison.layout.channel == index] for index, name in enumerate(comparison.layout.channels)}


def test_misfit_is_the_logarithm_of_model_over_measurement() -> None:
    """A measurement that is a tenth too large and leads by 0.2 rad: −ln 1.1 and −0.2, at every line."""
    comparison = compare_responses([observed(at, factor=1.1 * np.exp(0.2j)) for at in AT])
    found = by_channel(comparison, comparison.misfit(PHYSICS))
    assert list(found) == ["acceleration-at-table, amplitude", "acceleration-at-table, phase"]
    np.testing.assert_allclose(found["acceleration-at-table, amplitude"], -np.log(1.1), atol=1e-12)
    np.testing.assert_allclose(found["acceleration-at-table, phase"], -0.2, atol=1e-12)


@pytest.mark.parametrize("turned", [3.0, -3.0, 1.5 * np.pi])
def test_phases_differ_by_half_a_turn_at_most(turned) -> None:
    comparison = compare_responses([observed(AT[0], factor=np.exp(1j * turned))])
    phase = by_channel(comparison, comparison.misfit(PHYSICS))["acceleration-at-table, phase"]
    np.testing.assert_allclose(phase, np.angle(np.exp(-1j * turned)), atol=1e-12)


def test_a_change_through_half_a_turn_is_small() -> None:
    """Phases wrap, amplitudes do not."""
    comparison = compare_responses([observed(AT[0])])
    layout = comparison.layout
    phase = np.array([name.endswith("phase") for name in layout.channels])[layout.channel]
    before, after = np.where(phase, np.pi - 0.05, 3.0), np.where(phase, -np.pi + 0.05, -3.0)
    np.testing.assert_allclose(layout.difference(after, before), np.where(phase, 0.1, -6.0), atol=1e-12)


def test_values_know_their_setting_line_and_point() -> None:
    """Two sensors at the same conditions were read together and share one setting."""
    comparison = compare_responses(
        [observed(AT[0]), observed(AT[1]), observed(AT[0], point=ANGLE), observed(AT[1], point=ANGLE)]
    )
    layout, n = comparison.layout, LINES.size
    assert [setting.name for setting in layout.settings] == ["210 mm, 150 N", "520 mm, 150 N"]
    np.testing.assert_array_equal(layout.setting, np.repeat([0, 1], 4 * n))
    np.testing.assert_array_equal(layout.channel, np.tile(np.repeat([0, 1, 2, 3], n), 2))
    np.testing.assert_allclose(layout.frequency, np.tile(LINES, 8))
    assert comparison.condition_error_names == ("position", "preload", "gain 1", "gain 2")
    assert layout.settings[0].values[ConditionAxis.PRELOAD] == 150.0


def test_a_point_that_is_measured_again_was_measured_at_another_time() -> None:
    """With a position and a preload of its own, though the same is stated."""
    comparison = compare_responses([observed(AT[0]), observed(AT[0], factor=1.01), observed(AT[0])])
    assert len(comparison.layout.settings) == 3
    assert comparison.condition_error_names == ("position", "preload", "gain 1")


def test_an_error_of_a_setting_that_is_known_is_taken_out() -> None:
    """Truly 2 standard deviations further off, 1.5 below in preload, 3 too high in gain."""
    errors = np.array([[2.0, -1.5, 3.0], [0.0, 0.0, 0.0], [-1.0, 2.0, -2.0]])
    observations = []
    for stated, (position, preload, gain) in zip(AT, errors, strict=True):
        true = replace(
            stated,
            position=stated.position + position * TOLERANCES.position,
            preload=stated.preload * (1.0 + preload * TOLERANCES.preload_share),
        )
        factor = np.exp(-gain * TOLERANCES.gain_share)
        observations.append(replace(observed(true, factor=1.0 / factor), conditions=stated))
    comparison = compare_responses(observations)
    assert np.max(np.abs(comparison.misfit(PHYSICS))) > 0.01
    np.testing.assert_allclose(comparison.shifted(errors).misfit(PHYSICS), 0.0, atol=1e-12)


@pytest.mark.parametrize("index", range(4))
def test_changes_by_errors_are_those_of_the_shifted_comparison(index) -> None:
    """Position, preload, and the gain of each of two sensors, at one setting and not at the others."""
    comparison = compare_responses([observed(at, point=point) for at in AT for point in (ACCELERATION, ANGLE)])
    step, errors = 1e-3, np.zeros((3, 4))
    errors[1, index] = step
    misfit = comparison.misfit(PHYSICS)
    change = (comparison.shifted(errors).misfit(PHYSICS) - misfit) / step
    expected = np.where(comparison.layout.setting == 1, comparison.condition_errors(PHYSICS, misfit)[index], 0.0)
    np.testing.assert_allclose(change, expected, atol=0.02 * np.max(np.abs(expected)))
    assert np.any(change)


def smeared(conditions, *, point=ACCELERATION, resolution=2.0, steps=60):
    """Return a response as averages over windows show it, by the integral over the spectrum of Hann's window."""
    offsets = (np.arange(-4.0, 4.0, 8.0 / steps) + 4.0 / steps) * resolution
    turns = offsets / resolution
    power = (np.sinc(turns) + 0.5 * (np.sinc(turns - 1.0) + np.sinc(turns + 1.0))) ** 2
    seen = np.zeros(LINES.size, dtype=complex)
    for offset, weight in zip(offsets, power / np.sum(power), strict=True):
        case = ResponseCase(LINES + offset, conditions, ExcitationPoint.TORQUE_AT_MOTOR, point, MotorEnd.FREE)
        seen += weight * responses(PHYSICS, prepare_lines([case]))
    return replace(observed(conditions, point=point), response=seen, resolution=resolution)


def test_averages_over_windows_agree_with_the_axis_that_they_are_of() -> None:
    """Where they state their resolution: a fiftieth and less of the misfit is left that they show without."""
    averaged = [smeared(at) for at in AT]
    plain = compare_responses([replace(observation, resolution=0.0) for observation in averaged]).misfit(PHYSICS)
    stated = compare_responses(averaged)
    assert np.max(np.abs(plain)) > 0.05
    assert np.max(np.abs(stated.misfit(PHYSICS))) < 0.02 * np.max(np.abs(plain))
    for panel, observation in zip(stated.panels({"after": PHYSICS}), averaged, strict=True):
        np.testing.assert_allclose(panel.models["after"], np.abs(observation.response), rtol=1e-3)


def test_resolved_data_have_the_misfit_of_the_averages_where_they_were_resolved() -> None:
    """With errors of the settings, which move the modes; and no resolution is looked at any more."""
    comparison = compare_responses([smeared(at) for at in AT])
    errors = np.array([[1.0, -2.0, 0.5], [0.0, 1.0, 0.0], [-1.0, 0.3, 2.0]])
    resolved = comparison.resolved(PHYSICS, errors)
    assert resolved.smearing is None
    np.testing.assert_allclose(
        resolved.shifted(errors).misfit(PHYSICS), comparison.shifted(errors).misfit(PHYSICS), atol=1e-12
    )
    assert compare_responses([observed(AT[0])]).resolved(PHYSICS, errors[:1]).smearing is None


def test_a_gain_is_a_matter_of_the_amplitude_of_its_own_sensor() -> None:
    comparison = compare_responses([observed(AT[0]), observed(AT[0], point=ANGLE)])
    first, second = comparison.condition_errors(PHYSICS, comparison.misfit(PHYSICS))[2:]
    for index, row in ((0, first), (2, second)):
        np.testing.assert_array_equal(row, np.where(comparison.layout.channel == index, TOLERANCES.gain_share, 0.0))


def test_noise_of_a_line_scatters_both_parts_as_stated() -> None:
    """Over draws, at a signal twenty times the noise; the form error joins as a root of squares."""
    spectrum = FormSpectrum((10.0, 2000.0), (0.03, 0.03), frequency_tolerance=(0.0, 0.0), learnt=True)
    clean = observed(AT[0], noise=0.05)
    rng = np.random.default_rng(1)
    scatter = 0.05 * np.abs(clean.response)
    drawn = []
    for _ in range(600):
        noise = rng.standard_normal(LINES.size) + 1j * rng.standard_normal(LINES.size)
        noisy = replace(clean, response=clean.response + scatter * noise)
        drawn.append(compare_responses([noisy]).misfit(PHYSICS))
    np.testing.assert_allclose(np.std(drawn, axis=0), 0.05, rtol=5.0 / np.sqrt(2 * 600))
    comparison = compare_responses([clean], form=ModelFormError({ACCELERATION: spectrum}))
    np.testing.assert_allclose(comparison.layout.standard_deviation, np.hypot(0.05, 0.03))
    np.testing.assert_allclose(comparison.noise, 0.05)


@pytest.mark.parametrize("n_settings", [1, 3, 30])
@pytest.mark.parametrize("noise", [0.002, 0.03])
def test_floor_is_what_noise_and_a_learnt_form_error_leave(n_settings, noise) -> None:
    """Over machines, each off by one error at each line in all its settings."""
    spectrum = FormSpectrum((10.0, 2000.0), (0.01, 0.01), frequency_tolerance=(0.0, 0.0), learnt=True)
    conditions = [DriveConditions(x, 150.0) for x in np.linspace(0.1, 0.8, n_settings)]
    clean = [observed(at, noise=noise) for at in conditions]
    comparison = compare_responses(clean, form=ModelFormError({ACCELERATION: spectrum}))
    layout, rng = comparison.layout, np.random.default_rng(3)
    none = np.zeros((0, layout.n_values))
    squares = []
    for _ in range(400):
        of_form = 0.01 * rng.standard_normal(np.max(layout.common.group) + 1)
        misfit = of_form[layout.common.group] + noise * rng.standard_normal(layout.n_values)
        residuals = whitening(layout.standard_deviation, none, layout.setting, layout.common)(misfit)
        squares.append(np.mean(residuals**2))
    spread = np.std(squares) / np.sqrt(len(squares))
    assert comparison.noise_floor**2 == pytest.approx(np.mean(squares), abs=4.0 * spread)


def test_the_form_error_of_a_line_is_common_to_all_settings() -> None:
    """Amplitudes and phases apart, as large as it counts; held-out settings do not see that of the fitted ones."""
    comparison = compare_responses([observed(at) for at in AT], held_out=[frozenset({AT[1]})])
    layout, common = comparison.layout, comparison.layout.common
    np.testing.assert_allclose(np.hypot(comparison.noise, common.deviation), layout.standard_deviation)
    held = layout.setting == 1
    same = (
        (layout.frequency[:, None] == layout.frequency)
        & (layout.channel[:, None] == layout.channel)
        & (held[:, None] == held)
    )
    np.testing.assert_array_equal(common.group[:, None] == common.group, same)


def test_residuals_of_the_truth_are_standard_normal() -> None:
    """With noise and errors of every setting drawn as stated; Kolmogorov and Smirnov at one in ten thousand."""
    conditions = settings()
    comparison = compared(measured(true_subject(5), conditions, seed=5))
    truth = true_subject(5)
    around = linearise(comparison, truth, np.zeros((len(conditions), 3)), comparison.layout.standard_deviation)
    for _ in range(3):  # errors of settings are not quite linear
        errors = around.whitened_by.errors(around.misfit(truth))
        around = linearise(comparison, truth, errors, comparison.layout.standard_deviation)
    residuals = around.residuals(truth)
    assert stats.kstest(residuals, "norm").pvalue > 1e-4
    everything = np.ones(residuals.size, bool)
    assert comparison.gap(around.misfit(truth), residuals, everything) == pytest.approx(
        comparison.noise_floor, abs=4.0 / np.sqrt(2.0 * residuals.size)
    )


def test_gap_is_the_rms_of_the_chosen_values() -> None:
    comparison = compare_responses([observed(AT[0])])
    values = np.arange(comparison.layout.n_values, dtype=float)
    chosen = values < 4
    assert comparison.gap(np.full(values.size, 99.0), values, chosen) == pytest.approx(np.sqrt(14.0 / 4.0))
    assert comparison.unit == "sigma"


def test_lines_in_the_noise_are_left_out() -> None:
    """The logarithm of a line below eight times its noise would be biased; here every other line."""
    observation = observed(AT[0])
    noisy = np.arange(LINES.size) % 2 == 1
    deviation = np.where(noisy, 1.0 / 7.9, 1.0 / 8.1) * np.abs(observation.response)
    comparison = compare_responses([replace(observation, standard_deviation=deviation)])
    np.testing.assert_allclose(comparison.layout.frequency, np.tile(LINES[~noisy], 2))


def test_responses_without_a_clear_line_are_left_out_and_refused_if_none_has_one() -> None:
    good, bad = observed(AT[0]), observed(AT[1], noise=0.5)
    assert [setting.name for setting in compare_responses([bad, good]).layout.settings] == ["210 mm, 150 N"]
    with pytest.raises(NotIdentifiableError, match="8 times above their noise; got none"):
        compare_responses([bad])


def test_folds_are_whole_settings() -> None:
    folds = [frozenset({AT[1]}), frozenset({AT[0], AT[2]})]
    comparison = compare_responses([observed(at) for at in AT], held_out=folds)
    layout = comparison.layout
    np.testing.assert_array_equal(layout.held_out[0], layout.setting == 1)
    np.testing.assert_array_equal(layout.held_out[1], layout.setting != 1)


def test_pictures_show_measurement_and_models() -> None:
    comparison = compare_responses(
        [observed(at, factor=1.1) for at in AT], held_out=[frozenset({AT[1]})], form=FORM
    )  # fmt: skip
    panels = comparison.panels({"before": PHYSICS, "after": true_subject(1)})
    assert [panel.title for panel in panels] == [
        "210 mm, 150 N, acceleration-at-table",
        "520 mm, 150 N, acceleration-at-table",
        "520 mm, 300 N, acceleration-at-table",
    ]
    assert [panel.held_out for panel in panels] == [False, True, False]
    for panel, stated in zip(panels, AT, strict=True):
        assert list(panel.models) == ["before", "after"]
        np.testing.assert_allclose(panel.x, LINES)
        np.testing.assert_allclose(panel.measured, np.abs(observed(stated, factor=1.1).response))
        np.testing.assert_allclose(panel.models["before"], np.abs(observed(stated).response), rtol=1e-9)
        other = observed(stated, physics=true_subject(1))
        np.testing.assert_allclose(panel.models["after"], np.abs(other.response), rtol=1e-9)


def test_pictures_of_folds_in_turn_are_fitted_ones() -> None:
    comparison = compare_responses([observed(at) for at in AT], held_out=[frozenset({at}) for at in AT])
    assert [panel.held_out for panel in comparison.panels({})] == [False, False, False]
