"""Natural frequencies against an axis: whose frequency is whose, against brute force, and the numbers of Nguyen et al.

The closed form of Nguyen et al. (2018), Eqs. (1) to (6), is written out here once more.
"""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import optimize

from monitor_core.effects import wrong_parameter
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import SettingTolerances
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.observations import ModalObservation
from monitor_core.fitting.residuals.modes import compare_modes
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.extended import Move, natural_frequencies, physics_of
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.recordings.modal_csv import read_modal_table
from tests.discrepancy.axes import effects_by_key
from tests.models.extended_axes import bundled

MISSED = -math.log(0.75)
#: So well known that errors of settings play no part.
EXACT = SettingTolerances(position=1e-9, preload_share=1e-9)


def observed(frequencies, at, **stated):
    return [ModalObservation(at, float(frequency), **stated) for frequency in frequencies]


# --- whose frequency is whose ----------------------------------------------------------------------------------------

MANY = physics_of(bundled("receptance").parameters)
THERE = DriveConditions(0.8)
#: Without damping, below 6.1 kHz.
MODES = np.array(
    [
        mode.frequency
        for mode in natural_frequencies(
            replace(MANY, joints=replace(MANY.joints, bearing_damping=0.0, far_bearing_damping=0.0, nut_damping=0.0,
                                         coupling_damping=0.0)),
            [THERE], [MotorEnd.FREE], 6100.0,
        )[0]
        if mode.frequency > 1.0
    ]
)  # fmt: skip


def smallest_sum(measured, predicted):
    """Return the smallest sum of misfits over every way to give each measured frequency a mode of its own, or none."""
    best = math.inf
    for n_matched in range(min(measured.size, predicted.size) + 1):
        for kept in combinations(range(measured.size), n_matched):
            distance = np.abs(np.log(measured[list(kept), None] / predicted))
            rows, columns = optimize.linear_sum_assignment(distance) if n_matched else ([], [])
            best = min(best, float(np.sum(distance[rows, columns])) + MISSED * (measured.size - n_matched))
    return best


def test_the_axis_of_the_brute_force_has_many_modes() -> None:
    assert np.sum(MODES < 3000.0) >= 7


@settings(max_examples=30)
@given(st.lists(st.floats(15.0, 3000.0), min_size=2, max_size=5, unique=True))
def test_assignment_has_the_smallest_sum_of_misfits(frequencies) -> None:
    """Modes of the model up to twice the highest frequency; in no order, whatever the axis makes of them."""
    measured = np.array(sorted(frequencies))
    comparison = compare_modes(observed(measured, THERE), MotorEnd.FREE)
    misfit = comparison.misfit(MANY)
    sought = MODES[: np.searchsorted(MODES, 2.0 * np.max(measured))]
    assert np.sum(np.abs(misfit)) == pytest.approx(smallest_sum(measured, sought), rel=1e-6)
    # each misfit leads to a mode, and to one that no other has
    reached = measured * np.exp(misfit)
    matched = np.array([np.min(np.abs(MODES / frequency - 1.0)) < 1e-6 for frequency in reached])
    np.testing.assert_allclose(misfit[~matched], -MISSED)
    assert np.unique(np.round(reached[matched], 4)).size == np.count_nonzero(matched)


def test_a_mode_that_nobody_measured_costs_nothing() -> None:
    every, some = MODES[:5], MODES[[0, 3]]
    np.testing.assert_allclose(compare_modes(observed(every, THERE), MotorEnd.FREE).misfit(MANY), 0.0, atol=1e-9)
    np.testing.assert_allclose(compare_modes(observed(some, THERE), MotorEnd.FREE).misfit(MANY), 0.0, atol=1e-9)


def test_a_frequency_near_no_mode_is_missed_by_a_quarter() -> None:
    between = math.sqrt(MODES[0] * MODES[1])
    assert MODES[1] / MODES[0] > 0.75**-2
    misfit = compare_modes(observed([MODES[0], between], THERE), MotorEnd.FREE).misfit(MANY)
    np.testing.assert_allclose(misfit, [0.0, -MISSED], atol=1e-9)


