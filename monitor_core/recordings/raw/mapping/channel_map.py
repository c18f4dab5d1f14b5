"""Read a channel map (TOML): which channel is what, in which unit, and what the raw files do not say.

.. code-block:: toml

    axis_id = "mill-3-x"
    description = "impact moves"               # optional

    [text]                                     # how a text file is written, where it is not plain: see text_layout.py
    separator = "semicolon"

    [excitation]
    channel = "Drive/Current"                  # name in the file
    column = 3                                 # optional: column or row of a two-dimensional array, counted from 1
    quantity = "torque"                        # torque | force
    source = "drive"                           # sensor | drive
    unit = "A"                                 # what the numbers in the file are
    sensitivity = 0.74                         # only with a raw unit (V, mV, A, mA, count) …
    sensitivity_unit = "N.m/A"                 # … "quantity/raw" or, as on a sensor's sheet, "raw/quantity"
    offset = 0.0                               # optional, in the unit of the file, subtracted first
    time = "Time 1"                            # optional: channel with the sampling times of this one, unit as [time]

    [response]                                 # always an acceleration
    channel = "Nut/Acceleration"
    unit = "g"

    [position]                                 # optional measured travel; replaces the two position entries below
    channel = "Drive/Position"
    unit = "mm"

    [time]                                     # only if a channel holds the sampling times
    channel = "t"
    unit = "s"                                 # numbers; or, for texts of a date and time:
    format = "iso"                             # iso | a pattern of strptime such as "%d.%m.%Y %H:%M:%S.%f"
    date = "Date"                              # optional second channel in front of it
    zone = "+01:00"                            # where the texts carry none

    [resample]                                 # only where clocks differ or sampling is uneven
    sample_rate_hz = 5000
    method = "cubic"                           # cubic | linear

    [window]
    sample_rate_hz = 10000                     # only if neither the file nor [time] says it
    started_at = 2025-03-01T06:00:00Z          # only if the file does not say it
    position_mm = 250.0
    position_span_mm = 0.0
    measurement = "2025-03-01 at 250 mm"       # optional; otherwise the file's name without its ending
    direction = "both"                         # optional: + | - | both
    payload_kg = 0.0                           # optional, as temperature_c and preload_n
    samples_per_window = 20000                 # optional: cuts a long record into windows that follow each other
    windows_in = "rows"                        # only for two-dimensional arrays: rows | columns …
    window_interval_s = 2.0                    # … and the time from the start of one to the start of the next
    file_interval_s = 60.0                     # several files and one start: from the start of one to that of the next
    position_step_mm = 5.0                     # optional: windows this near the first are one measurement, numbered

    [[files]]                                  # optional, facts of one of several files; they go before [window]
    name = "p100.tdms"
    position_mm = 100

    [tolerances]                               # optional, how well the settings are known
    position_tolerance_mm = 0.5
    preload_tolerance = 0.05                   # relative, as gain_tolerance

A motion record has, instead of excitation, response and position, tables inside one: ``[motion]`` with ``position``,
``force`` or ``torque``, optionally ``reference``, each with entries as above, and ``sample_rate_hz`` or ``[time]``.

An FRF set has ``[frf]``: ``input`` and ``output`` as its format names them; ``frequency``, and ``real`` and
``imaginary`` or ``magnitude`` and ``phase`` (deg or rad), or ``response``, the name of a frequency response that the
file itself holds; ``standard_deviation`` (in the unit of the response; or a channel) or ``relative``; optionally
``resolution_hz`` and ``excitation_rms_nm`` or ``excitation_rms_n``. Conditions stand in ``[window]`` or ``[[files]]``.

What is stated in the file *and* here is refused, and so is an entry that is not listed above.
"""

from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import ExcitationQuantity, ExcitationSource
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import parse_toml, read_text
from monitor_core.recordings.elements.units import Quantity
from monitor_core.recordings.raw.mapping.frf_entries import response_lines
from monitor_core.recordings.raw.mapping.map_entries import (
    FILES,
    cutting,
    facts_required,
    files_of,
    mapped_channel,
    resampling,
    signal_in,
    table_of,
    time_source,
    tolerances,
    window_facts,
)
from monitor_core.recordings.raw.mapping.map_records import (
    ChannelMap,
    MapKind,
    MotionSignals,
    SessionSignals,
    WindowFacts,
)
from monitor_core.recordings.raw.text.layout import TextLayout

