"""What the model of an axis lacks, from its stored measurements or from posted peaks: jobs of kind ``discrepancy``."""

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from monitor_core.recordings.elements.units import metres
from monitor_core.recordings.model_file import parse_model
from service.errors import UnknownResourceError
from service.jobs import JobHandle
from service.operations.axis_measurements import measured_of_axis, selected_measurements
from service.operations.discrepancy.explanation import ExplanationRequest, require_explainable
from service.operations.discrepancy.explanation_process import explained
from service.store import jobs
from service.store.axes import get_axis
from service.store.database import Database
from service.store.reports import ReportStore
from service.store.tables import JobRow
from service.store.waveforms import WaveformStore

KIND = "discrepancy"
#: How many finished ones the page of an axis lists.
MOST_LISTED = 10


@dataclass(frozen=True, slots=True)
class FinishedDiscrepancy:
    """A finished job in the words of a list."""

    job_id: str
    finished_at: datetime
    outcome: str
    effects: tuple[str, ...]  # keys of what was found


class Discrepancies:
    """Explains in the background where the measurements of an axis and its model part."""

    def __init__(self, database: Database, waveforms: WaveformStore, reports: ReportStore) -> None:
        self._database = database
        self._waveforms = waveforms
        self._reports = reports

    def require(self, axis_id: str, arguments: dict[str, Any]) -> None:
        """Refuse what cannot be explained before a job is made of it, as far as that shows without measuring.

        Raises
        ------
        MonitorCoreError, ServiceError
            With the reason in one sentence.
        """
        with self._database.read() as session:
            get_axis(session, axis_id)
        if arguments["peaks"] is not None:
            require_explainable(self._request(axis_id, arguments))
        else:
            parse_model(arguments["baseline"], "baseline")
            selected_measurements(self._database, axis_id, arguments)

    def run(self, job: JobHandle) -> None:
        """Explain; begun anew if it was interrupted."""
        request = self._request(job.axis_id, job.arguments)
        said: list[str] = []

        def tell(sentence: str) -> None:
            if said[-1:] != [sentence]:
                said.append(sentence)
            job.report(len(said), None, {"progress": sentence})

        answer = explained(request, f"Axis {job.axis_id} against its {request.baseline.family} model", tell)
        self._reports.write(job.job_id, answer.page)
        job.report(len(said), len(said), answer.document)

    def report(self, axis_id: str, job_id: str) -> str:
        """Return the page of a finished job, HTML.

        Raises
        ------
        UnknownResourceError
            If there is no such job of the axis, or it has no answer.
        """
        with self._database.read() as session:
            row = jobs.get_job(session, job_id)
        if (row.kind, row.axis_id, row.status) != (KIND, axis_id, jobs.DONE):
            raise UnknownResourceError(f"axis '{axis_id}' has no finished job of kind {KIND} '{job_id}'")
        return self._reports.read(job_id)

    def finished(self, axis_id: str) -> list[FinishedDiscrepancy]:
        """Return the last jobs of an axis that came to an answer, newest first."""
        with self._database.read() as session:
            rows = jobs.finished_jobs(session, axis_id, KIND, MOST_LISTED)
        return [_in_short(row) for row in rows]

    def _request(self, axis_id: str, arguments: dict[str, Any]) -> ExplanationRequest:
        measured = measured_of_axis(self._database, self._waveforms, axis_id, arguments)
        return ExplanationRequest(
            baseline=parse_model(arguments["baseline"], "baseline"),
            measured=measured.observations,
            hold_out=tuple(metres(one) for one in arguments["hold_out_mm"]),
            accelerometer=arguments.get("accelerometer"),  # a job of an older version has none
            taken_as=measured.sentences,
        )


def _in_short(row: JobRow) -> FinishedDiscrepancy:
    result = row.result or {}
    effects = tuple(one["key"] for one in result["effects"])
    return FinishedDiscrepancy(row.id, row.updated_at, result["outcome"], effects)
