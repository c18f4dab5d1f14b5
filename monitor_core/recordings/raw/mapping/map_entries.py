"""Read the entries of a channel map that maps of every kind share: channels, times, windows, files, tolerances."""

import re
from collections.abc import Set as AbstractSet
from datetime import UTC, datetime, timedelta, timezone

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Direction
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.units import Quantity, factor_to_si, metres, sensor_factor
from monitor_core.recordings.raw.mapping.map_records import (
    Cutting,
    MappedChannel,
    ResampleMethod,
    Resampling,
    TimeSource,
    Tolerances,
    WindowFacts,
    WindowsIn,
)

PLACE = frozenset(("channel", "column", "row"))
_SIGNAL = PLACE | {"unit", "sensitivity", "sensitivity_unit", "offset", "time"}
_FACTS = frozenset((
    "started_at", "position_mm", "position_span_mm", "measurement", "direction", "payload_kg", "temperature_c",
    "preload_n",
))  # fmt: skip
#: What one of several files may state.
FILES = _FACTS | {"name"}
_ENTRIES = {
    "excitation": _SIGNAL | {"quantity", "source"},
    "response": _SIGNAL,
    "position": _SIGNAL,
    "time": PLACE | {"unit", "format", "date", "zone"},
    "resample": frozenset(("sample_rate_hz", "method")),
    "window": _FACTS | {
        "sample_rate_hz", "samples_per_window", "windows_in", "window_interval_s", "file_interval_s",
        "position_step_mm",
    },
    "files": FILES,
    "tolerances": frozenset(Tolerances().attributes),
    "motion": frozenset(("position", "force", "torque", "reference", "sample_rate_hz")),
    "frf": frozenset((
        "input", "output", "frequency", "real", "imaginary", "magnitude", "phase", "response", "standard_deviation",
        "relative", "resolution_hz", "excitation_rms_nm", "excitation_rms_n",
    )),
}  # fmt: skip
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)")


def facts_required(facts: WindowFacts, where: str) -> None:
    """Refuse windows whose place neither a channel nor the map says."""
    for name, value in (("position_mm", facts.position), ("position_span_mm", facts.position_span)):
        if value is None:
            raise RecordingFormatError(f"{where}, {name}: expected a number [mm]; it is missing")


def table_of(top: Fields, name: str) -> Fields:
    """Return a table of the map, with no entries but its own."""
    table = top.table(name)
    table.only(_ENTRIES[name])
    return table


def inner_table(fields: Fields, name: str, known: AbstractSet[str]) -> Fields:
    """Return a table inside another one, with no entries but those that are known."""
    table = fields.table(name)
    table.only(known)
    return table


def signal_in(fields: Fields, name: str, quantity: Quantity) -> MappedChannel:
    """Return a channel that has a table inside another one."""
    return mapped_channel(inner_table(fields, name, _SIGNAL), quantity)


def mapped_channel(fields: Fields, quantity: Quantity) -> MappedChannel:
    """Return a channel with the factor that its numbers are brought to SI by."""
    unit = fields.text("unit")
    if "sensitivity" in fields or "sensitivity_unit" in fields:
        factor = sensor_factor(
            unit, fields.positive("sensitivity", "-"), fields.text("sensitivity_unit"), quantity, fields.where
        )
    else:
        factor = factor_to_si(unit, quantity, f"{fields.where}, unit")
    row, column = place_of(fields)
    return MappedChannel(
        fields.text("channel"),
        unit,
        factor,
        fields.optional_number("offset", unit) or 0.0,
        row,
        column,
        fields.text("time") if "time" in fields else None,
    )


def place_of(fields: Fields) -> tuple[int | None, int | None]:
    """Return which row and which column of a two-dimensional array is meant, counted from 0."""
    if "row" in fields and "column" in fields:
        raise RecordingFormatError(f"{fields.where}: expected a row or a column; got both")
    row, column = (fields.count(name) - 1 if name in fields else None for name in ("row", "column"))
    return row, column


