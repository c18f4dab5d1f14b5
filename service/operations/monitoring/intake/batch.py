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
from monitor_core.recordings.elements.units import to_millimetres
from service.clock import now, text_of
from service.documents.stored_measurement import StoredMeasurement
from service.errors import ConflictError, WaveformDamagedError
from service.observability import Metrics
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings, load_configuration
from service.operations.monitoring.intake.admission import Admission, Measured
from service.operations.monitoring.intake.charts import remember_law, too_late
from service.operations.monitoring.intake.judge import Judged, Settled, judge, settle
from service.store import intake
from service.store.calibrations import CalibrationsInForce
from service.store.database import reading
from service.store.intake import OPEN, AxisRecord, ChartsRecord, MeasurementRecord, StoredMember, WindowRecord
from service.store.lookup import Remembered
from service.store.measurements import places_at
from service.store.retention import let_go
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
    """One request: windows of an axis, and which measurements are complete with them."""

    axis_id: str
    windows: Sequence[Window]
    complete: bool = False  # the measurements that these windows are of
    overdue: frozenset[int] = frozenset()  # numbers of measurements that are complete besides
    answer: Future[IngestReceipt] = field(default_factory=Future)


#: Of axes; then all are forgotten, and those that send are read again.
MOST_KNOWN = 5000


class KnownAxes:
    """Remembers the configuration and the calibration of each axis for as long as its row says the same."""

    def __init__(self) -> None:
        self._calibrations = CalibrationsInForce()
        self._configurations = Remembered(MOST_KNOWN)

    def calibration_of(self, connection: Connection, axis: AxisRecord) -> Calibration | None:
        """Return the calibration in force on an axis."""
        return self._calibrations.of(connection, axis)

    def configuration_of(self, axis: AxisRecord) -> AxisConfiguration:
        """Return the configuration of an axis; raises DocumentDamagedError if it cannot be read."""
        return self._configurations.of(axis.id, axis.configuration, lambda: load_configuration(axis.configuration))


class _History:
    """The stored measurements of an axis, as far as they were asked for; each is one record however often."""

    def __init__(self, connection: Connection, axis: AxisRecord) -> None:
        self._connection, self._axis = connection, axis
        self._charts: ChartsRecord | None = None
        self._known: dict[int, Measured] = {}

    def called(self, name: str, since: datetime, until: datetime) -> list[Measured]:
        """Return the measurements of one name that lie between two moments, or reach there, in time order."""
        return self._of(intake.measurements_called(self._connection, self._axis.id, name, since, until))

    def numbered(self, numbers: Iterable[int]) -> list[Measured]:
        """Return some measurements of the axis; one that is gone is left out."""
        wanted = set(numbers)
        new = wanted - self._known.keys()
        self._of(intake.measurements_numbered(self._connection, self._axis.id, new))
        return [self._known[number] for number in sorted(wanted & self._known.keys())]

    def members_of(self, row: MeasurementRecord) -> list[StoredMember]:
        """Return the windows that tell what a measurement is made of, in time order."""
        return intake.members_of(self._connection, row)

    def closed(self, row: MeasurementRecord) -> str | None:
        """Say why a measurement that was judged takes no more windows, if so."""
        if row.status == OPEN or row.id is None:
            return None
        if self._charts is None:
            self._charts = intake.read_charts(self._connection, self._axis)
        if too_late(self._charts, row.started_at):
            return f"measurement '{row.name}' was {row.status} too long before this window arrived"
        gone = let_go(self._connection, [row.id]).get(row.id)
        return None if gone is None else f"the other windows of measurement '{row.name}' were {gone}"

    def _of(self, rows: Iterable[MeasurementRecord]) -> list[Measured]:
        found = []
        for row in rows:
            if row.id is None:
                continue
            was = [] if row.status == OPEN else [(row.started_at, row.id)]
            found.append(self._known.setdefault(row.id, Measured(row, was)))
        return found


