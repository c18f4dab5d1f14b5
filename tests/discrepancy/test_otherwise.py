"""What a search may be left for is asked once of a fit, and what explains most is the answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from monitor_core.discrepancy.description import otherwise
from monitor_core.discrepancy.description.describe import Description
from monitor_core.discrepancy.description.otherwise import Otherwise
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


def said(fitted):
    """Return a description with this fit, whatever it says."""
    return Description(SimpleNamespace(), fitted, frozenset())


@pytest.fixture
def asked(monkeypatch):
    """Return who asks; the laws and ports that it would find; and the fits that each was asked of."""

    def _asked(law, port):
        calls = {"law": [], "port": []}

        def answers(kind, found):
            def answer(_baseline, fitted, *_rest):
                calls[kind].append(fitted)
                return found

            return answer

        monkeypatch.setattr(otherwise, "following_excitation", answers("law", law))
        monkeypatch.setattr(otherwise, "swinging_at_port", answers("port", port))
        monkeypatch.setattr(otherwise, "leaves_only_wandering", lambda _fitted: False)
        return Otherwise(None, quiet), calls

    return _asked


def test_of_a_law_and_what_swings_the_one_that_explains_more_is_the_answer(asked) -> None:
    baseline, first = fitted_with(), fitted_with(FIRST)
    more, less = said(fitted_with(FIRST, LAW, PORT)), said(fitted_with(FIRST, LAW))
    for law, port, expected in ((more, less, more), (less, more, None), (more, more, more), (more, None, more)):
        other, _ = asked(law, port)
        assert other.follows(baseline, first) is expected
        assert other.explains(baseline, first)


def test_each_question_is_answered_once_of_a_fit(asked) -> None:
    baseline, first = fitted_with(), fitted_with(FIRST)
    other, calls = asked(None, None)
    assert not other.explains(baseline, first)
    assert not other.explains(baseline, first)
    assert other.follows(baseline, first) is None
    assert calls == {"law": [first], "port": [first]}


def test_a_law_that_a_search_was_left_for_stays_the_answer_without_the_name(asked) -> None:
    """The name may be cleaned away afterwards: of a fit without one nothing would be asked."""
    baseline, first = fitted_with(), fitted_with(FIRST)
    law = said(fitted_with(LAW))
    other, calls = asked(law, None)
    assert other.explains(baseline, first)
    assert other.follows(baseline, baseline) is law
    assert calls["law"] == [first]


def test_of_no_name_or_two_nothing_is_asked_of_the_excitation(asked) -> None:
    baseline = fitted_with()
    other, calls = asked(said(fitted_with(LAW)), None)
    assert other.follows(baseline, baseline) is None
    assert other.follows(baseline, fitted_with(FIRST, PORT)) is None
    assert calls["law"] == []
