"""What is open is followed by what to do, in quantities of this machine: a record, a band, kilograms."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from monitor_core.discrepancy import Described, FoundParameter, Objection, Outcome, StepKind, UntestedReason
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, Member
from monitor_core.discrepancy.verdict.next_steps import next_steps, steps_to_locate
from monitor_core.effects import Form, Law, Variable
from monitor_core.effects.effect import ConditionAxis
from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.fitting.comparison import Setting
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.uncertainty import Estimate
from service.documents.explanation_sentences import KEYS, next_measurement, step_sentence, texts
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity

QUANTITY = re.compile(r"\d[\d.]* (mm|m|N|kg|K|Hz|s|m/s|% of what is stated)\b")
OPEN = (Outcome.UNKNOWN, Outcome.PARTIAL, Outcome.EQUIVALENT)
N_SETTINGS, N_LINES = 8, 20
FREQUENCY = np.geomspace(50.0, 1000.0, N_LINES)
SIZES = MachineSizes(
    {Reference.MOVING_MASS: 400.0, Reference.LENGTH: 2.5, Reference.PRELOAD: 3000.0, Reference.FREQUENCY: 80.0}
)


def left(data, *, lines=True, pulled=False, effects=()):
    """Return the fit of a model that has the effects asked for and nothing else; the settings are 100 mm apart."""
    frequency = np.tile(FREQUENCY, N_SETTINGS) if lines else np.nan
    layout = layout_of([N_LINES] * N_SETTINGS, 1.0, frequency=frequency)
    positions = [0.1 * (index + 1) for index in range(N_SETTINGS)]
    named = tuple(
        Setting(f"{1e3 * x:g} mm, 250 N", {ConditionAxis.POSITION: x, ConditionAxis.PRELOAD: 250.0}) for x in positions
    )
    n = N_SETTINGS * N_LINES
    directions = 3.0 * np.ones((1, n)) if pulled else np.zeros((0, n))
    design = np.zeros((n, 3))
    design[0, 0] = design[0, 1] = 1.0  # two quantities that do the same
    comparison = LinearComparison(replace(layout, settings=named), design, -np.asarray(data, dtype=float), directions)
    hypothesis = Hypothesis(LinearAxis({}, 3), tuple(quantity(index) for index in effects))
    return fit(comparison, hypothesis, hypothesis.null)


def advice(outcome, fitted, sizes=None, classes=(), described=()):
    return next_measurement(next_steps(SimpleNamespace(final=fitted), classes, outcome, (), sizes, described=described))


def located(fitted):
    return [step_sentence(step, KEYS) for step in steps_to_locate(fitted, None)]


def misfit_at(chosen, size=20.0):
    """Return noise of one standard deviation, with a misfit that changes its sign at the chosen values."""
    noise = np.random.default_rng(7).standard_normal(N_SETTINGS * N_LINES)
    return noise + np.where(chosen, size * (-1.0) ** np.arange(noise.size), 0.0)


SETTING, LINE = np.divmod(np.arange(N_SETTINGS * N_LINES), N_LINES)


@given(
    outcome=st.sampled_from(OPEN[:2]),
    seed=st.integers(0, 10_000),
    size=st.floats(0.0, 1e3),
    first=st.integers(0, N_SETTINGS - 1),
    lowest=st.integers(0, N_LINES - 1),
    constant=st.floats(-50.0, 50.0),
    lines=st.booleans(),
    pulled=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_what_is_left_is_followed_by_a_step_with_a_quantity(
    *, outcome, seed, size, first, lowest, constant, lines, pulled
) -> None:
    data = np.random.default_rng(seed).standard_normal(N_SETTINGS * N_LINES) + constant
    data[(first <= SETTING) & (lowest <= LINE)] += size
    fitted = left(data, lines=lines, pulled=pulled)
    for sizes in (None, SIZES):
        text = advice(outcome, fitted, sizes)
        assert text
        assert all(QUANTITY.search(step) for step in text.split("; ")), text
        assert "nan" not in text
        assert "inf" not in text


def test_effects_that_nothing_distinguishes_are_to_be_looked_at() -> None:
    fitted = left(misfit_at(SETTING < 0), effects=(0,))
    members = (
        Member(quantity(0), fitted, 100.0, plausible=True),
        Member(quantity(1), left(misfit_at(SETTING < 0), effects=(1,)), 99.0, plausible=True),
    )
    text = advice(Outcome.EQUIVALENT, fitted, classes=(EquivalenceClass(members, (), 5.0),))
    assert text.startswith("no change of conditions distinguishes quantity-0 from quantity-1: look at the parts")
    assert text.endswith("change one of them on purpose and measure 100 mm, 250 N again")
    assert QUANTITY.search(text)


VARIED = {
    ConditionAxis.POSITION: (0.1, 0.35, 0.8), ConditionAxis.PRELOAD: (120.0, 250.0, 400.0),
    ConditionAxis.PAYLOAD: (0.0, 6.0, 12.0), ConditionAxis.TEMPERATURE: (0.0, 8.0, 15.0),
    ConditionAxis.LEVEL: (0.05, 0.15, 0.45),
}  # fmt: skip


def varied(fitted):
    """Return the fit with settings in which everything is varied."""
    layout = fitted.comparison.layout
    settings_of_all = tuple(
        replace(each, values={axis: values[n % 3] for axis, values in VARIED.items()})
        for n, each in enumerate(layout.settings)
    )
    return replace(fitted, comparison=replace(fitted.comparison, layout=replace(layout, settings=settings_of_all)))


def coefficients(law, size):
    estimates = {item.name: Estimate(item.null + size * item.scale, 0.01) for item in law.parameters}
    return {name: FoundParameter(value, "-", (-9.0, 9.0), plausible=True) for name, value in estimates.items()}


#: As they are tried: a wave only along the travel, a power only of what is above zero.
_VARIED = tuple(variable for variable in Variable if variable is not Variable.NOTHING)
FORMS = {
    Form.CONSTANT: (Variable.NOTHING,),
    **dict.fromkeys((Form.LINEAR, Form.QUADRATIC, Form.STEP, Form.DIP), _VARIED),
    Form.CLIPPED: (Variable.EXCITATION,),
    Form.POWER: (Variable.EXCITATION, Variable.PRELOAD),
    Form.SATURATING: (Variable.EXCITATION, Variable.PRELOAD),
    Form.PERIODIC: (Variable.POSITION,),
    Form.YIELDING: (Variable.POSITION,),
}


@given(
    law_of=st.sampled_from([(variable, form) for form, variables in FORMS.items() for variable in variables]),
    reference=st.floats(0.01, 500.0),
    size=st.floats(-3.0, 3.0),
    swings=st.booleans(),
    turns=st.booleans(),
    frequency=st.floats(5.0, 2000.0),
)
@settings(max_examples=80, deadline=None)
def test_a_law_that_was_described_is_followed_by_where_to_look_for_it(
    *, law_of, reference, size, swings, turns, frequency
) -> None:
    law = Law(*law_of, reference, 0.5 * reference)
    parameter = "frequency_hz" if swings else "nut_stiffness_n_per_m"
    found = Described(
        "table", parameter, law, coefficients(law, size), (), (), 0.9, 200.0, 50.0,
        frequency_hz=frequency if swings else None, mass_kg=None if turns else 0.4,
        inertia_kg_m2=2e-5 if turns else None,
    )  # fmt: skip
    text = advice(Outcome.DESCRIBED, varied(left(misfit_at(SETTING < 0))), SIZES, described=(found,))
    steps = text.split("; ")
    assert any(parameter in step for step in steps)
    assert all(QUANTITY.search(step) for step in steps if parameter in step or "swings" in step), text
    assert any("swings" in step for step in steps) == swings
    assert not re.search(r"\b(nan|inf)\b", text)


def test_what_swings_is_looked_for_at_its_port_and_about_its_frequency() -> None:
    found = Described("motor", "impedance", None, {}, (), (), 1.0, 900.0, 80.0, 308.6, inertia_kg_m2=4.4e-5)
    text = advice(Outcome.DESCRIBED, left(misfit_at(SETTING < 0)), described=(found,))
    assert text.startswith(
        "look at the motor for what swings at 309 Hz with 4.4e-05 kg·m², hold it fast or take it off"
    )
    assert "measure 100 mm, 250 N again from 247 to 370 Hz: the resonance must go" in text


def test_a_screw_that_bends_is_tapped_across() -> None:
    found = Described("screw", "impedance", None, {}, (), (), 1.0, 900.0, 80.0, 39.58)
    text = advice(Outcome.DESCRIBED, left(misfit_at(SETTING < 0)), described=(found,))
    assert text.startswith("tap the screw across, near its middle, with an accelerometer on it there")
    assert "one that bends rings at 39.6 Hz" in text


@pytest.mark.parametrize("outcome", [Outcome.UNKNOWN, Outcome.PARTIAL])
def test_what_has_no_form_is_followed_by_the_two_settings_that_differ_most(outcome) -> None:
    factors = {"100 mm, 250 N": 1.02, "200 mm, 250 N": 0.71, "300 mm, 250 N": 1.31}
    found = Described("nut", "nut_stiffness_n_per_m", None, {}, (), (), 1.0, 300.0, 90.0, factors=factors)
    first, *_ = advice(outcome, left(misfit_at(SETTING < 0)), described=(found,)).split("; ")
    assert first.startswith(
        "measure 200 mm, 250 N and 300 mm, 250 N again, three times in turns: nut_stiffness_n_per_m"
    )
    assert "0.71 times what it is at the first and 1.31 times at the second" in first


def test_the_record_that_stands_out_is_named() -> None:
    """Its error, of 15 values' worth of standard deviations, is taken out by the tag."""
    data = misfit_at(SETTING < 0) + np.where(SETTING == 4, 60.0, 0.0)
    first, *_ = located(left(data, pulled=True))
    assert first.startswith("check the tag of 500 mm, 250 N: its error 1 would have to be ")


