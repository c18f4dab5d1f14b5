"""Screening an effect predicts what a refit then gains: exactly so where the misfit is linear."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import linalg

from monitor_core.discrepancy import screening as module
from monitor_core.discrepancy.screening import resonances, screen
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import (
    LinearAxis,
    LinearComparison,
    compared,
    covariance_of,
    effects_by_key,
    layout_of,
    measured,
    quantity,
    settings,
    subject,
    true_subject,
    wrong_quantity,
)

N = 120
UNCERTAIN = {"a": 0.3, "b": 2.0}
TRUTH = np.array([0.9, -1.0, 3.0, 0.7, -0.4])


def linear(seed=0):
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((N, TRUTH.size)) + rng.standard_normal((N, 1))  # columns that are alike
    comparison = LinearComparison(
        layout_of((40, 40, 40), 1.0), design, design @ TRUTH + rng.standard_normal(N), rng.standard_normal((2, N))
    )
    return comparison, LinearAxis(UNCERTAIN, TRUTH.size)


def fitted(hypothesis, comparison, chosen=None):
    return fit(comparison, hypothesis, np.full(hypothesis.n_coordinates, 0.5), chosen)


@pytest.mark.parametrize("index", [3, 4])
@pytest.mark.parametrize("last", [120, 80])
def test_predicted_decrease_is_that_of_a_refit(index, last) -> None:
    """And the start it proposes is the end of the refit; without the values that are held out."""
    comparison, subject_ = linear()
    chosen = np.arange(N) < last
    without = fitted(Hypothesis(subject_, (quantity(2),)), comparison, chosen)
    effect = quantity(index, scale=0.5)
    (result,) = screen(without, [effect])
    fuller = fitted(without.hypothesis.with_effect(effect), comparison, chosen)
    assert result.score == pytest.approx(without.cost - fuller.cost, rel=1e-4)
    assert result.decrease == pytest.approx(without.cost - fuller.cost, rel=1e-4)
    np.testing.assert_allclose(result.starts[0], fuller.coordinates, atol=2e-3)


def test_information_is_what_the_data_say_of_the_first_parameter() -> None:
    """One over the variance of the refitted size in its scales, by dense algebra."""
    comparison, subject_ = linear()
    without = fitted(Hypothesis(subject_, (quantity(2),)), comparison)
    (result,) = screen(without, [quantity(3, scale=0.5)])
    design = comparison.design[:, :4] * [0.3, 2.0, 1.0, 0.5]
    precision = design.T @ linalg.solve(covariance_of(comparison), design) + np.diag([1.0, 1.0, 0.0, 0.0])
    assert result.information == pytest.approx(1.0 / linalg.inv(precision)[3, 3], rel=1e-5)


def test_screening_stays_within_the_range() -> None:
    """Half of the quadratic's decrease is out of reach where the size may not have the sign it wants."""
    comparison, subject_ = linear()
    without = fitted(Hypothesis(subject_, (quantity(2),)), comparison)
    (wanted,) = screen(without, [quantity(3)])
    sign = np.sign(wanted.starts[0][-1])
    comparison = replace(comparison, design=comparison.design * np.where(np.arange(5) == 3, -sign, 1.0))
    without = fitted(Hypothesis(subject_, (quantity(2),)), comparison)
    (refused,) = screen(without, [quantity(3, lower=0.0)])
    assert (refused.decrease, refused.score) == (0.0, 0.0)
    np.testing.assert_array_equal(refused.starts[0][:-1], without.coordinates)
    assert refused.starts[0][-1] == 0.0


