"""Make a simulated axis with a year of history, through the ordinary operations: jobs of kind ``trial``.

Registered, measured, calibrated, alarmed, seen, repaired: what people did is entered as if they did it then.
"""

from collections.abc import Iterable
from datetime import datetime, timedelta
from itertools import count
from typing import Final

from service.clock import now, text_of
from service.jobs import JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.monitoring import maintenance
from service.operations.monitoring.alarms import Alarms
from service.operations.monitoring.axes import Axes
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.operations.monitoring.calibrations import Calibrations
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.monitoring.maintenance import MaintenanceIn, Work
from service.operations.monitoring.trend import Trend
from service.operations.trial.story import (
    BAND,
    COMMISSIONED,
    EVERY,
    N_WINDOWS,
    SAMPLE_RATE,
    Action,
    Chapter,
    machine_text,
    measurements_of,
    sister_story,
    story,
)
from service.store import alarms, calibrations, jobs
from service.store.database import Database
from service.store.tables import AxisRow, JobRow
from service.store.waveforms import WaveformStore

KIND: Final = "trial"
#: An axis is a trial as long as it is of this machine.
TRIAL_MACHINE: Final = "Trial (simulated)"
_NAME: Final = "Trial: X axis of the bundled machine"
_NAME_OF_SISTER: Final = "Trial: Y axis of the bundled machine"
#: Who did what is told of the year.
_FITTER: Final = "Anna (trial)"
_LATER: Final = timedelta(hours=1)
#: The cause of an alarm is waited for, but not for ever.
_LOOK_EVERY_S, _MOST_LOOKS = 0.2, 75


