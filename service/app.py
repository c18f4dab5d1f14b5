"""Put the application together: ``create_app``. One application, one database, one folder of waveforms."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version

from fastapi import Depends, FastAPI
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline

from service.api import (
    access,
    advice,
    alarms,
    analyses,
    axes,
    calibrations,
    health,
    jobs,
    receivers,
    recordings,
    trend,
    windows,
)
from service.api.access import Gate
from service.api.http.body import require_json
from service.api.http.compression import Compression
from service.api.http.guard import Guard
from service.api.http.limits import RequestLimits
from service.api.http.observer import RequestObserver
from service.api.http.problems import PROBLEM_RESPONSES, describe, install_problem_handlers
from service.api.services import Services
from service.blas_threads import compute_in_one_thread
from service.errors import ServiceError, StorageError
from service.jobs import JobRunner, Work
from service.observability import Metrics
from service.operations.access.access import Access
from service.operations.advice.advice import read_advice
from service.operations.analysis_job import AnalysisJob
from service.operations.discrepancy.alarm_cause import KIND as ALARM_EXPLANATION
from service.operations.discrepancy.alarm_cause import AlarmExplanations
from service.operations.discrepancy.discrepancy_job import DISCREPANCY
from service.operations.identification.identification_job import IDENTIFICATION
from service.operations.monitoring.alarms import Alarms
from service.operations.monitoring.axes import Axes
from service.operations.monitoring.calibrations import Calibrations
from service.operations.monitoring.history import History
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.monitoring.intake.known import Lanes
from service.operations.monitoring.intake.renewal import renew_charts
from service.operations.monitoring.replay import Replays
from service.operations.monitoring.trend import Trend
from service.operations.notices.dispatcher import Dispatcher
from service.operations.notices.receivers import read_receivers
from service.operations.recordings.recordings import KIND as IMPORT
from service.operations.recordings.recordings import Recordings
from service.operations.recordings.stored_windows import StoredWindows
from service.settings import Settings
from service.store.axes import list_axes
from service.store.database import Database
from service.store.jobs import ReportStore
from service.store.recordings import RecordingFiles
from service.store.safekeeping.database_file import require_database_of
from service.store.waveform_files import FolderFiles, WaveformFiles
from service.store.waveforms import WaveformStore
from service.web import login, pages

DESCRIPTION = """Windows of motor torque and nut acceleration in; ball-screw preload in newtons with its interval,
its trend and alarms out. SI units, every name carries its unit. Errors are RFC 9457 problem documents."""


def create_app(settings: Settings) -> FastAPI:
    """Return the application; nothing is opened before it starts."""
    compute_in_one_thread()  # whoever serves it
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        services = _build_services(settings, metrics)
        app.state.services = services
        services.jobs.resume()
        services.dispatcher.start()
        try:
            yield
        finally:
            services.dispatcher.close()
            services.recordings.close()
            services.jobs.close()
            services.ingest.close()
            services.waveforms.close()
            services.database.close()

    app = FastAPIOffline(
        title="Preload Monitor",
        version=version("preload-monitor"),
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=PROBLEM_RESPONSES,
        docs_url=None,
        redoc_url=None,
    )
    app.openapi = partial(describe, app)  # type: ignore[method-assign]  # FastAPI's own way to replace it
    app.state.settings = settings
    install_problem_handlers(app)
    app.add_middleware(
        RequestLimits,
        largest_body=settings.max_body_mib * 2**20,
        most_waiting=settings.max_waiting_requests,
        largest_recording=settings.max_recording_mib * 2**20,
    )
    app.add_middleware(Gate)
    app.add_middleware(Compression, minimum_size=1000)
    app.add_middleware(Guard, host_names=settings.own_names())
    app.add_middleware(RequestObserver, metrics=metrics)
    app.include_router(windows.router)
    app.include_router(recordings.router)
    for resource in (axes, trend, calibrations, analyses, alarms, jobs, access, receivers, advice):
        app.include_router(resource.router, dependencies=[Depends(require_json)])
    app.include_router(health.router)
    app.include_router(pages.router)
    app.include_router(login.router)
    app.mount("/static", StaticFiles(directory=pages.STATIC), name="static")

    return app


def open_database(settings: Settings) -> Database:
    """Open the database of a service at the newest schema, and hold it against other processes until it is closed.

    Raises DataFolderError if this is not a database that the service may go on with; StorageError if the disk or the
    database server does not let it.
    """
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"the data folder {settings.data_dir} cannot be made: {error.strerror}") from error
    database = Database(settings.resolved_database_url())
    try:
        if database.file is not None:
            database.file.hold()
            require_database_of(settings.data_dir, empty=not database.file.path.exists())
        database.migrate()
        with database.read() as session:
            require_database_of(settings.data_dir, empty=not list_axes(session))
    except ServiceError:
        database.close()
        raise
    return database


def _build_services(settings: Settings, metrics: Metrics) -> Services:
    database = open_database(settings)
    renew_charts(database)
    waveforms = WaveformStore(_waveform_files(settings))
    lanes = Lanes()
    work: dict[str, Work] = {}  # filled below: ingest starts jobs, and a replay is a job that ingests
    runner = JobRunner(database, work, settings.max_waiting_jobs)
    alarm_explanations = AlarmExplanations(database, waveforms, runner)
    ingest = Ingest(database, waveforms, lanes, metrics, alarm_explanations.follow)
    replays = Replays(settings.replay_dir, ingest)
    files = RecordingFiles(settings.data_dir)
    uploads = Recordings(database, files, ingest, runner, settings.max_recording_mib * 2**20)
    reports = ReportStore(settings.data_dir)
    identifications = AnalysisJob(IDENTIFICATION, database, waveforms, reports)
    discrepancies = AnalysisJob(DISCREPANCY, database, waveforms, reports)
    work |= {
        "replay": replays.run,
        IMPORT: uploads.run,
        identifications.kind: identifications.run,
        discrepancies.kind: discrepancies.run,
        ALARM_EXPLANATION: alarm_explanations.run,
    }
    return Services(
        database=database,
        waveforms=waveforms,
        metrics=metrics,
        access=Access(database, on_loopback=settings.is_on_loopback()),
        axes=Axes(database, lanes),
        ingest=ingest,
        trend=Trend(database),
        history=History(database),
        calibrations=Calibrations(database, waveforms, lanes),
        alarms=Alarms(database, lanes),
        replays=replays,
        recordings=uploads,
        stored_windows=StoredWindows(database, waveforms, files),
        identifications=identifications,
        discrepancies=discrepancies,
        alarm_explanations=alarm_explanations,
        jobs=runner,
        dispatcher=_dispatcher(settings, database, metrics),
        advice=read_advice(settings.advice_file),
    )


def _waveform_files(settings: Settings) -> WaveformFiles:
    if settings.waveform_url is None:
        return FolderFiles(settings.data_dir)
    from service.store.waveform_objects import ObjectFiles  # noqa: PLC0415  # an extra

    return ObjectFiles(settings.waveform_url)


def _dispatcher(settings: Settings, database: Database, metrics: Metrics) -> Dispatcher:
    receivers, source = read_receivers(settings.receivers_file), settings.public_url.rstrip("/")
    if not (receivers.webhook or receivers.mail):
        return Dispatcher(database, (), metrics)
    from service.operations.notices.senders import MailSender, WebhookSender  # noqa: PLC0415  # brings an HTTP client

    webhooks = [WebhookSender(webhook, source) for webhook in receivers.webhook]
    return Dispatcher(database, [*webhooks, *(MailSender(mail, source) for mail in receivers.mail)], metrics)
