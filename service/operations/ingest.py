"""Windows in: gated, on disk, committed, and judged when their measurement is complete."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any

from sqlalchemy.orm import Session

from monitor_core.pipeline import check_window
from monitor_core.recording import Rejection, RejectionReason, Window
from service.clock import now
from service.errors import ConflictError
from service.observability import Metrics
from service.operations.axes import AxisConfiguration
from service.operations.judge import Judge
from service.operations.lanes import Lanes
from service.operations.settings_of_axis import core_settings
from service.store import calibrations, measurements
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import AxisRow, MeasurementRow, WindowRow
from service.store.waveforms import WaveformStore, content_sha256


class WindowStatus(StrEnum):
    """What became of a posted window."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    ALREADY_THERE = "already-there"


@dataclass(frozen=True, slots=True)
class WindowReceipt:
    """The answer to one posted window."""

    started_at: datetime
    measurement: str
    status: WindowStatus
    reason: str | None = None
    detail: str | None = None


@dataclass(frozen=True, slots=True)
class IngestReceipt:
    """The answer to one request."""

    windows: tuple[WindowReceipt, ...]
    measurements: tuple[dict[str, Any], ...]  # outcomes of the measurements judged


class Ingest:
    """Takes windows of an axis, one request after another."""

    def __init__(
        self, database: Database, waveforms: WaveformStore, judge: Judge, lanes: Lanes, metrics: Metrics
    ) -> None:
        self._database = database
        self._waveforms = waveforms
        self._judge = judge
        self._lanes = lanes
        self._metrics = metrics

    def ingest(self, axis_id: str, windows: Sequence[Window], *, complete: bool) -> IngestReceipt:
        """Store windows durably and judge the measurements that they complete.

        Raises
        ------
        ConflictError
            If another window is stored (or posted) with the same start; then nothing of the request is stored.
        """
        hashes = [content_sha256(window) for window in windows]
        with self._lanes.of(axis_id):
            new = self._new_windows(axis_id, windows, hashes)
            outcomes = self._store(axis_id, new, complete_names={w.measurement for w in windows} if complete else set())
            judged = self._judge.judge_complete(axis_id, {w.started_at: w for w, _ in new})
        receipts = tuple(_receipt(window, outcomes) for window in windows)
        for receipt in receipts:
            self._metrics.windows.labels(receipt.reason or receipt.status).inc()
        return IngestReceipt(receipts, tuple(judged))

    def finish_interrupted(self) -> None:
        """Judge what was stored but not judged when the service last stopped."""
        with self._database.read() as session:
            axis_ids = measurements.axes_with_complete_measurements(session)
        for axis_id in axis_ids:
            with self._lanes.of(axis_id):
                self._judge.judge_complete(axis_id, {})

    def _new_windows(self, axis_id: str, windows: Sequence[Window], hashes: Sequence[str]) -> list[tuple[Window, str]]:
        with self._database.read() as session:
            get_axis(session, axis_id)
            stored = measurements.windows_at(session, axis_id, [window.started_at for window in windows])
        known = {moment: row.content_sha256 for moment, row in stored.items()}
        new = []
        for window, content in zip(windows, hashes, strict=True):
            if window.started_at not in known:
                known[window.started_at] = content
                new.append((window, content))
            elif known[window.started_at] != content:
                raise ConflictError(
                    f"axis '{axis_id}' has another window that started at {window.started_at.isoformat()}; "
                    "a window is never replaced, and nothing of this request was stored"
                )
        return sorted(new, key=lambda item: item[0].started_at)

    def _store(
        self, axis_id: str, new: list[tuple[Window, str]], complete_names: set[str]
    ) -> dict[datetime, Rejection | None]:
        """Write the waveforms, then the rows in one transaction; return the outcome of each new window."""
        if not new and not complete_names:
            return {}
        received_at = now()
        file = self._waveforms.write(axis_id, [window for window, _ in new], received_at) if new else None
        try:
            with self._database.write() as session:
                axis = get_axis(session, axis_id)
                batch = _Batch(session, axis)
                outcomes = {}
                for index, (window, content) in enumerate(new):
                    measurement = batch.measurement_of(window)
                    outcomes[window.started_at] = rejection = batch.gate(window, measurement)
                    assert file is not None  # noqa: S101 - new windows were just written
                    session.add(
                        WindowRow(
                            axis_id=axis_id,
                            measurement_id=measurement.id,
                            started_at=window.started_at,
                            received_at=received_at,
                            content_sha256=content,
                            file_path=file.path,
                            file_sha256=file.sha256,
                            index_in_file=index,
                            refusal_reason=None if rejection is None else str(rejection.reason),
                            refusal_detail=None if rejection is None else rejection.detail[:500],
                        )
                    )
                batch.close_measurements(complete_names)
                return outcomes
        except BaseException:
            if file is not None:
                self._waveforms.delete(file)
            raise


class _Batch:
    """New windows of one axis inside one transaction."""

    def __init__(self, session: Session, axis: AxisRow) -> None:
        self._session = session
        self._axis = axis
        self._configuration = AxisConfiguration.model_validate(axis.configuration)
        self._settings = core_settings(self._configuration)
        self._calibration = calibrations.active_calibration(session, axis)
        self._measurements: dict[str, MeasurementRow] = {}

    def measurement_of(self, window: Window) -> MeasurementRow:
        """Return the row of the window's measurement; the first window of a measurement makes it."""
        row = self._measurements.get(window.measurement)
        if row is None:
            named = measurements.measurements_named(self._session, self._axis.id, [window.measurement])
            row = named.get(window.measurement)
        if row is None:
            row = MeasurementRow(
                axis_id=self._axis.id,
                name=window.measurement,
                started_at=window.started_at,
                position_mm=window.conditions.position * 1e3,
                status=measurements.OPEN,
            )
            self._session.add(row)
            self._session.flush()
        self._measurements[window.measurement] = row
        return row

    def gate(self, window: Window, measurement: MeasurementRow) -> Rejection | None:
        """Tell why a window cannot be averaged with its measurement; ``None`` accepts it."""
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
        quality = check_window(window, self._settings, self._calibration)
        return quality if isinstance(quality, Rejection) else None

    def close_measurements(self, complete_names: set[str]) -> None:
        """Close what is said to be complete, what has enough windows, and what a newer measurement has followed."""
        self._session.flush()
        named = measurements.measurements_named(self._session, self._axis.id, complete_names)
        newest = max((row.started_at for row in self._measurements.values()), default=None)
        for row in measurements.measurements_with_status(self._session, self._axis.id, measurements.OPEN):
            enough = self._configuration.windows_per_measurement
            if (
                row.name in named
                or (newest is not None and row.started_at < newest)
                or measurements.accepted_windows(self._session, row.id) >= enough
            ):
                row.status = measurements.COMPLETE


def _receipt(window: Window, outcomes: dict[datetime, Rejection | None]) -> WindowReceipt:
    if window.started_at not in outcomes:
        return WindowReceipt(window.started_at, window.measurement, WindowStatus.ALREADY_THERE)
    rejection = outcomes[window.started_at]
    if rejection is None:
        return WindowReceipt(window.started_at, window.measurement, WindowStatus.ACCEPTED)
    return WindowReceipt(
        window.started_at, window.measurement, WindowStatus.REFUSED, str(rejection.reason), rejection.detail
    )
