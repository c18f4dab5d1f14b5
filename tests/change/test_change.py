"""Then against now: the response at the nut, what cancels, what is refused, and what a made-up axis is said to have."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from monitor_core.change.attribution import ChangeAttribution, attribute_change
from monitor_core.change.cells import ChangeTolerances, positions_of
from monitor_core.change.changes import Cause
from monitor_core.change.reference_ratio import ThenAndNow, compare_times
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.effects.drive_effects import (
    ADDED_MASS,
    BEARING_CHANGE,
    FAR_BEARING_CHANGE,
    MODULUS_PER_KELVIN,
    POSITION_OFFSET,
    PRELOAD_CHANGE,
    TORQUE_DELAY,
    WARMING,
)
from monitor_core.effects.effect import Effect
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.solver.linearised import linearise
from monitor_core.models.extended import (
    AxisPhysics,
    ResponseCase,
    natural_frequencies,
    physics_of,
    prepare_lines,
    responses,
)
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from service.documents.change import attribution_sentence
from tests.conftest import canary
from tests.hidden_effects.running.trials import described_axis
from tests.plant.chain import Axis, Condition
from tests.plant.simulation import state_space

PRELOAD = 300.0
POSITIONS = (0.15, 0.35, 0.55, 0.75)
FREQUENCY = np.arange(32.0, 400.0, 4.0)
NOISE = 0.004  # of a line, relative

AT_NUT = (ExcitationPoint.TORQUE_AT_SCREW, ResponsePoint.ACCELERATION_AT_NUT, MotorEnd.PRESCRIBED)
AT_TABLE = (ExcitationPoint.TORQUE_AT_SCREW, ResponsePoint.ACCELERATION_AT_TABLE, MotorEnd.PRESCRIBED)


@cache
def axis() -> AxisPhysics:
    return physics_of(described_axis().stated)


def observed(
    physics: AxisPhysics,
    rng: np.random.Generator,
    *,
    positions: Sequence[float] = POSITIONS,
    frequency: NDArray[np.float64] = FREQUENCY,
    temperature: float = 0.0,
    noise: float = NOISE,
) -> tuple[FrequencyResponseObservation, ...]:
    """Return noisy responses at the nut of an axis."""
    made = []
    for x in positions:
        conditions = DriveConditions(x, PRELOAD, temperature_deviation=temperature)
        lines = prepare_lines([ResponseCase(frequency, conditions, *AT_NUT)])
        exact = responses(physics, lines)
        error = noise * np.abs(exact)
        noisy = exact + error * (rng.standard_normal(exact.size) + 1j * rng.standard_normal(exact.size))
        made.append(FrequencyResponseObservation(conditions, frequency, noisy, error, *AT_NUT[:2]))
    return tuple(made)


def explained(
    *changes: tuple[Effect[AxisPhysics], dict[str, float]], seed: int = 1, told: float = 0.0
) -> ChangeAttribution:
    """Explain one reference of the described axis against one recent measurement of it with changes."""
    rng, now = np.random.default_rng(seed), axis()
    for effect, values in changes:
        now = effect.added_to(now, values)
    reference = observed(axis(), rng)
    recent = observed(now, rng, temperature=told)
    return attribute_change(described_axis(), reference, recent, preload=PRELOAD)


@pytest.mark.parametrize("position", [0.2, 0.7])
def test_response_at_the_nut_is_that_of_the_finite_element_axis(position: float) -> None:
    # hardly damped, for the two damp by different laws; 1 % is what their meshes and the modes left out make at 400 Hz
    space = state_space(Axis(screw_loss_factor=1e-6, joint_loss_factor=1e-6), Condition(position, preload=PRELOAD))
    n = space.a.shape[0]
    per_torque = np.array(
        [
            (space.c @ np.linalg.solve(2j * np.pi * f * np.eye(n) - space.a, space.b[:, :1]) + space.d[:, :1])[:2, 0]
            for f in FREQUENCY
        ]
    )
    plant = per_torque[:, 1] / per_torque[:, 0]
    conditions = DriveConditions(position, PRELOAD)
    undamped = replace(
        axis(), joints=replace(axis().joints, loss_factor=1e-6), bodies=replace(axis().bodies, table_damping=0.0)
    )
    at_nut, at_table = (
        responses(undamped, prepare_lines([ResponseCase(FREQUENCY, conditions, *where)]))
        for where in (AT_NUT, AT_TABLE)
    )
    np.testing.assert_allclose(np.abs(at_nut - plant) / np.maximum(np.abs(plant), 1.0), 0.0, atol=0.01)
    # on the table it is another response: no antiresonance
    assert np.min(np.abs(at_table[FREQUENCY < 300.0])) > 2.0 * np.min(np.abs(plant[FREQUENCY < 300.0]))


def test_rigid_bracket_makes_nut_and_table_one() -> None:
    rigid = replace(axis(), joints=replace(axis().joints, bracket_stiffness=1e18))
    conditions = DriveConditions(0.4, PRELOAD)
    at_nut, at_table = (
        responses(rigid, prepare_lines([ResponseCase(FREQUENCY, conditions, *points)])) for points in (AT_NUT, AT_TABLE)
    )
    np.testing.assert_allclose(at_nut, at_table, rtol=1e-6)


def test_change_of_preload_is_another_preload() -> None:
    def response(physics: AxisPhysics, preload: float) -> NDArray[np.complex128]:
        return responses(physics, prepare_lines([ResponseCase(FREQUENCY, DriveConditions(0.4, preload), *AT_NUT)]))

    changed = PRELOAD_CHANGE.added_to(axis(), {"preload_n": -80.0})
    np.testing.assert_allclose(response(changed, 300.0), response(axis(), 220.0), rtol=1e-12)
    assert np.max(np.abs(response(changed, 300.0) / response(axis(), 300.0) - 1.0)) > 0.05
    with pytest.raises(OutsideValidityError, match="the preload must stay positive"):
        response(PRELOAD_CHANGE.added_to(axis(), {"preload_n": -301.0}), 300.0)
    without_rating = replace(axis(), joints=replace(axis().joints, dynamic_load_rating=None))
    assert not PRELOAD_CHANGE.applies(without_rating)


def test_warming_moves_every_frequency_by_half_the_change_of_the_modulus() -> None:
    def frequencies(physics: AxisPhysics) -> NDArray[np.float64]:
        conditions = [DriveConditions(x, PRELOAD) for x in POSITIONS]
        found = natural_frequencies(physics, conditions, [MotorEnd.FREE] * len(conditions), 1500.0)
        return np.array([mode.frequency for modes in found for mode in modes if mode.frequency])

    kelvin = 20.0
    ratio = frequencies(WARMING.added_to(axis(), {"temperature_k": kelvin})) / frequencies(axis())
    # dampers are not of steel: what they add to a frequency, some 1e-5, stays
    np.testing.assert_allclose(ratio, np.sqrt(1.0 + MODULUS_PER_KELVIN * kelvin), rtol=2e-5)


@pytest.mark.parametrize(
    ("effect", "joint"), [(BEARING_CHANGE, "bearing_stiffness"), (FAR_BEARING_CHANGE, "far_bearing_stiffness")]
)
def test_change_of_a_bearing_is_a_ratio_of_what_it_has(effect: Effect[AxisPhysics], joint: str) -> None:
    softer = effect.added_to(axis(), {"ln_ratio": np.log(0.6)})
    assert getattr(softer.joints, joint) == pytest.approx(0.6 * getattr(axis().joints, joint), rel=1e-12)
    assert effect.added_to(axis(), {"ln_ratio": 0.0}) == axis()


def test_what_a_model_is_wrong_in_at_both_times_cancels() -> None:
    measured = observed(axis(), np.random.default_rng(3))
    comparison = compare_times(measured, measured, ChangeTolerances())
    wrong = replace(axis(), bodies=replace(axis().bodies, table_mass=35.0))
    np.testing.assert_allclose(comparison.misfit(ThenAndNow(then=wrong, now=wrong)), 0.0, atol=1e-12)
    changed = comparison.misfit(ThenAndNow(then=wrong, now=WARMING.added_to(wrong, {"temperature_k": 10.0})))
    assert np.max(np.abs(changed)) > 0.01


def test_gain_of_the_sensors_adds_to_amplitudes_alone() -> None:
    measured = observed(axis(), np.random.default_rng(3))
    comparison = compare_times(measured, measured, ChangeTolerances())
    misfit = comparison.misfit(ThenAndNow(then=axis(), now=axis(), log_gain=0.1))
    np.testing.assert_allclose(misfit, np.where(comparison.layout.channel == 0, 0.1, 0.0), atol=1e-12)


def test_errors_of_places_act_as_the_changes_they_are() -> None:
    comparison = compare_times(*two_times(), ChangeTolerances())
    errors = np.zeros((len(POSITIONS), len(comparison.condition_error_names)))
    now = {
        "position": POSITION_OFFSET.added_to(axis(), {"offset_m": 4e-3}),
        "preload": PRELOAD_CHANGE.added_to(axis(), {"preload_n": -20.0}),
        "temperature": WARMING.added_to(axis(), {"temperature_k": 5.0}),
        "delay": TORQUE_DELAY.added_to(axis(), {"delay_s": 2e-5}),
    }
    of_one = {"position": 4e-3 / 0.2e-3, "preload": -20.0 / (0.005 * PRELOAD), "temperature": 5.0 / 0.6, "delay": 40.0}
    unchanged = comparison.misfit(ThenAndNow(then=axis(), now=axis()))
    for name, physics in now.items():
        column = comparison.condition_error_names.index(name)
        moved = comparison.shifted(errors + of_one[name] * np.eye(errors.shape[1])[column] / comparison.spread[:, None])
        expected = comparison.misfit(ThenAndNow(then=axis(), now=physics)) - unchanged
        change = moved.misfit(ThenAndNow(then=axis(), now=axis())) - unchanged
        # dampers are not of steel, and a place is tagged to the micrometre
        np.testing.assert_allclose(change, expected, atol=2e-3 * np.max(np.abs(expected)))
        row = comparison.condition_errors(ThenAndNow(then=axis(), now=axis()), unchanged)[column]
        small = 1e-3 * np.eye(errors.shape[1])[column]
        by_small = comparison.shifted(errors + small).misfit(ThenAndNow(then=axis(), now=axis())) - unchanged
        np.testing.assert_allclose(by_small / 1e-3, row, atol=2e-3 * np.max(np.abs(row)))


def test_cost_of_a_change_is_the_same_around_whatever_errors_of_places() -> None:
    comparison = compare_times(*two_times(), ChangeTolerances())
    physics = ThenAndNow(then=axis(), now=WARMING.added_to(axis(), {"temperature_k": 2.0}))
    rng = np.random.default_rng(8)
    shape = (len(POSITIONS), len(comparison.condition_error_names))
    costs = []
    for size in (0.0, 0.05, 0.1):
        around = linearise(comparison, physics, size * rng.standard_normal(shape), comparison.layout.standard_deviation)
        costs.append(float(np.sum(around.residuals(physics) ** 2)))
    # errors this small act linearly; one that the comparison did not move would cost 1
    np.testing.assert_allclose(costs, costs[0], atol=0.05)


def two_times() -> tuple[tuple[FrequencyResponseObservation, ...], tuple[FrequencyResponseObservation, ...]]:
    rng = np.random.default_rng(7)
    return observed(axis(), rng), observed(axis(), rng)


def test_standardised_differences_of_an_unchanged_axis_are_standard_normal() -> None:
    comparison = compare_times(*two_times(), ChangeTolerances())
    values = comparison.misfit(ThenAndNow(then=axis(), now=axis())) / comparison.layout.standard_deviation
    # the share of changes and σ_0 make deviations a little large: 0.9 of those of the noise alone
    assert 0.8 < np.std(values) < 1.05


def test_lines_beside_each_other_share_wider_bands() -> None:
    rng = np.random.default_rng(5)
    first, second = observed(axis(), rng), observed(axis(), rng, frequency=FREQUENCY + 1.0)
    comparison = compare_times(first, second, ChangeTolerances())
    assert comparison.layout.n_values == 2 * len(POSITIONS) * FREQUENCY.size
    # the model is right, so that its own slope between the lines carries one over to the other
    assert np.std(comparison.misfit(ThenAndNow(then=axis(), now=axis()))) < 2.0 * NOISE


def test_positions_a_few_millimetres_apart_are_one_place() -> None:
    np.testing.assert_allclose(positions_of(np.array([0.301, 0.5, 0.3, 0.305, 0.7])), [0.302, 0.5, 0.7])


@pytest.mark.parametrize(
    ("change", "cause", "size"),
    canary(
        [
            ((PRELOAD_CHANGE, {"preload_n": -60.0}), Cause.PRELOAD, -60.0),
            ((ADDED_MASS, {"mass_kg": 1.5}), Cause.PAYLOAD, 1.5),
            ((FAR_BEARING_CHANGE, {"ln_ratio": -0.4}), Cause.BEARING, -0.4),
            ((POSITION_OFFSET, {"offset_m": 0.015}), Cause.POSITION, 0.015),
            ((TORQUE_DELAY, {"delay_s": -1e-4}), Cause.SENSOR, -1e-4),
        ]
    ),
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_change_is_named_with_its_size(
    change: tuple[Effect[AxisPhysics], dict[str, float]], cause: Cause, size: float
) -> None:
    answer = explained(change)
    first = answer.changes[0]
    assert (answer.outcome, answer.cause) == (Outcome.NAMED, cause)
    assert answer.confidence > 0.9
    assert first.size is not None
    assert abs(first.size.value - size) < 3.0 * first.size.standard_uncertainty
    assert first.size.standard_uncertainty < 0.2 * abs(size)
    assert sum(found.probability for found in answer.changes) == pytest.approx(1.0, abs=0.01)


def test_unchanged_axis_has_no_cause() -> None:
    answer = explained()
    assert (answer.outcome, answer.cause, answer.equivalent_to) == (Outcome.NONE, Cause.NONE, ())
    assert attribution_sentence(answer).startswith("nothing has changed beyond the noise")


@pytest.mark.release
def test_cause_beyond_the_catalogue_is_unknown() -> None:
    rng = np.random.default_rng(2)
    other = replace(axis(), joints=replace(axis().joints, bracket_stiffness=0.7 * axis().joints.bracket_stiffness))
    answer = attribute_change(described_axis(), observed(axis(), rng), observed(other, rng), preload=PRELOAD)
    assert answer.outcome is Outcome.UNKNOWN
    assert "no single change explains it" in attribution_sentence(answer)


@pytest.mark.release
def test_temperature_that_the_windows_state_explains_what_it_can() -> None:
    told = explained((WARMING, {"temperature_k": 15.0}), told=15.0)
    assert (told.outcome, told.cause, told.equivalent_to) == (Outcome.NAMED, Cause.TEMPERATURE, ())
    # an axis that does not follow what its thermometer says has not warmed
    assert explained(told=15.0).cause is not Cause.TEMPERATURE


@pytest.mark.release
def test_change_beside_a_stated_temperature_is_told_apart() -> None:
    answer = explained((WARMING, {"temperature_k": 10.0}), (PRELOAD_CHANGE, {"preload_n": -75.0}), told=10.0)
    assert (answer.outcome, answer.cause) == (Outcome.NAMED, Cause.PRELOAD)
    size = answer.changes[0].size
    assert size is not None
    assert abs(size.value + 75.0) < 3.0 * size.standard_uncertainty


def test_places_that_the_reference_lacks_are_left_out() -> None:
    rng = np.random.default_rng(6)
    reference = observed(axis(), rng)
    recent = observed(axis(), rng, positions=(0.05, *POSITIONS[:2], 0.45, *POSITIONS[2:]))
    comparison = compare_times(reference, recent, ChangeTolerances())
    assert [setting.name for setting in comparison.layout.settings] == ["150 mm", "350 mm", "550 mm", "750 mm"]


def test_two_places_are_too_few() -> None:
    rng = np.random.default_rng(4)
    few = observed(axis(), rng, positions=POSITIONS[:2])
    with pytest.raises(NotIdentifiableError, match="expected 3 positions or more at both times; got 2"):
        attribute_change(described_axis(), observed(axis(), rng), few, preload=PRELOAD)


def test_model_that_does_not_describe_the_reference_is_refused() -> None:
    drive = described_axis()
    wrong = replace(drive, stated=replace(drive.stated, screw_lead=0.010), uncertain={"loss_factor": 0.1})
    reference = observed(axis(), np.random.default_rng(4))
    with pytest.raises(NotIdentifiableError, match="must describe the reference of its axis to 10 % rms; got"):
        attribute_change(wrong, reference, reference, preload=PRELOAD)


@pytest.mark.release
def test_answer_that_is_not_sure_names_what_else_it_may_be() -> None:
    # a frequency shift that 10 K make, too: less than a temperature that nobody told
    answer = explained((ADDED_MASS, {"mass_kg": 0.06}))
    assert answer.outcome is Outcome.EQUIVALENT
    assert {answer.cause, *answer.equivalent_to} >= {Cause.PAYLOAD, Cause.TEMPERATURE}
    assert "nearly alike: " in attribution_sentence(answer)
