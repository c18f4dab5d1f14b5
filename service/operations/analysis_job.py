"""Jobs that analyse what was measured of an axis: ask, measure, analyse in a process of its own, store the answer.

What was measured are stored measurements of the axis, or peaks that come with the question.
"""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, ClassVar, Generic, Literal, Self, TypeVar

from pydantic import Field, model_validator

from monitor_core.errors import NotIdentifiableError
from monitor_core.models import DriveConditions
from monitor_core.recordings.elements.units import metres
from service.errors import UnknownResourceError
from service.jobs import JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.fields import Frequency, Moment, Number, Payload, Place, RequestModel, ScatterHz, SetPreload
from service.operations.monitoring.axis_configuration import core_settings, load_configuration
from service.operations.monitoring.stored_modes import measured_with_windows
from service.operations.own_process import Progress, Report, in_own_process
from service.store import jobs, measurements
from service.store.axes import get_axis
from service.store.database import Database
from service.store.jobs import ReportStore
from service.store.retention import require_stored
from service.store.tables import JobRow, MeasurementRow
from service.store.waveforms import WaveformStore

if TYPE_CHECKING:
    from monitor_core.fitting.axis import AxisDescription
    from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
    from monitor_core.measured_responses import SessionResponses


class MeasurementRange(RequestModel):
    """Stored measurements whose preload was set on purpose, by time."""

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")


class PeakIn(RequestModel):
    """One measured peak of the table's receptance."""

    position_mm: Place
    frequency_hz: Frequency
    frequency_standard_uncertainty_hz: ScatterHz | None = None
    amplitude_m_per_n: Annotated[Number, Field(ge=1e-18, le=1)] | None = None
    preload_n: SetPreload | None = None
    payload_kg: Payload | None = None

    def to_core(self) -> "ModalObservation":
        """Return the core's record, in SI units."""
        from monitor_core.fitting.observations import ModalObservation  # noqa: PLC0415  # a start pays for no analysis

        return ModalObservation(
            DriveConditions(metres(self.position_mm), self.preload_n, self.payload_kg or 0.0),
            self.frequency_hz,
            self.frequency_standard_uncertainty_hz,
            amplitude=self.amplitude_m_per_n,
        )


AccelerometerPlace = Annotated[
    Literal["table", "nut"],
    Field(description="where it sat on the measurements; without it where the model explains them better"),
]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What was measured of an axis, and what was settled on the way, in sentences."""

    observations: "tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...]"
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer as it is stored."""

    document: JsonObject
    page: str | None = None  # a report, one self-contained page of HTML


class AnalysisArguments(RequestModel):
    """What is asked, and what was measured: stored measurements, or peaks."""

    #: Name of the member that is the model of the axis, TOML.
    described_by: ClassVar[str]
    #: Of its jobs.
    kind: ClassVar[str]
    #: Reported until the analysis reports its own.
    first: ClassVar[Progress]

    measurements: MeasurementRange | None = None
    peaks: Annotated[list[PeakIn] | None, Field(min_length=1, max_length=1000)] = None
    hold_out_mm: Annotated[list[Place], Field(max_length=100)] = Field(default=[])
    accelerometer: AccelerometerPlace | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.measurements is None) == (self.peaks is None):
            raise ValueError("exactly one of measurements and peaks is expected; got both or none")
        if self.accelerometer is not None and self.measurements is None:
            raise ValueError("accelerometer goes with measurements; peaks are of the table")
        return self

    def axis(self) -> "AxisDescription":
        """Return what the axis is said to be; raises MonitorCoreError if that cannot be read."""
        from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415  # a start pays for no analysis

        return parse_model(getattr(self, self.described_by), self.described_by)

    def require(self, measured: Measured) -> None:
        """Refuse at once what cannot be answered; raises MonitorCoreError with the reason in one sentence."""
        raise NotImplementedError

    def answer(self, axis_id: str, measured: Measured, report: Report) -> Answer:
        """Answer it of an axis, in a process of its own; raises as :meth:`require`."""
        raise NotImplementedError

    @property
    def range(self) -> MeasurementRange:
        """Which stored measurements are asked for, where no peaks were posted."""
        return self.measurements or MeasurementRange()

    @property
    def hold_out(self) -> tuple[float, ...]:
        """Positions to be held out. [m]."""
        return tuple(metres(position) for position in self.hold_out_mm)


