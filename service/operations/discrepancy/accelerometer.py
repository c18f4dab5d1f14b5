"""Where the accelerometer of a session is taken to be: where it is said to be, or where the model fits better."""

from collections.abc import Sequence
from dataclasses import dataclass

from monitor_core.fitting.accelerometer import fits_by_place
from monitor_core.fitting.described_axis import DescribedDrive
from monitor_core.fitting.evidence import VERY_STRONG
from monitor_core.fitting.observations import (
    ACCELEROMETER_POINTS,
    FrequencyResponseObservation,
    with_accelerometer_at,
)
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.models.protocol import ResponsePoint

#: The points by the words of options and requests.
PLACES = {str(point).removeprefix("acceleration-at-"): point for point in ACCELEROMETER_POINTS}
_WORDS = {point: f"on the {word}" for word, point in PLACES.items()}
#: Costs nearer than this are one: without a bracket nut and table are the same body.
_SAME_COST = 1e-6


@dataclass(frozen=True, slots=True)
class PlacedAccelerometer:
    """Responses with the accelerometer where it is taken to be."""

    observations: tuple[FrequencyResponseObservation, ...]
    sentences: tuple[str, ...] = ()  # what was settled, for people


def place_accelerometer(
    observations: Sequence[FrequencyResponseObservation],
    stated: str | None,
    subject: DescribedDrive,
    map_function: MapFunction = map,
) -> PlacedAccelerometer:
    """Place the accelerometer of the responses whose record does not.

    Parameters
    ----------
    observations : sequence of FrequencyResponseObservation
        Those that say where they were taken stay as they are.
    stated : str, optional
        One of ``PLACES``; without it, the accelerometer is where a described drive fits better.
    subject : DescribedDrive
        The drive, with what may be adjusted to the responses.
    map_function : MapFunction
        Like ``map``; one of a pool of processes spreads the work.

    Raises
    ------
    NotIdentifiableError
        If no line stands above its noise.
    OutsideValidityError
        If the model has no answer under one of the conditions.
    """
    if all(one.placed for one in observations):
        return PlacedAccelerometer(tuple(observations))
    best, other = fits_by_place(observations, subject, map_function)
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
