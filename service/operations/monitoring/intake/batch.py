"""Take the requests to one axis together: gate, judge and store their windows."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from sqlalchemy import Connection

from monitor_core.pipeline import check_window
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from service.clock import now, text_of
from service.documents.stored_measurement import StoredMeasurement
from service.errors import ConflictError, WaveformDamagedError
from service.json_types import JsonObject
from service.observability import Metrics
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings, load_configuration
from service.operations.monitoring.intake.admission import Admission, at_its_position, counts
from service.operations.monitoring.intake.charts import too_late
from service.operations.monitoring.intake.judge import Judged, Settled, judge, settle
from service.store import intake
from service.store.calibrations import CalibrationsInForce
from service.store.database import reading
from service.store.intake import OPEN, AxisRecord, MeasurementRecord, WindowRecord
from service.store.measurements import member_places
from service.store.retention import LetGo, let_go
from service.store.safekeeping.verification import heal
from service.store.trend.points import point_of
from service.store.waveforms import WaveformPlace, WaveformStore, Writing
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
    measurements: tuple[StoredMeasurement, ...]  # outcomes of those judged now, and of those posted again


@dataclass(frozen=True, slots=True)
class Post:
    """One request: windows of an axis, and the measurements that are complete with them."""

    axis_id: str
    windows: Sequence[Window]
    complete: frozenset[str]
    answer: Future[IngestReceipt] = field(default_factory=Future)

    @property
    def names(self) -> set[str]:
        """The measurements that it is about."""
        return {window.measurement for window in self.windows} | self.complete


#: Of axes; then all are forgotten, and those that send are read again.
MOST_KNOWN = 5000


class KnownAxes:
    """Remembers the configuration and the calibration of each axis for as long as its row says the same."""

    def __init__(self) -> None:
        self._calibrations = CalibrationsInForce()
        self._configurations: dict[str, tuple[JsonObject, AxisConfiguration]] = {}

    def calibration_of(self, connection: Connection, axis: AxisRecord) -> Calibration | None:
        """Return the calibration in force on an axis."""
        return self._calibrations.of(connection, axis)

    def configuration_of(self, axis: AxisRecord) -> AxisConfiguration:
        """Return the configuration of an axis; raises DocumentDamagedError if it cannot be read."""
        remembered = self._configurations.get(axis.id)
        if remembered is None or remembered[0] != axis.configuration:
            remembered = axis.configuration, load_configuration(axis.configuration)
            if len(self._configurations) >= MOST_KNOWN:
                self._configurations.clear()
            self._configurations[axis.id] = remembered
        return remembered[1]


class Batch:
    """Requests to one axis on their way: read, gated and judged first; then written, in the transaction of several."""

    def __init__(self, connection: Connection, axis_id: str, posts: Sequence[Post], known: KnownAxes) -> None:
        names = set().union(*(post.names for post in posts))
        starts = {window.started_at for post in posts for window in post.windows}
        with reading(connection):
            self.axis: AxisRecord = intake.read_axis(connection, axis_id)
            if self.axis.archived_at is not None and starts:
                raise ConflictError(
                    f"axis '{axis_id}' is archived since {text_of(self.axis.archived_at)} and takes no windows; "
                    f"DELETE /v1/axes/{axis_id}/archive takes that back"
                )
            self._contents = intake.contents_at(connection, self.axis, starts)
            self._measurements = intake.read_measurements(connection, axis_id, names)
            self._closed = self._too_late(connection)
            self.calibration: Calibration | None = known.calibration_of(connection, self.axis)
            self._said_before = self._outcomes(connection, self._measurements.values())
        self.configuration = known.configuration_of(self.axis)
        self.posts: list[Post] = []
        self._new: dict[datetime, Window] = {}
        for post in posts:
            self._add(post)
        self._healed: set[datetime] = set()
        self._frame: Writing | None = None
        self._judged: list[Judged] = []

    def compute(self, connection: Connection, waveforms: WaveformStore, files: ExitStack, metrics: Metrics) -> None:
        """Begin to write the waveforms, and gate and judge meanwhile."""
        again = [window for post in self.posts for window in post.windows if window.started_at in self._contents]
        self._healed = heal(connection, waveforms, self.axis.id, again, now())
        new, self._received_at = [self._new[start] for start in sorted(self._new)], now()
        if new:
            self._frame = files.enter_context(waveforms.begin_write(self.axis.id, new, self._received_at))
        settings = core_settings(self.configuration)
        self._admission = Admission(
            self.axis.id, self.configuration, self._received_at, self._measurements, self._closed
        )
        self._admission.let_go = self._let_go(connection)
        was_judged_at = {row.name: row.started_at for row in self._measurements.values() if row.status != OPEN}
        for window in new:
            self._admission.admit(window, check_window(window, settings, self.calibration))
        complete = set().union(*(post.complete for post in self.posts))
        for row in self._admission.complete(complete):
            with metrics.judging.time():
                self._judged.append(self._judge(connection, waveforms, row, was_judged_at.get(row.name)))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to store."""
        return self._frame is None and not self._judged

    def sync(self) -> list[WaveformPlace]:
        """Wait until the waveforms are on disk."""
        return [] if self._frame is None else self._frame.sync()

    def store(self, connection: Connection, places: Sequence[WaveformPlace]) -> Settled | None:
        """Write everything in the transaction that is open; None: charts and counts of the axis stay as they are."""
        for row in self._admission.changed():
            intake.save_measurement(connection, row)
        intake.add_windows(connection, self._window_records(places))
        settled = settle(connection, self.axis, self._judged, self.calibration, refused_windows=self._refusals())
        if self._frame is not None:
            self._frame.keep()  # before the commit: one that fails may yet have happened (a lost connection)
        return settled

    def receipt(self, post: Post, settled: Settled | None) -> IngestReceipt:
        """Return the answer to one of the requests; a window that stands in two is already there in the second."""
        documents = self._said_before | ({} if settled is None else settled.measurements)
        admitted = {item.window.started_at: item for item in self._admission.admitted}
        receipts = []
        for window in post.windows:
            start, status, why = window.started_at, WindowStatus.ALREADY_THERE, tuple[str, ...]()
            if start in self._healed:
                self._healed.discard(start)
                why = RESTORED
            elif (item := admitted.get(start)) is not None and self._new.pop(start, None) is not None:
                status = WindowStatus.ACCEPTED
                if item.refusal is not None:
                    status, why = WindowStatus.REFUSED, (str(item.refusal.reason), item.refusal.detail)
            receipts.append(WindowReceipt(start, window.measurement, status, *why))
        named = [measured for name, measured in documents.items() if name in post.names]
        return IngestReceipt(tuple(receipts), tuple(sorted(named, key=lambda measured: str(measured.started_at))))

    def _add(self, post: Post) -> None:
        """Take the windows of a request that are not stored yet; the whole request is refused if one contradicts."""
        new: dict[datetime, Window] = {}
        for window in post.windows:
            start = window.started_at
            same_start = new.get(start) or self._new.get(start)
            if same_start is None and start not in self._contents:
                new[start] = window
            elif content_sha256(window) != (
                self._contents[start] if same_start is None else content_sha256(same_start)
            ):
                post.answer.set_exception(
                    ConflictError(
                        f"axis '{self.axis.id}' has another window that started at {text_of(start)}; "
                        "a window is never replaced, and nothing of this request was stored"
                    )
                )
                return
        self._new |= new
        self.posts.append(post)

    def _too_late(self, connection: Connection) -> frozenset[str]:
        """Return the names of the measurements that were judged too long ago to take more."""
        judged = [row for row in self._measurements.values() if row.status != OPEN]
        if not judged:
            return frozenset()  # as it should be: the charts are not asked
        charts = intake.read_charts(connection, self.axis)
        return frozenset(row.name for row in judged if too_late(charts, row.started_at))

    def _judge(
        self, connection: Connection, waveforms: WaveformStore, row: MeasurementRecord, was_judged_at: datetime | None
    ) -> Judged:
        """Judge a measurement by all its windows, those of this request and those on disk."""
        try:
            windows, stored = self._members(connection, waveforms, row)
        except WaveformDamagedError as error:
            damaged = Rejection(RejectionReason.WAVEFORM_DAMAGED, str(error))
            return Judged(row, judge(damaged, self.configuration, self.calibration), was_judged_at)
        refusals = at_its_position(windows, self.configuration.position_span_limit_mm)
        accepted = sorted(
            (window for window in windows if refusals[window.started_at] is None), key=lambda window: window.started_at
        )
        for item in self._admission.admitted:
            if item.measurement is row and counts(item.refusal):
                item.refusal = refusals[item.window.started_at]
        changed = {start: refusals[start] for start in stored if (refusals[start] is None) != stored[start]}
        outcome = judge(accepted, self.configuration, self.calibration)
        return Judged(row, outcome, was_judged_at, accepted[0] if accepted else None, len(accepted), changed)

    def _members(
        self, connection: Connection, waveforms: WaveformStore, row: MeasurementRecord
    ) -> tuple[list[Window], dict[datetime, bool]]:
        """Return the windows of a measurement, and of those stored before whether they were accepted."""
        windows = [item.window for item in self._admission.admitted if item.measurement is row and counts(item.refusal)]
        number, members = row.id, list[tuple[WaveformPlace, bool]]()
        if number is None:
            return windows, {}

        def places() -> list[WaveformPlace]:
            with reading(connection):
                members[:] = member_places(connection, number)
            return [place for place, _ in members]

        stored = waveforms.read_where_they_lie(places)
        accepted = {window.started_at: own for window, (_, own) in zip(stored, members, strict=True)}
        return windows + stored, accepted

    def _let_go(self, connection: Connection) -> dict[int, LetGo]:
        """Return which of the measurements that are judged, and get more windows, have lost some to a purge."""
        named = {window.measurement for window in self._new.values()}
        judged = [
            row.id
            for name, row in self._measurements.items()
            if row.status != OPEN and row.id is not None and name in named
        ]
        if not judged:
            return {}
        with reading(connection):
            return let_go(connection, judged)

    def _outcomes(self, connection: Connection, rows: Iterable[MeasurementRecord]) -> dict[str, StoredMeasurement]:
        """Return what was said about measurements that were judged before, by name."""
        judged = {row.id: row for row in rows if row.status != OPEN and row.id is not None}
        outcomes = intake.outcomes_of(connection, list(judged)) if judged else {}
        points = {
            number: point_of(connection, self.axis.number, judged[number].started_at, number) for number in outcomes
        }
        return {
            judged[number].name: StoredMeasurement.of(document, points[number]) for number, document in outcomes.items()
        }

    def _window_records(self, places: Sequence[WaveformPlace]) -> list[WindowRecord]:
        return [
            WindowRecord(
                axis_id=self.axis.id,
                measurement_id=item.measurement.id,
                started_at=item.window.started_at,
                received_at=self._received_at,
                content_sha256=place.content_sha256,
                file_path=place.path,
                offset_in_file=place.offset,
                index_in_frame=place.index,
                refusal_reason=None if item.refusal is None else str(item.refusal.reason),
                refusal_detail=None if item.refusal is None else item.refusal.detail[: intake.LONGEST_DETAIL],
            )
            for item, place in zip(self._admission.admitted, places, strict=True)
        ]

    def _refusals(self) -> Counter[str]:
        """Count the refused windows of this batch, less those stored before that turn out to be accepted."""
        refused = Counter(str(item.refusal.reason) for item in self._admission.admitted if item.refusal is not None)
        changed = [refusal for item in self._judged for refusal in item.changed.values()]
        mismatch = str(RejectionReason.POSITION_MISMATCH)
        refused[mismatch] += sum(-1 if refusal is None else 1 for refusal in changed)
        return refused


def by_axis(posts: Iterable[Post]) -> Mapping[str, list[Post]]:
    """Return requests by their axis, in order."""
    axes: dict[str, list[Post]] = {}
    for post in posts:
        axes.setdefault(post.axis_id, []).append(post)
    return axes
