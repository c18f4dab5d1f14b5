"""Fit joints to measurements at several positions: search, fit, verdicts, and errors at positions held out."""

import math
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.solver.global_search import MapFunction, Search, SearchCancelledError, SearchSettings, search
from monitor_core.fitting.solver.least_squares import FitSettings, LocalFit, Patience, fit_local
from monitor_core.identification.cases import Case, PredictionError, positions_of, require_positions
from monitor_core.identification.identifiability import Identifiability, Verdict, assess

#: Below this probability the residuals are larger than the stated uncertainties allow, and their scatter is used.
LACK_OF_FIT = 1e-3
#: Fits that are compared with the answer, or predict from it, need fewer digits than the answer.
_NEARLY = Patience(500, flat=1e-7)
#: Scatter and fit depend on each other where there are priors; after so many rounds neither changes any more.
_ROUNDS_OF_SCALE = 5


@dataclass(frozen=True, slots=True)
class JointFitSettings:
    """How joints are identified."""

    seed: int = 1  #: of the random streams of the search
    search: SearchSettings = field(default_factory=SearchSettings)
    uncertainties_stated: bool = True  #: whether the data state theirs; if not, the scatter of the residuals is used


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """Joints as coordinates, with what is and is not known of them."""

    fit: LocalFit  # coordinates, covariance and residuals of all that was not held out
    search: Search  # all starts, and how many agree
    judged: Identifiability
    lack_of_fit: bool  # the model misses the data by more than their uncertainties: their scatter is used instead
    trained_on: tuple[float, ...]  # positions [m]
    held_out: tuple[PredictionError, ...]  # at positions that played no part in the fit they are judged by
    seed: int  # of the search
    leave_one_out: bool  # ``held_out`` comes from as many fits as there are positions, each without one
    not_held_out: tuple[float, ...]  # positions that cannot be left out: what remains determines no joints [m]
    alone: Mapping[float, FloatArray]  # coordinates from one position alone, where it determines them [m]

    @property
    def worst_held_out(self) -> PredictionError | None:
        """The largest of the errors; ``None`` where nothing could be held out."""
        return max(self.held_out, key=lambda error: abs(error.relative_error), default=None)


