"""What an identification or an explanation is asked to look at: stored measurements of an axis, or posted peaks."""

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.models.protocol import DriveConditions
from monitor_core.recordings.elements.units import metres
from service.operations.measured_responses import responses_of_windows
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings
from service.operations.monitoring.measured_modes import measured_with_windows
from service.store import measurements
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import MeasurementRow
from service.store.waveforms import WaveformStore

#: More measurements than this at once were meant for a trend.
MOST_MEASUREMENTS = 200


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredOfAxis:
    """What an identification or an explanation looks at."""

    observations: tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...]
    sentences: tuple[str, ...] = ()  # what was settled on the way, for people


def measured_of_axis(
    database: Database, waveforms: WaveformStore, axis_id: str, arguments: dict[str, Any]
) -> MeasuredOfAxis:
    """Return the posted peaks, or the responses of stored measurements.

    Parameters
    ----------
    database : Database
    waveforms : WaveformStore
    axis_id : str
    arguments : dict
        Of a job: ``peaks`` or ``measurements``, the other one None.

    Raises
    ------
    NotIdentifiableError
        As :func:`selected_measurements`, or if none of them can be judged.
    """
    if arguments["peaks"] is not None:
        return MeasuredOfAxis(tuple(_peak(one) for one in arguments["peaks"]))
    with database.read() as session:
        configuration = AxisConfiguration.model_validate(get_axis(session, axis_id).configuration)
    rows = selected_measurements(database, axis_id, arguments)
    found = responses_of_windows(measured_with_windows(database, waveforms, core_settings(configuration), rows))
    return MeasuredOfAxis(found.observations, found.sentences)


def selected_measurements(database: Database, axis_id: str, arguments: dict[str, Any]) -> list[MeasurementRow]:
    """Return the rows of the stored measurements that are asked for.

    Raises
    ------
    NotIdentifiableError
        If there is none, or more than can have been meant.
    """
    start, end = (_moment(arguments["measurements"][name]) for name in ("from", "to"))
    with database.read() as session:
        rows = measurements.looked_at(session, axis_id, start, end, MOST_MEASUREMENTS)
    if not 0 < len(rows) <= MOST_MEASUREMENTS:
        got = "none" if not rows else "more"
        raise NotIdentifiableError(
            f"expected 1 to {MOST_MEASUREMENTS} measurements that were looked at; axis '{axis_id}' has {got} in that "
            "range"
        )
    return rows


def _moment(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text)


def _peak(one: dict[str, Any]) -> ModalObservation:
    return ModalObservation(
        DriveConditions(metres(one["position_mm"]), one["preload_n"], one["payload_kg"] or 0.0),
        one["frequency_hz"],
        one["frequency_standard_uncertainty_hz"],
        amplitude=one["amplitude_m_per_n"],
    )
