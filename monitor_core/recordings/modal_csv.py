"""Read and write a modal table, CSV: one row per measured natural frequency.

Required columns ``position_mm,frequency_hz``; optional ones are listed in :data:`COLUMNS`, and an empty optional cell
means *not stated*. Other columns are allowed and left out, except those that look like one of ours without its unit or
in another one (``frequency``, ``preload_kn``): these are refused, because leaving them out would pass for *not stated*.

UTF-8, with or without byte order mark, any line end, comma as separator, decimal point.
"""

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.fitting.observations import ModalObservation
from monitor_core.models.protocol import DriveConditions
from monitor_core.preload import ModalReading
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.fields import format_instant, parse_instant
from monitor_core.recordings.elements.files import read_text
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.recordings.raw.channels import require_distinct

REQUIRED = ("position_mm", "frequency_hz")
COLUMNS = (
    "preload_n", *REQUIRED, "frequency_std_hz", "n_readings", "mode", "damping_ratio", "amplitude", "payload_kg",
    "temperature_c", "started_at",
)  # fmt: skip
_UNITLESS = frozenset(("mode", "amplitude", "damping_ratio", "n_readings", "started_at"))
#: Our column names without their unit: "frequency_std" of "frequency_std_hz".
_STEMS = {name.rpartition("_")[0]: name for name in COLUMNS if name not in _UNITLESS}


@dataclass(frozen=True, slots=True)
class ModalRow:
    """One measured natural frequency. ``None`` means: not stated."""

    position: float  # table position from the fixed bearing [m]
    frequency: float  # [Hz]
    preload: float | None = None  # [N]
    frequency_std: float | None = None  # standard deviation of one reading [Hz]
    n_readings: int | None = None  # readings behind the mean
    mode: int | None = None  # order of the mode, from 1
    damping_ratio: float | None = None  # [-]
    amplitude: float | None = None  # of the FRF at the mode
    payload_mass: float | None = None  # [kg]
    temperature: float | None = None  # [°C]
    started_at: datetime | None = None  # with a time zone

    @property
    def reading(self) -> ModalReading:
        """The row as a calibration takes it."""
        conditions = Conditions(self.position, self.payload_mass, self.temperature, self.preload)
        return ModalReading(self.frequency, conditions, self.frequency_std, self.n_readings or 1)

    @property
    def observation(self) -> ModalObservation:
        """The row as a peak: the amplitude is the table's receptance in m/N, the damping ratio of no stated scatter."""
        scatter, n_readings = self.frequency_std, self.n_readings or 1
        return ModalObservation(
            DriveConditions(self.position, self.preload, self.payload_mass or 0.0),
            self.frequency,
            None if scatter is None else scatter / math.sqrt(n_readings),
            amplitude=self.amplitude,
            order=self.mode,
            damping_ratio=self.damping_ratio,
        )


def read_modal_table(path: Path) -> tuple[ModalRow, ...]:
    """Read a modal table, CSV with a header, in the order of the file and with positions in metres.

    ``RecordingFormatError`` if a column is missing, stands twice or lacks its unit, or if a cell is not what its column
    promises; the sentence names row (the header is row 1) and column.
    """
    reader = csv.reader(io.StringIO(read_text(path), newline=""), strict=True)
    try:
        numbered = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader if any(cells)]
    except csv.Error as error:
        where = f"{path.name}, row {reader.line_num}"
        raise RecordingFormatError(f"{where}: expected comma-separated text; {error}") from error
    if not numbered:
        raise RecordingFormatError(f"{path.name}: expected a header with {', '.join(REQUIRED)}; the file is blank")
    header = numbered[0][1]
    _require_header(header, path.name)
    if len(numbered) == 1:
        raise RecordingFormatError(f"{path.name}: expected at least one row under the header; got none")
    rows = []
    for number, cells in numbered[1:]:
        where = f"{path.name}, row {number}"
        if len(cells) != len(header):
            raise RecordingFormatError(f"{where}: expected {len(header)} cells as in the header; got {len(cells)}")
        rows.append(_row(_Cells(dict(zip(header, cells, strict=True)), where)))
    return tuple(rows)


