"""Jobs that judge the history of an axis anew under another calibration, or only say what that would change.

Measurement by measurement is judged aside, as intake judges it; meanwhile the axis says what it said. At the end all
of it takes the place of the old history in one transaction. A job that was interrupted goes on with what is left.
"""

from collections.abc import Iterator
from typing import Annotated

from pydantic import ConfigDict, Field
from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.recordings.calibration_file import calibration_from_document
from service.documents.history import COMPARISON, Comparison
from service.errors import BusyError, InvalidRequestError
from service.jobs import JobCancelledError, JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.fields import Moment, RequestModel, Text
from service.operations.monitoring.axis_configuration import load_configuration
from service.operations.monitoring.rejudged_history import Anew, judged_anew, swap
from service.store import calibrations, intake, rejudged
from service.store.axes import get_axis
from service.store.database import Database, reading, trying, writing
from service.store.jobs import CANCELLED, get_job
from service.store.rejudged import KIND
from service.store.tables import JobRow
from service.store.trend.points import Cursor, Span
from service.store.waveforms import WaveformStore

#: So many measurements are judged between two reports; what a crash undoes is done once more.
AT_ONCE = 20


class RejudgementIn(RequestModel):
    """By which calibration a history is judged anew, and which part of it."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"calibration": 2, "dry_run": True}]})

    calibration: Annotated[int, Field(ge=1, lt=2**63)]
    start: Moment | None = Field(default=None, alias="from", description="inclusive; what is older stays as it is")
    end: Moment | None = Field(default=None, alias="to", description="exclusive; only for a dry run")
    dry_run: bool = Field(default=False, description="only say, side by side, what it would change")
    reason: Text = "the history was judged anew"

    @property
    def span(self) -> Span:
        """The part of the history."""
        return Span(self.start, self.end)


class Rejudgements:
    """Judges histories anew; the work of a job of kind ``rejudgement``."""

    def __init__(self, database: Database, waveforms: WaveformStore, runner: JobRunner) -> None:
        self._database = database
        self._waveforms = waveforms
        self._runner = runner
        runner.work[KIND] = self.run

    def start(self, axis_id: str, asked: RejudgementIn, *, if_match: str | None = None) -> JobRow:
        """Begin in the background.

        ``if_match``: the calibration that is expected to be in force; PreconditionError if it is another one.

        Raises UnknownResourceError if there is no such calibration; InvalidRequestError if a part would be left whose
        charts go on; ConflictError while the history is judged anew already; BusyError as for every job.
        """
        if asked.end is not None and not asked.dry_run:
            raise InvalidRequestError(
                "to is for a dry run: the charts go on from what was measured last, so that it cannot be left out"
            )
        with self._database.read() as session:
            calibrations.get_calibration(session, axis_id, asked.calibration)

        def in_force(session: Session, row: JobRow) -> JsonObject:
            calibrations.require_in_force(get_axis(session, axis_id), if_match)
            return row.arguments

        return self._runner.submit(KIND, axis_id, _arguments(asked), in_force, alone=_alone(axis_id))

    def enter(self, session: Session, axis_id: str, asked: RejudgementIn) -> None:
        """Store a job in a transaction that does more; :meth:`wake` begins it. Raises as :meth:`start`."""
        self._runner.enter(session, KIND, axis_id, _arguments(asked), alone=_alone(axis_id))

    def wake(self) -> None:
        """Begin what was entered."""
        self._runner.wake(KIND)

    def run(self, job: JobHandle) -> None:
        """Judge what is left aside, then let it stand, or undo it where it is a dry run."""
        if "new" in (job.result or {}):  # everything stands, only the end of the job was not stored
            return
        asked = RejudgementIn.model_validate(job.arguments)
        with self._database.write() as session:
            rejudged.forget_staged(session.connection(), None)
            rejudged.forget_gone(session.connection(), job.job_id)
            axis = get_axis(session, job.axis_id)
            document = calibrations.get_calibration(session, job.axis_id, asked.calibration).document
            anew = Anew(
                job.job_id, axis.number, load_configuration(axis.configuration), asked.calibration,
                calibration_from_document(document),
            )  # fmt: skip
        try:
            self._judge_aside(job, anew, asked)
            self._finish(job, anew, asked)
        except JobCancelledError:
            self._forget_if_cancelled(job.job_id)
            raise

    def _judge_aside(self, job: JobHandle, anew: Anew, asked: RejudgementIn) -> None:
        with self._database.reading() as connection:
            done, total = rejudged.progress_of(connection, job.job_id, job.axis_id, asked.span)
        job.report(done, total, {})
        for n_judged in self._judged(job.axis_id, anew, asked.span):
            done += n_judged
            job.report(min(done, total), total, {})

    def _judged(self, axis_id: str, anew: Anew, span: Span) -> Iterator[int]:
        """Judge what is left, some at a time; yield how many."""
        after: Cursor | None = None
        with self._database.connect() as connection:
            while True:
                with reading(connection):
                    rows = rejudged.left_to_judge(connection, anew.job_id, axis_id, span, after=after, limit=AT_ONCE)
                    windows = [rejudged.windows_with_places(connection, row.id or 0) for row in rows]
                if not rows:
                    return
                records = [
                    judged_anew(anew, row, stored, self._waveforms) for row, stored in zip(rows, windows, strict=True)
                ]
                with writing(connection):
                    rejudged.stage(connection, records)
                yield len(rows)
                after = rows[-1].started_at, rows[-1].id or 0

    def _finish(self, job: JobHandle, anew: Anew, asked: RejudgementIn) -> None:
        """Judge what came meanwhile, while nothing else comes, and let everything stand."""
        with self._database.alone_at([job.axis_id]):
            for _ in self._judged(job.axis_id, anew, asked.span):
                pass
            with self._database.connect() as connection:
                if asked.dry_run:
                    with trying(connection):
                        comparison = self._swapped(connection, job, anew, asked)
                    with writing(connection):
                        self._end(connection, job, comparison, asked)
                else:
                    with self._database.at_axes(connection, [job.axis_id], wait=True), writing(connection):
                        comparison = self._swapped(connection, job, anew, asked)
                        self._end(connection, job, comparison, asked)

    def _swapped(self, connection: Connection, job: JobHandle, anew: Anew, asked: RejudgementIn) -> Comparison:
        axis = intake.read_axis(connection, job.axis_id)
        rejudged.forget_gone(connection, job.job_id)
        if rejudged.left_to_judge(connection, anew.job_id, axis.id, asked.span, after=None, limit=1):
            raise BusyError("another process took windows of this axis at this moment")
        return swap(connection, anew, axis, asked.span, asked.reason, dry_run=asked.dry_run)

    @staticmethod
    def _end(connection: Connection, job: JobHandle, comparison: Comparison, asked: RejudgementIn) -> None:
        """Store the answer in the transaction of the work: it is done with it, or neither is."""
        _, total = rejudged.progress_of(connection, job.job_id, job.axis_id, asked.span)
        rejudged.forget_staged(connection, job.job_id)
        with Session(connection) as session:
            job.conclude_within(session, total, COMPARISON.dump_python(comparison, mode="json"))

    def _forget_if_cancelled(self, job_id: str) -> None:
        with self._database.write() as session:
            if get_job(session, job_id).status == CANCELLED:
                rejudged.forget_staged(session.connection(), job_id)


def _arguments(asked: RejudgementIn) -> JsonObject:
    arguments: JsonObject = asked.model_dump(mode="json", by_alias=True)
    return arguments


def _alone(axis_id: str) -> str:
    return f"the history of axis '{axis_id}' is being judged anew"
