"""Global search: the same with any number of workers, honest about agreement, and stoppable."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.solver.global_search import (
    MapFunction,
    Search,
    SearchCancelledError,
    SearchSettings,
    search,
)
from monitor_core.fitting.solver.least_squares import FitSettings
from tests.fitting.strd import agreed_digits, certified, regression

QUICK = SearchSettings(candidates_per_coordinate=6, n_starts=5)


@dataclass(frozen=True)
class Wells:
    """χ² = (x² − 1)² + t² (x − 1)²: minima at 1 and, for t = 0.3, at −0.9528 (roots of 4x² + 4x + 2t²)."""

    tilt: float = 0.3
    names: tuple[str, ...] = ("x",)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        x = coordinates[0]
        return np.array([x**2 - 1.0, self.tilt * (x - 1.0)])

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.array([[2.0 * coordinates[0]], [self.tilt]])


@dataclass(frozen=True)
class Waves:
    """Many minima in two coordinates (after Rastrigin), the least at (0.5, −1); a third coordinate moves nothing."""

    names: tuple[str, ...] = ("a", "b", "unseen")

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        away = coordinates[:2] - np.array([0.5, -1.0])
        return np.concatenate([away, 3.0 * np.sin(np.pi * away)])

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        away = coordinates[:2] - np.array([0.5, -1.0])
        two = np.vstack([np.eye(2), np.diag(3.0 * np.pi * np.cos(np.pi * away))])
        return np.hstack([two, np.zeros((4, 1))])


@dataclass(frozen=True)
class NoAnswer:
    """A model that has an answer above a limit only."""

    limit: float
    names: tuple[str, ...] = ("x",)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        if coordinates[0] < self.limit:
            raise OutsideValidityError("the mode list cannot be assigned")
        return coordinates - 0.5

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.ones((1, 1))


def box(n: int, half: float) -> Bounds:
    return Bounds(np.full(n, -half), np.full(n, half))


def numbers(found: Search) -> list[tuple[object, ...]]:
    """Everything of a search that could differ."""
    return [
        (
            attempt.start.tolist(),
            attempt.fit.coordinates.values.tolist(),
            attempt.fit.chi_squared,
            attempt.same_as_best,
        )
        for attempt in found.fits
    ] + [(found.n_evaluations, found.not_compared)]


def test_one_and_two_workers_and_none_find_the_same_to_the_last_digit() -> None:
    alone = search(Waves(), box(3, 4.0), 7, QUICK)
    for workers in (1, 2):
        with ProcessPoolExecutor(workers) as pool:
            assert numbers(search(Waves(), box(3, 4.0), 7, QUICK, map_function=pool.map)) == numbers(alone)


def test_a_map_that_gathers_all_at_once_and_in_any_order_finds_the_same() -> None:
    class Backwards:
        """Like a cluster that finishes tasks as it likes and hands the answers over in order."""

        def __call__(self, function, items):
            return [function(item) for item in reversed(list(items))][::-1]

    backwards: MapFunction = Backwards()
    alone = search(Waves(), box(3, 4.0), 7, QUICK)
    assert numbers(search(Waves(), box(3, 4.0), 7, QUICK, map_function=backwards)) == numbers(alone)


def test_the_seed_alone_decides() -> None:
    once, again, other = (search(Waves(), box(3, 4.0), seed, QUICK) for seed in (3, 3, 4))
    assert numbers(once) == numbers(again)
    assert numbers(once) != numbers(other)


def test_the_best_of_many_candidates_lead_to_the_least_of_many_minima_where_all_do_not() -> None:
    best, everywhere = (search(Waves(), box(3, 4.0), 1, SearchSettings(128, n_starts)) for n_starts in (12, 384))
    for found in (best, everywhere):
        assert found.best.coordinates.values[:2] == pytest.approx([0.5, -1.0], abs=1e-6)
    assert best.agreement() > 3.0 * everywhere.agreement()
    found = everywhere
    assert found.not_compared == ("unseen",)
    assert [attempt.fit.chi_squared for attempt in found.fits] == sorted(
        attempt.fit.chi_squared for attempt in found.fits
    )


def test_agreement_is_the_share_that_reached_the_lower_of_two_minima() -> None:
    found = search(Wells(), box(1, 2.0), 5, SearchSettings(40, 40))
    ends = np.array([attempt.fit.coordinates.values[0] for attempt in found.fits])
    higher = (-1.0 - np.sqrt(1.0 - 2.0 * 0.09)) / 2.0
    lower_reached, higher_reached = np.abs(ends - 1.0) < 1e-4, np.abs(ends - higher) < 1e-3
    assert (lower_reached | higher_reached).all()
    assert 0 < higher_reached.sum() < 40
    assert found.agreement() == pytest.approx(lower_reached.mean())
    assert [attempt.same_as_best for attempt in found.fits] == lower_reached.tolist()


def test_two_equally_low_minima_do_not_agree() -> None:
    found = search(Wells(tilt=0.0), box(1, 2.0), 5, SearchSettings(20, 20))
    ends = np.array([attempt.fit.coordinates.values[0] for attempt in found.fits])
    assert found.fits[-1].fit.chi_squared < 1e-12
    assert found.agreement() == pytest.approx((np.sign(ends) == np.sign(ends[0])).mean())
    assert found.agreement() < 1.0


def test_search_finds_certified_values_without_a_start() -> None:
    expected = certified("Eckerle4")
    bounds = Bounds(np.array([0.1, 0.5, 400.0]), np.array([10.0, 50.0, 500.0]))
    found = search(regression("Eckerle4"), bounds, 2, fit_settings=FitSettings(uncertainties_stated=False))
    assert agreed_digits(found.best.coordinates.values, expected.values) >= 6.0


def test_progress_counts_up_to_its_total() -> None:
    seen: list[tuple[int, int]] = []
    search(Wells(), box(1, 2.0), 5, QUICK, progress=lambda done, total: seen.append((done, total)))
    done = [step for step, _ in seen]
    assert {total for _, total in seen} == {6 + 5}
    assert done == sorted(set(done))
    assert done[-1] == 11


@pytest.mark.parametrize("after", [0, 1, 7, 8, 12])
def test_cancelling_stops_at_the_next_part_or_start(after: int) -> None:
    seen = [0]

    def progress(done: int, total: int) -> None:
        seen.append(done)

    with pytest.raises(SearchCancelledError, match="of 13 steps"):
        search(Waves(), box(3, 4.0), 5, QUICK, progress=progress, cancelled=lambda: seen[-1] >= after)
    assert seen[-1] >= after
    assert all(step < after for step in seen[:-1])


def test_failed_starts_are_reported_and_count_against_agreement() -> None:
    found = search(NoAnswer(0.0), box(1, 1.0), 5, SearchSettings(20, 20))
    n_below = sum(failure.start[0] < 0.0 for failure in found.failed)
    assert n_below == len(found.failed) > 0
    assert {failure.reason for failure in found.failed} == {"the mode list cannot be assigned"}
    assert found.agreement() == pytest.approx(1.0 - n_below / 20)


def test_a_search_without_an_answer_is_refused() -> None:
    with pytest.raises(NotIdentifiableError, match="none of 5 starts led to a fit; the first: the mode list"):
        search(NoAnswer(5.0), box(1, 1.0), 5, QUICK)
    with pytest.raises(OutsideValidityError, match="finite bounds"):
        search(Wells(), Bounds(np.array([-np.inf]), np.array([1.0])), 5, QUICK)
    with pytest.raises(OutsideValidityError, match="at least one"):
        search(Wells(), box(1, 1.0), 5, SearchSettings(n_starts=0))
