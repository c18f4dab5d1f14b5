"""New windows of one axis inside one transaction: which measurement each belongs to, and what completes one."""

from datetime import datetime

from sqlalchemy.orm import Session

from monitor_core.recording import Rejection, RejectionReason, Window
from service.operations.settings_of_axis import AxisConfiguration
from service.store import measurements
from service.store.tables import AxisRow, MeasurementRow


class Admission:
    """Puts windows into the measurements of an axis; the caller's transaction keeps or drops all of it."""

    def __init__(self, session: Session, axis: AxisRow) -> None:
        self._session = session
        self._axis = axis
        self._configuration = AxisConfiguration.model_validate(axis.configuration)
        self._unjudged = measurements.unjudged_measurements(session, axis.id)
        self._by_name = {row.name: row for row in self._unjudged}
        self._newest: datetime | None = None

    def admit(self, window: Window, own_refusal: Rejection | None) -> tuple[int, Rejection | None]:
        """Return the measurement of a window, and why the window will not be averaged, if so.

        Parameters
        ----------
        window : Window
            Not stored yet.
        own_refusal : Rejection or None
            What the gate says of the window on its own.
        """
        measurement = self._measurement_of(window)
        self._newest = max(self._newest or measurement.started_at, measurement.started_at)
        refusal = self._misfit(window, measurement) or own_refusal
        if refusal is None:
            measurement.n_accepted += 1
        return measurement.id, refusal

    def close(self, complete_names: set[str]) -> list[int]:
        """Close what is said to be complete, what has enough windows, and what a newer measurement has followed.

        Returns
        -------
        list of int
            The measurements that are to be judged, in time order; one that an interruption left is among them.
        """
        for row in self._unjudged:
            if (
                row.name in complete_names
                or (self._newest is not None and row.started_at < self._newest)
                or row.n_accepted >= self._configuration.windows_per_measurement
            ):
                row.status = measurements.COMPLETE
        complete = [row for row in self._unjudged if row.status == measurements.COMPLETE]
        return [row.id for row in sorted(complete, key=lambda row: (row.started_at, row.id))]

    def _measurement_of(self, window: Window) -> MeasurementRow:
        """Return the row of the window's measurement; the first window of a measurement makes it."""
        row = self._by_name.get(window.measurement)
        row = row or measurements.measurement_named(self._session, self._axis.id, window.measurement)
        if row is None:
            row = MeasurementRow(
                axis_id=self._axis.id,
                name=window.measurement,
                started_at=window.started_at,
                position_mm=window.conditions.position * 1e3,
                set_preload_n=window.conditions.preload,
                status=measurements.OPEN,
                n_accepted=0,
            )
            self._session.add(row)
            self._session.flush()
            self._unjudged.append(row)
        elif row.status == measurements.OPEN:
            row.started_at = min(row.started_at, window.started_at)  # windows may arrive in any order
        self._by_name[row.name] = row
        return row

    def _misfit(self, window: Window, measurement: MeasurementRow) -> Rejection | None:
        if measurement.status != measurements.OPEN:
            return Rejection(
                RejectionReason.MEASUREMENT_CLOSED,
                f"measurement '{measurement.name}' was {measurement.status} before this window arrived",
            )
        position_mm, limit_mm = window.conditions.position * 1e3, self._configuration.position_span_limit_mm
        if abs(position_mm - measurement.position_mm) > limit_mm:
            return Rejection(
                RejectionReason.POSITION_MISMATCH,
                f"windows of a measurement must lie within {limit_mm:g} mm of each other; got {position_mm:.1f} mm in "
                f"'{measurement.name}' at {measurement.position_mm:.1f} mm",
            )
        return None
