"""Search the whole bounds, fit from the best of many candidates, and say how far the fits agree.

Candidates and fits come through a map, in steps that can be watched and stopped.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeVar

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import MonitorCoreError, NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds, Problem
from monitor_core.fitting.solver.least_squares import FitSettings, LocalFit, fit_local

_T = TypeVar("_T")
_R = TypeVar("_R")

#: Into how many parts the candidates are cut, whatever the number of workers: enough for eight.
_PARTS = 8


class SearchCancelledError(MonitorCoreError, RuntimeError):
    """The search was stopped on request before it had an answer."""


class MapFunction(Protocol):
    """``map`` and what is like it: a process pool's ``map``, or ``lambda f, s: client.gather(client.map(f, list(s)))``.

    Answers must come in the order of the items. A lazy one shows progress and can be cancelled between items.
    """

    def __call__(self, function: Callable[[_T], _R], items: Iterable[_T], /) -> Iterable[_R]:
        """Apply the function to each item."""
        ...


class Steps:
    """Count steps for whoever watches, and stop where asked to."""

    def __init__(
        self, total: int, progress: Callable[[int, int], None] | None, cancelled: Callable[[], bool] | None
    ) -> None:
        self.done, self.total, self._progress, self._cancelled = 0, total, progress, cancelled

    def reach(self, done: int) -> None:
        """Report that so many steps are done; raises SearchCancelledError if the search is to stop."""
        if done > self.done:
            self.done = done
            if self._progress is not None:
                self._progress(done, self.total)
        if self._cancelled is not None and self.done < self.total and self._cancelled():
            raise SearchCancelledError(f"the search was cancelled after {self.done} of {self.total} steps")


def _chi_squared_of(problem: Problem, candidates: FloatArray) -> FloatArray:
    """Return χ² of each candidate, infinite where the model has no answer; shape (n_candidates,)."""
    chi_squared = np.full(len(candidates), np.inf)
    for i, candidate in enumerate(candidates):
        try:
            residuals = problem.residuals(candidate)
        except MonitorCoreError:
            continue
        if np.max(np.abs(residuals), initial=0.0) < 1e150:
            chi_squared[i] = residuals @ residuals
    return chi_squared


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How a search is made."""

    candidates_per_coordinate: int = 128  #: spread over the bounds so that each has a part of every one to itself
    n_starts: int = 12  #: local fits, from the best of the candidates
    same_chi_squared: float = 0.01  #: two fits are one optimum if χ² differs by no more, in residual variances …
    same_coordinate: float = 0.1  #: … and each coordinate by no more than this part of its standard uncertainty
    compared_below: float = 0.25  #: coordinates less certain than this part of their bounds' width are not compared


@dataclass(frozen=True, slots=True, eq=False)
class StartedFit:
    """A local fit and where it came from."""

    start: FloatArray  # shape (n_parameters,)
    fit: LocalFit
    same_as_best: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start))


@dataclass(frozen=True, slots=True, eq=False)
class FailedStart:
    """A start from which nothing could be fitted."""

    start: FloatArray  # shape (n_parameters,)
    reason: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start))


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """What a global search found."""

    fits: tuple[StartedFit, ...]  # in order of χ², the best first
    failed: tuple[FailedStart, ...]
    not_compared: tuple[str, ...]  # coordinates that the data leave too open to say whether two fits agree in them
    n_evaluations: int  # of the residuals, candidates and local fits together

    @property
    def best(self) -> LocalFit:
        """The fit with the least χ²."""
        return self.fits[0].fit

    def agreement(self) -> float:
        """Return the share of starts that reached the best optimum; failed ones did not. [-]."""
        return sum(started.same_as_best for started in self.fits) / (len(self.fits) + len(self.failed))