def test_a_single_frequency_belongs_to_the_nearest_mode_however_far() -> None:
    between = 0.6 * MODES[0]
    misfit = compare_modes(observed([between], THERE), MotorEnd.FREE).misfit(MANY)
    # below 1 Hz and beyond twice the highest measured frequency no mode is sought
    np.testing.assert_allclose(misfit, [-math.log(0.6)], atol=1e-9)


# --- values, settings, gap -------------------------------------------------------------------------------------------

LUMPED = bundled("lumped").parameters
AT = (DriveConditions(0.25, 100.0), DriveConditions(0.5, 100.0), DriveConditions(0.75, 300.0))


def test_values_stand_by_position_and_rising_frequency() -> None:
    """Whatever the order of the table; a frequency without order is counted in its setting."""
    first, second = DriveConditions(0.4), DriveConditions(0.9)
    table = [*observed([MODES[2]], second), *observed([MODES[1], MODES[0]], first), *observed([MODES[0]], second)]
    layout = compare_modes(table, MotorEnd.FREE).layout
    assert [setting.name for setting in layout.settings] == ["400 mm", "900 mm"]
    np.testing.assert_array_equal(layout.setting, [0, 0, 1, 1])
    np.testing.assert_allclose(layout.frequency, [MODES[0], MODES[1], MODES[0], MODES[2]])
    assert layout.channels == ("mode 1", "mode 2")
    np.testing.assert_array_equal(layout.channel, [0, 1, 0, 1])


def test_orders_of_the_source_are_channels() -> None:
    table = observed([MODES[0]], THERE, order=1) + observed([MODES[3]], THERE, order=4)
    assert compare_modes(table, MotorEnd.FREE).layout.channels == ("mode 1", "mode 4")


def test_uncertainty_of_a_frequency() -> None:
    """As stated, with 0.1 % of the model's own beside it; 1.5 % where nobody states one."""
    table = observed([200.0], AT[0], frequency_uncertainty=0.4) + observed([180.0], AT[1])
    deviation = compare_modes(table, MotorEnd.CLAMPED).layout.standard_deviation
    np.testing.assert_allclose(deviation, [math.hypot(0.4 / 200.0, 0.001), 0.015])


def test_gap_in_hertz_of_one_mode_and_in_per_cent_of_several() -> None:
    single = compare_modes(observed([200.0], AT[0]) + observed([100.0], AT[1]), MotorEnd.CLAMPED)
    misfit, both = np.log([1.1, 0.8]), np.ones(2, bool)
    assert single.unit == "Hz"
    assert single.gap(misfit, np.zeros(2), both) == pytest.approx(20.0)  # +20 Hz and −20 Hz
    assert single.gap(misfit, np.zeros(2), np.array([True, False])) == pytest.approx(20.0)
    several = compare_modes(observed([100.0, 200.0], AT[0]), MotorEnd.CLAMPED)
    assert several.unit == "%"
    assert several.gap(misfit, np.zeros(2), both) == pytest.approx(100.0 * math.sqrt((0.01 + 0.04) / 2.0))


def test_noise_floor_is_the_gap_of_frequencies_off_by_their_uncertainty() -> None:
    table = [
        *observed([200.0], AT[0], frequency_uncertainty=1.0),
        *observed([100.0], AT[1], frequency_uncertainty=3.0),
    ]
    floor = compare_modes(table, MotorEnd.CLAMPED).noise_floor
    assert floor == pytest.approx(math.sqrt((1.0**2 + 0.2**2 + 3.0**2 + 0.1**2) / 2.0), rel=0.02)


def test_errors_of_settings_are_those_of_the_shifted_comparison() -> None:
    physics = physics_of(LUMPED)
    comparison = compare_modes([observation for at in AT for observation in observed([180.0], at)], MotorEnd.CLAMPED)
    assert comparison.condition_error_names == ("position", "preload")
    for index in range(2):
        errors = np.zeros((3, 2))
        errors[2, index] = 1e-2
        misfit = comparison.misfit(physics)
        change = (comparison.shifted(errors).misfit(physics) - misfit) / 1e-2
        expected = comparison.condition_errors(physics, misfit)[index] * [0.0, 0.0, 1.0]
        np.testing.assert_allclose(change, expected, rtol=0.02, atol=1e-9)


