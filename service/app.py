"""Put the application together: ``create_app``. One application, one database, one folder of waveforms."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING

from fastapi import FastAPI
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from pydantic.json_schema import models_json_schema

from service.api import (
    alarms,
    axes,
    calibrating,
    calibrations,
    health,
    jobs,
    lost_motion,
    recordings,
    retention,
    system,
    trend,
    trend_points,
    windows,
)
from service.api.access import Gate, RefusedInLog, scopes_of
from service.api.http.compression import LEVEL, Compression
from service.api.http.guard import Guard
from service.api.http.limits import RequestLimits
from service.api.http.observer import RequestObserver
from service.api.http.problems import PROBLEM_RESPONSES, Problem, install_problem_handlers
from service.api.services import Services
from service.api.windows import WindowIn, WindowsIn
from service.blas_threads import compute_in_one_thread
from service.errors import ServiceError
from service.jobs import Background, JobRunner, close_all
from service.json_types import JsonObject
from service.observability import Metrics
from service.operations.access.access import Access
from service.operations.access.scopes import Scope
from service.operations.advice import read_advice
from service.operations.alarm_cause import AlarmExplanations
from service.operations.analysis_job import AnalysisJob
from service.operations.calibrating.fit_job import CalibrationJobs
from service.operations.discrepancy_job import DiscrepancyIn
from service.operations.identification_job import IdentificationIn
from service.operations.monitoring.alarms import Alarms, watch_of_shelves
from service.operations.monitoring.axes import Axes
from service.operations.monitoring.calibrations import Calibrations
from service.operations.monitoring.changes import Changes
from service.operations.monitoring.history import History
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.monitoring.intake.renewal import renew_charts
from service.operations.monitoring.lost_motion import Readings, renew_readings
from service.operations.monitoring.rejudgements import Rejudgements
from service.operations.monitoring.replay import Replays
from service.operations.monitoring.trend import Trend
from service.operations.notices.dispatcher import Dispatcher
from service.operations.notices.receivers import Receivers, read_receivers
from service.operations.purge import Purge, Purges
from service.operations.recordings.recordings import CHECK, KIND as IMPORT, Recordings
from service.operations.recordings.stored_windows import StoredWindows
from service.operations.retention import Surveys, rule_of
from service.operations.trial.trial import Trials
from service.settings import VERSION, Settings
from service.store.axes import counted
from service.store.database import Database
from service.store.jobs import ReportStore
from service.store.lookup import Remembered
from service.store.recordings import RecordingFiles
from service.store.safekeeping.database_file import require_database_of
from service.store.safekeeping.private import private_folder
from service.store.waveform_objects import files_at
from service.store.waveforms import WaveformStore
from service.web.pages import PAGES
from service.web.site import STATIC, Site

if TYPE_CHECKING:
    from service.operations.notices.mqtt_states import StatePublisher
    from service.operations.notices.senders import Sender

#: A stop waits so long for all that goes on in the background, receivers that do not answer among it.
BACKGROUND_ENDS_WITHIN_S = 2.0
#: Pictures of so many pages are remembered, 60 kB of each.
MOST_DRAWN = 100
_COMPONENT = "#/components/schemas/{model}"
DESCRIPTION = """Windows of motor torque and nut acceleration in; ball-screw preload in newtons with its interval,
its trend and alarms out. SI units, every name carries its unit. Errors are RFC 9457 problem documents."""


def create_app(settings: Settings) -> FastAPI:
    """Return the application; nothing is opened before it starts."""
    compute_in_one_thread()  # whoever serves it
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        services, publishers = _build_services(settings, metrics)
        app.state.services = services
        services.purges.start()
        services.jobs.resume()
        in_background: tuple[Background, ...] = (
            watch_of_shelves(services.database),
            services.access.refusals.writer(),
            services.dispatcher,
            *publishers,
        )
        for each in in_background:
            each.start()
        try:
            yield
        finally:
            services.jobs.stopping.set()  # their work ends meanwhile
            close_all((services.purges, *reversed(in_background)), BACKGROUND_ENDS_WITHIN_S)
            services.recordings.close()
            services.jobs.close()
            services.ingest.close()
            services.waveforms.close()
            services.access.refusals.write()
            services.database.close()

    app = FastAPIOffline(
        title="Preload Monitor",
        version=VERSION,
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=PROBLEM_RESPONSES,
        docs_url=None,
        redoc_url=None,
        static_url="/static/swagger",  # where nobody has to say who it is, as for every file of the pages
    )
    app.openapi = partial(describe, app)  # type: ignore[method-assign]  # FastAPI's own way to replace it
    app.state.settings = settings
    install_problem_handlers(app)
    of_api = (
        windows, recordings, axes, trend_points, trend, lost_motion, calibrations, calibrating, alarms, jobs, retention,
        system, health,
    )  # fmt: skip
    routers = [*(each.router for each in of_api), axes.maintenance_router, *PAGES]
    app.add_middleware(
        RequestLimits,
        largest_body=settings.max_body_mib * 2**20,
        most_waiting=settings.max_waiting_requests,
        largest_recording=settings.max_recording_mib * 2**20,
    )
    needed = {("GET", "/openapi.json"): Scope.TRENDS_READ}  # the framework's own route
    app.add_middleware(Gate, needed=scopes_of(route for router in routers for route in router.routes) | needed)
    app.add_middleware(Compression, minimum_size=1000, compresslevel=LEVEL)
    app.add_middleware(Guard, host_names=settings.own_names())
    app.add_middleware(RefusedInLog)
    app.add_middleware(Site)
    app.add_middleware(RequestObserver, metrics=metrics)
    for router in routers:
        app.router.routes += router.routes  # which to include makes once more, at the first request of each start
    app.mount("/static", StaticFiles(directory=STATIC), name="static")

    return app


def describe(app: FastAPI) -> JsonObject:
    """Return the OpenAPI document, made once: FastAPI's own, with the models of bodies that a route reads by itself."""
    if app.openapi_schema is None:
        document = FastAPI.openapi(app)
        models = [(WindowIn, "validation"), (WindowsIn, "validation"), (Problem, "validation")]
        document["components"]["schemas"] |= models_json_schema(models, ref_template=_COMPONENT)[1]["$defs"]  # type: ignore[arg-type]
        app.openapi_schema = document
    return app.openapi_schema


