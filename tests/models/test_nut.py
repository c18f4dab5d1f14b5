"""Rigidity of the nut, Eq. (1) of Nguyen et al. (2018)."""

import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.ball_screw import nut_rigidity

K, RATING = 470e6, 4000.0  # Table 1: catalogue stiffness; 400 N are a tenth of the rating


def test_rigidity_is_that_of_eq_1() -> None:
    assert nut_rigidity(K, 400.0, RATING) == pytest.approx(0.8 * K)
    assert nut_rigidity(K, 50.0, RATING) == pytest.approx(0.4 * K)  # an eighth of the preload is half the rigidity


def test_without_preload_and_rating_it_is_what_was_stated() -> None:
    assert nut_rigidity(K, None, None) == K


@pytest.mark.parametrize(
    ("preload", "rating", "said"),
    [
        (None, RATING, "state the preload"),
        (200.0, None, "state the rating"),
        (401.0, RATING, "must not exceed 10 % of the dynamic load rating, 400 N; got 401 N"),
    ],
)
def test_what_does_not_fit_together_is_refused(preload: float | None, rating: float | None, said: str) -> None:
    with pytest.raises(OutsideValidityError, match=said):
        nut_rigidity(K, preload, rating)
