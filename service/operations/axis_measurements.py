"""What an identification or an explanation is asked to look at: stored measurements of an axis, or posted peaks."""

from monitor_core.errors import NotIdentifiableError
from monitor_core.measured_responses import SessionResponses, responses_of_windows
from service.operations.analysis_arguments import AnalysisArguments, MeasurementRange
from service.operations.monitoring.axis_configuration import core_settings, load_configuration
from service.operations.monitoring.measured_modes import measured_with_windows
from service.store import measurements
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import MeasurementRow
from service.store.waveforms import WaveformStore

#: More measurements than this at once were meant for a trend.
MOST_MEASUREMENTS = 200


def axis_measurements(
    database: Database, waveforms: WaveformStore, axis_id: str, chosen: MeasurementRange
) -> SessionResponses:
    """Return the responses of stored measurements.

    Raises NotIdentifiableError as :func:`selected_measurements`, or if none of them can be judged.
    """
    with database.read() as session:
        configuration = load_configuration(get_axis(session, axis_id).configuration)
    rows = selected_measurements(database, axis_id, chosen)
    return responses_of_windows(measured_with_windows(database, waveforms, core_settings(configuration), rows))


def selected_measurements(database: Database, axis_id: str, chosen: MeasurementRange) -> list[MeasurementRow]:
    """Return the rows of the stored measurements that are asked for.

    Raises NotIdentifiableError if there is none, or more than can have been meant.
    """
    with database.read() as session:
        rows = measurements.looked_at(session, axis_id, chosen.start, chosen.end, MOST_MEASUREMENTS)
    if not 0 < len(rows) <= MOST_MEASUREMENTS:
        got = "none" if not rows else "more"
        raise NotIdentifiableError(
            f"expected 1 to {MOST_MEASUREMENTS} measurements that were looked at; axis '{axis_id}' has {got} in that "
            "range"
        )
    return rows


def asked_for_measurements(arguments: AnalysisArguments) -> MeasurementRange:
    """Return which stored measurements are asked for, where no peaks were posted."""
    return arguments.measurements or MeasurementRange()
