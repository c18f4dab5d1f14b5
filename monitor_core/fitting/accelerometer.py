"""Where an accelerometer sits that the record does not place: how well a described drive fits with it at each point."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from monitor_core.fitting.described_axis import DescribedDrive
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.observations import (
    ACCELEROMETER_POINTS,
    FrequencyResponseObservation,
    with_accelerometer_at,
)
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.extended import paper_motor_end
from monitor_core.models.protocol import ResponsePoint


@dataclass(frozen=True, slots=True)
class PlaceFit:
    """How well a drive fits with the accelerometer at a point."""

    point: ResponsePoint
    cost: float  # twice the negative logarithm of the posterior, but for a constant
    gap: float  # rms misfit, in standard deviations


def fits_by_place(
    observations: Sequence[FrequencyResponseObservation], subject: DescribedDrive, map_function: MapFunction = map
) -> tuple[PlaceFit, ...]:
    """Fit what a described drive leaves open, with the accelerometer at each of the points it may be at.

    Parameters
    ----------
    observations : sequence of FrequencyResponseObservation
        Of which those that are not placed are tried at each point.
    subject : DescribedDrive
    map_function : MapFunction
        Like ``map``; one of a pool of processes spreads the work.

    Returns
    -------
    tuple of PlaceFit
        The best first.

    Raises
    ------
    NotIdentifiableError
        If no line stands above its noise.
    OutsideValidityError
        If the model has no answer under one of the conditions.
    """
    fits = map_function(partial(_fit_at, observations, subject), ACCELEROMETER_POINTS)
    return tuple(sorted(fits, key=lambda one: one.cost))


def _fit_at(
    observations: Sequence[FrequencyResponseObservation], subject: DescribedDrive, point: ResponsePoint
) -> PlaceFit:
    there, hypothesis = with_accelerometer_at(point, observations), Hypothesis(subject)
    comparison = compare_responses(there, otherwise_held=paper_motor_end(subject.stated))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    return PlaceFit(point, fitted.cost, fitted.gap)