@pytest.mark.parametrize(("index", "name"), list(enumerate(UNCERTAIN)))
def test_a_tolerance_that_is_let_go(index, name) -> None:
    """u²/(1 − h) less, where u is the prior's residual and h its leverage; to be seen it must leave its tolerance."""
    comparison, subject_ = linear()
    without = fitted(Hypothesis(subject_, (quantity(2),)), comparison)
    effect = wrong_quantity(index, name)
    (result,) = screen(without, [effect])
    freed = fit(comparison, without.hypothesis.with_effect(effect), result.starts[0])
    assert result.decrease == pytest.approx(without.cost - freed.cost, rel=1e-3)
    design = comparison.design[:, :3]
    prior = np.diag([1.0 / 0.3**2, 1.0 / 2.0**2, 0.0])
    prior[index, index] = 0.0
    precision = design.T @ linalg.solve(covariance_of(comparison), design) + prior
    scale = effect.parameters[0].scale
    variance = linalg.inv(precision)[index, index] + UNCERTAIN[name] ** 2  # of what the data say less what was stated
    assert result.information == pytest.approx(scale**2 / variance, rel=1e-4)


@dataclass(frozen=True, eq=False)
class FoldedSubject(LinearAxis):
    """An axis whose first quantity comes round again: another value of its parameter says nearly the same.

    There may be values between at which there is no axis.
    """

    hole: tuple[float, float] = (0.0, 0.0)
    folds: bool = True

    def physics(self, ln_ratios):
        theta = super().physics(ln_ratios)
        if self.hole[0] < theta[0] < self.hole[1]:
            raise OutsideValidityError("no axis is like that")
        if self.folds:
            theta[0] = np.sin(2.0 * np.pi * theta[0] / 2.5)
        return theta


def test_another_minimum_of_a_wrong_parameter_is_a_start_of_its_own() -> None:
    comparison, plain = linear()
    folded = FoldedSubject(plain.uncertain, plain.size)
    at_fit = fit(comparison, Hypothesis(folded), np.zeros(2))
    (result,) = screen(at_fit, [wrong_quantity(0, "a")])
    assert result.elsewhere is not None
    # in coordinates of a tenth: a period from the fit, as near as steps of a half come
    apart = np.abs(0.1 * result.elsewhere[-1] - 0.3 * at_fit.coordinates[0])
    assert apart == pytest.approx(2.5, abs=0.3)
    (of_plain,) = screen(fitted(Hypothesis(plain), comparison), [wrong_quantity(0, "a")])
    assert of_plain.elsewhere is None
    torn = FoldedSubject(plain.uncertain, plain.size, hole=(0.9, 1.1), folds=False)
    (of_torn,) = screen(fitted(Hypothesis(torn), comparison), [wrong_quantity(0, "a")])
    assert of_torn.elsewhere is None


def test_most_promising_first() -> None:
    comparison, subject_ = linear()
    without = fitted(Hypothesis(subject_), comparison)
    screened = screen(without, [quantity(4), quantity(3), quantity(2)])
    decreases = [
        without.cost - fitted(Hypothesis(subject_, (result.effect,)), comparison).cost for result in screened
    ]  # fmt: skip
    assert decreases == sorted(decreases, reverse=True)
    assert screened[0].effect.key == "quantity-2"


def test_of_several_parameters_each_size_is_tried() -> None:
    """The first one is of no use here, the second one is; the start has the second alone."""
    comparison, subject_ = linear()
    comparison = replace(comparison, design=np.column_stack([comparison.design, np.zeros(N)]))
    subject_ = LinearAxis(UNCERTAIN, 6)

    def add(theta, values):
        return theta + values["idle"] * np.eye(6)[5] + values["size"] * np.eye(6)[2]

    both = Effect(
        "both", "Both", "One of two adds.", "this test",
        (EffectParameter("idle", "-", -9.0, 9.0, 1.0), EffectParameter("size", "-", -9.0, 9.0, 1.0)), add,
    )  # fmt: skip
    without = fitted(Hypothesis(subject_), comparison)
    of_both, alone = screen(without, [both])[0], screen(without, [quantity(2)])[0]
    assert of_both.decrease == pytest.approx(alone.decrease, rel=1e-6)
    assert of_both.starts[0][-2] == 0.0
    assert of_both.starts[0][-1] == pytest.approx(alone.starts[0][-1], rel=1e-6)
    assert of_both.information == 0.0  # nothing that was measured moves with the first


def test_effects_without_an_answer_are_passed_over() -> None:
    comparison, subject_ = linear()
    without = fitted(Hypothesis(subject_), comparison)

    def refuse(theta, values):
        raise OutsideValidityError("no such axis")

    never = replace(quantity(3), add=refuse)
    assert [candidate.effect.key for candidate in screen(without, [never, quantity(4)])] == ["quantity-4"]


