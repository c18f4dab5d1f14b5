"""Compare the waveforms on disk with what the database says of them.

A lost or damaged waveform is written once more, from the same window sent again.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path

from sqlalchemy import Connection, select

from monitor_core.recording import Window
from service.errors import WaveformDamagedError
from service.store.database import reading, writing
from service.store.retention import move_windows
from service.store.tables import PLACE, WindowRow
from service.store.waveform_files import WaveformFiles
from service.store.waveforms import WaveformPlace, WaveformStore


def heal(
    connection: Connection, waveforms: WaveformStore, axis_id: str, windows: Sequence[Window], at: datetime
) -> set[datetime]:
    """Write those of some windows anew that are stored and cannot be read any more; return when these started.

    Each has the content that is stored under its start. Raises StorageError if the disk does not
    take them; then everything is as before.
    """
    by_start = {window.started_at: window for window in windows}
    if not by_start:
        return set()
    query = select(*PLACE, WindowRow.started_at, WindowRow.id).where(
        WindowRow.axis_id == axis_id, WindowRow.started_at.in_(list(by_start)), WindowRow.let_go_by.is_(None)
    )
    with reading(connection):
        stored = {WaveformPlace(*row[:4]): (row.started_at, row.id) for row in connection.execute(query)}
    in_order = sorted(stored, key=lambda place: (place.path, place.offset, place.index))
    lost = sorted(stored[damaged.place] for damaged in damaged_windows(waveforms.files, in_order))
    if lost:
        with waveforms.begin_write(axis_id, [by_start[start] for start, _ in lost], at) as frame:
            places = frame.sync()
            with writing(connection):
                move_windows(connection, {number: place for (_, number), place in zip(lost, places, strict=True)})
                frame.keep()
    return {start for start, _ in lost}


@dataclass(frozen=True, slots=True)
class DamagedWindow:
    """A window that cannot be read as it was stored, and why."""

    place: WaveformPlace
    reason: str


def damaged_windows(files: Path | WaveformFiles, places: Iterable[WaveformPlace]) -> Iterator[DamagedWindow]:
    """Read windows from files they lie, those of a frame together, and yield the ones that are not what was stored."""
    store = WaveformStore(files)  # a new one, which remembers nothing
    for _, group in groupby(places, key=lambda place: (place.path, place.offset)):
        frame = list(group)
        try:
            store.read(frame)
        except WaveformDamagedError:
            yield from _damaged_alone(store, frame)


def _damaged_alone(store: WaveformStore, places: Iterable[WaveformPlace]) -> Iterator[DamagedWindow]:
    for place in places:
        try:
            store.read([place])
        except WaveformDamagedError as error:
            yield DamagedWindow(place, str(error))