def test_settings_as_they_truly_were_leave_nothing() -> None:
    physics, tolerances = physics_of(LUMPED), SettingTolerances()
    errors = np.array([[2.0, -1.0], [0.0, 3.0], [-2.5, 0.5]])
    true = [
        DriveConditions(
            at.position + position * tolerances.position, at.preload * (1.0 + preload * tolerances.preload_share)
        )
        for at, (position, preload) in zip(AT, errors, strict=True)
    ]
    found = natural_frequencies(replace(physics, joints=replace(physics.joints, loss_factor=0.0)), true,
                                [MotorEnd.CLAMPED] * 3, 400.0)  # fmt: skip
    table = [
        observation for at, modes in zip(AT, found, strict=True) for observation in observed([modes[0].frequency], at)
    ]
    comparison = compare_modes(table, MotorEnd.CLAMPED)
    assert np.max(np.abs(comparison.misfit(physics))) > 1e-3
    np.testing.assert_allclose(comparison.shifted(errors).misfit(physics), 0.0, atol=1e-9)


def test_folds_are_whole_settings() -> None:
    table = [observation for at in AT for observation in observed([150.0, 180.0], at)]
    layout = compare_modes(table, MotorEnd.CLAMPED, held_out=[frozenset({at}) for at in AT]).layout
    for index, fold in enumerate(layout.held_out):
        np.testing.assert_array_equal(fold, layout.setting == index)


def test_an_empty_table_is_refused() -> None:
    with pytest.raises(NotIdentifiableError, match="at least one natural frequency; got none"):
        compare_modes([], MotorEnd.CLAMPED)


# --- damping ratios --------------------------------------------------------------------------------------------------

DAMPED = replace(physics_of(LUMPED), joints=replace(physics_of(LUMPED).joints, loss_factor=0.03))


def with_damping_ratios(physics, places, share=1.0, **stated):
    """Return the first mode at each place as the axis has it, its damping ratio multiplied."""
    found = natural_frequencies(physics, places, [MotorEnd.CLAMPED] * len(places), 400.0)
    undamped = replace(physics, joints=replace(physics.joints, loss_factor=0.0))
    rest = natural_frequencies(undamped, places, [MotorEnd.CLAMPED] * len(places), 400.0)
    return [
        ModalObservation(at, there[0].frequency, damping_ratio=share * modes[0].damping_ratio, **stated)
        for at, modes, there in zip(places, found, rest, strict=True)
    ]


def test_damping_ratios_follow_the_frequencies_of_their_setting() -> None:
    table = with_damping_ratios(DAMPED, AT[:2]) + observed([150.0], AT[2])
    layout = compare_modes(table, MotorEnd.CLAMPED).layout
    assert layout.channels == ("mode 1", "mode 1, damping ratio")
    np.testing.assert_array_equal(layout.setting, [0, 0, 1, 1, 2])
    np.testing.assert_array_equal(layout.channel, [0, 1, 0, 1, 0])
    np.testing.assert_array_equal(np.isnan(layout.frequency), [False, True, False, True, False])


@pytest.mark.parametrize("share", [0.5, 1.0, 4.0])
def test_misfit_of_a_damping_ratio_is_relative(share) -> None:
    comparison = compare_modes(with_damping_ratios(DAMPED, AT, share), MotorEnd.CLAMPED)
    expected = [0.0, 1.0 / share - 1.0] * 3
    np.testing.assert_allclose(comparison.misfit(DAMPED), expected, atol=1e-6)
    # an axis without damping has a misfit, too
    undamped = replace(DAMPED, joints=replace(DAMPED.joints, loss_factor=0.0))
    np.testing.assert_allclose(comparison.misfit(undamped), [0.0, -1.0] * 3, atol=1e-6)


def test_each_damping_ratio_is_that_of_its_own_mode() -> None:
    """Whether or not those between are measured."""
    found = [mode for mode in natural_frequencies(MANY, [THERE], [MotorEnd.FREE], 1500.0)[0] if mode.frequency > 1.0]
    table = [ModalObservation(THERE, MODES[k], damping_ratio=found[k].damping_ratio) for k in (0, 3)]
    table += observed([MODES[1]], THERE)
    comparison = compare_modes(table, MotorEnd.FREE)
    np.testing.assert_allclose(comparison.misfit(MANY), 0.0, atol=1e-6)
    assert comparison.layout.channels == (
        "mode 1",
        "mode 2",
        "mode 3",
        "mode 1, damping ratio",
        "mode 3, damping ratio",
    )