# --- an axis ---------------------------------------------------------------------------------------------------------

EFFECTS = effects_by_key()
CONDITIONS = settings(positions=(0.2113, 0.5113, 0.8113), preloads=(150.0, 300.0))


@pytest.mark.parametrize("frequency", [130.0, 480.0])
def test_a_resonance_is_sought_at_many_frequencies(frequency) -> None:
    """Its residue has no slope where the frequency is wrong; the start stands beside the true one."""
    mode = EFFECTS["second-mode"]
    values = {"residue_per_kg": 1e-4, "frequency_hz": frequency, "damping_ratio": 0.02}
    comparison = compared(measured(mode.added_to(true_subject(0), values), CONDITIONS))
    hypothesis = Hypothesis(subject())
    without = fit(comparison, hypothesis, hypothesis.null)
    (result,) = screen(without, [mode])
    fuller = hypothesis.with_effect(mode)
    assert fuller.values(result.starts[0])["second-mode"]["frequency_hz"] == pytest.approx(frequency, rel=0.1)
    refitted = fit(comparison, fuller, result.starts[0])
    assert fuller.values(refitted.coordinates)["second-mode"]["frequency_hz"] == pytest.approx(frequency, rel=1e-3)


def test_a_strong_effect_is_predicted_by_its_size_and_not_by_its_slope() -> None:
    """A far bearing a tenth as stiff as the fixed one; to judge by the slopes, an absorber hangs on the nut."""
    far = EFFECTS["far-bearing-stiffness"]
    comparison = compared(measured(far.added_to(true_subject(0), {"stiffness_n_per_m": 1e7}), CONDITIONS))
    hypothesis = Hypothesis(subject())
    screened = screen(fit(comparison, hypothesis, hypothesis.null), list(EFFECTS.values()))
    assert max(screened, key=lambda candidate: candidate.score).effect.key == "nut-absorber"
    assert max(screened, key=lambda candidate: candidate.decrease).effect.key == "far-bearing-stiffness"


@pytest.mark.parametrize("present", [None, "second-mode"])
def test_sizes_that_are_left_out_would_lead_nowhere(present, monkeypatch) -> None:
    """Of a healthy axis and of one with an effect: the same starts as when all sizes are tried, in fewer trials."""
    physics, values = true_subject(0), {"residue_per_kg": 1e-4, "frequency_hz": 310.0, "damping_ratio": 0.02}
    physics = physics if present is None else EFFECTS[present].added_to(physics, values)
    hypothesis = Hypothesis(subject())
    without = fit(compared(measured(physics, CONDITIONS)), hypothesis, hypothesis.null)
    effects = [EFFECTS[key] for key in ("second-mode", "table-absorber", "added-mass", "base-compliance")]
    tried, answers = [], []
    trial = module._EffectTrials._tried
    monkeypatch.setattr(module._EffectTrials, "_tried", lambda *given: tried.append(given) or trial(*given))
    for most in (module._MOST_WORSE, 1000):
        monkeypatch.setattr(module, "_MOST_WORSE", most)
        answers.append(
            ([(found.effect.key, *found.starts[0], found.decrease) for found in screen(without, effects)], len(tried))
        )
        tried.clear()
    (some, n_some), (everything, n_everything) = answers
    assert some == everything
    assert n_some < 0.9 * n_everything


def test_a_frequency_that_the_description_tells_is_tried_there_and_not_over_the_band() -> None:
    """The first mode of a bent screw, of which only higher ones may be in the band."""
    told = EffectParameter("frequency_hz", "Hz", lower=8.0, upper=24.0, scale=1.0, null=10.0)
    without = fitted(Hypothesis(linear()[1]), linear()[0])
    tried = resonances(without, told)
    assert any(frequency == pytest.approx(10.0, rel=1e-12) for frequency in tried)
    assert (min(tried), max(tried)) == pytest.approx((8.0, 24.0))
    assert max(np.diff(np.log(tried))) < 0.15
