"""Fit a calibration to stored measurements in the background: jobs of kind ``calibration``, found by their axis."""

from functools import partial
from typing import Annotated, Final, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator
from sqlalchemy.orm import Session

from monitor_core.errors import NotIdentifiableError
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import calibrate_by_drive
from monitor_core.preload import Calibration, CoefficientPrior, expected_frequency, log_preload
from monitor_core.recording import ExcitationSource
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.uncertainty import Estimate
from service.jobs import JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.fields import Moment, RequestModel, SetPreload
from service.operations.monitoring.axis_configuration import core_settings, load_configuration
from service.operations.monitoring.calibrations import add_calibration, fitted_to, nothing_to_fit
from service.operations.monitoring.stored_modes import measured_modes
from service.operations.own_process import Progress, Report, in_own_process
from service.store import jobs, measurements
from service.store.axes import get_axis
from service.store.calibrations import get_calibration
from service.store.database import Database
from service.store.tables import JobRow, MeasurementRow
from service.store.trend.epochs import MAINTENANCE, epochs_of
from service.store.waveforms import WaveformStore

KIND: Final = "calibration"
#: Measurements whose preload nobody set that join a drive model: more of one preload tell no more of it.
_MOST_UNSET: Final = 30


class CalibrationJobIn(RequestModel):
    """Which stored measurements a calibration is fitted to, and what was known before."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": "new nut, guided calibration"}]})

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    prior: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(
        default=None, description="a calibration of the axis whose k1…k4 were known before: fewer measurements will do"
    )
    by_drive_model: bool = Field(
        default=False,
        description="what the drive model of the axis lets expect is the prior; the first measurements without "
        "payload since the newest maintenance and `from` are joined with it under one preload that nobody set: to a "
        "factor of two",
    )
    preload_n: SetPreload | None = Field(
        default=None, description="of the nut in these, where it is known; goes with by_drive_model"
    )
    preload_standard_uncertainty_n: SetPreload | None = Field(default=None, description="goes with preload_n")
    comment: Annotated[str, Field(max_length=1000, pattern=r"^[^\x00]*$")] = ""

    @model_validator(mode="after")
    def _one_prior(self) -> Self:
        if self.by_drive_model and self.prior is not None:
            raise ValueError("expected one of prior and by_drive_model, for each is what was known before; got both")
        if (self.preload_n is None) != (self.preload_standard_uncertainty_n is None):
            raise ValueError("preload_n and preload_standard_uncertainty_n are stated together or not at all")
        if self.preload_n is not None and not self.by_drive_model:
            raise ValueError("preload_n goes with by_drive_model; measurements that are fitted state their own")
        return self

    @property
    def preload(self) -> Estimate | None:
        """Of the nut where nobody set it [N]; None: as makers set it."""
        if self.preload_n is None or self.preload_standard_uncertainty_n is None:
            return None
        return Estimate(self.preload_n, self.preload_standard_uncertainty_n)


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
        a preload set on purpose, or nothing at all where the axis has a drive model and is calibrated by that;
        ConflictError while the axis is being fitted already; BusyError as for every job.
        """
        with self._database.read() as session:
            axis = get_axis(session, axis_id)
            if asked.prior is not None:
                get_calibration(session, axis_id, asked.prior)
            if asked.by_drive_model and load_configuration(axis.configuration).drive_model is None:
                raise NotIdentifiableError(f"expected drive_model in the settings of axis '{axis_id}'; got none")
            if not _measured(session, axis_id, asked):
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
            configuration = load_configuration(get_axis(session, job.axis_id).configuration)
            settings, rows = core_settings(configuration), _measured(session, job.axis_id, asked)
            prior = None if asked.prior is None else get_calibration(session, job.axis_id, asked.prior).document
        measured: list[tuple[int, ModalMeasurement]] = []
        total = len(rows) + 1  # the fit is a step, too
        for done, row in enumerate(rows):
            job.report(done, total, {})
            measured += [(row.id, modal) for modal in measured_modes(self._database, self._waveforms, settings, [row])]
        job.report(len(rows), total, {})
        if configuration.drive_model is not None and asked.by_drive_model:
            usable = [modal for _, modal in measured]
            if not usable:
                raise nothing_to_fit(job.axis_id)
            # measured as they are, whatever the settings of the axis say: it tells how the motor end is held
            of_nut = partial(_of_drive, configuration.drive_model, usable[0].excitation_source)
            steps = Progress(len(rows), total)
            prior_of_k, usual = in_own_process(of_nut, lambda at: job.report(steps.done, steps.total, {}), steps)
            at_first = usual if asked.preload is None else log_preload(asked.preload)
            fitted = calibrate_by_drive(usable, prior_of_k, at_first, settings=settings)
        else:
            fitted = fitted_to(job.axis_id, settings, [modal for _, modal in measured], None, prior=prior)
        at_set_preload = [item for item in measured if item[1].conditions.preload is not None]
        readings = [_reading(number, modal, fitted) for number, modal in at_set_preload]

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


def _measured(session: Session, axis_id: str, asked: CalibrationJobIn) -> list[MeasurementRow]:
    """Return what is to be fitted: measurements of a preload that was set, before a drive model of one that was not."""
    rows = measurements.calibration_measurements(session, axis_id, asked.start, asked.end)
    if asked.by_drive_model:
        number = get_axis(session, axis_id).number
        begun = [epoch.begins_at for epoch in epochs_of(session.connection(), number) if epoch.begun_by == MAINTENANCE]
        since = max([*begun, *([] if asked.start is None else [asked.start])], default=None)  # of one nut only
        rows += measurements.first_without_payload(session, axis_id, since, asked.end, _MOST_UNSET)
    return rows


def _of_drive(drive_model: str, source: ExcitationSource, report: Report) -> tuple[CoefficientPrior, Estimate]:
    """Return what a drive model lets expect of k1…k4, and of ln(P/N): a second of work, in a process of its own."""
    from monitor_core.identification import prior_of_drive, usual_preload_of  # noqa: PLC0415
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415

    del report
    axis = parse_model(drive_model, "drive_model")
    return prior_of_drive(axis, source), usual_preload_of(axis)
