"""Judge the measurements of a recorded session one after the other, and calibrate an axis from one."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Protocol

from monitor_core.errors import NotIdentifiableError
from monitor_core.modal import ModalMeasurement, measure_modes, session_remarks
from monitor_core.pipeline import (
    AxisSettings,
    MeasurementOutcome,
    calibrate_from_measurements,
    check_window,
    judge_measurement,
    search_band,
)
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    PreloadEstimate,
    SessionPreload,
    Weighting,
    session_preload,
)
from monitor_core.preload.doubts import Places, of_whole_session, places_disagree
from monitor_core.preload.estimate import place_reading
from monitor_core.recording import SESSION_GAP, Conditions, Rejection, RejectionReason, Window


class RecordedMeasurements(Protocol):
    """Windows by measurement: a ``Session``, or a reader that takes them from a file one measurement at a time."""

    @property
    def measurements(self) -> tuple[str, ...]:
        """Names, in order of first appearance."""
        ...

    def windows_of(self, measurement: str) -> tuple[Window, ...]:
        """Return the windows of one measurement, in time order."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class GatedMeasurement:
    """The windows of one measurement, each accepted or refused by itself."""

    name: str
    conditions: Conditions  # of the first window
    accepted: tuple[Window, ...]
    refused: tuple[Rejection, ...]

    @property
    def rejection(self) -> Rejection:
        """Why a measurement without an accepted window cannot be judged."""
        reasons = ", ".join(sorted({str(refusal.reason) for refusal in self.refused}))
        return Rejection(RejectionReason.TOO_FEW_AVERAGES, f"every window was refused: {reasons}")


@dataclass(frozen=True, slots=True, eq=False)
class SessionMeasurement:
    """One measurement of a session: what came of it, and of the windows that were refused."""

    name: str
    conditions: Conditions  # of the first window
    outcome: MeasurementOutcome
    refused_windows: tuple[Rejection, ...]


def gate_session(
    session: RecordedMeasurements, settings: AxisSettings, calibration: Calibration | None = None
) -> Iterator[GatedMeasurement]:
    """Gate every window of a session by itself, measurement by measurement; memory stays flat."""
    for name in session.measurements:
        windows = session.windows_of(name)
        checked = [(window, check_window(window, settings, calibration)) for window in windows]
        yield GatedMeasurement(
            name,
            windows[0].conditions,
            tuple(window for window, refusal in checked if refusal is None),
            tuple(refusal for _, refusal in checked if refusal is not None),
        )


def judge_session(
    session: RecordedMeasurements, settings: AxisSettings, calibration: Calibration | None = None
) -> Iterator[SessionMeasurement]:
    """Judge the measurements of a session one after another.

    Without a calibration modes are measured, and no preload.
    """
    for gated in gate_session(session, settings, calibration):
        if gated.accepted:
            outcome = judge_measurement(gated.accepted, settings, calibration)
        else:
            outcome = MeasurementOutcome(gated.rejection, gated.rejection, gated.rejection)
        yield SessionMeasurement(gated.name, gated.conditions, outcome, gated.refused)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredModes:
    """One measurement of a session, with more modes than the axial one; each is measured or refused for itself."""

    measurement: SessionMeasurement
    modes: tuple[ModalMeasurement | Rejection, ...]  # by rising frequency


def modes_of_session(session: RecordedMeasurements, settings: AxisSettings, n_modes: int) -> Iterator[MeasuredModes]:
    """Judge the measurements of a session without a calibration, with up to so many modes of each."""
    for gated in gate_session(session, settings):
        if not gated.accepted:
            outcome = MeasurementOutcome(gated.rejection, gated.rejection, gated.rejection)
            modes: tuple[ModalMeasurement | Rejection, ...] = (gated.rejection,)
        else:
            outcome = judge_measurement(gated.accepted, settings, None)
            band = search_band(settings, None, gated.accepted[0])
            modes = measure_modes(gated.accepted, band=band, gate=settings.mode, n_modes=n_modes)
        yield MeasuredModes(SessionMeasurement(gated.name, gated.conditions, outcome, gated.refused), modes)


def with_session_doubts(
    judged: Sequence[SessionMeasurement], calibration: Calibration | None
) -> list[SessionMeasurement]:
    """Add to each preload what the measurements of its session say together: places that disagree, common deviations.

    The measurements are in the order of their time; those less than :data:`SESSION_GAP` after the one before are of one
    session.
    """
    if calibration is None:
        return list(judged)
    return [doubted for session in sessions_of(judged) for doubted in _doubted(session, calibration)]


