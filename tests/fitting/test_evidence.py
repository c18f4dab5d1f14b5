"""The evidence scale of a decrease of χ²: the information criterion by hand, and what correlated values are worth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale, neighbour_correlation
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity


def autoregression(correlation, n, rng, n_series=1):
    """Return series of a first-order autoregression with variance one, one after the other."""
    white = rng.standard_normal((n_series, n + 200)) * math.sqrt(1.0 - correlation**2)
    return lfilter([1.0], [1.0, -correlation], white)[:, 200:].ravel()


def fits(data, *, size=1, n_settings=1):
    """Return fits of data by nothing and by a constant."""
    n = data.size // n_settings
    comparison = LinearComparison(
        layout_of([n] * n_settings, 1.0), np.ones((data.size, size)), data, np.zeros((0, data.size))
    )
    subject = LinearAxis({}, size)
    return [
        fit(comparison, hypothesis, hypothesis.null)
        for hypothesis in (Hypothesis(subject), Hypothesis(subject, (quantity(0),)))
    ]


def test_a_parameter_that_moves_nothing_costs_nothing() -> None:
    """As the damping of a base in a table of its frequencies; the same parameter, where it is seen, costs ln n."""
    n, data = 200, 1.0 + np.random.default_rng(6).standard_normal(200)
    by = EvidenceScale(1.0, 0.0, n)

    def gained(index_of_shape):
        both = (quantity(0).parameters[0], replace(quantity(0).parameters[0], name="shape"))

        def add(theta, values):
            changed = theta.copy()
            changed[0] += values["size"]
            changed[index_of_shape] += 1e-9 * values["shape"]
            return changed

        comparison = LinearComparison(
            layout_of([n], 1.0), np.column_stack([np.ones(n), np.zeros(n)]), data, np.zeros((0, n))
        )
        shaped = replace(quantity(0), parameters=both, add=add)
        plain, fuller = (
            fit(comparison, hypothesis, hypothesis.null)
            for hypothesis in (Hypothesis(LinearAxis({}, 2)), Hypothesis(LinearAxis({}, 2), (shaped,)))
        )
        return delta_bic(plain, fuller, by)

    assert gained(1) - gained(0) == pytest.approx(math.log(n), abs=1e-3)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_correlation_of_neighbours_is_that_of_the_autoregression(correlation) -> None:
    """Its estimate scatters by √((1 − ρ²)/n)."""
    series = autoregression(correlation, 20_000, np.random.default_rng(1))
    chosen = np.ones(series.size, bool)
    found = neighbour_correlation(layout_of([series.size], 1.0), series, chosen)
    assert found == pytest.approx(correlation, abs=4.0 * math.sqrt((1.0 - correlation**2) / series.size))


@pytest.mark.parametrize("correlation", [0.3, 0.6])
def test_values_of_an_autoregression_are_worth_their_share(correlation) -> None:
    """The mean of n of them has the variance of n·share independent ones; exactly so for long series."""
    n = 5000
    lags = np.arange(1, n)
    variance_of_mean = (1.0 + 2.0 * np.sum((1.0 - lags / n) * correlation**lags)) / n
    share = EvidenceScale(1.0, correlation, n).share
    assert 1.0 / variance_of_mean == pytest.approx(n * share, rel=2e-3)


@pytest.mark.release
def test_series_end_with_their_setting() -> None:
    """Settings that follow one another are not neighbours, nor are values with a held-out one between them."""
    rng = np.random.default_rng(2)
    series = autoregression(0.9, 2, rng, n_series=20_000)  # pairs
    layout = layout_of([2] * 20_000, 1.0)
    chosen = np.ones(series.size, bool)
    assert neighbour_correlation(layout, series, chosen) == pytest.approx(0.9, abs=0.02)
    level = np.repeat([1.0, -1.0], 3)  # six values in one setting, the third of them held out
    single = layout_of([6], 1.0)
    assert neighbour_correlation(single, level, np.arange(6) != 2) == pytest.approx(1.0)
    assert neighbour_correlation(single, level, np.ones(6, bool)) < 0.7
    assert neighbour_correlation(single, level, np.arange(6) < 2) == 0.0  # a single pair tells nothing


def test_difference_of_bic_by_hand() -> None:
    """For a constant c among n white values: n c̄² − ln n; a fit of its own noise costs its share."""
    rng = np.random.default_rng(3)
    data = rng.standard_normal(400)
    data = (data - np.mean(data)) / np.std(data) + 0.4
    without, fuller = fits(data)
    by = EvidenceScale(1.0, 0.0, 400)
    assert delta_bic(without, fuller, by) == pytest.approx(400 * 0.4**2 - math.log(400), abs=1e-3)
    halved = EvidenceScale(2.0, 1.0 / 3.0, 400)  # s² = 2, and two values are worth one
    assert delta_bic(without, fuller, halved) == pytest.approx(400 * 0.4**2 / 4.0 - math.log(200), abs=1e-3)


def test_each_parameter_more_is_paid_for() -> None:
    rng = np.random.default_rng(4)
    data = rng.standard_normal(100)
    design = rng.standard_normal((100, 3))
    comparison = LinearComparison(layout_of([100], 1.0), design, data, np.zeros((0, 100)))
    subject = LinearAxis({}, 3)
    smaller, larger = (
        fit(comparison, hypothesis, hypothesis.null)
        for hypothesis in (Hypothesis(subject, tuple(quantity(index) for index in range(n))) for n in (1, 3))
    )
    by = EvidenceScale(1.0, 0.0, 100)
    assert smaller.cost - larger.cost - delta_bic(smaller, larger, by) == pytest.approx(2.0 * math.log(100))
    assert delta_bic(larger, smaller, by) == pytest.approx(-delta_bic(smaller, larger, by))


def test_evidence_scale_of_a_fit() -> None:
    """What the fit leaves per value is noise, no less than is stated, unless it is less than half of that."""
    rng = np.random.default_rng(5)
    series = 3.0 * autoregression(0.5, 10_000, rng) + 0.7
    _, fuller = fits(series)
    by = evidence_scale(fuller)
    assert by.n_values == 10_000
    left = series - np.mean(series)
    assert by.mean_square == pytest.approx(np.sum(left**2) / 9_999, rel=1e-6)
    assert by.correlation == pytest.approx(0.5, abs=0.03)
    assert by.factor == pytest.approx(by.share / by.mean_square)
    quiet = evidence_scale(fits(0.6 * autoregression(-0.5, 10_000, rng))[1])
    assert (quiet.mean_square, quiet.correlation, quiet.share) == (1.0, 0.0, 1.0)
    series = 0.1 * autoregression(-0.5, 10_000, rng)
    disproved = evidence_scale(fits(series)[1])
    assert disproved.mean_square == pytest.approx(4.0 * np.var(series, ddof=1), rel=1e-6)


def test_a_constant_in_correlated_noise_is_rarely_claimed() -> None:
    """In 2 Φ(−√ln n_eff) of all series: 3 % of those whose 400 values are worth 100; 22 % if taken for 400."""
    rng = np.random.default_rng(6)
    claimed = naively = 0
    for _ in range(200):
        without, fuller = fits(autoregression(0.6, 400, rng))
        by = evidence_scale(fuller)
        claimed += delta_bic(without, fuller, by) > 0.0
        naively += delta_bic(without, fuller, EvidenceScale(by.mean_square, 0.0, 400)) > 0.0
    assert claimed < 0.07 * 200
    assert naively > 0.15 * 200


@pytest.mark.release
def test_parameters_within_tolerances_do_not_swell_the_scale() -> None:
    """As many tolerances as two thirds of the values: the mean of s² over draws is still the noise's, here 4."""
    rng = np.random.default_rng(9)
    n, tolerances = 18, {f"quantity-{index}": 0.3 for index in range(12)}
    hypothesis = Hypothesis(LinearAxis(tolerances, 13), (quantity(12),))
    scales = []
    for _ in range(300):
        design = rng.standard_normal((n, 13))
        # noise and quantities are twice what is stated of them
        truth = 2.0 * np.r_[0.3 * rng.standard_normal(12), 1.0]
        data = design @ truth + 2.0 * rng.standard_normal(n)
        comparison = LinearComparison(layout_of([n], 1.0), design, data, np.zeros((0, n)))
        scales.append(evidence_scale(fit(comparison, hypothesis, np.zeros(13))).mean_square)
    assert np.mean(scales) == pytest.approx(4.0, abs=4.0 * 4.0 * math.sqrt(2.0 / (17 * 300)))