def fit_joints(
    case: Case,
    bounds: Bounds,
    settings: JointFitSettings | None = None,
    *,
    hold_out: Collection[float] = (),
    map_function: MapFunction = map,
    progress: Callable[[int, int], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> JointFit:
    """Find the joints within finite bounds, judge each, and predict what was held out.

    The fit does not see the positions to ``hold_out`` [m] and is judged by them, beside fits to each of the others
    alone that start from the answer. Without any, each position in turn is
    left out of a fit that starts from the answer, where enough others remain. The answer does not depend on
    ``map_function``. ``progress`` is told (done, total); ``cancelled`` is asked whenever progress is made.

    Raises SearchCancelledError if ``cancelled`` said so; NotIdentifiableError if there are too few positions or data,
    no joint moves anything, or every joint ended at a bound; OutsideValidityError if a bound is not finite.
    """
    settings = settings or JointFitSettings()
    require_positions(case, hold_out)
    trained_on = tuple(position for position in positions_of(case) if position not in hold_out)
    steps = _Steps(len(bounds.lower) + len(trained_on), progress, cancelled)
    fit_settings = FitSettings(uncertainties_stated=settings.uncertainties_stated)
    searched = search(
        case.search_problem(trained_on),
        bounds,
        settings.seed,
        settings.search,
        replace(fit_settings, patience=_NEARLY),
        map_function=map_function,
        progress=steps.of_search,
        cancelled=cancelled,
    )
    fit = fit_local(case.problem(trained_on), bounds, searched.best.coordinates.values, fit_settings)
    lacks_fit = settings.uncertainties_stated and _lacks_fit(fit)
    if lacks_fit:
        fit_settings = replace(fit_settings, uncertainties_stated=False)
    if not fit_settings.uncertainties_stated:
        case = _with_priors_on_the_scale_of_the_data(case, bounds, fit, fit_settings, trained_on)
        fit = fit_local(case.problem(trained_on), bounds, fit.coordinates.values, fit_settings)
    problem = case.problem(trained_on)
    _require_something_inside(fit)
    steps.next(0)
    judged = assess(problem, bounds, fit, map_function=map_function)
    if lacks_fit:
        judged = _less_than_determined(judged)
    steps.next(len(bounds.lower))
    cannot: tuple[float, ...] = ()
    alone: dict[float, FloatArray] = {}
    if hold_out:
        held_out = case.prediction_errors(fit.coordinates.values, hold_out)
        alone = _from_one_position(case, bounds, fit, trained_on)
    else:
        held_out, cannot = _leave_one_out(case, bounds, fit, replace(fit_settings, patience=_NEARLY), steps)
    steps.finish()
    return JointFit(fit, searched, judged, lacks_fit, trained_on, held_out, settings.seed, not hold_out, cannot, alone)


def _from_one_position(
    case: Case, bounds: Bounds, fit: LocalFit, positions: tuple[float, ...]
) -> dict[float, FloatArray]:
    """Return the coordinates that each position gives by itself; left out where it determines none."""
    alone = {}
    for position in positions if len(positions) > 1 else ():
        with suppress(NotIdentifiableError, OutsideValidityError):
            problem = case.problem([position], minimum_positions=1)
            alone[position] = fit_local(
                problem, bounds, fit.coordinates.values, FitSettings(patience=_NEARLY)
            ).coordinates.values
    return alone


def _lacks_fit(fit: LocalFit) -> bool:
    """Test χ² of residuals in units of stated uncertainties."""
    if fit.degrees_of_freedom < 1:
        return False
    return float(scipy.special.gammaincc(fit.degrees_of_freedom / 2.0, fit.chi_squared / 2.0)) < LACK_OF_FIT


def _with_priors_on_the_scale_of_the_data(
    case: Case, bounds: Bounds, fit: LocalFit, settings: FitSettings, positions: tuple[float, ...]
) -> Case:
    """Make a prior worth what it says beside data whose residuals are in another unit.

    All residuals are divided by their common scatter s in the end. A prior is known in units of its own uncertainty, so
    that is divided by s beforehand.
    """
    if case.priors is None:
        return case
    scaled = case
    for _ in range(_ROUNDS_OF_SCALE):
        scale = math.sqrt(fit.residual_variance)
        scaled = case.with_priors(case.priors / np.array([[1.0], [scale]]))
        fit = fit_local(scaled.problem(positions), bounds, fit.coordinates.values, settings)
    return scaled


def _less_than_determined(judged: Identifiability) -> Identifiability:
    """Call nothing determined where the model misses the data: what it leaves out is in no interval."""
    coordinates = tuple(
        replace(judgement, verdict=Verdict.POORLY_DETERMINED) if judgement.verdict is Verdict.DETERMINED else judgement
        for judgement in judged.coordinates
    )
    return replace(judged, coordinates=coordinates)


def _require_something_inside(fit: LocalFit) -> None:
    at_bounds = {*fit.at_lower, *fit.at_upper}
    if at_bounds.issuperset(fit.names):
        raise NotIdentifiableError(
            f"at least one of {', '.join(fit.names)} must lie within its limits; every one of them ended at a limit: "
            "widen the limits, or look whether model and data are of one axis"
        )


def _leave_one_out(
    case: Case, bounds: Bounds, fit: LocalFit, settings: FitSettings, steps: "_Steps"
) -> tuple[tuple[PredictionError, ...], tuple[float, ...]]:
    """Predict each position from a fit to the others; where these are too few, name it instead."""
    errors: list[PredictionError] = []
    cannot: list[float] = []
    positions = positions_of(case)
    for left_out in positions:
        others = [position for position in positions if position != left_out]
        try:
            without = fit_local(case.problem(others), bounds, fit.coordinates.values, settings)
        except (NotIdentifiableError, OutsideValidityError):
            cannot.append(left_out)
            continue
        errors += case.prediction_errors(without.coordinates.values, [left_out])
        steps.next(1)
    return tuple(errors), tuple(cannot)


class _Steps:
    """Adds what follows the search to its progress."""

    def __init__(
        self, n_after: int, progress: Callable[[int, int], None] | None, cancelled: Callable[[], bool] | None
    ) -> None:
        self._n_after, self._done, self._total = n_after, 0, 0
        self._progress, self._cancelled = progress, cancelled

    def of_search(self, done: int, total: int) -> None:
        self._done, self._total = done, total + self._n_after
        self._report()

    def next(self, n: int) -> None:
        if self._cancelled is not None and self._cancelled():
            raise SearchCancelledError(f"the identification was cancelled after {self._done} of {self._total} steps")
        self._done += n
        self._report()

    def finish(self) -> None:
        self._done = self._total
        self._report()

    def _report(self) -> None:
        if self._progress is not None:
            self._progress(self._done, self._total)