def test_a_band_is_measured_with_lines_that_show_a_peak() -> None:
    steps = located(left(misfit_at((LINE >= 9) & (LINE <= 11))))
    (band,) = (step for step in steps if "second accelerometer" in step)
    low, high = (float(number) for number in re.findall(r"([\d.]+)(?= to| Hz)", band))
    assert (low, high) == pytest.approx((FREQUENCY[9], FREQUENCY[11]), rel=0.01)


def test_positions_are_measured_between_those_that_are_missed() -> None:
    steps = located(left(misfit_at((SETTING >= 2) & (SETTING <= 3))))
    assert any(
        step.startswith("measure from 300 to 400 mm and a little beyond, in half of the steps so far") for step in steps
    )


def test_nothing_is_advised_where_nothing_is_open() -> None:
    assert advice(Outcome.NAMED, left(misfit_at(SETTING < 0)), SIZES) == ""


def test_sizes_are_those_of_the_machine() -> None:
    """Of 400 kg a quarter is 100; five positions along 2.5 m; half of a preload of 3 kN."""
    fitted = left(misfit_at(SETTING < 0), lines=False)
    layout = fitted.comparison.layout
    few = tuple(
        replace(setting, values={**setting.values, ConditionAxis.POSITION: 0.1, ConditionAxis.PAYLOAD: 0.0})
        for setting in layout.settings
    )
    fitted = replace(fitted, comparison=replace(fitted.comparison, layout=replace(layout, settings=few)))
    needs = frozenset({ConditionAxis.PRELOAD, ConditionAxis.FREQUENCY})
    unseen = replace(quantity(0, "unseen"), needs=needs)
    text = next_measurement(next_steps(SimpleNamespace(final=fitted), (), Outcome.NONE, (unseen,), SIZES))
    assert "measure at 5 positions or more along the 2500 mm of the screw" in text
    assert "a known added mass of 100 kg" in text
    assert "vary the preload from 1500 to 3000 N, without which unseen cannot be seen" in text
    assert "measure whole frequency responses from 8 to 400 Hz, without which unseen cannot be seen" in text


def test_each_kind_of_step_reason_and_outcome_has_its_sentence() -> None:
    assert texts("next_step").keys() == set(StepKind)
    assert texts("untested").keys() == set(UntestedReason) - {UntestedReason.NOT_VARIED}
    assert texts("meaning").keys() == {*Outcome, "unfinished", "against_screw"}
    assert texts("against_screw").keys() == set(Objection)
    assert texts("change").keys() < set(ConditionAxis)
