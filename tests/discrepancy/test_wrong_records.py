"""A record that is wrong is named, with what is wrong in it; what is right is not, whatever else is missing."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import RecordFault
from monitor_core.discrepancy.records import (
    Records,
    cleared,
    least_along,
    record_costs,
    scatter_of,
    worst_record,
)
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.settings import SettingTolerances
from monitor_core.fitting.hold_out import fitted_values
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from tests.conftest import canary
from tests.discrepancy.axes import (
    compared,
    effects_by_key,
    measured,
    settings,
    subject,
    true_subject,
)

#: Record 8 is wrong: at 476.2 mm and 300 N.
AT = 7
CONDITIONS = [*settings(), *settings((0.3455, 0.6047), payload_mass=6.0)]


def spoilt(observations, **tags):
    """Return the observations with other tags on one of them."""
    wrong = observations[AT]
    return [
        *observations[:AT],
        replace(wrong, conditions=replace(wrong.conditions, **tags)),
        *observations[AT + 1 :],
    ]


def answered(observations, *keys, **options):
    candidates = tuple(effects_by_key()[key] for key in keys)
    return explain_comparison(compared(observations, **options), subject(), candidates)


@pytest.mark.release
def test_a_wrong_position_is_named_with_the_record_and_how_far_it_is_off() -> None:
    observations = spoilt(measured(true_subject(), CONDITIONS), position=0.4762 + 0.049)
    (record,) = answered(observations, "added-mass").records
    assert (record.number, record.fault, record.unit) == (AT + 1, RecordFault.POSITION, "mm")
    assert record.observations == (AT,)
    assert record.setting == "525.2 mm, 300 N"
    assert record.stated == pytest.approx(525.2)
    assert record.found == pytest.approx(476.2, abs=3.0 * record.standard_uncertainty)
    assert record.standard_uncertainty < 5.0


@pytest.mark.parametrize(
    ("tag", "wrong", "fault", "true"),
    canary([("preload", 210.0, RecordFault.PRELOAD, 300.0), ("payload_mass", 5.0, RecordFault.PAYLOAD, 0.0)]),
)
def test_another_wrong_tag_is_named_as_what_it_is(tag, wrong, fault, true) -> None:
    observations = spoilt(measured(true_subject(), CONDITIONS), **{tag: wrong})
    answer = answered(observations, "added-mass")
    (record,) = answer.records
    assert (record.number, record.fault) == (AT + 1, fault)
    assert record.stated == pytest.approx(wrong)
    assert record.found == pytest.approx(true, abs=max(4.0 * record.standard_uncertainty, 0.05))
    assert answer.outcome == "none"


def test_a_wrong_gain_is_named_by_its_factor() -> None:
    observations = measured(true_subject(), CONDITIONS)
    wrong = observations[AT]
    observations[AT] = replace(
        wrong, response=1.3 * wrong.response, standard_deviation=1.3 * wrong.standard_deviation
    )  # fmt: skip
    (record,) = answered(observations, "added-mass").records
    assert (record.number, record.fault, record.unit) == (AT + 1, RecordFault.GAIN, "1")
    assert record.found == pytest.approx(1.3, abs=0.03)


def test_a_record_of_another_axis_is_an_outlier_that_no_tag_explains() -> None:
    observations = measured(true_subject(), CONDITIONS)
    wrong = observations[AT]
    bump = 1.0 + 0.4 / (1.0 - (wrong.frequency / 150.0) ** 2 + 0.1j)
    observations[AT] = replace(wrong, response=bump * wrong.response)
    (record,) = answered(observations, "added-mass").records
    assert (record.number, record.fault) == (AT + 1, RecordFault.OUTLIER)
    assert np.isnan(record.found)


@pytest.mark.release
def test_a_hidden_effect_beside_a_wrong_record_is_found_as_without_it() -> None:
    far = effects_by_key()["far-bearing-stiffness"].added_to(true_subject(), {"stiffness_n_per_m": 6e7})
    observations = spoilt(measured(far, CONDITIONS), payload_mass=5.0)
    answer = answered(observations, "far-bearing-stiffness", "added-mass")
    assert [record.number for record in answer.records] == [AT + 1]
    assert answer.outcome == "named"
    (effect,) = answer.effects
    assert effect.key == "far-bearing-stiffness"
    assert effect.parameters["stiffness_n_per_m"].estimate.value == pytest.approx(6e7, rel=0.05)


def test_records_of_one_level_that_an_effect_moves_together_are_not_wrong() -> None:
    """Two payloads are in truth 2 kg more: an effect of the payload, and no two wrong records."""
    heavier = [replace(each, payload_mass=each.payload_mass + 2.0 * bool(each.payload_mass)) for each in CONDITIONS]
    observations = [
        replace(observation, conditions=stated)
        for observation, stated in zip(measured(true_subject(), heavier), CONDITIONS, strict=True)
    ]
    answer = answered(observations, "payload-mass", "added-mass")
    assert answer.records == ()
    assert [effect.key for effect in answer.effects] == ["payload-mass"]


def test_a_level_is_not_taken_out_record_by_record() -> None:
    """One more record with a payload stands out as half of them did: that is no other wrong record."""
    heavier = [replace(each, payload_mass=each.payload_mass + 4.0 * bool(each.payload_mass)) for each in CONDITIONS]
    comparison = compared(
        [
            replace(observation, conditions=stated)
            for observation, stated in zip(measured(true_subject(), heavier), CONDITIONS, strict=True)
        ]
    )
    *taken_out, last = (number for number, stated in enumerate(CONDITIONS) if stated.payload_mass)
    rest = comparison.only(frozenset(range(len(CONDITIONS))) - {*taken_out, last})
    hypothesis = Hypothesis(subject())
    fitted = fit(rest, hypothesis, hypothesis.null, fitted_values(rest.layout))
    others = comparison.only(frozenset(range(len(CONDITIONS))) - frozenset(taken_out))
    assert worst_record(fitted, others, frozenset()).number == len(others.layout.settings)  # by itself
    assert worst_record(fitted, comparison, frozenset(taken_out[: len(taken_out) // 2 + 1])) is None


@pytest.mark.release
def test_of_healthy_machines_no_record_is_named() -> None:
    named = [
        cleared(compared(measured(true_subject(seed), CONDITIONS, seed=seed)), subject(), lambda _: None).wrong
        for seed in range(20)
    ]
    assert not any(named)


def bent(observations):
    """Return the comparison of observations, and the fit of the axis as described that may have bent to one of them."""
    comparison, hypothesis = compared(observations), Hypothesis(subject())
    return comparison, fit(comparison, hypothesis, hypothesis.null, fitted_values(comparison.layout))


def test_a_record_that_the_fit_has_bent_to_is_found_under_a_fit_without_it() -> None:
    """The first record is nearest to the bearing, and what its preload says moves two declared springs."""
    observations = measured(true_subject(), CONDITIONS)
    wrong = observations[0]
    observations[0] = replace(wrong, conditions=replace(wrong.conditions, preload=180.0))
    comparison, fitted = bent(observations)
    assert worst_record(fitted, comparison, frozenset()) is None  # it looks like others
    record = Records(comparison).bent_to(fitted)
    assert (record.number, record.fault) == (1, RecordFault.PRELOAD)
    assert record.found == pytest.approx(120.0, abs=max(3.0 * record.standard_uncertainty, 3.6))


@pytest.mark.release
def test_of_healthy_machines_a_fit_has_bent_to_no_record() -> None:
    pairs = [bent(measured(true_subject(seed), CONDITIONS, seed=seed)) for seed in range(20)]
    assert not any(Records(comparison).bent_to(fitted) for comparison, fitted in pairs)


#: The last two records were taken 40 K warmer, as is stated.
WARM = [*settings(), *settings((0.3455, 0.6047), (300.0,), temperature_deviation=40.0)]
SOFTENING = {"relative_change_per_k": -5e-4}
THERMAL = ("thermal-stiffness", "thermal-preload", "added-mass")


def softening_axis():
    return effects_by_key()["thermal-stiffness"].added_to(true_subject(), SOFTENING)


def measured_at_both_ends(physics):
    """Return what is measured of table and motor."""
    return [
        observation
        for response in (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
        for observation in measured(physics, WARM, excitation=ExcitationPoint.TORQUE_AT_MOTOR, response=response)
    ]


@pytest.mark.release
def test_of_two_records_that_were_warm_neither_is_wrong() -> None:
    answer = answered(measured_at_both_ends(softening_axis()), *THERMAL)
    assert answer.records == ()
    assert [effect.key for effect in answer.effects] == ["thermal-stiffness"]


@pytest.mark.parametrize(
    ("truth", "tag", "wrong"),
    [(SOFTENING, 75.0, {len(WARM) - 1}), ({"relative_change_per_k": -1e-3}, 40.0, set())],
)
def test_of_an_axis_that_is_stated_to_soften_the_record_with_a_wrong_tag_alone_is_wrong(truth, tag, wrong) -> None:
    """Where it softens twice as much as is stated, both warm records stand out and are right."""
    drive = replace(subject(), present={"thermal-stiffness": SOFTENING})
    physics = effects_by_key()["thermal-stiffness"].added_to(true_subject(), truth)
    ends = {"excitation": ExcitationPoint.TORQUE_AT_MOTOR, "response": ResponsePoint.ANGLE_AT_MOTOR}
    *observations, last = measured(physics, WARM, **ends)
    observations.append(replace(last, conditions=replace(last.conditions, temperature_deviation=tag)))
    candidates = [effects_by_key()[key] for key in THERMAL]
    assert cleared(compared(observations), drive, lambda _: None, candidates).wrong == wrong


@pytest.mark.release
def test_a_warm_record_with_a_wrong_preload_is_no_preload_that_follows_temperature() -> None:
    """The effect would need another record to be wrong as well, and explains no more."""
    observations, wrong = measured_at_both_ends(true_subject()), len(WARM) - 1
    tagged = replace(WARM[wrong], preload=210.0)
    observations = [
        replace(each, conditions=tagged) if each.conditions == WARM[wrong] else each for each in observations
    ]
    answer = answered(observations, *THERMAL)
    (record,) = answer.records
    assert (record.number, record.fault) == (wrong + 1, RecordFault.PRELOAD)
    assert answer.effects == ()


def test_the_cost_of_a_record_is_that_of_its_covariance() -> None:
    comparison, physics = compared(measured(true_subject(), CONDITIONS)), true_subject()
    scatter = np.array([1.0, 2.0, 1.0])
    costs = record_costs(comparison, physics, scatter)
    misfit = comparison.misfit(physics)
    directions = comparison.condition_errors(physics, misfit) * scatter[:, None]
    here = comparison.layout.setting == AT
    covariance = np.diag(comparison.layout.standard_deviation[here] ** 2) + directions[:, here].T @ directions[:, here]
    inverse = np.linalg.inv(covariance)
    assert costs.chi_squared[AT] == pytest.approx(misfit[here] @ inverse @ misfit[here], rel=1e-3)
    along = np.where(comparison.layout.channel == 0, 1.0, 0.0)
    taken, amount, deviation = costs.taken_by(along)
    information = along[here] @ inverse @ along[here]
    assert amount[AT] == pytest.approx(-(along[here] @ inverse @ misfit[here]) / information, rel=0.02)
    assert taken[AT] == pytest.approx((along[here] @ inverse @ misfit[here]) ** 2 / information, rel=0.04)
    assert deviation[AT] == pytest.approx(information**-0.5, rel=0.01)


def test_a_least_value_between_the_lines_of_a_grid_is_found() -> None:
    grid = np.linspace([0.0, 0.0], [1.0, 1.0], 11)
    at, least = least_along(lambda x: (x - np.array([0.234, 0.987])) ** 2, grid, 14)
    np.testing.assert_allclose(at, [0.234, 0.987], atol=1e-4)
    np.testing.assert_allclose(least, 0.0, atol=1e-8)


def test_a_single_pull_does_not_count_for_the_scatter() -> None:
    rng = np.random.default_rng(0)
    pulls = np.column_stack([rng.standard_normal(400), 3.0 * rng.standard_normal(400), np.full(400, np.nan)])
    pulls[0, :2] = 1e3
    np.testing.assert_allclose(scatter_of(pulls), [1.0, 3.0, 1.0], rtol=0.15)


def test_payloads_and_temperatures_that_are_not_exact_are_condition_errors() -> None:
    tolerances = SettingTolerances(payload=0.1, temperature=2.0)
    observations = measured(true_subject(), CONDITIONS)
    comparison, physics = compared(observations, tolerances=tolerances), true_subject()
    assert comparison.condition_error_names == ("position", "preload", "gain 1", "payload", "temperature")
    misfit = comparison.misfit(physics)
    errors = np.zeros((len(CONDITIONS), 5))
    errors[:, 3] = 0.1
    heavier = comparison.shifted(errors).misfit(physics)
    np.testing.assert_allclose(heavier - misfit, 0.1 * comparison.condition_errors(physics, misfit)[3], atol=5e-4)
    assert np.ptp(heavier - misfit) > 1e-3


@pytest.mark.parametrize("wrong", [{"position": 0.0}, {"gain_share": np.inf}, {"payload": -1.0}])
def test_a_tolerance_is_positive(wrong) -> None:
    with pytest.raises(OutsideValidityError, match="tolerance"):
        SettingTolerances(**wrong)
