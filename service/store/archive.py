"""Windows of a measurement, back from disk."""

from collections.abc import Mapping
from datetime import datetime

from sqlalchemy.orm import Session

from monitor_core.recording import Window
from service.store.measurements import windows_of
from service.store.waveforms import WaveformFile, WaveformStore


def accepted_windows(
    session: Session, waveforms: WaveformStore, measurement_id: int, held: Mapping[datetime, Window] | None = None
) -> list[Window]:
    """Return the accepted windows of a measurement in time order; those at hand (``held``) are not read again."""
    held = held or {}
    files: dict[WaveformFile, list[Window]] = {}
    windows = []
    for row in windows_of(session, measurement_id, accepted_only=True):
        window = held.get(row.started_at)
        if window is None:
            file = WaveformFile(row.file_path, row.file_sha256)
            if file not in files:
                files[file] = waveforms.read(file)
            window = files[file][row.index_in_file]
        windows.append(window)
    return windows
