"""Place an accelerometer that the record does not place: where it is stated, or where a described drive fits better."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.evidence import VERY_STRONG
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

#: The points by the words of options and requests.
PLACES = {str(point).removeprefix("acceleration-at-"): point for point in ACCELEROMETER_POINTS}
_WORDS = {point: f"on the {word}" for word, point in PLACES.items()}
#: Costs nearer than this are one: without a bracket nut and table are the same body.
_SAME_COST = 1e-6


@dataclass(frozen=True, slots=True)
class PlaceFit:
    """How well a drive fits with the accelerometer at a point."""

    point: ResponsePoint
    cost: float  # twice the negative logarithm of the posterior, but for a constant
    gap: float  # rms misfit, in standard deviations


@dataclass(frozen=True, slots=True)
class PlacedAccelerometer:
    """Responses with the accelerometer where it is taken to be."""

    observations: tuple[FrequencyResponseObservation, ...]
    sentences: tuple[str, ...] = ()  # what was settled, for people


def place_accelerometer(
    observations: Sequence[FrequencyResponseObservation],
    stated: str | None,
    drive: DescribedDrive,
    map_function: MapFunction = map,
) -> PlacedAccelerometer:
    """Place the accelerometer of the responses whose record does not.

    It is where ``stated``, one of ``PLACES``, or else where a described drive fits better. Raises NotIdentifiableError
    if no line stands above its noise; OutsideValidityError if the model has no answer under one of the conditions.
    """
    if all(observation.placed for observation in observations):
        return PlacedAccelerometer(tuple(observations))
    best, other = fits_by_place(observations, drive, map_function)
    apart = other.cost - best.cost
    alike = apart <= _SAME_COST * abs(best.cost)
    if stated is not None:
        point = PLACES[stated]
        sentence = f"The accelerometer is {_WORDS[point]}, as stated"
        if point is not best.point and apart >= VERY_STRONG:
            sentence += (
                f", where the model leaves {other.gap:.3g} σ; {_WORDS[best.point]} it would leave {best.gap:.3g} σ"
            )
        elif alike:
            sentence += "; to this model, without a bracket between nut and table, that makes no difference"
        return PlacedAccelerometer(with_accelerometer_at(point, observations), (f"{sentence}.",))
    if apart < VERY_STRONG:
        at_table = with_accelerometer_at(ResponsePoint.ACCELERATION_AT_TABLE, observations)
        undecided = "The session does not tell whether the accelerometer is on the nut; it is taken to be on the table."
        return PlacedAccelerometer(at_table, () if alike else (undecided,))
    sentence = (
        f"The accelerometer is taken to be {_WORDS[best.point]}, where the model leaves {best.gap:.3g} σ once adjusted "
        f"within its tolerances ({other.gap:.3g} σ {_WORDS[other.point]}); state it if it is elsewhere."
    )
    return PlacedAccelerometer(with_accelerometer_at(best.point, observations), (sentence,))


def fits_by_place(
    observations: Sequence[FrequencyResponseObservation], drive: DescribedDrive, map_function: MapFunction = map
) -> tuple[PlaceFit, ...]:
    """Fit what a described drive leaves open, with the accelerometer at each point it may be at; the best first.

    Raises as :func:`place_accelerometer`.
    """
    fits = map_function(partial(_fit_at, observations, drive), ACCELEROMETER_POINTS)
    return tuple(sorted(fits, key=lambda place: place.cost))


def _fit_at(
    observations: Sequence[FrequencyResponseObservation], drive: DescribedDrive, point: ResponsePoint
) -> PlaceFit:
    there, hypothesis = with_accelerometer_at(point, observations), Hypothesis(drive)
    comparison = compare_responses(there, otherwise_held=paper_motor_end(drive.stated))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    return PlaceFit(point, fitted.cost, fitted.gap)
