"""Assign new windows to measurements, and decide which measurements are complete."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.recordings.elements.units import to_millimetres
from service.clock import text_of
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.store.intake import OPEN, MeasurementRecord
from service.store.retention import LetGo

#: A window that says it began so long after it arrived comes from a clock that is wrong: put into the charts, it would
#: make everything that is measured until then too old for them.
MOST_AHEAD = timedelta(minutes=10)


@dataclass(slots=True)
class Admitted:
    """A new window in its measurement, and why it will not be averaged there, if so."""

    window: Window
    measurement: MeasurementRecord
    refusal: Rejection | None


@dataclass(slots=True)
class Admission:
    """Puts new windows into the measurements of an axis. Nothing is stored here."""

    axis_id: str
    configuration: AxisConfiguration
    received_at: datetime
    measurements: dict[str, MeasurementRecord]  # those that the windows name
    closed: Collection[str]  # names of those that were judged too long ago to take more
    admitted: list[Admitted] = field(default_factory=list)
    let_go: Mapping[int, LetGo] = field(default_factory=dict)  # by measurement, of those that lost windows to a purge

    def admit(self, window: Window, own_refusal: Rejection | None) -> None:
        """Put a new window, with what the gate says of it on its own, into its measurement; the first one makes it."""
        row = self.measurements.get(window.measurement)
        ahead = window.started_at - self.received_at > MOST_AHEAD
        if row is None:
            row = self.measurements[window.measurement] = MeasurementRecord(
                axis_id=self.axis_id,
                name=window.measurement,
                started_at=self.received_at if ahead else window.started_at,
                position_mm=to_millimetres(window.conditions.position),
                set_preload_n=window.conditions.preload,
                closes_at=None,
            )
        refusal = self._clock(window) if ahead else self._closed(row) or own_refusal or self._elsewhere(window, row)
        if row.status == OPEN:
            row.closes_at = self.received_at + timedelta(seconds=self.configuration.measurement_timeout_s)
            if not ahead:
                row.started_at = min(row.started_at, window.started_at)  # windows may arrive in any order
        row.n_accepted += refusal is None
        self.admitted.append(Admitted(window, row, refusal))

    def changed(self) -> list[MeasurementRecord]:
        """Return the measurements that new windows made or changed."""
        rows = {item.measurement.name: item.measurement for item in self.admitted}
        return [row for row in rows.values() if row.status == OPEN]

    def complete(self, named: Iterable[str]) -> list[MeasurementRecord]:
        """Return what is to be judged, in time order.

        That is what is said to be complete, what has enough windows, and what was judged and has got more: a value
        rests on all the windows of its measurement, in whatever order they came.
        """
        more = {item.measurement.name for item in self.admitted if counts(item.refusal)}
        complete = [
            row
            for row in self.measurements.values()
            if (
                row.status == OPEN
                and (row.name in named or row.n_accepted >= self.configuration.windows_per_measurement)
            )
            or (row.status != OPEN and row.name in more)
        ]
        return sorted(complete, key=lambda row: row.started_at)

    def _clock(self, window: Window) -> Rejection:
        return Rejection(
            RejectionReason.CLOCK_AHEAD,
            f"a window may begin {MOST_AHEAD} after it arrives at most; got {text_of(window.started_at)} at "
            f"{text_of(self.received_at)}: set the clock of the sender",
        )

    def _closed(self, row: MeasurementRecord) -> Rejection | None:
        if row.status != OPEN and row.id is not None and (gone := self.let_go.get(row.id)) is not None:
            return Rejection(RejectionReason.TOO_LATE, f"the other windows of measurement '{row.name}' were {gone}")
        if row.name not in self.closed:
            return None
        return Rejection(
            RejectionReason.TOO_LATE, f"measurement '{row.name}' was {row.status} too long before this window arrived"
        )

    def _elsewhere(self, window: Window, row: MeasurementRecord) -> Rejection | None:
        return mismatch(window, row.position_mm, row.name, self.configuration.position_span_limit_mm)


def counts(refusal: Rejection | None) -> bool:
    """Tell whether a window is averaged in its measurement, or would be if that stood where the window is."""
    return refusal is None or refusal.reason is RejectionReason.POSITION_MISMATCH


def mismatch(window: Window, position_mm: float, name: str, limit_mm: float) -> Rejection | None:
    """Return why a window is not of a measurement at some position, if so."""
    own_mm = to_millimetres(window.conditions.position)
    if abs(own_mm - position_mm) <= limit_mm:
        return None
    return Rejection(
        RejectionReason.POSITION_MISMATCH,
        f"windows of a measurement must lie within {limit_mm:g} mm of each other; got {own_mm:.1f} mm in "
        f"'{name}' at {position_mm:.1f} mm",
    )


def at_its_position(windows: Sequence[Window], limit_mm: float) -> dict[datetime, Rejection | None]:
    """Say of each window of a measurement whether it lies where the first of them lies, whichever came first here."""
    in_time = sorted(windows, key=lambda window: window.started_at)
    first_mm = to_millimetres(in_time[0].conditions.position) if in_time else 0.0
    return {window.started_at: mismatch(window, first_mm, window.measurement, limit_mm) for window in in_time}
