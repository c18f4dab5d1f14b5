"""Windows in: gated, judged when they complete a measurement, on disk and committed, then acknowledged."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from sqlalchemy import Connection

from monitor_core.pipeline import MeasurementOutcome, check_window
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.trend import TrendStatus
from service.clock import now
from service.errors import ConflictError, WaveformDamagedError
from service.json_types import JsonObject
from service.observability import Metrics
from service.operations.monitoring.admission import Admission
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings, load_configuration
from service.operations.monitoring.judge import Verdict, judge, record
from service.operations.monitoring.lanes import Lanes
from service.store import intake
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database, reading, writing
from service.store.intake import AxisRecord, MeasurementRecord, WindowRecord
from service.store.measurements import accepted_places
from service.store.safekeeping.healing import heal
from service.store.waveforms import WaveformPlace, WaveformStore
from service.store.window_format import content_sha256


class WindowStatus(StrEnum):
    """What became of a posted window."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    ALREADY_THERE = "already-there"


#: Reason and detail of a window that was stored, could not be read any more, and was written once more.
RESTORED = ("waveform-restored", "its stored waveform was lost or damaged, and was written again from this window")


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
    measurements: tuple[JsonObject, ...]  # outcomes of those judged now, and of those posted again


@dataclass(frozen=True, slots=True)
class _Known:
    """What is stored of an axis, as far as a request asks for it."""

    axis: AxisRecord
    configuration: AxisConfiguration
    calibration: Calibration | None
    contents: dict[datetime, str]  # of windows that started when posted ones did
    measurements: dict[str, MeasurementRecord]  # open ones, and those that the windows name


class Ingest:
    """Takes windows of an axis, one request after another.

    A request is read, computed and written, in this order, and written in one transaction: the database is locked for
    no longer than that takes, and there is nothing half done to be made up for after a crash. Whoever changes the axis
    in between (another process) makes the writing fail, and the request is sent again.
    """

    def __init__(
        self,
        database: Database,
        waveforms: WaveformStore,
        lanes: Lanes,
        metrics: Metrics,
        follow_alarm: Callable[[str], None],
    ) -> None:
        self._database = database
        self._waveforms = waveforms
        self._follow_alarm = follow_alarm  # told the axis that a measurement left in alarm
        self._in_force = CalibrationsInForce()
        self._lanes = lanes
        self._metrics = metrics

    def ingest(self, axis_id: str, windows: Sequence[Window], *, complete: bool) -> IngestReceipt:
        """Store windows durably, and judge the measurements that they complete.

        Raises ConflictError if another window is stored (or posted) with the same start; StorageError or BusyError if
        disk or database did not take it; it may be sent again. Whatever is raised, nothing of the request is stored.
        """
        names = {window.measurement for window in windows}
        with self._lanes.of(axis_id), self._database.connect() as connection:
            known = self._read(connection, axis_id, windows, names)
            new = _new_windows(axis_id, windows, known.contents)
            judged_before = [row.outcome for row in known.measurements.values() if row.outcome is not None]
            again = [window for window in windows if window.started_at in known.contents]
            healed = heal(connection, self._waveforms, axis_id, again, now())
            admission, verdicts = self._take(connection, known, new, names if complete else set())
        refusals = {item.window.started_at: item.refusal for item in admission.admitted}
        receipts = tuple(_receipts(windows, refusals, healed))
        self._count(receipts, verdicts)
        if known.configuration.drive_model is not None and _leave_in_alarm(verdicts):
            self._follow_alarm(axis_id)
        return IngestReceipt(receipts, (*(verdict.document for verdict in verdicts), *judged_before))

    def _read(self, connection: Connection, axis_id: str, windows: Collection[Window], names: Iterable[str]) -> _Known:
        with reading(connection):
            axis, measurements = intake.read_axis(connection, axis_id, names)
            return _Known(
                axis,
                load_configuration(axis.configuration),
                self._in_force.of(connection, axis),
                intake.contents_at(connection, axis, {window.started_at for window in windows}),
                measurements,
            )

    def _take(
        self, connection: Connection, known: _Known, new: Sequence[Window], complete_names: set[str]
    ) -> tuple[Admission, list[Verdict]]:
        """Write the waveforms, gate and judge meanwhile, then commit all of it."""
        received_at = now()
        with ExitStack() as files:
            frame = files.enter_context(self._waveforms.begin_write(known.axis.id, new, received_at)) if new else None
            admission = self._admit(known, new)
            judged = [
                (row, self._judge(connection, row, known, admission)) for row in admission.complete(complete_names)
            ]
            if frame is None and not judged:
                return admission, []
            places = [] if frame is None else frame.sync()
            with writing(connection):
                for row in admission.changed():
                    intake.save_admitted(connection, row)
                if places:
                    intake.add_windows(connection, _window_rows(admission, places, received_at))
                verdicts = [record(connection, known.axis, row, outcome, known.calibration) for row, outcome in judged]
                if frame is not None:
                    frame.keep()  # before the commit: one that fails may yet have happened (a lost connection)
        return admission, verdicts

    def _admit(self, known: _Known, windows: Iterable[Window]) -> Admission:
        settings = core_settings(known.configuration)
        admission = Admission(known.axis.id, known.configuration, known.measurements)
        for window in windows:
            quality = check_window(window, settings, known.calibration)
            admission.admit(window, quality if isinstance(quality, Rejection) else None)
        return admission

    def _judge(
        self, connection: Connection, row: MeasurementRecord, known: _Known, admission: Admission
    ) -> MeasurementOutcome:
        with self._metrics.judging.time():
            return judge(self._accepted(connection, row, admission), known.configuration, known.calibration)

    def _accepted(
        self, connection: Connection, row: MeasurementRecord, admission: Admission
    ) -> list[Window] | Rejection:
        """Return the accepted windows of a measurement, those of this request and those on disk, in time order."""
        windows = [item.window for item in admission.admitted if item.measurement is row and item.refusal is None]
        if row.id is not None and len(windows) < row.n_accepted:
            try:
                with reading(connection):
                    places = accepted_places(connection, row.id)
                windows += self._waveforms.read(places)
            except WaveformDamagedError as error:
                return Rejection(RejectionReason.WAVEFORM_DAMAGED, str(error))
        return sorted(windows, key=lambda window: window.started_at)

    def _count(self, receipts: Iterable[WindowReceipt], verdicts: Iterable[Verdict]) -> None:
        for receipt in receipts:
            self._metrics.windows.labels(receipt.reason or str(receipt.status)).inc()
        for verdict in verdicts:
            self._metrics.measurements.labels(verdict.outcome).inc()
            if verdict.alarm is not None:
                self._metrics.alarms.labels(verdict.alarm).inc()


