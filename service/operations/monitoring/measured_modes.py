"""Modes of stored measurements, measured once more from their waveforms."""

from collections.abc import Iterable, Iterator, Sequence

from monitor_core.modal import ModalMeasurement, measure_mode
from monitor_core.pipeline import AxisSettings, measure_response, search_band
from monitor_core.recording import Rejection, Window
from service.store.database import Database
from service.store.measurements import accepted_places
from service.store.tables import MeasurementRow
from service.store.waveforms import WaveformStore


def measured_modes(
    database: Database, waveforms: WaveformStore, settings: AxisSettings, rows: Iterable[MeasurementRow]
) -> Iterator[ModalMeasurement]:
    """Measure the mode of each stored measurement, without a calibration; those that cannot be judged are left out.

    Raises WaveformDamagedError if a waveform is not what was stored: what comes of it must not silently rest on less
    than it was asked for.
    """
    for windows in _stored_windows(database, waveforms, rows):
        modal = measure_mode(windows, band=search_band(settings, None, windows[0]), gate=settings.mode)
        if isinstance(modal, ModalMeasurement):
            yield modal


def measured_with_windows(
    database: Database, waveforms: WaveformStore, settings: AxisSettings, rows: Iterable[MeasurementRow]
) -> Iterator[tuple[ModalMeasurement | Rejection, Sequence[Window]]]:
    """Measure the response of each stored measurement on all its lines, and return it, or why not, with its windows.

    Raises WaveformDamagedError as :func:`measured_modes`.
    """
    for windows in _stored_windows(database, waveforms, rows):
        yield measure_response(windows, settings), windows


def _stored_windows(
    database: Database, waveforms: WaveformStore, rows: Iterable[MeasurementRow]
) -> Iterator[Sequence[Window]]:
    for row in rows:
        with database.read() as session:
            places = accepted_places(session, row.id)
        windows = waveforms.read(places)
        if windows:
            yield windows
