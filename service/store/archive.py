"""Windows of a measurement, back from disk."""

from collections.abc import Sequence

from sqlalchemy.orm import Session

from monitor_core.recording import Window
from service.store.measurements import accepted_places
from service.store.waveforms import WaveformFile, WaveformStore


def accepted_windows(session: Session, waveforms: WaveformStore, measurement_id: int) -> list[Window]:
    """Return the accepted windows of a measurement in time order; each file is read once.

    Raises
    ------
    WaveformDamagedError
        If a waveform is not what was stored.
    """
    files: dict[WaveformFile, Sequence[Window]] = {}
    windows = []
    for file, index in accepted_places(session, measurement_id):
        if file not in files:
            files[file] = waveforms.read(file)
        windows.append(files[file][index])
    return windows