class Batch:
    """Requests to one axis on their way: read, gated and judged first; then written, in the transaction of several."""

    def __init__(self, connection: Connection, axis_id: str, posts: Sequence[Post], known: KnownAxes) -> None:
        starts = {window.started_at for post in posts for window in post.windows}
        with reading(connection):
            self.axis: AxisRecord = intake.read_axis(connection, axis_id)
            if self.axis.archived_at is not None and starts:
                raise ConflictError(
                    f"axis '{axis_id}' is archived since {text_of(self.axis.archived_at)} and takes no windows; "
                    f"DELETE /v1/axes/{axis_id}/archive takes that back"
                )
            self._contents = intake.contents_at(connection, self.axis, starts)
            self.calibration: Calibration | None = known.calibration_of(connection, self.axis)
        self.configuration = known.configuration_of(self.axis)
        self.posts: list[Post] = []
        self._new: dict[datetime, Window] = {}
        for post in posts:
            self._add(post)
        self._healed: set[datetime] = set()
        self._frame: Writing | None = None
        self._judged: list[Judged] = []
        self._said_before: dict[int, StoredMeasurement] = {}

    def compute(self, connection: Connection, waveforms: WaveformStore, files: ExitStack, metrics: Metrics) -> None:
        """Begin to write the waveforms, and gate and judge meanwhile."""
        again = [window for post in self.posts for window in post.windows if window.started_at in self._contents]
        self._healed = heal(connection, waveforms, self.axis.id, again, now())
        new, self._received_at = [self._new[start] for start in sorted(self._new)], now()
        if new:
            self._frame = files.enter_context(waveforms.begin_write(self.axis.id, new, self._received_at))
        settings = core_settings(self.configuration)
        refusals = {window.started_at: check_window(window, settings, self.calibration) for window in new}
        with reading(connection):
            history = _History(connection, self.axis)
            self._admission = Admission(self.axis.id, self.configuration, self._received_at, history)
            self._admission.admit(new, lambda window: refusals[window.started_at])
            stored = {number for _, number in self._contents.values()}
            overdue = set[int]().union(*(post.overdue for post in self.posts))
            self._stored = {measurement.row.id: measurement for measurement in history.numbered(stored | overdue)}
            said = {measurement for post in self.posts for measurement in self._measured(post, only_complete=True)}
            complete = self._admission.complete(said)
            for measurement in complete:
                self._admission.load(measurement)
            named = {measurement for post in self.posts for measurement in self._measured(post)}
            self._said_before = self._outcomes(connection, named - set(complete))  # these are said anew
        for measurement in complete:
            with metrics.judging.time():
                self._judged.append(self._judge(connection, waveforms, measurement))
        if self._judged and self.calibration is None and self.configuration.drive_model is not None:
            with reading(connection):
                charts = intake.read_charts(connection, self.axis)
            starts = [at for item in self._judged for at in (item.measurement.started_at, *(at for at, _ in item.was))]
            remember_law(self.axis, charts, min(starts))

    def _measured(self, post: Post, *, only_complete: bool = False) -> list[Measured]:
        """Return the measurements that the windows of a request are of, and those that are overdue, each once."""
        windows = () if only_complete and not post.complete else post.windows
        found = dict.fromkeys(self._of(window.started_at) for window in windows)
        overdue = (self._stored.get(number) for number in post.overdue)
        return [measurement for measurement in (*found, *overdue) if measurement is not None]

    def _of(self, start: datetime) -> Measured | None:
        """Return the measurement that a window is of."""
        measurement = self._admission.measured.get(start)
        if measurement is None and start in self._contents:
            measurement = self._stored.get(self._contents[start][1])
        return measurement if measurement is None else self._admission.joined.get(measurement, measurement)

    @property
    def empty(self) -> bool:
        """Whether there is nothing to store."""
        return self._frame is None and not self._judged

    def sync(self) -> list[WaveformPlace]:
        """Wait until the waveforms are on disk."""
        return [] if self._frame is None else self._frame.sync()

    def store(self, connection: Connection, places: Sequence[WaveformPlace]) -> Settled | None:
        """Write everything in the transaction that is open; None: charts and counts of the axis stay as they are."""
        for measurement in self._admission.changed():
            if measurement.row.status == OPEN:
                intake.save_measurement(connection, measurement.row)
        intake.add_windows(connection, self._window_records(places))
        for start, _, measurement in self._admission.moved:
            intake.move_window(connection, self.axis.id, start, _number(measurement))
        for before, measurement in dict.fromkeys((before, to) for _, before, to in self._admission.moved):
            intake.keep_pinned(connection, _number(before), _number(measurement))
        for gone, measurement in self._admission.joined.items():
            intake.join_measurement(connection, gone.row, _number(measurement))
        settled = settle(connection, self.axis, self._judged, self.calibration, refused_windows=self._refusals())
        if self._frame is not None:
            self._frame.keep()  # before the commit: one that fails may yet have happened (a lost connection)
        return settled

    def receipt(self, post: Post, settled: Settled | None) -> IngestReceipt:
        """Return the answer to one of the requests; a window that stands in two is already there in the second."""
        documents = self._said_before | ({} if settled is None else settled.measurements)
        admitted = {item.placed.started_at: item for item in self._admission.admitted}
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
        named = [
            documents[number] for measurement in self._measured(post) if (number := measurement.row.id) in documents
        ]
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
                self._contents[start][0] if same_start is None else content_sha256(same_start)
            ):
                post.answer.set_exception(
                    ConflictError(
                        f"axis '{self.axis.id}' has another window that started at {text_of(start)}; "
                        "a window is never replaced, and nothing of this request was stored: "
                        "state when a recording began whose file does not say it"
                    )
                )
                return
        self._new |= new
        self.posts.append(post)

    def _judge(self, connection: Connection, waveforms: WaveformStore, measurement: Measured) -> Judged:
        """Judge a measurement by all its windows, those of this request and those on disk."""
        accepted = [member for member in measurement.members if member.accepted]
        stored = [member.placed.started_at for member in accepted if not member.is_new]

        def places() -> list[WaveformPlace]:
            with reading(connection):
                return places_at(connection, self.axis.id, stored)

        try:
            windows = waveforms.read_where_they_lie(places) if stored else []
        except WaveformDamagedError as error:
            damaged = Rejection(RejectionReason.WAVEFORM_DAMAGED, str(error))
            return Judged(measurement.row, judge(damaged, self.configuration, self.calibration), measurement.was)
        windows += [self._new[member.placed.started_at] for member in accepted if member.is_new]
        windows.sort(key=lambda window: window.started_at)
        outcome = judge(windows, self.configuration, self.calibration)
        return Judged(measurement.row, outcome, measurement.was, windows[0] if windows else None, len(windows))

    def _outcomes(self, connection: Connection, measured: Iterable[Measured]) -> dict[int, StoredMeasurement]:
        """Return what was said about measurements that were judged before, by number."""
        judged = {
            measurement.row.id: measurement.row
            for measurement in measured
            if measurement.row.status != OPEN and measurement.row.id is not None
        }
        outcomes = intake.outcomes_of(connection, list(judged)) if judged else {}
        return {
            number: StoredMeasurement.of(
                document, point_of(connection, self.axis.number, judged[number].started_at, number)
            )
            for number, document in outcomes.items()
        }

    def _window_records(self, places: Sequence[WaveformPlace]) -> list[WindowRecord]:
        return [
            WindowRecord(
                axis_id=self.axis.id,
                measurement_id=None if item.of is None else item.of.row.id,
                started_at=item.placed.started_at,
                received_at=self._received_at,
                content_sha256=place.content_sha256,
                file_path=place.path,
                offset_in_file=place.offset,
                index_in_frame=place.index,
                refusal_reason=None if item.refusal is None else str(item.refusal.reason),
                refusal_detail=None if item.refusal is None else item.refusal.detail[: intake.LONGEST_DETAIL],
                ended_at=item.placed.ended_at,
                position_mm=to_millimetres(item.placed.position),
                set_preload_n=item.placed.preload,
            )
            for item, place in zip(self._admission.admitted, places, strict=True)
        ]

    def _refusals(self) -> Counter[str]:
        """Count the refused windows of this batch."""
        return Counter(str(item.refusal.reason) for item in self._admission.admitted if item.refusal is not None)


def _number(measurement: Measured) -> int:
    if measurement.row.id is None:
        raise AssertionError(f"measurement '{measurement.row.name}' is stored before its windows")
    return measurement.row.id


def by_axis(posts: Iterable[Post]) -> Mapping[str, list[Post]]:
    """Return requests by their axis, in order."""
    axes: dict[str, list[Post]] = {}
    for post in posts:
        axes.setdefault(post.axis_id, []).append(post)
    return axes