def _leave_in_alarm(verdicts: Sequence[Verdict]) -> bool:
    return bool(verdicts) and verdicts[-1].state is TrendStatus.ALARM


def _new_windows(axis_id: str, posted: Iterable[Window], stored: Mapping[datetime, str]) -> list[Window]:
    """Return the windows that are not stored yet, in time order."""
    new: dict[datetime, Window] = {}
    for window in posted:
        start = window.started_at
        if start not in stored and start not in new:
            new[start] = window
        elif content_sha256(window) != (stored[start] if start in stored else content_sha256(new[start])):
            raise ConflictError(
                f"axis '{axis_id}' has another window that started at {start.isoformat()}; "
                "a window is never replaced, and nothing of this request was stored"
            )
    return [new[start] for start in sorted(new)]


def _window_rows(
    admission: Admission, places: Iterable[WaveformPlace], received_at: datetime
) -> Iterator[WindowRecord]:
    return (
        WindowRecord(
            axis_id=admission.axis_id,
            measurement_id=item.measurement.id,
            started_at=item.window.started_at,
            received_at=received_at,
            content_sha256=place.content_sha256,
            file_path=place.path,
            offset_in_file=place.offset,
            index_in_frame=place.index,
            refusal_reason=None if item.refusal is None else str(item.refusal.reason),
            refusal_detail=None if item.refusal is None else item.refusal.detail[:500],
        )
        for item, place in zip(admission.admitted, places, strict=True)
    )


def _receipts(
    windows: Sequence[Window], refusals: Mapping[datetime, Rejection | None], healed: Collection[datetime]
) -> Iterator[WindowReceipt]:
    """Answer each posted window; one that stands twice in a request is already there the second time."""
    answered: set[datetime] = set()
    for window in windows:
        refusal = refusals.get(window.started_at)
        if window.started_at in healed and window.started_at not in answered:
            yield WindowReceipt(window.started_at, window.measurement, WindowStatus.ALREADY_THERE, *RESTORED)
        elif window.started_at not in refusals or window.started_at in answered:
            yield WindowReceipt(window.started_at, window.measurement, WindowStatus.ALREADY_THERE)
        elif refusal is None:
            yield WindowReceipt(window.started_at, window.measurement, WindowStatus.ACCEPTED)
        else:
            yield WindowReceipt(
                window.started_at, window.measurement, WindowStatus.REFUSED, str(refusal.reason), refusal.detail
            )
        answered.add(window.started_at)
