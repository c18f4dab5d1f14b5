"""Look at a whole session: its windows, measurements and settings, and each of its channels over all windows."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Window
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.raw.channels import Channel
from monitor_core.recordings.raw.inspection import ChannelSummary, summary_of
from monitor_core.recordings.session_hdf5 import EXCITATION_UNIT, RESPONSE_UNIT, SessionReader
from monitor_core.recordings.usability import Settings

#: Positions closer than this are one place that was driven to again.
_SAME_PLACE = 0.5  # [mm]


@dataclass(frozen=True, slots=True)
class SessionContents:
    """What a session holds; the windows that cannot be read stand among the problems."""

    axis_id: str
    n_windows: int
    measurements: tuple[str, ...]
    settings: Settings
    started_at: datetime | None  # of the first window
    last_at: datetime | None
    channels: tuple[ChannelSummary, ...]
    problems: tuple[str, ...]


@dataclass(slots=True)
class _Gathered:
    """What was seen so far."""

    channels: dict[str, list[ChannelSummary]] = field(default_factory=dict)
    settings: dict[str, tuple[float, float | None]] = field(default_factory=dict)  # of each measurement
    starts: list[datetime] = field(default_factory=list)

    def add(self, window: Window) -> None:
        for channel in _channels_of(window):
            self.channels.setdefault(channel.name, []).append(summary_of(channel))
        conditions = window.conditions
        self.settings.setdefault(window.measurement, (to_millimetres(conditions.position), conditions.preload))
        self.starts.append(window.started_at)


def look_at_session(reader: SessionReader, most_problems: int) -> SessionContents:
    """Read every window of an open session, one at a time; at most so many problems are listed."""
    gathered, problems = _Gathered(), list[str]()
    for name in reader.measurement_of:
        try:
            gathered.add(reader.window(name))
        except RecordingFormatError as error:
            problems.append(str(error))
            if len(problems) > most_problems:
                break
    return SessionContents(
        axis_id=reader.axis_id,
        n_windows=len(reader.measurement_of),
        measurements=reader.measurements,
        settings=_settings(gathered),
        started_at=min(gathered.starts, default=None),
        last_at=max(gathered.starts, default=None),
        channels=tuple(_joined(name, windows) for name, windows in gathered.channels.items()),
        problems=tuple(problems),
    )


def places(positions_mm: list[float]) -> tuple[float, ...]:
    """Return distinct positions, rising; those of one place are counted once."""
    distinct: list[float] = []
    for position in sorted(positions_mm):
        if not distinct or position - distinct[-1] > _SAME_PLACE:
            distinct.append(position)
    return tuple(distinct)


def _settings(gathered: _Gathered) -> Settings:
    known = [(position, preload) for position, preload in gathered.settings.values() if preload is not None]
    return Settings(
        n_readings=len(gathered.settings),
        positions_mm=places([position for position, _ in gathered.settings.values()]),
        preloads_n=tuple(sorted({preload for _, preload in known})),
        n_with_preload=len(known),
    )


def _channels_of(window: Window) -> Iterator[Channel]:
    rate, start = window.sample_rate, window.started_at
    unit = EXCITATION_UNIT[window.excitation_quantity]
    yield Channel("excitation", window.excitation, unit, rate, start)
    yield Channel("response", window.response, RESPONSE_UNIT, rate, start)
    if window.position_trace is not None:
        yield Channel("position", window.position_trace, "m", rate, start)


def _joined(name: str, windows: list[ChannelSummary]) -> ChannelSummary:
    """Put the summaries of one channel in all windows together."""
    first, n = windows[0], len(windows)
    rates = {window.sample_rate for window in windows}
    units = {window.unit for window in windows}
    lengths = {window.shape for window in windows}
    counts = {
        "not finite": sum(window.n_not_finite > 0 for window in windows),
        "constant": sum(window.is_constant for window in windows),
        "stuck": sum(window.is_stuck for window in windows),
        "clipped": sum(window.is_clipped for window in windows),
    }
    remarks = [f"{what} in {count} of {n} windows" for what, count in counts.items() if count]
    if len(lengths) > 1:
        remarks.append(f"windows of {min(lengths)[0]} to {max(lengths)[0]} samples")
    if len(rates) > 1:
        remarks.append(f"sampled at {', '.join(f'{rate:g} Hz' for rate in sorted(rate or 0.0 for rate in rates))}")
    if len(units) > 1:
        remarks.append(f"windows in {' and in '.join(sorted(unit or '?' for unit in units))}")
    known = [window for window in windows if window.minimum is not None]
    return replace(
        first,
        name=name,
        shape=(n, max(lengths)[0]),
        minimum=min((window.minimum for window in known if window.minimum is not None), default=None),
        maximum=max((window.maximum for window in known if window.maximum is not None), default=None),
        n_not_finite=int(np.sum([window.n_not_finite for window in windows])),
        is_constant=counts["constant"] == n,
        is_stuck=counts["stuck"] > 0,
        is_clipped=counts["clipped"] > 0,
        remarks=tuple(remarks),
        doubts=tuple(dict.fromkeys(doubt for window in windows for doubt in window.doubts))[:1],
    )
