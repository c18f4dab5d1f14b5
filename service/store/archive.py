"""Windows of a measurement, back from disk."""

from collections.abc import Mapping
from datetime import datetime

from sqlalchemy.orm import Session

from monitor_core.recording import Window
from service.store.measurements import accepted_places
from service.store.waveforms import WaveformFile, WaveformStore


def accepted_windows(
    session: Session, waveforms: WaveformStore, measurement_id: int, held: Mapping[datetime, Window] | None = None
) -> list[Window]:
    """Return the accepted windows of a measurement in time order; those at hand (``held``) are not read again."""
    held = held or {}
    files: dict[WaveformFile, list[Window]] = {}
    windows = []
    for started_at, file, index in accepted_places(session, measurement_id):
        window = held.get(started_at)
        if window is None:
            if file not in files:
                files[file] = waveforms.read(file)
            window = files[file][index]
        windows.append(window)
    return windows
