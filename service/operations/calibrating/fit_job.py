"""Fit a calibration to stored measurements in the background: jobs of kind ``calibration``, found by their axis."""

from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session

from monitor_core.modal import ModalMeasurement
from monitor_core.preload import Calibration, expected_frequency
from monitor_core.recordings.elements.units import to_millimetres
from service.jobs import JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.fields import Moment, RequestModel
from service.operations.monitoring.axis_configuration import core_settings, load_configuration
from service.operations.monitoring.calibrations import add_calibration, fitted_to, nothing_to_fit
from service.operations.monitoring.stored_modes import measured_modes
from service.store import jobs, measurements
from service.store.axes import get_axis
from service.store.calibrations import get_calibration
from service.store.database import Database
from service.store.tables import JobRow
from service.store.waveforms import WaveformStore

KIND: Final = "calibration"


class CalibrationJobIn(RequestModel):
    """Which stored measurements a calibration is fitted to, and what was known before."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": "new nut, guided calibration"}]})

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    prior: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(
        default=None, description="a calibration of the axis whose k1…k4 were known before: fewer measurements will do"
    )
    comment: Annotated[str, Field(max_length=1000, pattern=r"^[^\x00]*$")] = ""


class FittedReading(BaseModel):
    """Where a reading lies about the fit; friction that the fit takes off is part of what is left."""

    measurement: int
    position_mm: float
    preload_n: float | None
    frequency_hz: float
    residual_hz: float


class _Result(BaseModel):
    """What a job that came to its end has stored."""

    calibration: int | None = None
    readings: list[FittedReading] = []


class CalibrationJobs:
    """Fits calibrations in the background."""

    def __init__(self, database: Database, waveforms: WaveformStore, runner: JobRunner) -> None:
        self._database = database
        self._waveforms = waveforms
        self._runner = runner
        runner.work[KIND] = self.run

    def start(self, axis_id: str, asked: CalibrationJobIn) -> JobRow:
        """Begin a fit.

        Raises UnknownResourceError if there is no such axis or prior; NotIdentifiableError if nothing was measured with
        a preload set on purpose; ConflictError while the axis is being fitted already; BusyError as for every job.
        """
        with self._database.read() as session:
            get_axis(session, axis_id)
            if asked.prior is not None:
                get_calibration(session, axis_id, asked.prior)
            if not measurements.calibration_measurements(session, axis_id, asked.start, asked.end):
                raise nothing_to_fit(axis_id)

        alone = f"a calibration of axis '{axis_id}' is being fitted"
        return self._runner.submit(KIND, axis_id, asked.model_dump(mode="json", by_alias=True), alone=alone)

    def newest(self, axis_id: str) -> JobRow | None:
        """Return the fit of an axis that was begun last; None if there was none."""
        with self._database.read() as session:
            return jobs.newest_job(session, axis_id, KIND)

    def readings_of(self, axis_id: str, calibration_id: int) -> list[FittedReading]:
        """Return the readings that a calibration was fitted to, with their residuals; none if no job here fitted it."""
        with self._database.read() as session:
            for row in jobs.finished_jobs(session, axis_id, KIND, _MOST_LOOKED_AT):
                result = _Result.model_validate(row.result or {})
                if result.calibration == calibration_id:
                    return result.readings
        return []

    def run(self, job: JobHandle) -> None:
        """Measure the modes, fit, and store the calibration for review; an interrupted fit begins anew."""
        if job.result is not None and "calibration" in job.result:
            return  # it was stored before the interruption
        asked = CalibrationJobIn.model_validate(job.arguments)
        with self._database.read() as session:
            settings = core_settings(load_configuration(get_axis(session, job.axis_id).configuration))
            rows = measurements.calibration_measurements(session, job.axis_id, asked.start, asked.end)
            prior = None if asked.prior is None else get_calibration(session, job.axis_id, asked.prior).document
        measured: list[tuple[int, ModalMeasurement]] = []
        total = len(rows) + 1  # the fit is a step, too
        for done, row in enumerate(rows):
            job.report(done, total, {})
            measured += [(row.id, modal) for modal in measured_modes(self._database, self._waveforms, settings, [row])]
        job.report(len(rows), total, {})
        fitted = fitted_to(job.axis_id, settings, [modal for _, modal in measured], None, prior=prior)
        readings = [_reading(number, modal, fitted) for number, modal in measured]

        def stored(session: Session) -> JsonObject:
            row = add_calibration(session, job.axis_id, fitted, asked.comment)
            return _Result(calibration=row.id, readings=readings).model_dump()

        job.conclude(total, stored)


#: Fits that are looked through for the one that a calibration came from.
_MOST_LOOKED_AT: Final = 100


def _reading(number: int, modal: ModalMeasurement, fitted: Calibration) -> FittedReading:
    conditions, frequency = modal.conditions, modal.mode.frequency.value
    return FittedReading(
        measurement=number,
        position_mm=to_millimetres(conditions.position),
        preload_n=conditions.preload,
        frequency_hz=frequency,
        residual_hz=frequency - expected_frequency(fitted, conditions),
    )
