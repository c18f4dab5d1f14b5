"""Populations of a global search: differential evolution through a map, in steps that can be watched and stopped."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Protocol, TypeVar

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution

from monitor_core.arrays import FloatArray
from monitor_core.errors import MonitorCoreError
from monitor_core.fitting.problem import Bounds, Problem

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

    def after_generation(intermediate_result: OptimizeResult) -> None:
        steps.reach(steps.done + 1)

    steps.reach(steps.done)
    found = differential_evolution(
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
    return np.asarray(found.x, dtype=np.float64)
