"""Where the accelerometer of a record sits that does not say it: where the model explains it better."""

from collections.abc import Sequence
from dataclasses import dataclass

from monitor_core.discrepancy.comparing.responses import compare_responses
from monitor_core.discrepancy.hypothesis import Hypothesis
from monitor_core.discrepancy.searching.fit import Fitted, fit
from monitor_core.discrepancy.subject import DriveSubject
from monitor_core.identification.observations import FrequencyResponseObservation, with_accelerometer_at
from monitor_core.models.extended import AxisPhysics, paper_motor_end
from monitor_core.models.protocol import ResponsePoint

#: The points by the words of options and requests.
PLACES = {"table": ResponsePoint.ACCELERATION_AT_TABLE, "nut": ResponsePoint.ACCELERATION_AT_NUT}
_WORDS = {point: f"on the {word}" for word, point in PLACES.items()}
#: Costs nearer than this are one: without a bracket nut and table are the same body.
_SAME_COST = 1e-6


def points_of(stated: str | None) -> tuple[ResponsePoint, ...]:
    """Return where the accelerometer of a session may be: where its word says, or anywhere."""
    return tuple(PLACES.values()) if stated is None else (PLACES[stated],)


@dataclass(frozen=True, slots=True)
class PlacedAccelerometer:
    """Responses with the accelerometer where it is taken to be."""

    observations: tuple[FrequencyResponseObservation, ...]
    point: ResponsePoint | None  # None: as the record says
    sentences: tuple[str, ...] = ()  # what was settled, for people

    def likewise(self, others: Sequence[FrequencyResponseObservation]) -> tuple[FrequencyResponseObservation, ...]:
        """Return the responses of another machine, measured likewise."""
        return tuple(others) if self.point is None else with_accelerometer_at(self.point, others)


def place_accelerometer(
    observations: Sequence[FrequencyResponseObservation], points: Sequence[ResponsePoint], subject: DriveSubject
) -> PlacedAccelerometer:
    """Take the accelerometer to be at that of the points where a described drive fits better.

    Parameters
    ----------
    observations : sequence of FrequencyResponseObservation
    points : sequence of ResponsePoint
        Those it may be at; none: the record says it.
    subject : DriveSubject
        The drive, with what may be adjusted to the responses.

    Raises
    ------
    NotIdentifiableError
        If no line stands above its noise.
    OutsideValidityError
        If the model has no answer under one of the conditions.
    """
    if not observations or not points:
        return PlacedAccelerometer(tuple(observations), None)
    if len(points) == 1:
        sentence = f"The accelerometer is {_WORDS[points[0]]}, as stated."
        return PlacedAccelerometer(with_accelerometer_at(points[0], observations), points[0], (sentence,))
    fits = {point: _fitted(with_accelerometer_at(point, observations), subject) for point in points}
    best, *others = sorted(points, key=lambda point: fits[point].cost)
    placed = with_accelerometer_at(best, observations)
    if all(abs(fits[one].cost - fits[best].cost) <= _SAME_COST * fits[best].cost for one in others):
        return PlacedAccelerometer(placed, best)
    elsewhere = ", ".join(f"{fits[one].gap:.3g} σ {_WORDS[one]}" for one in others)
    sentence = (
        f"The accelerometer is taken to be {_WORDS[best]}, where the model as described leaves {fits[best].gap:.3g} "
        f"σ ({elsewhere}); state it if it is elsewhere."
    )
    return PlacedAccelerometer(placed, best, (sentence,))


def _fitted(observations: Sequence[FrequencyResponseObservation], subject: DriveSubject) -> Fitted[AxisPhysics]:
    comparison = compare_responses(observations, otherwise_held=paper_motor_end(subject.stated))
    hypothesis = Hypothesis(subject)
    return fit(comparison, hypothesis, hypothesis.null)
