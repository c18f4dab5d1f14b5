"""Find which change of an axis explains its alarm: jobs of kind ``alarm-explanation``.

The measurements of the baseline that the alarm rests on are the reference, the newest ones since the onset the recent
side. A job follows the commit of a measurement that leaves the axis in alarm, and anew with each further one until all
recent ones were taken after the alarm: those around the onset may be of before and after the change.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel

from monitor_core.errors import MonitorCoreError, NotIdentifiableError
from monitor_core.modal import ModalMeasurement
from service.clock import now
from service.documents.change import examined_document, read_cause, refused_document
from service.documents.measurement import AlarmEvidence, read_evidence
from service.errors import BusyError, ConflictError, ServiceError
from service.jobs import JobHandle, JobRunner
from service.operations.monitoring.alarm_changes import store_explanation
from service.operations.monitoring.alarms import (
    EXPLANATION,
    MOST_RECENT,
    count_positions,
    fewest_positions,
    recent_side,
)
from service.operations.monitoring.axes import axis_drive
from service.operations.monitoring.axis_configuration import (
    AxisConfiguration,
    core_settings,
    load_configuration,
)
from service.operations.monitoring.stored_modes import measured_with_windows
from service.operations.own_process import Progress, Report, in_own_process
from service.store import alarms, jobs
from service.store.axes import get_axis
from service.store.database import Database
from service.store.measurements import newest_monitored
from service.store.tables import AlarmRow, JobRow, MeasurementRow
from service.store.waveforms import WaveformStore

if TYPE_CHECKING:
    from monitor_core.change import ChangeAttribution
    from monitor_core.fitting.observations import FrequencyResponseObservation

log = logging.getLogger(__name__)

#: Of a longer baseline the newest: what more would add is less than the time that they take.
MOST_REFERENCE = 30


class _Arguments(BaseModel):
    """What a job is to explain."""

    alarm: int


@dataclass(frozen=True, slots=True)
class _Case:
    """An alarm with what its explanation rests on."""

    alarm: AlarmRow
    evidence: AlarmEvidence
    configuration: AxisConfiguration
    reference: list[MeasurementRow]
    recent: list[MeasurementRow]

    def lacks(self) -> str | None:
        """Return what the recent measurements lack, in a sentence; None if they were made at enough places."""
        n_places, fewest = count_positions(self.recent), fewest_positions()
        if n_places >= fewest:
            return None
        return (
            f"expected measurements at {fewest} places or more since {self.evidence.onset.isoformat()}; got {n_places}"
        )

    @property
    def settled(self) -> bool:
        """Whether the last explanation rests on measurements after the alarm alone."""
        recent = read_cause(self.alarm.explanation).recent
        return recent is not None and recent.n_measurements >= MOST_RECENT and recent.first_at > self.evidence.at


class AlarmExplanations:
    """Finds in the background which change of an axis explains its alarm."""

    def __init__(self, database: Database, waveforms: WaveformStore, runner: JobRunner) -> None:
        self._database = database
        self._waveforms = waveforms
        self._jobs = runner
        self._put_off = set[str]()  # axes whose job found no place in the queue
        runner.work[EXPLANATION] = self.run

    def follow(self, axis_id: str) -> None:
        """Start a job if a measurement that was just committed lets the alarm of its axis be explained, or better.

        It never fails: the measurement is stored already, and the next one leads here again.
        """
        try:
            with self._database.read() as session:
                newest = alarms.list_alarms(
                    session, axis_id=axis_id, status=None, before_id=None, limit=1, by_measurements=True
                )
                # one that waits will look at all that is measured by then; one of an earlier alarm asks nothing of this
                waiting = [
                    row.arguments.get("alarm")
                    for row in jobs.unfinished_jobs(session, EXPLANATION, axis_id)
                    if row.status == jobs.QUEUED
                ]
            if not newest or newest[0].id in waiting or newest[0].status not in alarms.OPEN:
                return
            if read_evidence(newest[0].evidence).while_learning:  # there is no baseline to compare with
                return
            case = self._case(newest[0].id)
            if not case.settled and case.lacks() is None:
                self._jobs.submit(EXPLANATION, axis_id, _Arguments(alarm=case.alarm.id).model_dump())
        except BusyError as error:
            log.info("the alarm of axis '%s' waits for its explanation: %s", axis_id, error)
            self._put_off.add(axis_id)
        except (ServiceError, MonitorCoreError) as error:
            log.warning("the alarm of axis '%s' waits for its explanation: %s", axis_id, error)

    def start(self, alarm_id: int) -> JobRow:
        """Explain an alarm as its axis stands now, because somebody asks for it.

        Raises ConflictError if it is cleared: what was measured since belongs to another baseline; or if it is being
        explained; NotIdentifiableError
        or OutsideValidityError if the axis has no drive model, or was not measured at enough places.
        """
        case = self._case(alarm_id)
        axis_drive(_model(case.configuration))
        if (lack := case.lacks()) is not None:
            raise NotIdentifiableError(lack)
        with self._database.read() as session:
            under_way = jobs.unfinished_jobs(session, EXPLANATION, case.alarm.axis_id)
        if any(row.arguments.get("alarm") == alarm_id for row in under_way):
            raise ConflictError(f"the cause of alarm {alarm_id} is being looked for already")
        return self._jobs.submit(EXPLANATION, case.alarm.axis_id, _Arguments(alarm=alarm_id).model_dump())

    def run(self, job: JobHandle) -> None:
        """Explain and store it with the alarm; begun anew if it was interrupted."""
        put_off, self._put_off = self._put_off, set()
        for axis_id in list(put_off):
            self.follow(axis_id)
        try:
            case = self._case(_Arguments.model_validate(job.arguments).alarm)
        except ConflictError as closed:  # meanwhile: nobody waits for its cause any more
            job.report(2, 2, {"sentence": str(closed)})
            return
        try:
            document = examined_document(self._explained(case, job), now(), case.reference, case.recent)
        except MonitorCoreError as refusal:  # an answer, too: the alarm says why
            document = refused_document(refusal, case.recent)
        with self._database.write(case.alarm.axis_id) as session:
            store_explanation(session, alarms.get_alarm(session, case.alarm.id), document)
        job.report(2, 2, document)

    def _case(self, alarm_id: int) -> _Case:
        with self._database.read() as session:
            alarm = alarms.get_alarm(session, alarm_id)
            if alarm.status not in alarms.OPEN:
                raise ConflictError(f"only an alarm that is open can be explained; alarm {alarm_id} is {alarm.status}")
            if alarm.kind == alarms.LOST_MOTION:
                raise NotIdentifiableError(f"expected an alarm of the preload; alarm {alarm_id} is of {alarm.kind}")
            configuration = load_configuration(get_axis(session, alarm.axis_id).configuration)
            evidence = read_evidence(alarm.evidence)
            start, end = _baseline(alarm.id, evidence)
            return _Case(
                alarm,
                evidence,
                configuration,
                newest_monitored(session, alarm.axis_id, start, end, MOST_REFERENCE),
                recent_side(session, alarm),
            )

    def _explained(self, case: _Case, job: JobHandle) -> "ChangeAttribution":
        job.say(0, 2, "measuring the responses")
        reference, recent = self._responses(case)

        def report(progress: Progress) -> None:
            job.say(progress.done, progress.total, progress.sentence)

        work = partial(_explain, _model(case.configuration), reference, recent, case.evidence.baseline_preload_n)
        return in_own_process(work, report, Progress(1, 2, "reading what was measured"))

    def _responses(self, case: _Case) -> "tuple[Sequence[FrequencyResponseObservation], ...]":
        """Measure both sides once more, on all lines: the antiresonance of the nut lies beside the mode."""
        from monitor_core.measured_responses import measured_responses  # noqa: PLC0415  # as above

        settings = core_settings(case.configuration)
        reference, recent = (
            [
                modal
                for modal, _ in measured_with_windows(self._database, self._waveforms, settings, rows)
                if isinstance(modal, ModalMeasurement)
            ]
            for rows in (case.reference, case.recent)
        )
        usual = _usual_temperature(reference, recent)
        return tuple(measured_responses(side, usual_temperature=usual) for side in (reference, recent))


def _baseline(alarm_id: int, evidence: AlarmEvidence) -> tuple[datetime, datetime]:
    """Return from when until when the baseline was learnt that an alarm rests on, its last measurement included."""
    if evidence.baseline_started_at is None or evidence.baseline_ended_at is None:
        raise NotIdentifiableError(
            f"expected the time in which the baseline of alarm {alarm_id} was learnt; got none: it was raised before "
            "that, or by an older version"
        )
    return evidence.baseline_started_at, evidence.baseline_ended_at + timedelta(microseconds=1)


def _usual_temperature(reference: Sequence[ModalMeasurement], recent: Sequence[ModalMeasurement]) -> float | None:
    """Return that of the reference; None unless every measurement states its own."""
    temperatures = [modal.conditions.temperature for modal in (*reference, *recent)]
    stated = [temperature for temperature in temperatures if temperature is not None]
    if not reference or len(stated) < len(reference) + len(recent):
        return None
    return float(np.mean(stated[: len(reference)]))


def _model(configuration: AxisConfiguration) -> str:
    if configuration.drive_model is None:
        raise NotIdentifiableError("expected drive_model in the configuration of the axis; got none")
    return configuration.drive_model


def _explain(
    model: str,
    reference: "Sequence[FrequencyResponseObservation]",
    recent: "Sequence[FrequencyResponseObservation]",
    preload: float | None,
    report: Report,
) -> "ChangeAttribution":
    """Work in the process of its own."""
    from monitor_core.change import attribute_change  # noqa: PLC0415  # as above

    report(Progress(1, 2, "fitting the reference, then each change"))
    return attribute_change(axis_drive(model), reference, recent, preload=preload)