_ANY_MAP = frozenset(("axis_id", "description", "text"))
_TABLES = {
    MapKind.SESSION: frozenset((
        "excitation", "response", "position", "time", "resample", "window", "files", "tolerances",
    )),
    MapKind.MOTION: frozenset(("motion", "time", "resample")),
    MapKind.FRF_SET: frozenset(("frf", "window", "files", "tolerances")),
}  # fmt: skip
#: What ``[window]`` and ``[[files]]`` may state of a frequency response.
_CONDITIONS = frozenset(("position_mm", "payload_kg", "temperature_c", "preload_n"))


def read_channel_map(path: Path) -> ChannelMap:
    """Read a channel map from a TOML file; the module's text shows every entry.

    Factors are to SI and positions in metres. ``RecordingFormatError`` if it is no TOML, lacks an entry, has one that
    is not known, or names a unit that does not fit the quantity.
    """
    return parse_channel_map(read_text(path), path.name)


def parse_channel_map(text: str, where: str) -> ChannelMap:
    """Read a channel map from its text; ``where`` names it in messages. Raises as :func:`read_channel_map`."""
    top = Fields(parse_toml(text, where, "a channel map"), where)
    kind = MapKind.MOTION if "motion" in top else MapKind.FRF_SET if "frf" in top else MapKind.SESSION
    top.only(_ANY_MAP | _TABLES[kind])
    readers = {MapKind.SESSION: _session_map, MapKind.MOTION: _motion_map, MapKind.FRF_SET: _frf_map}
    return readers[kind](top)


def _session_map(top: Fields) -> ChannelMap:
    if "excitation" not in top:
        raise RecordingFormatError(
            f"{top.where}: expected a table [excitation], the torque or the force that drives the axis; it is missing, "
            "and without it there is no frequency response"
        )
    axis_id = top.text("axis_id")
    excitation, response = table_of(top, "excitation"), table_of(top, "response")
    quantity = excitation.choice("quantity", ExcitationQuantity)
    measured = "position" in top
    window = table_of(top, "window")
    signals = SessionSignals(
        mapped_channel(excitation, Quantity(quantity)),
        quantity,
        excitation.choice("source", ExcitationSource),
        mapped_channel(response, Quantity.ACCELERATION),
        mapped_channel(table_of(top, "position"), Quantity.POSITION) if measured else None,
    )
    files = files_of(top, FILES, measured=measured)
    facts = window_facts(window, measured=measured)
    if not measured and not files:
        facts_required(facts, window.where)
    return ChannelMap(
        signals,
        axis_id,
        facts,
        _description(top),
        _text(top),
        time_source(top),
        resampling(top),
        window.positive("sample_rate_hz", "Hz") if "sample_rate_hz" in window else None,
        cutting(window),
        files,
        tolerances(top),
    )


def _motion_map(top: Fields) -> ChannelMap:
    motion = table_of(top, "motion")
    drives = [quantity for quantity in ExcitationQuantity if quantity in motion]
    if len(drives) != 1:
        got = " and ".join(drives) or "neither"
        raise RecordingFormatError(f"{motion.where}: expected one of force and torque; got {got}")
    (quantity,) = drives
    reference = signal_in(motion, "reference", Quantity.POSITION) if "reference" in motion else None
    signals = MotionSignals(
        signal_in(motion, "position", Quantity.POSITION),
        signal_in(motion, quantity, Quantity(quantity)),
        quantity,
        reference,
    )
    return ChannelMap(
        signals,
        _axis_id(top),
        WindowFacts(),
        _description(top),
        _text(top),
        time_source(top),
        resampling(top),
        motion.positive("sample_rate_hz", "Hz") if "sample_rate_hz" in motion else None,
    )


def _frf_map(top: Fields) -> ChannelMap:
    frf = table_of(top, "frf")
    window = top.table("window") if "window" in top else Fields({}, f"{top.where} [window]")
    window.only(_CONDITIONS)
    files = files_of(top, _CONDITIONS | {"name"}, measured=False)
    facts = window_facts(window, measured=False)
    if facts.position is None and not files:
        raise RecordingFormatError(f"{window.where}, position_mm: expected a number [mm]; it is missing")
    return ChannelMap(
        response_lines(frf),
        _axis_id(top),
        facts,
        _description(top),
        _text(top),
        files=files,
        tolerances=tolerances(top),
    )


def _axis_id(top: Fields) -> str:
    return top.text("axis_id") if "axis_id" in top else ""


def _description(top: Fields) -> str:
    return top.text("description") if "description" in top else ""


def _text(top: Fields) -> TextLayout | None:
    return TextLayout.from_fields(top.table("text")) if "text" in top else None