#: More measurements than this at once were meant for a trend.
MOST_MEASUREMENTS = 200


def axis_measurements(
    database: Database, waveforms: WaveformStore, axis_id: str, chosen: MeasurementRange
) -> "SessionResponses":
    """Return the responses of stored measurements.

    Raises NotIdentifiableError as :func:`selected_measurements`, or if none of them can be judged.
    """
    from monitor_core.measured_responses import responses_of_windows  # noqa: PLC0415  # a start pays for no analysis

    with database.read() as session:
        configuration = load_configuration(get_axis(session, axis_id).configuration)
    rows = selected_measurements(database, axis_id, chosen)
    return responses_of_windows(measured_with_windows(database, waveforms, core_settings(configuration), rows))


def selected_measurements(database: Database, axis_id: str, chosen: MeasurementRange) -> list[MeasurementRow]:
    """Return the rows of the stored measurements that are asked for.

    Raises NotIdentifiableError if there is none, or more than can have been meant; LetGoError if the waveforms of one
    were let go.
    """
    with database.read() as session:
        rows = measurements.looked_at(session, axis_id, chosen.start, chosen.end, MOST_MEASUREMENTS)
    if not 0 < len(rows) <= MOST_MEASUREMENTS:
        got = "none" if not rows else "more"
        raise NotIdentifiableError(
            f"expected 1 to {MOST_MEASUREMENTS} measurements that were looked at; axis '{axis_id}' has {got} in that "
            "range"
        )
    with database.read() as session:
        require_stored(session, [row.id for row in rows])
    return rows


#: How many finished ones the page of an axis lists.
MOST_LISTED = 10


Arguments = TypeVar("Arguments", bound=AnalysisArguments)


class AnalysisJob(Generic[Arguments]):
    """Runs one kind of analysis in the background."""

    def __init__(
        self,
        arguments: type[Arguments],
        database: Database,
        waveforms: WaveformStore,
        reports: ReportStore,
        runner: JobRunner,
    ) -> None:
        self.kind = arguments.kind
        self._arguments = arguments
        self._database = database
        self._waveforms = waveforms
        self._reports = reports
        self._runner = runner
        runner.work[self.kind] = self.run

    def start(self, axis_id: str, asked: Arguments) -> JobRow:
        """Begin; what cannot be answered is refused at once, as far as that shows without measuring.

        ``MonitorCoreError`` or ``ServiceError`` with the reason in one sentence.
        """
        with self._database.read() as session:
            get_axis(session, axis_id)
        if asked.peaks is not None:
            asked.require(self._measured(axis_id, asked))
        else:
            asked.axis()
            selected_measurements(self._database, axis_id, asked.range)
        return self._runner.submit(self.kind, axis_id, asked.model_dump(mode="json", by_alias=True))

    def run(self, job: JobHandle) -> None:
        """Answer; begun anew if it was interrupted."""
        asked = self._arguments.model_validate(job.arguments)
        work = partial(asked.answer, job.axis_id, self._measured(job.axis_id, asked))
        latest = asked.first

        def report(progress: Progress) -> None:
            nonlocal latest
            latest = progress
            job.say(progress.done, progress.total, progress.sentence)

        answer = in_own_process(work, report, latest)
        if answer.page is not None:
            self._reports.write(job.job_id, answer.page)
        steps = latest.total or max(latest.done, 1)
        job.report(steps, steps, answer.document)

    def report(self, axis_id: str, job_id: str) -> str:
        """Return the page of a finished job, HTML.

        ``UnknownResourceError`` if there is no such job of the axis, or it has no answer.
        """
        with self._database.read() as session:
            row = jobs.get_job(session, job_id)
        if (row.kind, row.axis_id, row.status) != (self.kind, axis_id, jobs.DONE):
            raise UnknownResourceError(f"axis '{axis_id}' has no finished job of kind {self.kind} '{job_id}'")
        return self._reports.read(job_id)

    def _measured(self, axis_id: str, asked: Arguments) -> Measured:
        if asked.peaks is not None:
            return Measured(tuple(peak.to_core() for peak in asked.peaks))
        responses = axis_measurements(self._database, self._waveforms, axis_id, asked.range)
        return Measured(responses.observations, responses.sentences)