def write_modal_table(path: Path, rows: Iterable[ModalRow]) -> None:
    """Write a modal table, leaving out the columns that no row states; an existing file is replaced.

    ``RecordingFormatError`` if there is no row.
    """
    stated = [_cells(row) for row in rows]
    if not stated:
        raise RecordingFormatError(f"{path.name}: a modal table needs at least one row; got none")
    columns = [name for name in COLUMNS if any(cells[name] for cells in stated)]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(stated)


def _require_header(header: list[str], where: str) -> None:
    if len(header) == 1 and any(separator in header[0] for separator in ";\t"):
        raise RecordingFormatError(f"{where}: expected columns separated by commas; got the header {header[0][:80]!r}")
    require_distinct(header, where)
    for name in header:
        meant = _meant(name)
        if meant is not None:
            raise RecordingFormatError(f"{where}: expected the column {meant!r}; got {name!r}")
    for name in REQUIRED:
        if name not in header:
            raise RecordingFormatError(f"{where}: expected the column {name!r}; got {', '.join(header)[:200]}")


def _meant(name: str) -> str | None:
    """Return the column that an unknown name seems to stand for."""
    if name in COLUMNS:
        return None
    plain = name.lower().replace(" ", "_")
    if plain in COLUMNS:
        return plain
    return _STEMS.get(plain) or _STEMS.get(plain.rpartition("_")[0])


@dataclass(frozen=True, slots=True)
class _Cells:
    """Cells of one row by column."""

    by_name: dict[str, str]
    where: str

    def number(self, name: str, unit: str, lower: float = -np.inf, *, open_below: bool = True) -> float | None:
        text = self.by_name.get(name, "")
        if not text:
            return None
        place = f"{self.where}, column {name!r}"
        try:
            value = float(text.replace("_", "?"))  # Python alone would take 1_000
        except ValueError:
            raise RecordingFormatError(f"{place}: expected a number [{unit}]; got {text[:40]!r}") from None
        if not np.isfinite(value) or value < lower or (open_below and value == lower):
            bound = "" if lower == -np.inf else f" {'above' if open_below else 'of at least'} {lower:g} {unit}"
            raise RecordingFormatError(f"{place}: expected a finite number{bound}; got {text} {unit}")
        return value

    def required(self, name: str, unit: str, lower: float = -np.inf) -> float:
        value = self.number(name, unit, lower)
        if value is None:
            raise RecordingFormatError(f"{self.where}, column {name!r}: expected a number [{unit}]; the cell is empty")
        return value

    def count(self, name: str) -> int | None:
        value = self.number(name, "-", 1.0, open_below=False)
        if value is not None and not value.is_integer():
            raise RecordingFormatError(f"{self.where}, column {name!r}: expected a whole number; got {value}")
        return None if value is None else int(value)


def _row(cells: _Cells) -> ModalRow:
    started_at = cells.by_name.get("started_at")
    return ModalRow(
        position=metres(cells.required("position_mm", "mm")),
        frequency=cells.required("frequency_hz", "Hz", 0.0),
        preload=cells.number("preload_n", "N", 0.0),
        frequency_std=cells.number("frequency_std_hz", "Hz", 0.0),
        n_readings=cells.count("n_readings"),
        mode=cells.count("mode"),
        damping_ratio=cells.number("damping_ratio", "-", 0.0, open_below=False),
        amplitude=cells.number("amplitude", "-"),
        payload_mass=cells.number("payload_kg", "kg", 0.0, open_below=False),
        temperature=cells.number("temperature_c", "°C", -273.15),
        started_at=parse_instant(started_at, f"{cells.where}, column 'started_at'") if started_at else None,
    )


def _cells(row: ModalRow) -> dict[str, str]:
    values = {
        "preload_n": row.preload,
        "position_mm": to_millimetres(row.position),
        "frequency_hz": row.frequency,
        "frequency_std_hz": row.frequency_std,
        "n_readings": row.n_readings,
        "mode": row.mode,
        "damping_ratio": row.damping_ratio,
        "amplitude": row.amplitude,
        "payload_kg": row.payload_mass,
        "temperature_c": row.temperature,
        "started_at": None if row.started_at is None else format_instant(row.started_at),
    }
    return {name: "" if value is None else str(value) for name, value in values.items()}
