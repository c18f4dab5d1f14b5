"""Effects that the data cannot tell apart, and intervals of found effects that hold what they promise."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, stats

from monitor_core.discrepancy.search.workspace import Accepted, Found, Rival
from monitor_core.discrepancy.verdict.classes import Member, covariance, equivalence_class, found_parameters
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import (
    LinearAxis,
    LinearComparison,
    covariance_of,
    layout_of,
    quantity,
    wrong_quantity,
)

N = 200
UNCERTAIN = {"a": 0.5}


def comparison_of(seed=0):
    """Return data with a third quantity of 2; the fourth acts as the third does, the fifth almost so."""
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((N, 6))
    design[:, 3] = design[:, 2]
    design[:, 4] = design[:, 2] + 0.05 * rng.standard_normal(N)
    truth = np.array([0.3, 0.0, 2.0, 0.0, 0.0, 0.0])
    data = design @ truth + rng.standard_normal(N)
    return LinearComparison(layout_of((50,) * 4, 1.0), design, data, rng.standard_normal((1, N)))


COMPARISON, SUBJECT = comparison_of(), LinearAxis(UNCERTAIN, 6)
BASELINE = fit(COMPARISON, Hypothesis(SUBJECT), np.zeros(1))
BY = EvidenceScale(1.0, 0.0, N)


def fitted_with(effect):
    hypothesis = BASELINE.hypothesis.with_effect(effect)
    return fit(COMPARISON, hypothesis, np.full(hypothesis.n_coordinates, 0.3))


def classed(effect, *rivals, by=BY, evidence=None, threshold=COMPARISON.least_delta_bic, floor=COMPARISON.noise_floor):
    """Return the class of an accepted effect with rivals; their ΔBIC as fitted, or as told."""
    comparison = replace(COMPARISON, least_delta_bic=threshold, noise_floor=floor)
    final = replace(fitted_with(effect), comparison=comparison)
    refitted = [fitted_with(rival) for rival in rivals]
    told = evidence or [delta_bic(BASELINE, fitted, by) for fitted in (final, *refitted)]
    entries = zip(rivals, refitted, told[1:], strict=True)
    accepted = Accepted(effect, told[0], 33.0, tuple(Rival(*entry) for entry in entries), BASELINE)
    return equivalence_class(Found(BASELINE, (final,), final, (accepted,), by, (), 10.0), accepted, ())


def keys(found):
    return [member.effect.key for member in found.members]


def test_effects_that_leave_the_same_residuals_are_one_finding() -> None:
    found = classed(quantity(2), quantity(3), quantity(5))
    assert keys(found) == ["quantity-2"]
    assert found.aliases == ("quantity-3",)
    assert found.held_out_gain == 33.0


def test_a_twin_of_another_member_is_not_one_of_the_representative() -> None:
    """The fourth quantity acts as the third does, the fifth almost so: whichever leads, the others may be the truth."""
    found = classed(quantity(4), quantity(2), quantity(3), evidence=(102.0, 100.0, 99.0))
    assert found.representative.effect.key == "quantity-4"
    assert found.aliases == ()
    assert found.others == ("quantity-2", "quantity-3")


@pytest.mark.parametrize("named_first", [True, False])
def test_of_twins_the_catalogue_leads(named_first) -> None:
    """An added mass and a wrong mass: the mechanism is named, whichever of them the search accepted."""
    effects = (quantity(2), wrong_quantity(3, "c"))
    found = classed(*effects) if named_first else classed(*reversed(effects))
    assert keys(found) == ["quantity-2"]
    assert found.aliases == ("wrong-parameter:c",)


def test_of_twins_one_with_a_plausible_value_leads() -> None:
    """A mass cannot be negative enough where a misprint can; here the catalogue's size may be 1 at most."""
    found = classed(quantity(2, upper=1.0), wrong_quantity(3, "c"))
    assert keys(found) == ["wrong-parameter:c"]
    assert found.representative.plausible
    assert found.aliases == ("quantity-2",)


def test_what_the_data_cannot_tell_apart_is_one_class() -> None:
    """Columns that differ by 5 % do not differ in 200 values; one that has nothing to do with it is no member."""
    found = classed(quantity(2), quantity(4), quantity(5))
    assert set(keys(found)) == {"quantity-2", "quantity-4"}
    assert found.aliases == ()
    strengths = [member.delta_bic for member in found.members]
    assert strengths == sorted(strengths, reverse=True)
    assert found.representative is found.members[0]


