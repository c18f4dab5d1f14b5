"""What a search may be left for is asked once of a fit, and what explains most is the answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from monitor_core.discrepancy.description import describe, otherwise
from monitor_core.discrepancy.description.describe import Description
from monitor_core.discrepancy.description.otherwise import Otherwise
from monitor_core.effects import Variable
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity

N_SETTINGS, N_VALUES = 8, 12
FIRST, LAW, PORT = quantity(0), quantity(1), quantity(2)


def quiet(_sentence: str) -> None:
    """Say nothing."""


def fitted_with(*effects, shares=(4.0, 4.0, 4.0)):
    """Fit effects to data in which each of three quantities has such a share."""
    layout = layout_of([N_VALUES] * N_SETTINGS, 1.0)
    rng = np.random.default_rng(7)
    design = rng.standard_normal((layout.n_values, 3))
    data = design @ np.array(shares) + rng.standard_normal(layout.n_values)
    comparison = LinearComparison(layout, design, data, np.zeros((0, layout.n_values)))
    hypothesis = Hypothesis(LinearAxis({}, 3), effects)
    return fit(comparison, hypothesis, hypothesis.null)


def said(fitted, variable=Variable.EXCITATION):
    """Return the description that this fit is of a law of a variable, or of what swings where there is none."""
    return Description(SimpleNamespace(law=variable and SimpleNamespace(variable=variable)), fitted, frozenset())


@pytest.fixture
def asked(monkeypatch):
    """Return who asks what would be found, and the fits that it was asked of."""

    def _asked(found):
        calls = []
        monkeypatch.setattr(otherwise, "describe_in_place", lambda _baseline, fitted, *_: calls.append(fitted) or found)
        monkeypatch.setattr(otherwise, "leaves_only_wandering", lambda _fitted: False)
        return Otherwise(None, quiet), calls

    return _asked


def test_each_question_is_answered_once_of_a_fit(asked) -> None:
    baseline, first = fitted_with(), fitted_with(FIRST)
    other, calls = asked(None)
    assert not other.explains(baseline, first)
    assert not other.explains(baseline, first)
    assert other.follows(baseline, first) is None
    assert calls == [first]


def test_a_law_that_a_search_was_left_for_stays_the_answer_without_the_name(asked) -> None:
    """The name may be cleaned away afterwards: of a fit without one nothing would be asked."""
    baseline, first = fitted_with(), fitted_with(FIRST)
    for found, stays in ((said(fitted_with(LAW)), True), (said(fitted_with(LAW), None), False)):
        other, calls = asked(found)
        assert other.explains(baseline, first)
        assert other.follows(baseline, baseline) is (found if stays else None)
        assert calls == [first]


def test_of_no_name_or_two_nothing_is_asked_of_the_excitation(asked) -> None:
    baseline = fitted_with()
    other, calls = asked(said(fitted_with(LAW)))
    assert other.follows(baseline, baseline) is None
    assert other.follows(baseline, fitted_with(FIRST, PORT)) is None
    assert calls == []


@pytest.mark.parametrize(
    ("with_names", "variable", "is_answer"),
    [
        ((), Variable.EXCITATION, True),  # it leaves nothing, and a name is far from that
        ((), None, True),
        ((), Variable.POSITION, False),  # such a law is sought where all names have been tried
        ((FIRST, LAW, PORT), Variable.EXCITATION, False),  # names do as well
    ],
)
def test_what_leaves_nothing_is_the_answer_in_the_place_of_a_name_that_does_not(
    monkeypatch, with_names, variable, is_answer
) -> None:
    best = said(fitted_with(FIRST, LAW, PORT), variable)
    monkeypatch.setattr(describe, "may_be_described", lambda _fitted: True)
    monkeypatch.setattr(describe, "_at_ports", lambda *_: ())
    monkeypatch.setattr(describe, "list_of", lambda *_: [])
    monkeypatch.setattr(describe, "best_of", lambda *_, **_options: best)
    found = describe.describe_in_place(fitted_with(), fitted_with(*with_names), None, quiet)
    assert found is (best if is_answer else None)