def open_database(settings: Settings) -> Database:
    """Open the database of a service at the newest schema, and hold it against other processes until it is closed.

    Raises DataFolderError if this is not a database that the service may go on with; StorageError if the disk or the
    database server does not let it.
    """
    private_folder(settings.data_dir)
    database = Database(settings.resolved_database_url())
    try:
        if database.file is not None:
            database.file.hold()
            require_database_of(settings.data_dir, empty=not database.file.path.exists())
        database.migrate()
        with database.read() as session:
            require_database_of(settings.data_dir, empty=not counted(session))
    except ServiceError:
        database.close()
        raise
    return database


def _build_services(settings: Settings, metrics: Metrics) -> "tuple[Services, list[StatePublisher]]":
    database = open_database(settings)
    renew_charts(database)
    renew_readings(database)
    waveforms = WaveformStore(files_at(settings.data_dir, settings.waveform_url))
    runner = JobRunner(database, {}, settings.max_waiting_jobs)  # each operation below says which work it does
    alarm_explanations = AlarmExplanations(database, waveforms, runner)
    ingest = Ingest(database, waveforms, metrics, alarm_explanations.follow)
    files = RecordingFiles(settings.data_dir)
    uploads = Recordings(database, files, ingest, runner, settings.max_recording_mib * 2**20)
    reports = ReportStore(settings.data_dir)
    receivers, trend = read_receivers(settings.receivers_file), Trend(database)
    rule = rule_of(settings)
    runner.work |= {CHECK: uploads.check, IMPORT: uploads.run}
    services = Services(
        database=database,
        waveforms=waveforms,
        metrics=metrics,
        access=Access(database, on_loopback=settings.is_on_loopback()),
        axes=Axes(database),
        ingest=ingest,
        trend=trend,
        history=History(database),
        calibrations=Calibrations(database, waveforms),
        calibration_jobs=CalibrationJobs(database, waveforms, runner),
        rejudgements=Rejudgements(database, waveforms, runner),
        alarms=Alarms(database),
        readings=Readings(database),
        changes=Changes(database),
        replays=Replays(settings.replay_dir, ingest, runner),
        trials=Trials(database, waveforms, runner, ingest),
        recordings=uploads,
        stored_windows=StoredWindows(database, waveforms, files),
        identifications=AnalysisJob(IdentificationIn, database, waveforms, reports, runner),
        discrepancies=AnalysisJob(DiscrepancyIn, database, waveforms, reports, runner),
        alarm_explanations=alarm_explanations,
        jobs=runner,
        dispatcher=Dispatcher(database, _senders(receivers, settings.public_url.rstrip("/")), metrics),
        advice=read_advice(settings.advice_file),
        drawn=Remembered(MOST_DRAWN),
        purges=Purges(database, runner, Purge(database, waveforms, rule, settings.data_dir)),
        surveys=Surveys(database, waveforms, rule),
    )
    return services, _state_publishers(receivers, trend)


def _senders(receivers: Receivers, source: str) -> "list[Sender]":
    senders: list[Sender] = []
    if receivers.webhook:
        from service.operations.notices.webhook import WebhookSender  # noqa: PLC0415  # brings an HTTP client

        senders += [WebhookSender(webhook, source) for webhook in receivers.webhook]
    if receivers.mail:
        from service.operations.notices.mail import MailSender  # noqa: PLC0415  # likewise

        senders += [MailSender(mail, source) for mail in receivers.mail]
    if receivers.mqtt:
        from service.operations.notices.mqtt import MqttSender  # noqa: PLC0415  # an extra

        senders += [MqttSender(broker, source) for broker in receivers.mqtt]
    return senders


def _state_publishers(receivers: Receivers, trend: Trend) -> "list[StatePublisher]":
    if not receivers.mqtt:
        return []
    from service.operations.notices.mqtt_states import StatePublisher  # noqa: PLC0415  # an extra

    return [StatePublisher(broker, trend) for broker in receivers.mqtt]