def sessions_of(judged: Sequence[SessionMeasurement]) -> list[list[SessionMeasurement]]:
    """Return the measurements, in the order of their time, session by session: no :data:`SESSION_GAP` within one."""
    together: list[list[SessionMeasurement]] = []
    last: datetime | None = None
    for measurement in judged:
        modal = measurement.outcome.modal
        started_at = None if isinstance(modal, Rejection) else modal.started_at
        if not together or (started_at is not None and last is not None and started_at - last > SESSION_GAP):
            together.append([])
        together[-1].append(measurement)
        last = started_at or last
    return together


def preload_of_session(session: Sequence[SessionMeasurement], calibration: Calibration) -> SessionPreload | None:
    """Join the preloads of the measurements of one session (:func:`~monitor_core.preload.session_preload`).

    ``None`` where there are fewer than two, where somebody set preloads, or where they contradict each other: a mean of
    what is not one preload is nobody's.
    """
    measured = [(m.outcome.preload, m.conditions) for m in session if isinstance(m.outcome.preload, PreloadEstimate)]
    places = Places()
    for estimate, conditions in measured:
        places = places.with_reading(place_reading(conditions, estimate, calibration))
    if not places.agrees or any(conditions.preload is not None for _, conditions in measured):
        return None
    return session_preload([e for e, _ in measured], [stated.position for _, stated in measured], calibration)


def _doubted(session: Sequence[SessionMeasurement], calibration: Calibration) -> list[SessionMeasurement]:
    """Add the doubts of one session to each of its preloads; places are compared where nobody has set the preload."""
    preloads = [m.outcome.preload for m in session if isinstance(m.outcome.preload, PreloadEstimate)]
    places = [
        place_reading(m.conditions, m.outcome.preload, calibration)
        for m in session
        if isinstance(m.outcome.preload, PreloadEstimate) and m.conditions.preload is None
    ]
    disagreement = places_disagree(places)
    common = of_whole_session([estimate.deviations for estimate in preloads], calibration)
    doubts = (*common, *(() if disagreement is None else (disagreement,)))
    return [
        replace(m, outcome=replace(m.outcome, preload=m.outcome.preload.with_doubts(doubts)))
        if isinstance(m.outcome.preload, PreloadEstimate)
        else m
        for m in session
    ]


def excitation_remarks(judged: Sequence[SessionMeasurement]) -> dict[str, str]:
    """Return by the names of the measurements what is said of those that were driven otherwise than the others."""
    modes = {m.name: m.outcome.modal for m in judged if isinstance(m.outcome.modal, ModalMeasurement)}
    remarks = session_remarks(list(modes.values()))
    return {name: remark for name, remark in zip(modes, remarks, strict=True) if remark is not None}


def modes_at_set_preloads(judged: Sequence[SessionMeasurement]) -> list[ModalMeasurement]:
    """Return the modes of the measurements whose preload was set on purpose and that were not refused."""
    return [
        measurement.outcome.modal
        for measurement in judged
        if measurement.conditions.preload is not None and isinstance(measurement.outcome.modal, ModalMeasurement)
    ]


def calibrate_session(
    session: RecordedMeasurements,
    settings: AxisSettings,
    *,
    weighting: Weighting = Weighting.NONE,
    prior: CoefficientPrior | None = None,
) -> Calibration:
    """Fit k1…k4 to the measurements of a session whose preload was set on purpose.

    With a prior, what was known of k1…k4 before, fewer measurements will do. ``NotIdentifiableError`` if none of the
    measurements can be judged, or they determine no calibration.
    """
    return calibrate_judged(list(judge_session(session, settings)), settings, weighting=weighting, prior=prior)


def calibrate_judged(
    judged: Sequence[SessionMeasurement],
    settings: AxisSettings,
    *,
    weighting: Weighting = Weighting.NONE,
    prior: CoefficientPrior | None = None,
) -> Calibration:
    """Fit k1…k4 to measurements that are judged already; as :func:`calibrate_session`."""
    modes = modes_at_set_preloads(judged)
    if not modes:
        raise NotIdentifiableError("a calibration needs measurements with preload_n set that can be judged; got none")
    return calibrate_from_measurements(modes, settings=settings, weighting=weighting, prior=prior)