def search(
    problem: Problem,
    bounds: Bounds,
    seed: int,
    settings: SearchSettings | None = None,
    fit_settings: FitSettings | None = None,
    *,
    map_function: MapFunction = map,
    progress: Callable[[int, int], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Search:
    """Find the least χ² within finite bounds.

    A local fit from each of the best candidates of a Latin hypercube [1]_. It is drawn from the seed and its candidates
    are cut into a fixed number of parts: the result does not depend on ``map_function``, nor on how many workers are
    behind it. Where it leaves the process the problem must be picklable.

    ``progress`` is told (done, total) after each part and each local fit, at last (total, total); between them
    ``cancelled`` is asked, and ``SearchCancelledError`` if it said so: half a search has no agreement to report.
    ``NotIdentifiableError`` if no start led to a fit; the reason given by the best is quoted. ``OutsideValidityError``
    if a bound is not finite, or there is nothing to start from.

    References
    ----------
    .. [1] M. D. McKay, R. J. Beckman, W. J. Conover, Technometrics 21 (1979) 239-245.
    """
    settings, fit_settings = settings or SearchSettings(), fit_settings or FitSettings()
    if not (np.isfinite(bounds.lower).all() and np.isfinite(bounds.upper).all()):
        raise OutsideValidityError("a global search needs finite bounds; got an infinite one")
    if min(settings.n_starts, settings.candidates_per_coordinate) < 1:
        raise OutsideValidityError("a search needs at least one candidate and one start; got none")
    rng, n_parameters = np.random.default_rng(seed), bounds.lower.size
    n_candidates = settings.candidates_per_coordinate * n_parameters
    strata = np.array([rng.permutation(n_candidates) for _ in range(n_parameters)]).T
    share = (strata + rng.random(strata.shape)) / n_candidates
    candidates = bounds.lower + share * (bounds.upper - bounds.lower)
    parts = np.array_split(candidates, min(_PARTS, n_candidates))
    steps = Steps(len(parts) + min(settings.n_starts, n_candidates), progress, cancelled)

    def counted(answers: Iterable[_R]) -> list[_R]:
        gathered = []
        steps.reach(steps.done)
        for answer in answers:
            gathered.append(answer)
            steps.reach(steps.done + 1)
        return gathered

    chi_squared = np.concatenate(counted(map_function(partial(_chi_squared_of, problem), parts)))
    starts = candidates[np.argsort(chi_squared, kind="stable")[: settings.n_starts]]
    outcomes = counted(map_function(partial(_fit_or_reason, problem, bounds, fit_settings), list(starts)))
    return _ranked(starts, outcomes, bounds, settings, n_candidates)


def _fit_or_reason(problem: Problem, bounds: Bounds, settings: FitSettings, start: FloatArray) -> LocalFit | str:
    try:
        return fit_local(problem, bounds, start, settings)
    except MonitorCoreError as error:
        return str(error)


def _ranked(
    starts: FloatArray,
    outcomes: list[LocalFit | str],
    bounds: Bounds,
    settings: SearchSettings,
    n_evaluations: int,
) -> Search:
    fitted = [(start, out) for start, out in zip(starts, outcomes, strict=True) if isinstance(out, LocalFit)]
    failed = [FailedStart(start, out) for start, out in zip(starts, outcomes, strict=True) if isinstance(out, str)]
    if not fitted:
        raise NotIdentifiableError(f"none of {len(starts)} starts led to a fit; the first: {failed[0].reason}")
    fitted.sort(key=lambda started: started[1].chi_squared)
    best = fitted[0][1]
    width = bounds.upper - bounds.lower
    uncertainty = best.coordinates.standard_uncertainties
    compared = uncertainty < settings.compared_below * width

    def same(fit: LocalFit) -> bool:
        distance = np.abs(fit.coordinates.values - best.coordinates.values)
        if (distance <= 1e-6 * width).all():  # where nothing scatters, standard uncertainties are no measure
            return True
        near = distance <= settings.same_coordinate * uncertainty
        higher = fit.chi_squared - best.chi_squared
        return bool(near[compared].all()) and higher <= settings.same_chi_squared * best.residual_variance

    return Search(
        fits=tuple(StartedFit(start, fit, same(fit)) for start, fit in fitted),
        failed=tuple(failed),
        not_compared=tuple(name for name, is_compared in zip(best.names, compared, strict=True) if not is_compared),
        n_evaluations=n_evaluations + sum(fit.n_evaluations for _, fit in fitted),
    )