def test_the_damping_ratio_of_a_missed_mode_is_missed_altogether() -> None:
    between = math.sqrt(MODES[0] * MODES[1])
    table = observed([MODES[0]], THERE) + observed([between], THERE, damping_ratio=0.01)
    np.testing.assert_allclose(compare_modes(table, MotorEnd.FREE).misfit(MANY), [0.0, -MISSED, -1.0], atol=1e-9)


def test_frequencies_and_damping_ratios_have_a_gap_in_standard_deviations() -> None:
    """In per cent a damping ratio known to a fifth would hide a frequency."""
    table = with_damping_ratios(DAMPED, AT[:1], damping_ratio_uncertainty=0.001)
    table += with_damping_ratios(DAMPED, AT[1:2])
    comparison = compare_modes(table, MotorEnd.CLAMPED)
    assert (comparison.unit, comparison.noise_floor) == ("sigma", 1.0)
    deviation = comparison.layout.standard_deviation
    np.testing.assert_allclose(deviation, [0.015, 0.001 / table[0].damping_ratio, 0.015, 0.2])
    assert comparison.gap(np.zeros(4), np.array([3.0, 4.0, 0.0, 0.0]), np.array([True, True, False, False])) == (
        pytest.approx(math.sqrt(12.5))
    )


def test_panels_show_damping_ratios_beside_frequencies() -> None:
    table = with_damping_ratios(DAMPED, AT[:2])
    lossier = replace(DAMPED, joints=replace(DAMPED.joints, loss_factor=0.06))
    frequency, damping = compare_modes(table, MotorEnd.CLAMPED).panels({"after": lossier})
    assert (frequency.y_name, damping.y_name) == ("natural frequency [Hz]", "damping ratio [-]")
    np.testing.assert_allclose(frequency.measured, [observation.frequency for observation in table])
    np.testing.assert_allclose(damping.measured, [observation.damping_ratio for observation in table])
    np.testing.assert_allclose(damping.models["after"], 2.0 * damping.measured, rtol=5e-3)


@pytest.mark.parametrize(
    ("stated", "sentence"),
    [
        ({"damping_ratio": 0.0}, "damping_ratio must be positive and finite; got 0.0$"),
        ({"damping_ratio_uncertainty": 0.01}, "a damping ratio must be stated with its uncertainty; got 0.01 without"),
    ],
)
def test_impossible_damping_ratios_are_refused(stated, sentence) -> None:
    with pytest.raises(OutsideValidityError, match=sentence):
        ModalObservation(THERE, 100.0, **stated)


# --- Nguyen et al. (2018) --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table(published_data):
    return read_modal_table(published_data / "nguyen_table2.csv")


def closed_form(rows, bracket, *, far=0.0, ground=0.0):
    """Return the frequencies of Eqs. (1) to (6) with the literal values of Table 1, and a spring more."""
    x, preload = np.array([row.position for row in rows]), np.array([row.preload for row in rows])
    rigidity = math.pi / 4.0 * 0.0172**2 * 206e9
    nut = 0.8 * 470e6 * np.cbrt(preload / (0.1 * 4000.0))
    shear = 206e9 / 2.6
    ratio, length = 0.006 / (2.0 * math.pi), 0.971
    polar = math.pi / 32.0 * 0.0172**4
    turning = 1.0 / 849.0 + x * (length - x) / (length * shear * polar)
    axial = 1.0 / (1.0 / 100e6 + x / rigidity)
    if far:
        axial = axial + 1.0 / (1.0 / far + (length - x) / rigidity)
    path = 1.0 / (1.0 / axial + ratio**2 * turning + 1.0 / bracket + 1.0 / nut) + ground
    return np.sqrt(path / (20.54 + 2.024 + 1.3)) / (2.0 * math.pi)


