"""Which measurement a new window belongs to, whether it is averaged there, and what completes a measurement."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.recordings.elements.units import to_millimetres
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.store.intake import OPEN, MeasurementRecord


@dataclass(frozen=True, slots=True)
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
    measurements: dict[str, MeasurementRecord]  # open ones, and those that the windows name
    admitted: list[Admitted] = field(default_factory=list)

    def admit(self, window: Window, own_refusal: Rejection | None) -> None:
        """Put a new window, with what the gate says of it on its own, into its measurement; the first one makes it."""
        row = self.measurements.get(window.measurement)
        if row is None:
            row = self.measurements[window.measurement] = MeasurementRecord(
                axis_id=self.axis_id,
                name=window.measurement,
                started_at=window.started_at,
                position_mm=to_millimetres(window.conditions.position),
                set_preload_n=window.conditions.preload,
            )
        refusal = self._misfit(window, row) or own_refusal
        if row.status == OPEN:
            row.started_at = min(row.started_at, window.started_at)  # windows may arrive in any order
            row.n_accepted += refusal is None
        self.admitted.append(Admitted(window, row, refusal))

    def changed(self) -> list[MeasurementRecord]:
        """Return the measurements that new windows made or changed."""
        rows = {item.measurement.name: item.measurement for item in self.admitted}
        return [row for row in rows.values() if row.status == OPEN]

    def complete(self, named: Iterable[str]) -> list[MeasurementRecord]:
        """Return what is to be judged, in time order.

        That is what is said to be complete, what has enough windows, and what a newer measurement has followed.
        """
        newest = max((item.measurement.started_at for item in self.admitted), default=None)
        complete = [
            row
            for row in self.measurements.values()
            if row.status == OPEN
            and (
                row.name in named
                or (newest is not None and row.started_at < newest)
                or row.n_accepted >= self.configuration.windows_per_measurement
            )
        ]
        return sorted(complete, key=lambda row: row.started_at)

    def _misfit(self, window: Window, row: MeasurementRecord) -> Rejection | None:
        if row.status != OPEN:
            return Rejection(
                RejectionReason.MEASUREMENT_CLOSED,
                f"measurement '{row.name}' was {row.status} before this window arrived",
            )
        position_mm, limit_mm = to_millimetres(window.conditions.position), self.configuration.position_span_limit_mm
        if abs(position_mm - row.position_mm) > limit_mm:
            return Rejection(
                RejectionReason.POSITION_MISMATCH,
                f"windows of a measurement must lie within {limit_mm:g} mm of each other; got {position_mm:.1f} mm in "
                f"'{row.name}' at {row.position_mm:.1f} mm",
            )
        return None
