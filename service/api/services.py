"""Make the routers of the API, and give them the operations of one application."""

from dataclasses import dataclass
from typing import Annotated, cast

from fastapi import APIRouter, Depends, Request

from service.api.http.body import require_json
from service.api.http.problems import PROBLEM_RESPONSES
from service.jobs import JobRunner
from service.observability import Metrics
from service.operations.access.access import Access
from service.operations.advice import AdviceTable
from service.operations.alarm_cause import AlarmExplanations
from service.operations.analysis_job import AnalysisJob
from service.operations.calibrating.fit_job import CalibrationJobs
from service.operations.discrepancy_job import DiscrepancyIn
from service.operations.identification_job import IdentificationIn
from service.operations.monitoring.alarms import Alarms
from service.operations.monitoring.axes import Axes
from service.operations.monitoring.calibrations import Calibrations
from service.operations.monitoring.changes import Changes
from service.operations.monitoring.history import History
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.monitoring.lost_motion import Readings
from service.operations.monitoring.rejudgements import Rejudgements
from service.operations.monitoring.replay import Replays
from service.operations.monitoring.trend import Trend
from service.operations.notices.dispatcher import Dispatcher
from service.operations.purge import Purges
from service.operations.recordings.recordings import Recordings
from service.operations.recordings.stored_windows import StoredWindows
from service.operations.retention import Surveys
from service.operations.trial.trial import Trials
from service.store.database import Database
from service.store.lookup import Remembered
from service.store.waveforms import WaveformStore


@dataclass(frozen=True, slots=True)
class Services:
    """The operations, made once per application."""

    database: Database
    waveforms: WaveformStore
    metrics: Metrics
    access: Access
    axes: Axes
    ingest: Ingest
    trend: Trend
    history: History
    calibrations: Calibrations
    calibration_jobs: CalibrationJobs
    rejudgements: Rejudgements
    alarms: Alarms
    readings: Readings
    changes: Changes
    replays: Replays
    trials: Trials
    recordings: Recordings
    stored_windows: StoredWindows
    identifications: AnalysisJob[IdentificationIn]
    discrepancies: AnalysisJob[DiscrepancyIn]
    alarm_explanations: AlarmExplanations
    jobs: JobRunner
    dispatcher: Dispatcher
    purges: Purges
    surveys: Surveys
    advice: AdviceTable
    drawn: Remembered  # pictures of the pages


async def services_of(request: Request) -> Services:
    """Return the operations of the application that serves this request."""
    return cast(Services, request.app.state.services)


#: What a route takes them by.
ServicesOf = Annotated[Services, Depends(services_of)]


def api_router(*tags: str, prefix: str = "/v1", reads_bodies: bool = False) -> APIRouter:
    """Return a router whose errors are problems, and which takes JSON only unless its routes read bodies themselves."""
    dependencies = [] if reads_bodies else [Depends(require_json)]
    return APIRouter(prefix=prefix, tags=list(tags), dependencies=dependencies, responses=PROBLEM_RESPONSES)