def smallest(rows, scale_of, start):
    """Return the gap in hertz at the smallest sum of squares of logarithms, and at that of hertz."""
    measured = np.array([row.frequency for row in rows])
    gaps = []
    for residual in (lambda f: np.log(f / measured), lambda f: f - measured):
        found = optimize.least_squares(lambda u: residual(scale_of(u)), start, x_scale="jac", xtol=1e-12)  # noqa: B023
        gaps.append(float(np.sqrt(np.mean((scale_of(found.x) - measured) ** 2))))
    return gaps


#: The effects, the gap in hertz that independent calculations found (least squares in hertz), and the same here.
PUBLISHED = {
    "as printed": ((), 63.30, None, []),
    "bracket": (("bracket",), 7.268, lambda u: {"bracket": 2.1e7 * math.exp(u[0])}, [2.0]),
    "bracket and far bearing": (
        ("bracket", "far-bearing-stiffness"),
        3.695,
        lambda u: {"bracket": 2.1e7 * math.exp(u[0]), "far": 1e7 * u[1]},
        [1.4, 2.0],
    ),
    "ground spring": (("guide-stiffness",), 6.020, lambda u: {"bracket": 2.1e7, "ground": 1e6 * u[0]}, [18.0]),
}


@pytest.mark.release
@pytest.mark.parametrize("what", PUBLISHED)
def test_gaps_of_nguyen(table, what) -> None:
    """From Table 1 as printed, bracket stiffness 2.1E7 N/m, to Table 2."""
    keys, published, values, start = PUBLISHED[what]
    literal = replace(LUMPED, bracket_stiffness=2.1e7)
    by_key = effects_by_key() | {"bracket": wrong_parameter("bracket_stiffness_n_per_m", literal)}
    observations = [ModalObservation(DriveConditions(row.position, row.preload), row.frequency) for row in table]
    comparison = compare_modes(observations, MotorEnd.CLAMPED, tolerances=EXACT)
    hypothesis = Hypothesis(DescribedDrive(literal, {}, {}), tuple(by_key[key] for key in keys))
    at = hypothesis.null if not keys else np.full(len(keys), 1.0)
    fitted = fit(comparison, hypothesis, at)
    found = comparison.gap(fitted.misfit, fitted.standardised, fitted.fitted)
    if values is None:
        assert found == pytest.approx(published, abs=0.01)
        np.testing.assert_allclose(
            np.sort(np.exp(fitted.misfit) * comparison.layout.frequency), np.sort(closed_form(table, 2.1e7)), rtol=1e-4
        )
        return
    by_logarithm, by_hertz = smallest(table, lambda u: closed_form(table, **values(u)), start)
    assert by_hertz == pytest.approx(published, abs=0.01)
    assert found == pytest.approx(by_logarithm, abs=0.01)


# --- slopes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bearing_stiffness", "nut_stiffness", "bracket_stiffness", "coupling_stiffness"])
def test_slopes_are_those_of_the_misfit_itself(name) -> None:
    """Of an axis, and of errors of its settings."""
    physics = physics_of(LUMPED)
    observations = [peak for at in AT for peak in observed([30.0, 250.0, 900.0], at)]
    comparison = compare_modes(observations, MotorEnd.FREE)

    def moved(share):
        joints = replace(physics.joints, **{name: getattr(physics.joints, name) * math.exp(share)})
        return replace(physics, joints=joints)

    (slope,) = comparison.slopes(physics, [Move(moved(-1e-4), moved(1e-4), 2e-4)])
    difference = (comparison.misfit(moved(1e-4)) - comparison.misfit(moved(-1e-4))) / 2e-4
    assert np.max(np.abs(difference)) > 1e-3
    np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-8)
    misfit = comparison.misfit(physics)
    by_errors = comparison.condition_errors(physics, misfit)
    for errors, expected in zip(np.eye(2), by_errors, strict=True):
        ahead = comparison.shifted(np.tile(1e-2 * errors, (3, 1))).misfit(physics)
        behind = comparison.shifted(np.tile(-1e-2 * errors, (3, 1))).misfit(physics)
        np.testing.assert_allclose(expected, (ahead - behind) / 2e-2, rtol=2e-2, atol=1e-8)
