"""Read the stored windows of a measurement back: as a session file, or as a table of their samples."""

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import BufferedReader
from pathlib import Path

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.recording import ExcitationQuantity, Session, Window
from monitor_core.recordings.session_hdf5 import UNIT_IN_NAMES, write_session
from service.errors import UnknownResourceError
from service.store import measurements
from service.store.database import Database
from service.store.recordings import RecordingFiles, not_taken
from service.store.retention import require_stored
from service.store.waveforms import WaveformPlace, WaveformStore
from service.store.window_format import size_of

#: Six numbers of at most 24 characters, and what is between them.
LONGEST_ROW_BYTES = 156
_ROWS_AT_ONCE = 4096
_AT_ONCE = 2**20


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file that is there for one reader only, and gone with it."""

    size_bytes: int
    parts: Iterator[bytes]


class StoredWindows:
    """Gives stored windows back, with the samples as they are stored: bit by bit those that were sent."""

    def __init__(self, database: Database, waveforms: WaveformStore, files: RecordingFiles) -> None:
        self._database = database
        self._waveforms = waveforms
        self._files = files
        self._one_at_a_time = threading.Lock()  # the windows of a measurement are in memory together

    def session(self, axis_id: str, measurement_id: int, number: int | None) -> StoredFile:
        """Return the windows of a measurement, or one of them counted from 1, as a session file.

        Raises UnknownResourceError; LetGoError if they were let go; WaveformDamagedError if a window cannot be read;
        StorageError.
        """
        with self._one_at_a_time:
            windows = self._windows(axis_id, measurement_id, number)
            return self._written(
                2 * size_of(windows), lambda path: write_session(path, Session(axis_id, tuple(windows)))
            )

    def table(self, axis_id: str, measurement_id: int, number: int | None) -> StoredFile:
        """Return them as CSV, one row a sample; raises as :meth:`session` does."""
        with self._one_at_a_time:
            windows = self._windows(axis_id, measurement_id, number)
            n_samples = sum(window.n_samples for window in windows)
            return self._written(LONGEST_ROW_BYTES * n_samples, lambda path: _write_table(path, windows, number or 1))

    def _written(self, most_bytes: int, write: Callable[[Path], None]) -> StoredFile:
        """Write a file and open it; it has no name any more, and is gone when it is closed."""
        self._files.require_room(most_bytes)
        folder = self._files.begin()
        try:
            path = folder.path / "windows"
            try:
                write(path)
                file = path.open("rb")
            except OSError as error:
                raise not_taken(error) from error
        finally:
            folder.close()
        return StoredFile(_size(file), _parts(file))

    def _windows(self, axis_id: str, measurement_id: int, number: int | None) -> list[Window]:
        return self._waveforms.read_where_they_lie(partial(self._places, axis_id, measurement_id, number))

    def _places(self, axis_id: str, measurement_id: int, number: int | None) -> list[WaveformPlace]:
        with self._database.read() as session:
            measurements.get_measurement(session, axis_id, measurement_id)
            rows = measurements.windows_of(session, measurement_id)
            if number is not None and number > len(rows):
                raise UnknownResourceError(f"measurement {measurement_id} has {len(rows)} windows; got window {number}")
            if number is not None:
                rows = rows[number - 1 : number]
            if any(row.let_go_by is not None for row in rows):
                require_stored(session, [measurement_id])
        return [
            WaveformPlace(row.file_path, row.offset_in_file, row.index_in_frame, row.content_sha256) for row in rows
        ]


def _size(file: BufferedReader) -> int:
    size = file.seek(0, 2)
    file.seek(0)
    return size


def _parts(file: BufferedReader) -> Iterator[bytes]:
    with file:
        while part := file.read(_AT_ONCE):
            yield part


def _write_table(path: Path, windows: Sequence[Window], first_number: int) -> None:
    with path.open("wb") as file:
        file.writelines(_rows(windows, first_number))


def _rows(windows: Sequence[Window], first_number: int) -> Iterator[bytes]:
    """Yield the header and the rows; a column that a window has no samples for is empty there."""
    signals = zip(*map(_signals, windows), strict=True)
    names = list(dict.fromkeys(name for signal in signals for name, samples in signal if samples is not None))
    yield (",".join(["window", "time_s", *names]) + "\n").encode()
    for number, window in enumerate(windows, start=first_number):
        held = dict(_signals(window))
        for begin in range(0, window.n_samples, _ROWS_AT_ONCE):
            part = slice(begin, min(begin + _ROWS_AT_ONCE, window.n_samples))
            length = part.stop - part.start
            columns = [[str(number)] * length, _texts(np.arange(part.start, part.stop) / window.sample_rate)]
            for name in names:
                samples = held.get(name)
                columns.append([""] * length if samples is None else _texts(samples[part]))
            yield "".join(",".join(row) + "\n" for row in zip(*columns, strict=True)).encode()


def _signals(window: Window) -> list[tuple[str, SampleArray | None]]:
    """Return the columns of a window, and their samples."""
    excited, answers = window.excitation_quantity, window.response_quantity
    commanded = "commanded-" if excited is ExcitationQuantity.ACCELERATION else ""
    return [
        (f"{commanded}{excited}_{UNIT_IN_NAMES[excited]}".replace("-", "_"), window.excitation),
        (f"{answers}_{UNIT_IN_NAMES[answers]}".replace("-", "_"), window.response),
        ("position_m", window.position_trace),
        ("reference", window.reference),
    ]


def _texts(values: SampleArray) -> list[str]:
    """Write numbers in as many digits as their precision needs, so that they are read back as they are."""
    return [str(value) for value in values] if values.dtype == np.float32 else [repr(v) for v in values.tolist()]
