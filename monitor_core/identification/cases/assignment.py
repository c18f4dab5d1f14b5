r"""Which mode a measured peak belongs to: by frequency, position and shape, not by its place in a list.

A list of peaks has holes: where the table stands at a node a mode makes no peak, and the fourth mode is then third in
the list. Each peak is given to a mode of the model, the modes being followed along the screw by their shapes. All peaks
are placed at once, so that the sum over positions of

.. math::

    \left( \ln \frac{f_t}{f_c} - \beta_q \right)^2

is least (t measured, c the model's mode q): :math:`\beta_q`, common to all positions, is by how much the joints of the
model put a mode too low. A model whose joints are not known yet misses a mode everywhere by the same share, and one
position where two modes are close does not decide for itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.observations import AssignedPeak, ModalObservation, conditions_in_order
from monitor_core.fitting.residuals.peak_grid import IndexArray
from monitor_core.identification.cases.mode_tracks import ModeTracks, track_modes
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance.parameters import ReceptanceParameters

#: A mode in which the table moves with less than this share of its largest φ² is masked: its peak is 13 dB lower.
MASKED_BELOW = 0.05
#: What it costs to give a peak to a masked mode, in squares of ln f: 10 % of frequency.
_MASKED_COST = math.log(1.1) ** 2
_ROUNDS = 20


@dataclass(frozen=True, slots=True)
class MissingPeak:
    """A mode that other positions show and this one does not."""

    conditions: DriveConditions
    mode: int  # from 1
    frequency: float  # where the model has it, shifted as at the other positions [Hz]
    table_share: float  # φ² at the table over its largest along the screw [-]

    @property
    def masked(self) -> bool:
        """Whether it cannot be seen there: the table stands at a node of the mode."""
        return self.table_share < MASKED_BELOW

    @property
    def sentence(self) -> str:
        """What to tell."""
        where = f"mode {self.mode} near {self.frequency:.0f} Hz has no peak at {self.conditions.position * 1e3:g} mm"
        return f"{where}: the table stands at its node" if self.masked else f"{where}, where it should be seen"


@dataclass(frozen=True, slots=True)
class ModeAssignment:
    """Peaks with their modes, and what is not there."""

    peaks: tuple[AssignedPeak, ...]  # in the order of the table
    missing: tuple[MissingPeak, ...]
    shift: dict[int, float]  # mean ln(measured/model) of each mode that was measured [-]


def assign_modes(
    parameters: ReceptanceParameters,
    observations: Sequence[ModalObservation],
    *,
    largest_shift: float = 0.25,
    n_modes: int = 6,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> ModeAssignment:
    """Give each measured peak the one of the model's ``n_modes`` lowest elastic modes that it belongs to.

    Repeated readings of one peak are averaged before; the ``order`` of observations plays no part. Raises
    NotIdentifiableError if a peak is farther than ``largest_shift``, relative, from every mode, or two peaks at one
    position belong to one.
    """
    if not observations:
        raise NotIdentifiableError("modes must be assigned to one peak at least; the table has none")
    conditions = conditions_in_order(observations)
    tracks = track_modes(parameters, conditions, n_modes=n_modes, motor_end=motor_end)
    where = np.array([conditions.index(observation.conditions) for observation in observations])
    measured = np.log([observation.frequency for observation in observations])
    limit = math.log1p(largest_shift)
    _require_near(observations, measured, where, tracks, largest_shift)
    modes, shift = _placed(measured, where, tracks, limit)
    distance = np.abs(measured - np.log(tracks.frequency[where, modes]))
    if np.any(distance > limit):
        raise NotIdentifiableError(_two_for_one(observations, measured, where, tracks, int(distance.argmax())))
    peaks = tuple(AssignedPeak(peak, int(mode) + 1) for peak, mode in zip(observations, modes, strict=True))
    shown = sorted({int(mode) for mode in modes})
    return ModeAssignment(
        peaks, _missing(tracks, where, modes, shift), {mode + 1: float(shift[mode]) for mode in shown}
    )


def _placed(measured: FloatArray, where: IndexArray, tracks: ModeTracks, limit: float) -> tuple[IndexArray, FloatArray]:
    """Return the mode of each peak, counted from 0, and the shift of each mode."""
    model = np.log(tracks.frequency)
    masked = _MASKED_COST * (tracks.table_share < MASKED_BELOW)
    shift, modes = np.zeros(tracks.n_modes), np.full(measured.size, -1)
    for _ in range(_ROUNDS):
        before = modes.copy()
        for place in range(len(tracks.conditions)):
            here = np.flatnonzero(where == place)
            # more peaks than modes: the last of them stay without one, which is refused by their distance
            cost = (measured[here, None] - model[place] - shift) ** 2 + masked[place]
            rows, columns = scipy.optimize.linear_sum_assignment(cost)
            modes[here] = np.argmin(cost, axis=1)
            modes[here[rows]] = columns
        if np.array_equal(before, modes):
            break
        for mode in range(tracks.n_modes):
            own = modes == mode
            if np.any(own):
                shift[mode] = np.clip(np.mean(measured[own] - model[where[own], mode]), -limit, limit)
    return modes, shift


def _require_near(
    observations: Sequence[ModalObservation],
    measured: FloatArray,
    where: IndexArray,
    tracks: ModeTracks,
    largest_shift: float,
) -> None:
    away = np.abs(measured[:, None] - np.log(tracks.frequency[where]))
    nearest = away.min(axis=1)
    k = int(nearest.argmax())
    if nearest[k] > math.log1p(largest_shift):
        model = tracks.frequency[where[k], away[k].argmin()]
        raise NotIdentifiableError(
            f"a peak must lie within {largest_shift:.0%} of a mode of the model; {observations[k].name} is nearest to "
            f"one at {model:.0f} Hz"
        )


def _two_for_one(
    observations: Sequence[ModalObservation], measured: FloatArray, where: IndexArray, tracks: ModeTracks, worst: int
) -> str:
    """Name the two peaks, at the position of the one that found no mode, that are nearest to the same mode."""
    here = np.flatnonzero(where == where[worst])
    nearest = np.abs(measured[here, None] - np.log(tracks.frequency[where[worst]])).argmin(axis=1)
    shared = next((mode for mode in nearest if np.sum(nearest == mode) > 1), None)
    if shared is None:
        return f"{observations[worst].name} belongs to no mode once the others at its position have theirs"
    peak, other = (observations[k] for k in here[nearest == shared][:2])
    return (
        f"a mode has one peak at a position; {peak.name} and that at {other.frequency:g} Hz both belong to mode "
        f"{shared + 1}; average repeated readings, leave out what is no mode"
    )


def _missing(tracks: ModeTracks, where: IndexArray, modes: IndexArray, shift: FloatArray) -> tuple[MissingPeak, ...]:
    present = set(zip(where.tolist(), modes.tolist(), strict=True))
    return tuple(
        MissingPeak(
            conditions,
            mode + 1,
            float(tracks.frequency[place, mode] * math.exp(shift[mode])),
            float(tracks.table_share[place, mode]),
        )
        for place, conditions in enumerate(tracks.conditions)
        for mode in sorted(set(modes.tolist()))
        if (place, mode) not in present
    )
