"""A search that is left when its time is up: the best answer so far, and what was not tried."""

import numpy as np
import pytest

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Explanation, Outcome, Untested, UntestedReason
from monitor_core.discrepancy.search.workspace import StoppableAxis, TimeIsUpError
from service.documents.explanation import explanation_document
from service.documents.explanation_sentences import KEYS, unfinished_sentence
from service.report.content import report_content
from tests.discrepancy.axes import LinearAxis, quantity
from tests.discrepancy.test_explanation import N, linear

TRUTH = np.array([0.0, 8.0, 4.0, 0.0])


def explained_within(n_answers: float) -> Explanation:
    """Explain two missing quantities; time is up after so many answers of the axis."""
    asked = 0

    def time_is_up() -> bool:
        nonlocal asked
        asked += 1
        return asked > n_answers

    candidates = [quantity(1), quantity(2), quantity(3)]
    return explain_comparison(linear(TRUTH), LinearAxis({}, 4), candidates, time_is_up=time_is_up)


@pytest.mark.release
def test_the_answer_so_far_is_never_more_than_partial_and_says_what_was_not_tried() -> None:
    whole = explained_within(np.inf)
    assert (whole.outcome, whole.unfinished) == (Outcome.NAMED, None)
    outcomes = set()
    for n_answers in range(0, 400, 5):
        answer = explained_within(n_answers)
        if answer.unfinished is None:
            assert answer.outcome is Outcome.NAMED
            continue
        outcomes.add((answer.outcome, tuple(effect.key for effect in answer.effects)))
        assert answer.outcome in (Outcome.UNKNOWN, Outcome.PARTIAL)
        sentence = unfinished_sentence(answer.unfinished, KEYS)
        assert sentence.startswith("Time was up while ")
        assert answer.gap.after.fit <= answer.gap.before.fit
        content = report_content(answer)
        assert content.headline.startswith("Time was up")
        assert sentence in content.asides
        assert explanation_document(answer, "")["unfinished"] == sentence
    assert (Outcome.UNKNOWN, ()) in outcomes
    assert any(keys for _, keys in outcomes)  # what had been found by then is in the answer


def test_at_once_the_model_as_it_stands_is_judged_and_every_effect_is_said_not_to_have_been_tried() -> None:
    answer = explained_within(0)
    assert answer.outcome is Outcome.UNKNOWN
    assert answer.unfinished is not None
    assert answer.unfinished.untried == ("quantity-1", "quantity-2", "quantity-3")
    assert {candidate.untested for candidate in answer.candidates} == {Untested(UntestedReason.TIME_UP)}


def test_an_axis_is_left_once_and_answers_again() -> None:
    axis = StoppableAxis(LinearAxis({"a": 0.1}, 1), lambda: True)
    axis.physics({})  # nothing is searched yet
    with axis.stoppable():
        with pytest.raises(TimeIsUpError):
            axis.physics({})
        axis.physics({})
    np.testing.assert_array_equal(axis.physics({}), LinearAxis({"a": 0.1}, 1).physics({}))
    assert axis.uncertain == {"a": 0.1}


class CountedAxis(LinearAxis):
    """An axis that counts what it was asked."""

    n_answers = 0

    def physics(self, ln_ratios):
        CountedAxis.n_answers += 1
        return super().physics(ln_ratios)


def test_hardly_anything_is_computed_after_the_limit_wherever_it_comes() -> None:
    """Eight effects that are not told apart, four folds: what each would do on held-out values takes answers, too."""
    rng = np.random.default_rng(4)
    alike = rng.standard_normal((N, 1)) + 0.02 * rng.standard_normal((N, 8))
    columns = np.concatenate([rng.standard_normal((N, 1)), alike], axis=1)
    folds = tuple(np.arange(N) % 4 == fold for fold in range(4))
    comparison = linear(np.array([0.0, 3.0, *[0.0] * 7]), columns=columns, held_out=folds)
    candidates = [quantity(number) for number in range(1, 9)]

    def n_answers_within(limit: float) -> int:
        began = CountedAxis.n_answers
        explain_comparison(
            comparison, CountedAxis({}, 9), candidates, time_is_up=lambda: CountedAxis.n_answers - began >= limit
        )
        return CountedAxis.n_answers - began

    without_limit = n_answers_within(np.inf)
    assert without_limit > 500
    late = {limit: n_answers_within(limit) - limit for limit in range(20, without_limit, 19)}
    assert max(late.values()) <= n_answers_within(0), late  # what the model leaves as it stands is found in any case