def time_source(top: Fields) -> TimeSource | None:
    """Return where the sampling times stand; None where nothing is said."""
    if "time" not in top:
        return None
    fields = table_of(top, "time")
    channel = fields.text("channel") if "channel" in fields else None
    row, column = place_of(fields)
    if "format" not in fields:
        for name in ("date", "zone"):
            if name in fields:
                raise RecordingFormatError(f"{fields.where}: expected {name} with format; got it with unit")
        unit = fields.text("unit")
        factor = factor_to_si(unit, Quantity.TIME, f"{fields.where}, unit")
        return TimeSource(channel, factor, unit, row=row, column=column)
    if "unit" in fields:
        raise RecordingFormatError(f"{fields.where}: expected unit for numbers or format for texts; got both")
    if channel is None:
        raise RecordingFormatError(f"{fields.where}, channel: expected a text; it is missing")
    return TimeSource(
        channel,
        None,
        None,
        _format(fields),
        fields.text("date") if "date" in fields else None,
        _zone(fields) if "zone" in fields else None,
    )


def _format(fields: Fields) -> str:
    form = fields.text("format")
    if form != "iso" and "%" not in form:
        raise RecordingFormatError(f"{fields.where}, format: expected 'iso' or a pattern of strptime; got {form!r}")
    return form


def _zone(fields: Fields) -> timezone:
    text = fields.text("zone")
    if text.upper() == "Z":
        return UTC
    match = _ZONE.fullmatch(text)
    if match is None or int(match[2]) > 23 or int(match[3]) > 59:
        raise RecordingFormatError(f"{fields.where}, zone: expected an offset such as '+01:00' or 'Z'; got {text!r}")
    offset = timedelta(hours=int(match[2]), minutes=int(match[3]))
    return timezone(-offset if match[1] == "-" else offset)


def resampling(top: Fields) -> Resampling | None:
    """Return how channels are brought to one clock; None where nothing is said."""
    if "resample" not in top:
        return None
    fields = table_of(top, "resample")
    return Resampling(fields.positive("sample_rate_hz", "Hz"), fields.choice("method", ResampleMethod))


def cutting(window: Fields) -> Cutting:
    """Return how long records are cut into windows."""
    step = window.positive("position_step_mm", "mm") if "position_step_mm" in window else None
    return Cutting(
        window.count("samples_per_window") if "samples_per_window" in window else None,
        window.optional_choice("windows_in", WindowsIn),
        window.positive("window_interval_s", "s") if "window_interval_s" in window else None,
        window.positive("file_interval_s", "s") if "file_interval_s" in window else None,
        None if step is None else metres(step),
    )


def window_facts(fields: Fields, *, measured: bool) -> WindowFacts:
    """Return what is stated of windows, whose position is ``measured`` by a channel or stated here."""
    if measured and ("position_mm" in fields or "position_span_mm" in fields):
        raise RecordingFormatError(
            f"{fields.where}: expected the position once; got a [position] channel and position_mm or position_span_mm"
        )
    position, span = (fields.optional_number(name, "mm") for name in ("position_mm", "position_span_mm"))
    started_at: datetime | None = fields.instant("started_at") if "started_at" in fields else None
    return WindowFacts(
        started_at,
        None if position is None else metres(position),
        None if span is None else metres(span),
        fields.optional_number("payload_kg", "kg"),
        fields.optional_number("temperature_c", "°C"),
        fields.optional_number("preload_n", "N"),
        fields.text("measurement") if "measurement" in fields else None,
        fields.optional_choice("direction", Direction),
    )


def files_of(top: Fields, known: AbstractSet[str], *, measured: bool) -> tuple[tuple[str, WindowFacts], ...]:
    """Return what is stated of each file, by its name and in the order of the map."""
    if "files" not in top:
        return ()
    tables = top.values["files"]
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise RecordingFormatError(f"{top.where}: expected tables [[files]]; got {type(tables).__name__}")
    found: dict[str, WindowFacts] = {}
    for number, table in enumerate(tables, start=1):
        fields = Fields(table, f"{top.where} [[files]] {number}")
        fields.only(known)
        name = fields.text("name")
        if name in found:
            raise RecordingFormatError(f"{fields.where}, name: expected each file once; got {name!r} twice")
        found[name] = window_facts(fields, measured=measured)
    return tuple(found.items())


def tolerances(top: Fields) -> Tolerances:
    """Return how well settings are known, as far as it is stated."""
    if "tolerances" not in top:
        return Tolerances()
    fields = table_of(top, "tolerances")
    stated = [fields.not_negative(name, "mm or 1") if name in fields else None for name in Tolerances().attributes]
    return Tolerances(*stated)
