"""Measure modes and responses of stored measurements again, from their waveforms."""

from collections.abc import Iterable, Iterator, Sequence

from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisSettings, judge_measurement, measure_response
from monitor_core.recording import Rejection, Window
from service.store.database import Database
from service.store.measurements import accepted_places
from service.store.tables import MeasurementRow
from service.store.waveforms import WaveformPlace, WaveformStore


def accepted_windows(database: Database, waveforms: WaveformStore, measurement_id: int) -> list[Window]:
    """Return the windows that a measurement rests on.

    Raises LetGoError or WaveformDamagedError if a waveform is not there, or not what was stored.
    """

    def places() -> list[WaveformPlace]:
        with database.read() as session:
            return accepted_places(session, measurement_id)

    return waveforms.read_where_they_lie(places)


def measured_modes(
    database: Database, waveforms: WaveformStore, settings: AxisSettings, rows: Iterable[MeasurementRow]
) -> Iterator[ModalMeasurement]:
    """Measure the mode of each stored measurement, without a calibration; those that cannot be judged are left out.

    Raises as :func:`accepted_windows`: what comes of it must not silently rest on less than it was asked for.
    """
    for row in rows:
        windows = accepted_windows(database, waveforms, row.id)
        # as later measurements are judged, with the friction torque of the windows
        modal = judge_measurement(windows, settings, None).modal if windows else None
        if isinstance(modal, ModalMeasurement):
            yield modal


def measured_with_windows(
    database: Database, waveforms: WaveformStore, settings: AxisSettings, rows: Iterable[MeasurementRow]
) -> Iterator[tuple[ModalMeasurement | Rejection, Sequence[Window]]]:
    """Measure the response of each stored measurement on all its lines, and return it, or why not, with its windows.

    Raises as :func:`accepted_windows`.
    """
    for row in rows:
        if windows := accepted_windows(database, waveforms, row.id):
            yield measure_response(windows, settings), windows