def test_the_plausible_member_leads_whatever_it_is_worth() -> None:
    first = classed(quantity(2, upper=1.0), quantity(4), evidence=(100.0, 99.0))
    assert keys(first) == ["quantity-4", "quantity-2"]
    assert [member.plausible for member in first.members] == [True, False]


#: D − 2ε√(G D) = 10 of BIC (Kass and Raftery, 1995: very strong) with ε = 5 %: D = 13.70 for G = 100, 26.18 for 1000;
#: no more than 1 % of the values.
MARGINS = {
    "a small gain": (100.0, 10_000, 86.4, 86.2),
    "a gain of 1000": (1000.0, 10_000, 973.9, 973.7),
    "1 % of the values": (10_000.0, 2000, 9981.0, 9979.0),
}


@pytest.mark.parametrize("what", MARGINS)
def test_margin(what) -> None:
    best, n_values, inside, outside = MARGINS[what]
    by = EvidenceScale(1.0, 0.0, n_values)
    assert len(classed(quantity(2), quantity(4), by=by, evidence=(best, inside)).members) == 2
    assert len(classed(quantity(2), quantity(4), by=by, evidence=(best, outside)).members) == 1


def test_where_something_is_left_the_margin_is_a_share_of_the_gain() -> None:
    """A gap of two floors is no noise: 5 % of a gain of 10 000, and not 1 % of 2000 values."""
    by = EvidenceScale(1.0, 0.0, 2000)
    for evidence, n_members in ((9501.0, 2), (9499.0, 1)):
        found = classed(quantity(2), quantity(4), by=by, evidence=(10_000.0, evidence), floor=0.5)
        assert len(found.members) == n_members


def test_margin_grows_with_the_least_evidence_for_an_effect() -> None:
    """40 % of what is asked of a comparison whose model may feign as much."""
    for evidence, members in ((81.0, 2), (79.0, 1)):
        found = classed(quantity(2), quantity(4), evidence=(100.0, evidence), threshold=50.0)
        assert len(found.members) == members


def test_values_that_hang_together_count_for_less_in_the_margin() -> None:
    """2000 values of correlation 1/3 are worth 1000, and 1 % of these is 10."""
    by = EvidenceScale(1.0, 1.0 / 3.0, 2000)
    assert len(classed(quantity(2), quantity(4), by=by, evidence=(10_000.0, 9991.0)).members) == 2
    assert len(classed(quantity(2), quantity(4), by=by, evidence=(10_000.0, 9989.0)).members) == 1


def test_a_rival_that_is_better_has_the_effect_for_a_member_only_near_it() -> None:
    """The search accepted what came first; in the end another one does better by more than the margin."""
    found = classed(quantity(2), quantity(4), evidence=(100.0, 104.0))
    assert keys(found) == ["quantity-4", "quantity-2"]


# --- intervals -------------------------------------------------------------------------------------------------------


def test_covariance_of_a_linear_fit() -> None:
    """Dense: (f Aᵀ V⁻¹ A + Π)⁻¹ with the evidence scale's factor on the data alone."""
    fitted = fitted_with(quantity(2, scale=0.1))
    by = EvidenceScale(1.5, 0.2, N)
    design = COMPARISON.design[:, [0, 2]] * [0.5, 0.1]
    precision = design.T @ linalg.solve(covariance_of(COMPARISON), design) * (0.8 / 1.2) / 1.5
    np.testing.assert_allclose(covariance(fitted, by), linalg.inv(precision + np.diag([1.0, 0.0])), rtol=1e-5)


def test_covariance_rests_on_the_fitted_values() -> None:
    chosen = np.arange(N) < 100
    hypothesis = BASELINE.hypothesis.with_effect(quantity(2))
    fitted = fit(COMPARISON, hypothesis, np.full(2, 0.3), chosen)
    design = COMPARISON.design[chosen][:, [0, 2]] * [0.5, 1.0]
    dense = covariance_of(COMPARISON)[np.ix_(chosen, chosen)]
    precision = design.T @ linalg.solve(dense, design) + np.diag([1.0, 0.0])
    np.testing.assert_allclose(covariance(fitted, BY), linalg.inv(precision), rtol=1e-5)


