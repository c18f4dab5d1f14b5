"""Search the whole bounds by differential evolution, fit from many starts, and say how far the fits agree.

The populations come through a map, in steps that can be watched and stopped.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Protocol, TypeVar

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import MonitorCoreError, NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds, Problem
from monitor_core.fitting.solver.least_squares import FitSettings, LocalFit, fit_local

_T = TypeVar("_T")
_R = TypeVar("_R")

#: Into how many parts the candidates of a generation are cut, whatever the number of workers: enough for eight.
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


class Population:
    """χ² of all candidates of a generation, through the map."""

    def __init__(self, problem: Problem, map_function: MapFunction) -> None:
        self._function = partial(_chi_squared_of, problem)
        self._map = map_function
        self.n_evaluations = 0

    def __call__(self, candidates: FloatArray) -> FloatArray:
        """Return χ² of candidates, shape (n_parameters, n_candidates)."""
        rows = np.atleast_2d(candidates.T)  # scipy hands over (n_parameters, n_candidates)
        self.n_evaluations += len(rows)
        return np.concatenate(list(self._map(self._function, np.array_split(rows, min(_PARTS, len(rows))))))


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


def evolve(
    evaluate: Population, bounds: Bounds, stream: np.random.Generator, size: tuple[int, int], steps: Steps
) -> FloatArray:
    """Return the best candidate of one differential evolution, shape (n_parameters,).

    ``size`` is the number of candidates for each coordinate, and the most generations.
    """
    candidates_per_coordinate, n_generations = size

    def after_generation(intermediate_result: object) -> None:
        steps.reach(steps.done + 1)

    steps.reach(steps.done)
    result = scipy.optimize.differential_evolution(
        evaluate,
        list(zip(bounds.lower, bounds.upper, strict=True)),
        popsize=candidates_per_coordinate,
        maxiter=n_generations,
        mutation=(0.4, 0.9),
        recombination=0.9,
        seed=stream,
        callback=after_generation,
        polish=False,
        updating="deferred",
        vectorized=True,
    )
    return np.asarray(result.x, dtype=np.float64)


class StartOrigin(StrEnum):
    """Where a local fit started."""

    POPULATION = "population"  #: the best candidate of one differential evolution
    RANDOM = "random"  #: drawn evenly over the bounds


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How a search is made."""

    n_populations: int = 3  #: independent differential evolutions
    candidates_per_coordinate: int = 15  #: of each population
    n_generations: int = 60  #: at most; a population that has gathered in one place stops earlier
    n_random_starts: int = 12
    same_chi_squared: float = 0.01  #: two fits are one optimum if χ² differs by no more, in residual variances …
    same_coordinate: float = 0.1  #: … and each coordinate by no more than this part of its standard uncertainty
    compared_below: float = 0.25  #: coordinates less certain than this part of their bounds' width are not compared

    @property
    def n_starts(self) -> int:
        """Local fits in all."""
        return self.n_populations + self.n_random_starts


@dataclass(frozen=True, slots=True, eq=False)
class StartedFit:
    """A local fit and where it came from."""

    origin: StartOrigin
    start: FloatArray  # shape (n_parameters,)
    fit: LocalFit
    same_as_best: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start))


@dataclass(frozen=True, slots=True, eq=False)
class FailedStart:
    """A start from which nothing could be fitted."""

    origin: StartOrigin
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
    n_evaluations: int  # of the residuals, populations and local fits together

    @property
    def best(self) -> LocalFit:
        """The fit with the least χ²."""
        return self.fits[0].fit

    def agreement(self, origin: StartOrigin | None = None) -> float:
        """Return the share of starts (of one origin) that reached the best optimum; failed ones did not. [-]."""
        of_origin = [started for started in self.fits if origin in (None, started.origin)]
        n_failed = sum(origin in (None, failed.origin) for failed in self.failed)
        return sum(started.same_as_best for started in of_origin) / max(len(of_origin) + n_failed, 1)


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

    Differential evolution [1]_ (best/1/bin, deferred updating) of several populations, then a local fit from the best
    candidate of each and from starts drawn evenly over the bounds. Each population and each start has a random stream
    of its own, spawned from the seed, and generations are cut into a fixed number of parts: the result does not depend
    on ``map_function``, nor on how many workers are behind it. Where it leaves the process the problem must be
    picklable.

    ``progress`` is told (done, total) after each generation and each local fit, at last (total, total); between them
    ``cancelled`` is asked, and ``SearchCancelledError`` if it said so: half a search has no agreement to report.
    ``NotIdentifiableError`` if no start led to a fit; the reason given by the first is quoted. ``OutsideValidityError``
    if a bound is not finite, or there is nothing to start from.

    References
    ----------
    .. [1] R. Storn, K. Price, J. Global Optimization 11 (1997) 341-359.
    """
    settings, fit_settings = settings or SearchSettings(), fit_settings or FitSettings()
    if not (np.isfinite(bounds.lower).all() and np.isfinite(bounds.upper).all()):
        raise OutsideValidityError("a global search needs finite bounds; got an infinite one")
    if settings.n_starts < 1:
        raise OutsideValidityError("a search needs at least one population or one random start; got none")
    steps = Steps(settings.n_populations * settings.n_generations + settings.n_starts, progress, cancelled)
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(settings.n_starts)]
    size = settings.candidates_per_coordinate, settings.n_generations
    evaluate = Population(problem, map_function)
    starts: list[tuple[StartOrigin, FloatArray]] = []
    for i, stream in enumerate(streams):
        if i < settings.n_populations:
            best = evolve(evaluate, bounds, stream, size, steps)
            steps.reach((i + 1) * settings.n_generations)
            starts.append((StartOrigin.POPULATION, best))
        else:
            starts.append((StartOrigin.RANDOM, stream.uniform(bounds.lower, bounds.upper)))
    outcomes = []
    fit_from = partial(_fit_or_reason, problem, bounds, fit_settings)
    for outcome in map_function(fit_from, [start for _, start in starts]):
        outcomes.append(outcome)
        steps.reach(settings.n_populations * settings.n_generations + len(outcomes))
    return _ranked(starts, outcomes, bounds, settings, evaluate.n_evaluations)


def _fit_or_reason(problem: Problem, bounds: Bounds, settings: FitSettings, start: FloatArray) -> LocalFit | str:
    try:
        return fit_local(problem, bounds, start, settings)
    except MonitorCoreError as error:
        return str(error)


def _ranked(
    starts: list[tuple[StartOrigin, FloatArray]],
    outcomes: list[LocalFit | str],
    bounds: Bounds,
    settings: SearchSettings,
    n_evaluations: int,
) -> Search:
    fitted = [(*start, out) for start, out in zip(starts, outcomes, strict=True) if isinstance(out, LocalFit)]
    failed = [FailedStart(*start, out) for start, out in zip(starts, outcomes, strict=True) if isinstance(out, str)]
    if not fitted:
        raise NotIdentifiableError(f"none of {len(starts)} starts led to a fit; the first: {failed[0].reason}")
    fitted.sort(key=lambda started: started[2].chi_squared)
    best = fitted[0][2]
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
        fits=tuple(StartedFit(origin, start, fit, same(fit)) for origin, start, fit in fitted),
        failed=tuple(failed),
        not_compared=tuple(name for name, is_compared in zip(best.names, compared, strict=True) if not is_compared),
        n_evaluations=n_evaluations + sum(fit.n_evaluations for _, _, fit in fitted),
    )
