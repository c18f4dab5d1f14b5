"""What a search means, as a table; and the pulls of settings that nothing is wrong with."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from monitor_core.discrepancy.explanation import Gap, GapPair, Outcome
from monitor_core.discrepancy.hypothesis import Hypothesis
from monitor_core.discrepancy.judging.classes import EquivalenceClass, Member
from monitor_core.discrepancy.judging.outcome import OutcomeSettings, explained_share, outcome_of, variances_of_pulls
from monitor_core.discrepancy.searching.fit import fit
from monitor_core.discrepancy.searching.holding_out import REMAINDER
from tests.discrepancy.axes import LinearComparison, LinearSubject, layout_of, quantity

SETTINGS = OutcomeSettings()
MANY = 100_000  # values: their rms does not scatter
FLOOR = 2.0
#: Just within and just beyond what counts as nothing left, in the unit of the gap.
AT_FLOOR, LEFT = 0.999 * REMAINDER * FLOOR, 1.001 * REMAINDER * FLOOR
BEFORE = 40.0
QUIET = {"position": 0.5 * SETTINGS.pulls, "gain 1": 0.5 * SETTINGS.pulls}
PULLED = {"position": 1.1 * SETTINGS.pulls}
GAINS = {"position": 0.1, "gain 1": 20.0 * SETTINGS.pulls}


def found(*plausible):
    """Return a class with members that are plausible or not, the leader first."""
    members = tuple(Member(quantity(index), None, 100.0, one) for index, one in enumerate(plausible))
    return EquivalenceClass(members, (), 50.0)


def gap(fit_after, held_out_after=math.nan, before=BEFORE):
    held_out_before = math.nan if math.isnan(held_out_after) else before
    return Gap("sigma", FLOOR, GapPair(before, held_out_before), GapPair(fit_after, held_out_after))


GOOD, TWO, STAND_IN = found(True), found(True, True), found(False)
TABLE = {
    "nothing found, nothing left": ((), gap(AT_FLOOR), QUIET, Outcome.NONE),
    "nothing found, something left": ((), gap(LEFT), QUIET, Outcome.UNKNOWN),
    "nothing found, something left on held-out data": ((), gap(FLOOR, LEFT), QUIET, Outcome.UNKNOWN),
    "nothing found, settings drift": ((), gap(AT_FLOOR), PULLED, Outcome.UNKNOWN),
    "nothing found, gains off": ((), gap(AT_FLOOR), GAINS, Outcome.NONE),
    "found": ((GOOD,), gap(AT_FLOOR, AT_FLOOR), QUIET, Outcome.NAMED),
    "two effects found": ((GOOD, GOOD), gap(AT_FLOOR), QUIET, Outcome.NAMED),
    "not told apart": ((GOOD, TWO), gap(AT_FLOOR), QUIET, Outcome.EQUIVALENT),
    "a remainder": ((GOOD,), gap(LEFT), QUIET, Outcome.PARTIAL),
    "a remainder on held-out data": ((GOOD,), gap(FLOOR, LEFT), QUIET, Outcome.PARTIAL),
    "a remainder, not told apart": ((TWO,), gap(LEFT), QUIET, Outcome.UNKNOWN),
    "a remainder, one told apart": ((TWO, GOOD), gap(LEFT), QUIET, Outcome.PARTIAL),
    "settings drift, not told apart": ((TWO,), gap(AT_FLOOR), PULLED, Outcome.PARTIAL),
    "settings drift": ((GOOD,), gap(AT_FLOOR), PULLED, Outcome.PARTIAL),
    "a stand-in alone": ((STAND_IN,), gap(AT_FLOOR), QUIET, Outcome.UNKNOWN),
    "a stand-in beside an effect": ((GOOD, STAND_IN), gap(AT_FLOOR), QUIET, Outcome.PARTIAL),
}  # fmt: skip


def judged(classes, gap_, pulls, explained=1.0):
    return outcome_of(classes, gap_, pulls=pulls, explained=explained, n_judged=MANY, settings=SETTINGS)


@pytest.mark.parametrize("what", TABLE)
def test_outcome(what) -> None:
    classes, gap_, pulls, expected = TABLE[what]
    assert judged(classes, gap_, pulls) is expected


@pytest.mark.parametrize("left", [(gap(LEFT), QUIET), (gap(FLOOR, LEFT), QUIET), (gap(AT_FLOOR), PULLED)])
def test_what_explains_too_little_may_stand_for_something_else(left) -> None:
    least = SETTINGS.least_share
    assert judged((GOOD,), *left, explained=least) is Outcome.PARTIAL
    assert judged((GOOD,), *left, explained=0.999 * least) is Outcome.UNKNOWN
    assert judged((GOOD,), gap(AT_FLOOR), QUIET, explained=0.999 * least) is Outcome.NAMED  # nothing is left


@pytest.mark.parametrize("beyond", [0.0, 1.0, 3.0])
def test_share_explained_is_of_residuals_and_of_pulls(beyond) -> None:
    """Two steps that nothing takes up, a and b, of which the second fit has a: a² of a² + b² and the pulls is gone."""
    rng = np.random.default_rng(3)
    design = np.linalg.qr(rng.standard_normal((40, 2)))[0]
    comparison = LinearComparison(layout_of([4] * 10, np.ones(40)), design, design @ [30.0, 10.0], np.zeros((0, 40)))
    fits = [
        fit(comparison, hypothesis, hypothesis.null)
        for effects in ((), (quantity(0),))
        for hypothesis in [Hypothesis(LinearSubject({}, 2), effects)]
    ]
    in_floors = 2.0 * REMAINDER
    pulls = {"error 1": 1.0 + beyond, "gain 1": 50.0}
    left = 10.0**2 * (1.0 - 0.5**2) + 10 * beyond
    share = explained_share(*fits, gap(in_floors * FLOOR), pulls, n_judged=MANY, settings=SETTINGS)
    assert share == pytest.approx(900.0 / (900.0 + left), rel=1e-6)
    nothing = explained_share(fits[0], fits[0], gap(in_floors * FLOOR), pulls, n_judged=MANY, settings=SETTINGS)
    assert nothing == 0.0


def test_variances_of_pulls_are_one_where_all_is_right() -> None:
    """Over draws of 40 settings, about their mean: χ² of 39 degrees of freedom (Kolmogorov and Smirnov at 1e-4)."""
    rng = np.random.default_rng(1)
    n_settings, n = 40, 240
    layout = layout_of([6] * n_settings, 0.5)
    directions = rng.standard_normal((2, n))
    subject = LinearSubject({}, 1)
    drawn = []
    for _ in range(400):
        errors = rng.standard_normal((n_settings, 2))
        data = 0.5 * rng.standard_normal(n) + np.sum(directions * errors[layout.setting].T, axis=0)
        comparison = LinearComparison(layout, np.zeros((n, 1)), data, directions)
        fitted = fit(comparison, Hypothesis(subject), np.zeros(0))
        drawn.append(variances_of_pulls(fitted))
    for name in ("error 1", "error 2"):
        values = n_settings * np.array([one[name] for one in drawn])
        assert stats.kstest(values, stats.chi2(n_settings - 1).cdf).pvalue > 1e-4


def test_settings_that_err_alike_are_no_drift() -> None:
    """A preload too high by three standard deviations at every setting is a matter of the nut, not of settings."""
    layout, directions = layout_of([6] * 10, 0.1), np.ones((1, 60))
    alike = LinearComparison(layout, np.zeros((60, 1)), np.full(60, 3.0), directions)
    drifting = replace(alike, data=np.repeat(np.linspace(-5.0, 5.0, 10), 6))
    for comparison, left in ((alike, 0.0), (drifting, np.var(np.linspace(-5.0, 5.0, 10)))):
        fitted = fit(comparison, Hypothesis(LinearSubject({}, 1)), np.zeros(0))
        assert variances_of_pulls(fitted)["error 1"] == pytest.approx(left, rel=0.02, abs=1e-9)


def test_errors_that_nothing_tells_of_are_not_judged() -> None:
    comparison = LinearComparison(layout_of([3], 1.0), np.zeros((3, 1)), np.ones(3), np.array([[1.0] * 3, [0.0] * 3]))
    fitted = fit(comparison, Hypothesis(LinearSubject({}, 1)), np.zeros(0))
    assert list(variances_of_pulls(fitted)) == ["error 1"]
