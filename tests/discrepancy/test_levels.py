"""What goes with the levels of a variable is described by place, quantity and form: by plants of finite elements."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.description.answers import Base, share_of_free
from monitor_core.discrepancy.description.describe import describe, refit_with_law
from monitor_core.discrepancy.description.levels import describe_levels
from monitor_core.discrepancy.description.variation import (
    QUANTITIES,
    FreeVariation,
    constant_law,
    evidence_of_variables,
    fitted_settings,
    judged_on_lines,
    law_of_levels,
    vary_freely,
)
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Outcome, Unfinished
from monitor_core.discrepancy.search.workspace import StoppableAxis, TimeIsUpError
from monitor_core.effects import Form, Variable
from monitor_core.effects.variation import GEAR_RATIO
from monitor_core.fitting.hold_out import fitted_values, gap_of
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.extended import AxisSetting
from tests.discrepancy import axes
from tests.hidden_effects.answered import compared
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.machines import jittered, machine_named
from tests.hidden_effects.situations import Situation


def drawn(kind, machine, design, noise, seed):
    """Return a case, its comparison and the drive as stated."""
    situation = Situation(machine=jittered(machine_named(machine), np.random.default_rng([seed, 1])), design=design)
    case = draw_case(kind, "large", noise, seed, situation=situation)
    return case, *compared(case)


def described(kind, machine, design, noise, seed):
    """Return the case, and what is said of it from the model as stated."""
    case, comparison, drive = drawn(kind, machine, design, noise, seed)
    plain = Hypothesis(drive)
    baseline = fit(comparison, plain, plain.null, fitted_values(comparison.layout))
    answer = describe_levels(baseline, baseline, lambda _sentence: None)
    assert gap_of(answer.fitted.comparison, answer.fitted.held_out) < 1.1 * comparison.noise_floor
    found, (truth,) = answer.described, case.truth.values()
    return case, found, truth


def value_of(found, name="change"):
    return found.parameters[name].estimate.value


def holds_for(found, truth, name="change", widened=1.0):
    """Return whether an interval, or one so many times as wide, covers the truth."""
    (low, high), value = found.parameters[name].interval_95, value_of(found, name)
    return value - widened * (value - low) <= truth <= value + widened * (high - value)


def test_a_belt_between_motor_and_screw_is_another_ratio_at_every_setting():
    _, found, truth = described("outside:belt", "gantry", "poor", 0.003, 7020)
    assert (found.place, found.parameter) == ("motor", "gear_ratio")
    assert (found.law.variable, found.law.form) == (Variable.NOTHING, Form.CONSTANT)
    assert holds_for(found, truth["ratio"] - 1.0)


def test_neither_description_goes_on_once_time_is_up():
    """Whoever asks for them stops: an axis says so once."""
    _, comparison, drive = drawn("outside:belt", "gantry", "poor", 0.003, 7020)
    axis = StoppableAxis(drive, lambda: True)
    plain = Hypothesis(axis)
    baseline = fit(comparison, plain, plain.null, fitted_values(comparison.layout))
    with axis.stoppable(), pytest.raises(TimeIsUpError):
        describe(baseline, baseline, (), None, lambda _sentence: None)
    with axis.stoppable(), pytest.raises(TimeIsUpError):
        describe_levels(baseline, baseline, lambda _sentence: None)
    told = list[str]()
    answer = explain_comparison(
        comparison, drive, (), progress=told.append, time_is_up=lambda: told[-1].startswith("describing what is left")
    )
    assert told[-2:] == ["describing what is left", "locating the misfit"]
    assert (answer.outcome, answer.unfinished) == (Outcome.UNKNOWN, Unfinished("describing what is left"))


def test_a_law_with_a_value_at_each_level_has_a_share_where_the_fit_reached_the_data():
    """A constant law has none of what a free variation takes, and one of levels is weighed by its fit alone."""
    _, comparison, drive = drawn("outside:belt", "gantry", "poor", 0.003, 7020)
    plain = Hypothesis(drive)
    before = fit(comparison, plain, plain.null, fitted_values(comparison.layout))
    ratio = next(each for each in QUANTITIES if each.field == GEAR_RATIO)
    variation, settings = vary_freely(before, ratio), fitted_settings(before)
    for tried in (constant_law(variation), law_of_levels(variation, Variable.POSITION, settings)):
        answer = refit_with_law(Base(before), tried, lambda _sentence: None)
        assert share_of_free(answer) > 0.9


@pytest.mark.release
def test_a_screw_that_is_worn_at_a_place_is_a_dip_of_the_nut_there():
    """The nut is of the cube root of its preload, most of which is lost on a fifth of the screw."""
    case, found, truth = described("outside:local-wear", "mini", "rich", 0.01, 7000)
    length = case.axis.parts.screw_length
    assert (found.place, found.parameter) == ("nut", "nut_stiffness_n_per_m")
    assert (found.law.variable, found.law.form) == (Variable.POSITION, Form.DIP)
    assert found.law.reference == pytest.approx(truth["place"] * length, abs=0.05 * length)
    assert value_of(found) == pytest.approx((1.0 - truth["share"]) ** (1.0 / 3.0) - 1.0, abs=0.1)


@pytest.mark.release
def test_a_screw_that_is_worn_beyond_a_place_is_a_step_of_the_nut():
    case, found, truth = described("outside:wear-beyond", "bench", "usual", 0.003, 7005)
    place = truth["place"] * case.axis.parts.screw_length
    assert (found.place, found.parameter) == ("nut", "nut_stiffness_n_per_m")
    assert (found.law.variable, found.law.form) == (Variable.POSITION, Form.STEP)
    assert abs(place - found.law.reference) < found.law.scale
    assert holds_for(found, (1.0 - truth["share"]) ** (1.0 / 3.0) - 1.0)


@pytest.mark.release
def test_a_torque_that_saturates_is_a_gain_that_is_clipped():
    _, found, truth = described("outside:torque-limit", "centre", "rich", 0.003, 7010)
    assert (found.place, found.parameter) == ("motor", "torque_gain")
    assert (found.law.variable, found.law.form) == (Variable.EXCITATION, Form.CLIPPED)
    assert found.law.scale / value_of(found, "scale_over_limit") == pytest.approx(truth["torque_nm"], rel=0.05)


@pytest.mark.release
def test_an_error_of_pitch_is_the_travel_per_turn_over_the_position():
    case, found, truth = described("outside:pitch-error", "mill", "usual", 0.01, 7015)
    assert (found.place, found.parameter) == ("screw", "travel_per_turn_m")
    assert (found.law.variable, found.law.form) == (Variable.POSITION, Form.LEVELS)
    along = np.array(found.law.knots) / case.axis.parts.screw_length
    true = 1.0 + truth["share"] * np.sin(2.0 * math.pi * truth["waves"] * along)
    changes = tuple(value_of(found, name) for name in found.parameters)
    factors = np.array([found.law.factor(knot, changes) for knot in found.law.knots])
    np.testing.assert_allclose(factors, true, atol=0.01)


@pytest.mark.release
@pytest.mark.parametrize(
    ("kind", "machine", "design", "noise", "seed", "form"),
    [
        ("outside:mass-lost", "mini", "rich", 0.003, 7025, Form.LINEAR),
        ("outside:mass-lost-at-once", "bench", "usual", 0.01, 7030, Form.STEP),
    ],
)
def test_a_mass_that_is_lost_during_the_test_is_told_with_how(kind, machine, design, noise, seed, form):  # noqa: PLR0917
    case, found, truth = described(kind, machine, design, noise, seed)
    assert (found.place, found.parameter) == ("table", "table_mass_kg")
    assert (found.law.variable, found.law.form) == (Variable.ORDER, form)
    assert value_of(found) == pytest.approx(-truth["mass_kg"] / case.axis.parts.table_mass, rel=0.1)
    assert form is Form.LINEAR or abs(truth["when"] - found.law.reference) < found.law.scale + 0.05


# --- which variable, before anything is fitted

SETTINGS = tuple(
    AxisSetting(position=x, preload=preload, order=order)
    for (x, preload), order in zip(
        [(0.1 * n, preload) for n in range(1, 8) for preload in (100.0, 200.0, 300.0)],
        np.random.default_rng(3).permutation(21) / 20.0,
        strict=True,
    )
)
GRID = np.linspace(-1.0, 1.0, 41)


def asking_for(theta, deviation=0.01):
    """Return the free variation of settings that ask for these values, each within a deviation."""
    cost = ((GRID - np.asarray(theta)[:, None]) / deviation) ** 2
    return FreeVariation(QUANTITIES[0], GRID, cost, np.zeros_like(cost))


def test_what_settings_ask_for_is_read_from_their_parabolas() -> None:
    theta = np.linspace(-0.7, 0.6, 21)
    asked, variance = asking_for(theta).asked
    np.testing.assert_allclose(asked, theta, atol=1e-12)
    np.testing.assert_allclose(variance, 1e-4, rtol=1e-9)


@pytest.mark.parametrize(
    ("of", "variable"),
    [
        (lambda setting: -0.5 * (setting.position > 0.45), Variable.POSITION),
        (lambda setting: -0.4 * math.exp(-0.5 * ((setting.position - 0.3) / 0.05) ** 2), Variable.POSITION),
        (lambda setting: 0.001 * setting.preload, Variable.PRELOAD),
        (lambda setting: -0.3 * (setting.order > 0.6), Variable.ORDER),
    ],
)
def test_the_evidence_is_for_the_variable_that_values_follow(of, variable) -> None:
    scatter = 0.01 * np.random.default_rng(1).standard_normal(21)
    evidence = evidence_of_variables(asking_for([of(setting) for setting in SETTINGS] + scatter), SETTINGS, 1.0)
    assert max(evidence, key=evidence.get) is variable
    assert evidence[variable] > max(value for other, value in evidence.items() if other is not variable) + 5.0


def test_a_variable_that_is_alike_but_for_rounding_is_not_asked() -> None:
    settings = tuple(replace(setting, payload_mass=0.1 * 3.0 + 1e-16 * n) for n, setting in enumerate(SETTINGS))
    assert np.ptp([setting.payload_mass for setting in settings]) > 0.0
    assert Variable.PAYLOAD not in evidence_of_variables(asking_for(np.zeros(21)), settings, 1.0)


def test_levels_that_lie_apart_have_a_value_where_there_are_data() -> None:
    positions = np.repeat([*np.linspace(0.1, 0.2, 9), 1.0, 1.1, 1.2], 2)
    settings = tuple(AxisSetting(position=x) for x in positions)
    law = law_of_levels(asking_for(-0.3 * positions), Variable.POSITION, settings)
    knots = np.array(law.law.knots)
    assert set(knots) <= set(np.round(positions, 9))
    np.testing.assert_allclose(law.coefficients, np.expm1(-0.3 * knots), atol=1e-9)


def test_a_setting_without_lines_held_out_is_judged_with_the_quantity_as_all_have_it() -> None:
    cost = asking_for(np.full(21, 0.3)).cost
    held_out = cost.copy()
    held_out[4] = 0.0
    judged = FreeVariation(QUANTITIES[0], GRID, cost, held_out).judged
    assert judged == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("offset", [1e-9, 0.004])
def test_neighbouring_lines_of_offset_grids_are_held_out_together(offset) -> None:
    """Each setting has its lines a little higher than the one before, and some responses lack a few of them."""
    observations = [
        each
        for n, stated in enumerate(axes.settings())
        for each in axes.measured(axes.true_subject(), [stated], lines=np.delete(axes.LINES, [n]) * (1.0 + offset * n))
    ]
    plain = Hypothesis(axes.subject())
    layout = judged_on_lines(fit(axes.compared(observations), plain, plain.null)).comparison.layout
    (out,), runs = layout.held_out, axes.LINES[np.arange(axes.LINES.size) % 12 < 4]
    for number in range(len(layout.settings)):
        here = layout.setting == number
        assert np.mean(out[here]) == pytest.approx(1.0 / 3.0, abs=0.1)
        near = np.min(np.abs(layout.frequency[here & out][:, None] / runs - 1.0), axis=1)
        assert np.max(near) < 0.1  # a line and the next are 8 % apart


def test_two_lines_that_nearly_coincide_are_no_grid_to_go_on_with() -> None:
    """A response reaches farther down than the longest, of which the first two lines are the same but for rounding."""
    first, second = axes.settings()[:2]
    longest = np.concatenate([[300.0, 300.02], np.arange(302.0, 360.0)])
    lower = np.arange(260.0, 310.0)
    observations = [
        *axes.measured(axes.true_subject(), [first], lines=longest),
        *axes.measured(axes.true_subject(), [second], lines=lower),
    ]
    plain = Hypothesis(axes.subject())
    layout = judged_on_lines(fit(axes.compared(observations), plain, plain.null)).comparison.layout
    out = layout.held_out[0][(layout.setting == layout.setting[-1]) & (layout.frequency < 300.0)][:40]  # one response
    np.testing.assert_array_equal(out[12:], out[:-12])
    assert np.mean(out[:36]) == pytest.approx(1.0 / 3.0)


def test_values_by_lot_follow_no_variable_and_alike_ones_ask_for_none() -> None:
    rng = np.random.default_rng(2)
    by_lot = evidence_of_variables(asking_for(rng.uniform(-0.4, 0.4, 21)), SETTINGS, 1.0)
    assert max(by_lot, key=by_lot.get) is None
    alike = evidence_of_variables(asking_for(0.2 + 0.01 * rng.standard_normal(21)), SETTINGS, 1.0)
    assert max(alike.values()) < 0.0
