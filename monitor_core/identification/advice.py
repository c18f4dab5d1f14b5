"""What to do next with identified joints: which mode to watch for a loss of preload, and where to measure next."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.residuals.peak_grid import Band
from monitor_core.fitting.solver.least_squares import LocalFit
from monitor_core.identification.cases import Case, positions_of
from monitor_core.identification.sensitivity import (
    Detectability,
    NextPosition,
    peak_sensitivities,
    rank_modes_to_monitor,
    rank_next_positions,
)
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceModel, ReceptanceParameters

#: Of one monitored frequency: what a judged measurement of some twenty windows states on the bundled sessions.
MONITORED_UNCERTAINTY = 1e-3
#: How many positions are weighed, and how far beyond those measured, as a part of the range that they span.
N_CANDIDATES, BEYOND = 15, 0.25
#: No position closer to a bearing than this part of the screw: the nut has a length.
_NEAREST_BEARING = 0.05


def modes_to_monitor(
    axis: ReceptanceParameters,
    conditions: Sequence[DriveConditions],
    frequencies: tuple[float, float],
    *,
    relative_frequency_uncertainty: float = MONITORED_UNCERTAINTY,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> tuple[Detectability, ...]:
    """Rank the peaks of the table's receptance by the smallest loss of preload that they show, the best first.

    ``conditions`` are those one may monitor under, ``frequencies`` the lowest and highest that are measured [Hz].
    """
    peaks = [
        peak
        for at in {each.position: each for each in conditions}.values()
        for peak in peak_sensitivities(axis, [at], bands_at(axis, at, frequencies, motor_end), motor_end=motor_end)
    ]
    return rank_modes_to_monitor(peaks, {peak.mode: relative_frequency_uncertainty for peak in peaks})


def bands_at(
    axis: ReceptanceParameters,
    conditions: DriveConditions,
    frequencies: tuple[float, float],
    motor_end: MotorEnd = MotorEnd.FREE,
) -> dict[int, Band]:
    """Return a band for each mode between two frequencies [Hz]: half way (geometrically) to its neighbours.

    It holds at one position: where modes change places along the screw, bands that hold at all positions do not exist.
    """
    modes = ReceptanceModel(axis).natural_frequencies(conditions, motor_end)
    elastic = [mode.frequency for mode in modes if mode.frequency > 0.0]
    edges = [elastic[0] / 2.0, *(math.sqrt(a * b) for a, b in itertools.pairwise(elastic))]
    edges.append(elastic[-1] * 1.5)
    return {
        mode: Band(edges[mode - 1], edges[mode])
        for mode, frequency in enumerate(elastic, start=1)
        if frequencies[0] <= frequency <= frequencies[1] and edges[mode - 1] < edges[mode]
    }


def next_positions(case: Case, fit: LocalFit, screw_length: float, parameter: int | None) -> tuple[NextPosition, ...]:
    """Rank positions at which a further measurement of the same kind would help most; none where no position helps.

    They are ranked by the variance of a ``parameter``, or without one by the determinant of the covariance.
    """
    measured = positions_of(case)
    candidates = [replace(case.conditions[0], position=position) for position in _candidates(measured, screw_length)]
    planned = case.planned(fit.coordinates.values, candidates)
    if not planned:
        return ()
    try:
        return rank_next_positions(fit.jacobian, planned, parameter=parameter)
    except NotIdentifiableError:
        return ()


def _candidates(measured: Sequence[float], screw_length: float) -> list[float]:
    reach = BEYOND * (measured[-1] - measured[0])
    low = max(measured[0] - reach, _NEAREST_BEARING * screw_length)
    high = min(measured[-1] + reach, (1.0 - _NEAREST_BEARING) * screw_length)
    candidates: list[float] = np.linspace(low, high, N_CANDIDATES).tolist()
    return candidates
