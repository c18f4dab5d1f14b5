"""Answer what an axis did over a long time: its responses and its sisters."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import BaseModel, TypeAdapter

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.preload import position_part
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.units import metres
from service.documents.stored_measurement import StoredMeasurement
from service.operations.monitoring.axis_configuration import sisters_of
from service.operations.monitoring.extremes import extremes
from service.operations.monitoring.history import HealthyFrequency
from service.store import axes, measurements
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database
from service.store.trend.points import Span
from service.store.trend.shown import ShownPoint

#: Responses of a picture, from as many stretches of the time.
MOST_SPECTRA: Final = 26
#: So many measurements they are chosen from.
_CHOSEN_FROM: Final = 6 * MOST_SPECTRA
MOST_SISTERS: Final = 6
_OF_A_SISTER: Final = 60


class _Response(BaseModel):
    """A frequency response as it is stored."""

    frequency_hz: list[float]
    real: list[float | None]
    imaginary: list[float | None]


_RESPONSE: Final = TypeAdapter(_Response)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """The size of the response of one measurement; shape (n_frequencies,). As if it had been at the usual position."""

    point: ShownPoint
    mode: float  # [Hz]
    frequency: FloatArray  # [Hz]
    magnitude: FloatArray  # in the unit of the response
    coherence: float | None  # mean over the half-power band
    unexplained: float | None  # share of the response that one mode leaves, as amplitude


@dataclass(frozen=True, slots=True)
class Sister:
    """An axis of a type with the newest of what it measured, in time order."""

    id: str
    name: str
    state: str
    points: list[ShownPoint]


def spectra_of(database: Database, axis_id: str, healthy: HealthyFrequency | None) -> list[Spectrum]:
    """Return responses over the time, newest first: of each stretch the one measured nearest to one position.

    The position is the usual one, and those under a payload are left out if there are others. What is left of the
    position is taken off by the calibration in force, or by what is known of the ``healthy`` axis without one.
    """
    with database.read() as session:
        row, connection = axes.get_axis(session, axis_id), session.connection()
        points = extremes(connection, row.number, Span(), _CHOSEN_FROM)
        measured = [point for point in points if point.frequency_hz is not None]
        bare = [point for point in measured if not point.payload_kg]
        chosen, usual = _alike((bare if len(bare) > 1 else measured)[::-1])
        calibration = CalibrationsInForce().numbered(connection, axis_id, row.active_calibration_id)
        stored = measurements.responses_of(session, [point.measurement_id for point in chosen])

    def of_place(position: float) -> float:
        """Return what of 1/f² goes with the position [s²]."""
        if calibration is not None:
            return float(position_part(position, calibration.coefficients))
        return 0.0 if healthy is None else healthy.law.shift(Conditions(position))

    def corrected(point: ShownPoint, outcome: object, response: object) -> Spectrum:
        mode = point.frequency_hz or math.nan
        feature = mode**-2 - of_place(metres(point.position_mm)) + of_place(metres(usual))
        at_usual = feature**-0.5 if feature > 0.0 else mode  # the law does not reach so far: as it is
        return _spectrum(point, StoredMeasurement.model_validate(outcome), response, at_usual)

    return [corrected(point, *stored[point.measurement_id]) for point in chosen if point.measurement_id in stored]


def sisters_with_trend(database: Database, axis_id: str) -> list[Sister]:
    """Return the axis and others of its type, each with its trend in brief; none if there is no other."""
    with database.read() as session:
        own = axes.get_axis(session, axis_id)
        others = list(itertools.islice(sisters_of(session, own), MOST_SISTERS))
        rows = [own, *others] if others else []
        return [
            Sister(row.id, row.name, row.state, extremes(session.connection(), row.number, Span(), _OF_A_SISTER))
            for row in rows
        ]


def _alike(points: Sequence[ShownPoint]) -> tuple[list[ShownPoint], float]:
    """Return of each stretch the measurement nearest to the usual position, and that [mm]."""
    if not points:
        return [], math.nan
    usual = float(np.median([point.position_mm for point in points]))
    edges = np.linspace(0, len(points), min(MOST_SPECTRA, len(points)) + 1).astype(int)
    stretches = [points[begin:end] for begin, end in itertools.pairwise(edges)]
    return [min(stretch, key=lambda point: abs(point.position_mm - usual)) for stretch in stretches], usual


def _spectrum(point: ShownPoint, outcome: StoredMeasurement, document: object, at_usual: float) -> Spectrum:
    stored, mode = _RESPONSE.validate_python(document), point.frequency_hz or math.nan
    frequency = np.array(stored.frequency_hz)
    real, imaginary = (np.array(part, dtype=np.float64) for part in (stored.real, stored.imaginary))
    left = (
        None
        if outcome.damping_ratio is None
        else unexplained(frequency, real + 1j * imaginary, mode, outcome.damping_ratio)
    )
    return Spectrum(point, at_usual, at_usual / mode * frequency, np.hypot(real, imaginary), outcome.coherence, left)


def unexplained(frequency: FloatArray, response: ComplexArray, mode: float, damping_ratio: float) -> float | None:
    r"""Return which share of a response one mode of known frequency [Hz] and damping ratio leaves, as amplitude.

    The accelerance :math:`A f^2 / (f_0^2 - f^2 + 2 i \zeta f_0 f) + B` is fitted to the lines by least squares, with B
    for all modes far off (Ewins, Modal Testing, 2000, section 4.3). None of fewer than four lines.
    """
    finite = np.isfinite(response)
    lines, measured = frequency[finite], response[finite]
    if lines.size < 4 or not np.any(measured):
        return None
    resonance = lines**2 / (mode**2 - lines**2 + 2j * damping_ratio * mode * lines)
    basis = np.stack([resonance, np.ones_like(resonance)], axis=1)
    left = measured - basis @ np.linalg.lstsq(basis, measured, rcond=None)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(measured))
