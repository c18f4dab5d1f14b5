"""Modes of stored measurements, measured once more from their waveforms."""

from collections.abc import Iterable, Iterator, Sequence

from monitor_core.modal import ModalMeasurement, measure_mode
from monitor_core.pipeline import AxisSettings, search_band
from monitor_core.recording import Window
from service.store.database import Database
from service.store.measurements import accepted_places
from service.store.tables import MeasurementRow
from service.store.waveforms import WaveformStore


def measured_modes(
    database: Database, waveforms: WaveformStore, settings: AxisSettings, rows: Iterable[MeasurementRow]
) -> Iterator[ModalMeasurement]:
    """Measure the mode of each stored measurement, without a calibration; those that cannot be judged are left out.

    Raises
    ------
    WaveformDamagedError
        As :func:`modes_and_windows`.
    """
    return (modal for modal, _ in modes_and_windows(database, waveforms, settings, rows))


def modes_and_windows(
    database: Database, waveforms: WaveformStore, settings: AxisSettings, rows: Iterable[MeasurementRow]
) -> Iterator[tuple[ModalMeasurement, Sequence[Window]]]:
    """Measure the modes as :func:`measured_modes` does, and return each with the windows that it was measured from.

    Raises
    ------
    WaveformDamagedError
        If a waveform is not what was stored: what comes of it must not silently rest on less than it was asked for.
    """
    for row in rows:
        with database.read() as session:
            places = accepted_places(session, row.id)
        windows = waveforms.read(places)
        if not windows:
            continue
        modal = measure_mode(windows, band=search_band(settings, None, windows[0]), gate=settings.mode)
        if isinstance(modal, ModalMeasurement):
            yield modal, windows
