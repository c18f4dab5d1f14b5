"""Find the modes of measured frequency responses; those of the same conditions share their poles."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.modal.response_modes import GivenResponse, ResponseModes, modes_of_responses
from monitor_core.models.protocol import DriveConditions
from monitor_core.recording import Rejection


@dataclass(frozen=True, slots=True, eq=False)
class ModesAtConditions:
    """The modes that the responses of the same conditions share, or why there are no modes."""

    conditions: DriveConditions
    responses: tuple[int, ...]  # their places in the set
    found: ResponseModes | Rejection


def modes_by_conditions(
    observations: Sequence[FrequencyResponseObservation],
    *,
    band: tuple[float, float] | None = None,
    n_modes: int | None = None,
) -> Iterator[ModesAtConditions]:
    """Yield the modes of each conditions in the order of the set; raises as :func:`modes_of_responses`."""
    groups: dict[DriveConditions, list[int]] = {}
    for number, observation in enumerate(observations):
        groups.setdefault(observation.conditions, []).append(number)
    for conditions, numbers in groups.items():
        given = [
            GivenResponse(
                observation.frequency,
                observation.response,
                observation.standard_deviation,
                observation.response_point.is_acceleration,
            )
            for observation in (observations[number] for number in numbers)
        ]
        modes = modes_of_responses(given, band=band, n_modes=n_modes)
        yield ModesAtConditions(conditions, tuple(numbers), modes)