def test_parameters_of_a_member_in_their_units() -> None:
    effect = quantity(2, scale=0.1, upper=1.0)
    member = classed(effect).representative
    (found,) = found_parameters(member, member.fitted, BY).values()
    value = 0.1 * member.fitted.coordinates[1]
    deviation = np.hypot(0.1 * np.sqrt(covariance(member.fitted, BY)[1, 1]), effect.form_share * value)
    assert found.estimate.value == pytest.approx(value)
    assert found.estimate.standard_uncertainty == pytest.approx(deviation)
    normal = stats.norm.interval(0.95, found.estimate.value, deviation)
    np.testing.assert_allclose(found.interval_95, normal, rtol=1e-6)
    assert not found.plausible  # it is 2, and 1 at most would be


def test_interval_ends_where_no_axis_can_be() -> None:
    effect = quantity(2)
    (size,) = effect.parameters
    narrow = replace(effect, parameters=(replace(size, upper=1.9, beyond=False),))
    member = classed(narrow).representative
    (found,) = found_parameters(member, member.fitted, BY).values()
    assert found.estimate.value == pytest.approx(1.9, abs=1e-3)  # the data would have a little more
    # the axis may well be beyond: the value is a bound, and has no uncertainty of its own
    assert found.interval_95[1] == math.inf
    assert 1.0 < found.interval_95[0] < 1.9
    assert found.estimate.standard_uncertainty == math.inf
    assert found.at_end
    (beside,) = found_parameters(classed(effect).representative, classed(effect).representative.fitted, BY).values()
    (covering,) = found_parameters(
        classed(effect).representative, classed(effect).representative.fitted, BY, [member.fitted]
    ).values()
    # of fits that the data do not tell apart, each has its value within
    assert covering.interval_95[1] == beside.interval_95[1]
    assert covering.interval_95[0] == pytest.approx(beside.interval_95[0] - beside.estimate.value + 1.9, abs=1e-3)
    known = replace(narrow, textbook={"size": 1.9})  # what is as the textbook has it stands where it should
    (plain,) = found_parameters(classed(known).representative, classed(known).representative.fitted, BY).values()
    assert not plain.at_end
    uncertain = replace(effect, parameters=(replace(size, lower=0.0),), form_share=1.0)
    (positive,) = found_parameters(
        classed(uncertain).representative, classed(uncertain).representative.fitted, BY
    ).values()
    assert positive.interval_95[0] == 0.0  # what cannot be negative is not
    assert positive.estimate.value - 1.96 * positive.estimate.standard_uncertainty < 0.0
    (inside,) = found_parameters(classed(effect).representative, classed(effect).representative.fitted, BY).values()
    assert not inside.at_end


@pytest.mark.release
def test_intervals_cover_what_they_promise() -> None:
    """95 ± 2 % over 450 draws of priors, settings and noise, three quantities each; chance alone does ± 1.2 %."""
    rng = np.random.default_rng(11)
    time = np.arange(150) / 150.0
    smooth = np.tile(np.array([np.sin(2.0 * np.pi * time), np.cos(2.0 * np.pi * time), 1.0 - time]), 4)
    design = np.column_stack([smooth.T, rng.standard_normal(600)])
    layout, directions = layout_of((150,) * 4, 1.0), np.array([np.tile(0.3 + 0.2 * time, 4)])
    hypothesis = Hypothesis(LinearAxis({"a": 0.2, "b": 0.2}, 4), (quantity(2), quantity(3)))
    covered = []
    for _ in range(450):
        truth = np.r_[0.2 * rng.standard_normal(2), 1.0, -0.5]
        of_settings = directions[0] * rng.standard_normal(4)[layout.setting]
        data = design @ truth + rng.standard_normal(600) + of_settings
        fitted = fit(LinearComparison(layout, design, data, directions), hypothesis, np.array([0.0, 0.0, 0.9, -0.4]))
        by = evidence_scale(fitted)
        for effect, true in zip(hypothesis.effects, truth[2:], strict=True):
            (found,) = found_parameters(Member(effect, fitted, 0.0, plausible=True), fitted, by).values()
            covered.append(found.interval_95[0] <= true <= found.interval_95[1])
        deviation = np.sqrt(covariance(fitted, by)[0, 0])
        covered.append(abs(fitted.coordinates[0] - truth[0] / 0.2) <= 1.96 * deviation)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.02)
