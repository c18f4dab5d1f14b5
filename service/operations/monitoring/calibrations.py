"""Fit, store and activate the calibrations of axes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy.orm import Session

from monitor_core.errors import NotIdentifiableError
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisSettings, calibrate_from_measurements
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    ModalReading,
    Weighting,
    calibrate,
    prior_from_calibration,
    verify_calibration,
)
from monitor_core.recording import ExcitationSource
from monitor_core.recordings.calibration_file import calibration_document, calibration_from_document
from service.clock import now
from service.json_types import JsonObject
from service.operations.monitoring.axis_configuration import core_settings, load_configuration
from service.operations.monitoring.intake.epochs import begin_by_calibration
from service.operations.monitoring.stored_modes import measured_modes
from service.store import calibrations, measurements
from service.store.axes import get_axis, key_of
from service.store.database import Database
from service.store.tables import ActivationRow, CalibrationRow
from service.store.waveforms import WaveformStore


@dataclass(frozen=True, slots=True)
class CalibrationOverview:
    """The calibrations of an axis, newest first, and which is in force."""

    calibrations: list[CalibrationRow]
    activations: list[ActivationRow]
    active: int | None


class Calibrations:
    """Fit, store and activate calibrations."""

    def __init__(self, database: Database, waveforms: WaveformStore) -> None:
        self._database = database
        self._waveforms = waveforms

    def fit_measurements(
        self,
        axis_id: str,
        span: tuple[datetime | None, datetime | None],
        weighting: str | None,
        comment: str,
        *,
        prior: JsonObject | None = None,
    ) -> CalibrationRow:
        """Fit to stored measurements whose preload was set on purpose, from their waveforms.

        Raises WaveformDamagedError if a waveform is not what was stored: a calibration does not silently rest on less
        than it was asked for.
        """
        with self._database.read() as session:
            axis = get_axis(session, axis_id)
            rows = measurements.calibration_measurements(session, axis_id, *span)
        settings = core_settings(load_configuration(axis.configuration))
        measured = list(measured_modes(self._database, self._waveforms, settings, rows))
        return self._store(axis_id, fitted_to(axis_id, settings, measured, weighting, prior=prior), comment)

    def fit_readings(
        self,
        axis_id: str,
        readings: Sequence[ModalReading],
        weighting: str | None,
        comment: str,
        *,
        prior: JsonObject | None = None,
    ) -> CalibrationRow:
        """Fit to the rows of a modal table; they are taken to be of the excitation source that the axis states."""
        with self._database.read() as session:
            configuration = load_configuration(get_axis(session, axis_id).configuration)
        stated = all(reading.frequency_std is not None for reading in readings)
        fitted = calibrate(
            readings,
            weighting=Weighting(weighting or (Weighting.STD if stated else Weighting.NONE)),
            excitation_source=ExcitationSource(configuration.excitation_source),
            moving_mass=core_settings(configuration).moving_mass,
            prior=_prior(prior),
        )
        return self._store(axis_id, fitted, comment)

    def bring(self, axis_id: str, document: JsonObject, comment: str) -> CalibrationRow:
        """Store a calibration that ``preload calibrate`` wrote."""
        return self._store(axis_id, calibration_from_document(document), comment)

    def activate(
        self,
        axis_id: str,
        calibration_id: int,
        reason: str,
        *,
        expected_active: str | None,
        judge_history: Callable[[Session], object] | None = None,
    ) -> None:
        """Put a calibration in force; the charts begin with a new baseline, since they watch another number now.

        Activating what is in force changes nothing, so that a request may be repeated. ``judge_history``: called in
        the same transaction where frequencies were watched until now, for the calibration alone tells newtons; if it
        refuses, none comes in force.
        """
        with self._database.write(axis_id) as session:
            axis = get_axis(session, axis_id)
            row = calibrations.get_calibration(session, axis_id, calibration_id)
            calibrations.require_in_force(axis, expected_active)
            if axis.active_calibration_id == row.id:
                return
            if judge_history is not None and axis.active_calibration_id is None and axis.last_charted_at is not None:
                judge_history(session)
            axis.active_calibration_id = row.id
            session.flush()
            begin_by_calibration(session.connection(), axis_id)
            session.add(ActivationRow(axis_id=axis_id, calibration_id=row.id, activated_at=now(), reason=reason))

    def overview(self, axis_id: str) -> CalibrationOverview:
        """Return the calibrations of an axis and their history."""
        with self._database.read() as session:
            return CalibrationOverview(
                calibrations.list_calibrations(session, axis_id),
                calibrations.list_activations(session, axis_id),
                key_of(session, axis_id).calibration_id,
            )

    def get(self, axis_id: str, calibration_id: int) -> tuple[CalibrationRow, int | None]:
        """Return one calibration, and which is in force."""
        with self._database.read() as session:
            row = calibrations.get_calibration(session, axis_id, calibration_id)
            return row, get_axis(session, axis_id).active_calibration_id

    def _store(self, axis_id: str, calibration: Calibration, comment: str) -> CalibrationRow:
        with self._database.write() as session:
            return add_calibration(session, axis_id, calibration, comment)


def fitted_to(
    axis_id: str,
    settings: AxisSettings,
    measured: Sequence[ModalMeasurement],
    weighting: str | None,
    *,
    prior: JsonObject | None = None,
) -> Calibration:
    """Fit to measured modes, and store nothing yet.

    Raises NotIdentifiableError if they do not determine the coefficients.
    """
    if not measured:
        raise nothing_to_fit(axis_id)
    return calibrate_from_measurements(
        measured, settings=settings, weighting=Weighting(weighting or Weighting.NONE), prior=_prior(prior)
    )


def add_calibration(session: Session, axis_id: str, calibration: Calibration, comment: str) -> CalibrationRow:
    """Store a calibration for review; raises UnknownResourceError if the axis is gone."""
    get_axis(session, axis_id)
    document = calibration_document(calibration)
    row = CalibrationRow(axis_id=axis_id, document=document, comment=comment, created_at=now())
    session.add(row)
    session.flush()
    return row


def nothing_to_fit(axis_id: str) -> NotIdentifiableError:
    """Return the refusal of a fit without measurements."""
    return NotIdentifiableError(
        f"axis '{axis_id}' has no judged measurement with preload_n set in that range; a calibration needs "
        "them at three or more positions and two or more preloads, or with a prior one; by a drive model one will do "
        "whose preload nobody set, without payload"
    )


def _prior(document: JsonObject | None) -> CoefficientPrior | None:
    if document is None:
        return None
    verify_calibration(calibration := calibration_from_document(document))
    return prior_from_calibration(calibration, "a calibration")