class Trials:
    """Starts trials and tells of them; the work of a job of kind ``trial``."""

    def __init__(self, database: Database, waveforms: WaveformStore, runner: JobRunner, ingest: Ingest) -> None:
        self._database = database
        self._runner = runner
        runner.work[KIND] = self.run
        self._ingest = ingest
        self._axes = Axes(database)
        self._calibrations = Calibrations(database, waveforms)
        self._alarms = Alarms(database)

    def start(self) -> JobRow:
        """Begin to make a trial axis of a name that is free.

        Raises ConflictError if one is being made.
        """
        with self._database.read() as session:
            names = ("trial" if number == 1 else f"trial-{number}" for number in count(1))
            axis_id = next(name for name in names if session.get(AxisRow, name) is None)
        ends_at = (now() - _LATER).replace(second=0, microsecond=0)
        arguments: JsonObject = {"axis": axis_id, "ends_at": text_of(ends_at)}
        return self._runner.submit(KIND, None, arguments, alone="a trial axis is being made")

    def under_way(self) -> JobRow | None:
        """Return the job that makes a trial axis now."""
        with self._database.read() as session:
            return next(iter(jobs.unfinished_jobs(session, KIND)), None)

    def end(self) -> None:
        """Put all trial axes away."""
        for status in Trend(self._database).fleet(TRIAL_MACHINE).axes:
            self._axes.archive(status.row.id, archived=True)

    def run(self, job: JobHandle) -> None:
        """Make a trial axis, from the chapter on at which the job was interrupted."""
        axis_id, ends_at = str(job.arguments["axis"]), datetime.fromisoformat(str(job.arguments["ends_at"]))
        chapters, of_sister, sister_id = story(ends_at), sister_story(ends_at), f"{axis_id}-sister"
        began_at = chapters[0].readings[0].at
        self._register(axis_id, _NAME, EVERY, commissioned_at=began_at)
        written = [(axis_id, chapter) for chapter in chapters] + [(sister_id, chapter) for chapter in of_sister]
        total, done = sum(len(chapter.readings) for _, chapter in written), 0
        for of_axis, chapter in written:
            done += len(chapter.readings)
            if done <= job.done:
                continue
            if chapter is of_sister[0]:
                self._register(sister_id, _NAME_OF_SISTER, 4 * EVERY, commissioned_at=began_at)
                self._lend_calibration(axis_id, sister_id, chapter.readings[0].at - _LATER)
            waiting = [
                self._ingest.submit(of_axis, windows, complete=True) for windows in measurements_of(chapter.readings)
            ]
            for receipt in waiting:
                receipt.result()
            self._do(job, of_axis, chapter)
            job.report(done, total, {"axis": axis_id, "sister": sister_id})
        self._date_alarms(axis_id, chapters)

    def _register(self, axis_id: str, name: str, every: timedelta, *, commissioned_at: datetime) -> None:
        configuration = AxisConfiguration(
            search_band_hz=BAND,
            sample_rate_hz=SAMPLE_RATE,
            windows_per_measurement=N_WINDOWS,
            measurements_per_year=round(timedelta(days=365) / every),
            machine=TRIAL_MACHINE,
            axis_type="axis of the bundled machine",
            commissioned_preload_n=COMMISSIONED,
            commissioned_at=commissioned_at,
            silent_after_hours=8760.0,  # nobody goes on measuring it, and it shall still be there to look at
            drive_model=machine_text(),
        )
        self._axes.register(axis_id, name, configuration)

    def _do(self, job: JobHandle, axis_id: str, chapter: Chapter) -> None:
        """Do what people did after a chapter; what is done already, before an interruption, is left."""
        at = chapter.ended_at + _LATER
        match chapter.action:
            case Action.CALIBRATE:
                self._calibrate(axis_id, at)
            case Action.SEE_ALARM:
                for alarm in self._alarms.list(axis_id, alarms.ACTIVE, None, 1):
                    self._alarms.acknowledge(alarm.row.id, "looked at it; the axis has play by hand", _FITTER)
            case Action.REPAIR:
                self._wait_for_cause(job)
                self._log(axis_id, at, Work.MOUNTING, "lock nut of the fixed bearing tightened", COMMISSIONED)
                for alarm in self._alarms.list(axis_id, alarms.ACKNOWLEDGED, None, 1):
                    self._alarms.clear(alarm.row.id, "lock nut tightened, preload set again", _FITTER)
            case Action.LUBRICATE:
                self._log(axis_id, at, Work.LUBRICATED, "grease after half a year", None)
        if chapter.action in (Action.SEE_ALARM, Action.REPAIR):
            self._date_alarms(axis_id, [chapter])

    def _wait_for_cause(self, job: JobHandle) -> None:
        """Let the cause of the alarm be found before it is cleared; after that nobody looks for it."""
        axis_id = str(job.arguments["axis"])
        for _ in range(_MOST_LOOKS):
            if all(row.status not in (jobs.QUEUED, jobs.RUNNING) for row in self._runner.list(axis_id, 10)):
                return
            job.sleep(_LOOK_EVERY_S)

    def _calibrate(self, axis_id: str, at: datetime) -> None:
        if self._calibrations.overview(axis_id).active is None:
            fitted = self._calibrations.fit_measurements(axis_id, (None, None), None, "of the trial")
            self._calibrations.activate(axis_id, fitted.id, "first calibration", expected_active=None)
        with self._database.write(axis_id) as session:
            calibrations.date_back(session, axis_id, at)

    def _lend_calibration(self, axis_id: str, sister_id: str, at: datetime) -> None:
        """Give the sister the calibration of the axis: both are built alike."""
        overview = self._calibrations.overview(axis_id)
        fitted = next(row for row in overview.calibrations if row.id == overview.active)
        if self._calibrations.overview(sister_id).active is None:
            lent = self._calibrations.bring(sister_id, fitted.document, f"of {axis_id}, which is built alike")
            self._calibrations.activate(sister_id, lent.id, "lent by its sister", expected_active=None)
        with self._database.write(sister_id) as session:
            calibrations.date_back(session, sister_id, at)

    def _log(self, axis_id: str, at: datetime, kind: Work, note: str, set_preload_n: float | None) -> None:
        entry = MaintenanceIn(at=at, who=_FITTER, kind=kind, note=note, set_preload_n=set_preload_n)
        maintenance.enter(self._database, axis_id, entry)

    def _date_alarms(self, axis_id: str, chapters: Iterable[Chapter]) -> None:
        """Let what was done about alarms have been done after its chapter."""
        when = {chapter.action: chapter.ended_at + _LATER for chapter in chapters}
        done_at = {
            status: when[action]
            for action, status in ((Action.SEE_ALARM, alarms.ACKNOWLEDGED), (Action.REPAIR, alarms.CLEARED))
            if action in when
        }
        with self._database.write(axis_id) as session:
            alarms.date_back(session, axis_id, done_at)
