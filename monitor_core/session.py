"""Judge the measurements of a recorded session one after the other, and calibrate an axis from one."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Protocol

import numpy as np

from monitor_core.arrays import Shown
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

if TYPE_CHECKING:
    from monitor_core.shown import Panel


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


class Trend(Shown, tuple[SessionMeasurement, ...]):
    """Judged measurements in the order of their time: ``Trend(judge_session(session, settings, calibration))``.

    What is shown of one is its preload [N] with its interval, or without a calibration its frequency [Hz].
    """

    __slots__ = ()

    def __repr__(self) -> str:
        """Return it in two lines: how many there are, and the first and the last value with interval and date."""
        unit, values = self._values()
        n_refused = len(self) - len(values)
        said = f"Trend of {len(self)} measurements{f', {n_refused} of them refused' if n_refused else ''}"
        if not values:
            return said
        first, last = (
            f"{value:.4g} {unit} ({lower:.4g} to {upper:.4g}) on {at:%Y-%m-%d}"
            for at, value, lower, upper in (values[0], values[-1])
        )
        return f"{said}\n  first {first}, last {last}"

    def _values(self) -> tuple[str, list[tuple[datetime, float, float, float]]]:
        """Return the unit of what is shown; of each measurement that has it when, the value, and its 95 % interval."""
        outcomes = [m.outcome for m in self]
        modes = [(o.modal, o.preload) for o in outcomes if not isinstance(o.modal, Rejection)]
        preloads = [
            (modal.started_at, preload.preload, preload.interval.lower, preload.interval.upper)
            for modal, preload in modes
            if isinstance(preload, PreloadEstimate)
        ]
        if preloads:
            return "N", preloads
        found = [(modal.started_at, modal.mode.frequency) for modal, _ in modes]
        return "Hz", [
            (at, f.value, f.value - f.expanded_uncertainty, f.value + f.expanded_uncertainty) for at, f in found
        ]

    def _panels(self) -> "Sequence[Panel]":
        from monitor_core.shown import Panel  # noqa: PLC0415  # few ask

        unit, values = self._values()
        if not values:
            return []
        at, value, lower, upper = zip(*values, strict=True)
        days = np.array([(moment - at[0]).total_seconds() for moment in at]) / 86400.0
        name = "preload [N]" if unit == "N" else "axial frequency [Hz]"
        interval = (np.array(lower), np.array(upper))
        return [Panel("", f"days since {at[0]:%Y-%m-%d %H:%M %Z}", name, days, np.array(value), interval=interval)]

    def _columns(self) -> Mapping[str, Sequence[object]]:
        modes = [None if isinstance(m.outcome.modal, Rejection) else m.outcome.modal for m in self]
        preloads = [m.outcome.preload if isinstance(m.outcome.preload, PreloadEstimate) else None for m in self]
        refusals = [m.outcome.refusal for m in self]
        return {
            "measurement": [m.name for m in self],
            "at": [None if mode is None else mode.started_at for mode in modes],
            "position_m": [m.conditions.position for m in self],
            "frequency_hz": [None if mode is None else mode.mode.frequency.value for mode in modes],
            "preload_n": [None if preload is None else preload.preload for preload in preloads],
            "lower_n": [None if preload is None else preload.interval.lower for preload in preloads],
            "upper_n": [None if preload is None else preload.interval.upper for preload in preloads],
            "refusal": [None if refusal is None else str(refusal.reason) for refusal in refusals],
        }


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

    Examples
    --------
    The axial mode of the plant that recorded this session, by finite elements in the time domain, is at 178 to 198 Hz:

    >>> from pathlib import Path
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> with recordings.open_session(Path("replay_data/healthy-month.session.h5")) as session:
    ...     judged = next(mc.judge_session(session, mc.AxisSettings(search_band=(140.0, 230.0))))
    >>> round(judged.outcome.modal.mode.frequency.value, 1)
    188.7
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

    Examples
    --------
    Recorded of a model at nine settings, and once more at 200 N:

    >>> from datetime import UTC, datetime
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> from monitor_core.models.generator import SimulationSettings
    >>> axis = recordings.read_model_file(Path("replay_data/models/lumped.toml")).build()
    >>> def recorded(places, seed):
    ...     few, start = SimulationSettings(windows_per_measurement=8), datetime(2026, 3, 2, tzinfo=UTC)
    ...     rng = np.random.default_rng(seed)
    ...     return mc.simulate_session(axis, places, few, axis_id="x", started_at=start, rng=rng)
    >>> set_to = [mc.DriveConditions(x, preload=p) for x in (0.2, 0.45, 0.7) for p in (100.0, 200.0, 400.0)]
    >>> settings = mc.AxisSettings(search_band=(150.0, 300.0))
    >>> calibration = mc.calibrate_session(recorded(set_to, 1), settings)
    >>> [again] = mc.judge_session(recorded([mc.DriveConditions(0.5, preload=200.0)], 2), settings, calibration)
    >>> round(again.outcome.preload.preload)
    200
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
