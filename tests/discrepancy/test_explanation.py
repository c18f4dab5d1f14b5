"""What the words of an answer say is what its numbers are: on linear data, where every number is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Setting
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity, wrong_quantity

N = 160


def keys(answer):
    return [effect.key for effect in answer.effects]


def linear(truth, *, columns=None, seed=1, held_out=()):
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((N, len(truth))) if columns is None else columns
    layout = layout_of((40,) * 4, 1.0, held_out=held_out)
    layout = replace(
        layout,
        settings=tuple(
            Setting(setting.name, {ConditionAxis.POSITION: 0.1 * i}) for i, setting in enumerate(layout.settings)
        ),
    )
    data = design @ truth + rng.standard_normal(N)
    return LinearComparison(layout, design, data, np.zeros((0, N)), least_delta_bic=30.0)


@pytest.mark.parametrize("scale", [0.02, -0.02])
def test_an_effect_at_its_detection_limit_is_found(scale) -> None:
    """A quarter more is, a quarter less is not; the limit is stated where nothing is missing, in its unit, unsigned."""
    healthy = linear(np.zeros(2))
    subject_, candidate = LinearAxis({}, 2), quantity(1, scale=scale)
    answer = explain_comparison(healthy, subject_, [candidate])
    (stated,) = answer.candidates
    assert (stated.key, stated.unit) == ("quantity-1", "-")
    # least evidence and ln n against the square of the column: by hand
    by_hand = math.sqrt((30.0 + math.log(N)) / np.sum(healthy.design[:, 1] ** 2))
    assert stated.detection_limit == pytest.approx(by_hand, rel=0.15)  # residuals set the noise, too
    noise = healthy.data - healthy.design[:, 1] * (healthy.design[:, 1] @ healthy.data) / np.sum(
        healthy.design[:, 1] ** 2
    )
    for factor, outcome in ((1.25, ["quantity-1"]), (0.75, [])):
        data = noise + factor * stated.detection_limit * healthy.design[:, 1]
        assert keys(explain_comparison(replace(healthy, data=data), subject_, [candidate])) == outcome


def test_the_model_that_is_handed_over_has_the_effect_that_is_named() -> None:
    """Where a wrong parameter and an effect say the same, the effect is named, and is what is added."""
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((N, 3))
    columns[:, 2] = columns[:, 1]
    comparison = linear(np.array([0.0, 2.0, 0.0]), columns=columns)
    answer = explain_comparison(comparison, LinearAxis({}, 3), [wrong_quantity(1, "b"), quantity(2)])
    assert keys(answer) == ["quantity-2"]
    assert list(answer.added) == ["quantity-2"]
    assert answer.effects[0].aliases == ("wrong-parameter:b",)


def test_each_step_says_what_it_left() -> None:
    truth = np.array([0.0, 3.0, 1.5])
    answer = explain_comparison(linear(truth), LinearAxis({}, 3), [quantity(1), quantity(2)])
    assert {step.effects for step in answer.steps} == {("quantity-1",), ("quantity-2",)}
    assert answer.gap.before.fit > answer.steps[0].gap.fit > answer.steps[1].gap.fit == answer.gap.after.fit
    assert math.isnan(answer.gap.after.held_out)


def test_no_effect_stands_in_the_model_twice() -> None:
    """Two wrong parameters are found, and an effect that is nearly their sum might lead the classes of both."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((N, 3))
    columns[:, 2] = columns[:, 0] + columns[:, 1]
    for truth in (0.4, -0.4):
        comparison = linear(np.array([2.5, truth, 0.0]), columns=columns / 0.3)
        once = replace(quantity(2, "sum"), applies=lambda theta: theta[2] == 0.0)
        answer = explain_comparison(
            comparison, LinearAxis({}, 3), [wrong_quantity(0, "a"), wrong_quantity(1, "b"), once]
        )
        assert len(set(keys(answer))) == 2
        assert answer.gap.after.fit < 1.1 * answer.gap.noise_floor


def test_what_has_no_answer_beside_the_others_does_not_lead() -> None:
    """Of each of two wrong parameters there is a twin in the catalogue, but an axis cannot have both of those."""
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((N, 4))
    columns[:, 2:] = columns[:, :2]
    comparison = linear(np.array([2.5, -1.5, 0.0, 0.0]), columns=4.0 * columns)
    candidates = [
        wrong_quantity(0, "a"),
        wrong_quantity(1, "b"),
        replace(quantity(2), applies=lambda theta: theta[3] == 0.0),
        replace(quantity(3), applies=lambda theta: theta[2] == 0.0),
    ]
    answer = explain_comparison(comparison, LinearAxis({}, 4), candidates)
    assert answer.outcome is Outcome.NAMED
    assert keys(answer)[0] in {"quantity-2", "quantity-3"}
    assert keys(answer)[1] in {"wrong-parameter:a", "wrong-parameter:b"}
    (other,) = {"quantity-2", "quantity-3"} - set(keys(answer))
    assert answer.effects[1].aliases == (other,)
    assert {*answer.added, *(f"wrong-parameter:{name}" for name in answer.ln_ratios)} >= set(keys(answer))


def test_what_would_do_as_well_is_no_untestable_candidate() -> None:
    """Whatever looks like what was found shows nothing beside it; in its place it has evidence, held out as well."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((N, 4))
    columns[:, 2] = columns[:, 1] + 0.01 * rng.standard_normal(N)
    held_out = (np.arange(N) % 4 == 0,)
    comparison = linear(np.array([0.0, 8.0, 0.0, 0.0]), columns=columns, held_out=held_out)
    answer = explain_comparison(comparison, LinearAxis({}, 4), [quantity(1), quantity(2), quantity(3)])
    (found,) = answer.effects
    alike = {candidate.key: candidate for candidate in answer.candidates}[found.equivalent_to[0]]
    assert alike.untested is None
    assert alike.delta_bic == pytest.approx(found.delta_bic, rel=0.01)
    assert alike.held_out == pytest.approx(found.held_out_log_likelihood_gain, rel=0.01)
    other = {candidate.key: candidate for candidate in answer.candidates}["quantity-3"]
    assert other.delta_bic < 0.0
    assert math.isnan(other.held_out)


def test_data_without_any_misfit_are_answered() -> None:
    comparison = LinearComparison(layout_of([10] * 4, 1.0), np.ones((40, 1)), np.zeros(40), np.zeros((0, 40)))
    answer = explain_comparison(comparison, LinearAxis({}, 1), [quantity(0)])
    assert answer.outcome is Outcome.NONE
    assert answer.gap.before.fit == 0.0


def test_data_beyond_all_reason_are_answered() -> None:
    comparison = LinearComparison(layout_of([10] * 4, 1e-6), np.zeros((40, 1)), 10.0 * np.ones(40), np.zeros((0, 40)))
    assert explain_comparison(comparison, LinearAxis({"a": 0.5}, 1), []).outcome is Outcome.UNKNOWN
