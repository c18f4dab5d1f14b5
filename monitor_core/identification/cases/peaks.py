r"""Pose peaks of the table's receptance as the problem of a fit, each given to a mode by frequency, position and shape.

The receptance family alone has such a case: its modes are followed along the screw by their shapes. A list of peaks has
holes: where the table stands at a node a mode makes no peak, and the fourth mode is then third in the list. All peaks
are placed at once, so that the sum over positions of

.. math::

    \left( \ln \frac{f_t}{f_c} - \beta_q \right)^2

is least (t measured, c the model's mode q): :math:`\beta_q`, common to all positions, is by how much the joints of the
model put a mode too low. A model whose joints are not known yet misses a mode everywhere by the same share, and one
position where two modes are close does not decide for itself.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak, ModalObservation, conditions_in_order
from monitor_core.fitting.problem import Problem, with_priors
from monitor_core.fitting.residuals.peak_search import (
    AMPLITUDE_UNCERTAINTY,
    FREQUENCY_UNCERTAINTY,
    Band,
    IndexArray,
    Place,
    find_peaks,
    mode_bands,
    peak_grid,
    relative_amplitude_uncertainty,
    relative_frequency_uncertainty,
)
from monitor_core.fitting.residuals.peaks import (
    PeakProblem,
    Weighting,
    paper_objective,
    peak_problem,
    receptance_axis,
)
from monitor_core.identification.cases.any_family import POSITIONS_OF_PEAKS, PlannedMeasurements, PredictionError
from monitor_core.identification.cases.mode_tracks import ModeTracks, track_modes
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance.joint_response import joints_of
from monitor_core.models.published.receptance.parameters import ReceptanceParameters

#: A mode in which the table moves with less than this share of its largest φ² is masked: its peak is 13 dB lower.
MASKED_BELOW = 0.05
#: What it costs to give a peak to a masked mode, in squares of ln f: 10 % of frequency.
_MASKED_COST = math.log(1.1) ** 2
#: A peak moves otherwise than a mode where the two differ by more than so many of their standard uncertainties.
_OTHERWISE = 2.0
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
        place = f"mode {self.mode} near {self.frequency:.0f} Hz has no peak at {self.conditions.position * 1e3:g} mm"
        return f"{place}: the table stands at its node" if self.masked else f"{place}, where it should be seen"


@dataclass(frozen=True, slots=True)
class DroppedPeak:
    """A peak that is no axial mode: it does not move with the position as one does, or there is none left for it."""

    observation: ModalObservation
    mode: int  # of the model, the next one in frequency; from 1
    mode_frequency: float  # where the model has it, shifted as at the other positions [Hz]
    own_peaks: tuple[int, ...]  # the modes below and above it, where both have peaks of their own there
    elsewhere: ModalObservation | None  # the peak next to it at the position from which that mode moves most
    mode_moves: float  # by how much that mode would have moved from there, at the frequency of the peak [Hz]

    @property
    def moved(self) -> float | None:
        """By how much it moved from elsewhere; None where no other position has a peak near it. [Hz]."""
        return None if self.elsewhere is None else self.observation.frequency - self.elsewhere.frequency

    @property
    def sentence(self) -> str:
        """Why it is none."""
        mode = f"mode {self.mode} near {self.mode_frequency:.0f} Hz"
        reason = f"no other position has a peak near it; next to it is {mode}"
        if self.elsewhere is not None:
            reason = (
                f"it moved by {self.moved:+.3g} Hz from {self.elsewhere.conditions.position * 1e3:g} mm, where {mode} "
                f"would by {self.mode_moves:+.3g} Hz"
            )
        if self.own_peaks:
            reason = f"{reason}; modes {' and '.join(map(str, self.own_peaks))} have their own"
        return f"{self.observation.name} is no axial mode: {reason}"


@dataclass(frozen=True, slots=True)
class ModeAssignment:
    """Peaks with their modes, and what is not there."""

    peaks: tuple[AssignedPeak, ...]  # in the order of the table
    missing: tuple[MissingPeak, ...]
    shift: dict[int, float]  # mean ln(measured/model) of each mode that was measured [-]
    dropped: tuple[DroppedPeak, ...] = ()


def assign_modes(
    parameters: ReceptanceParameters,
    observations: Sequence[ModalObservation],
    *,
    largest_shift: float = 0.25,
    n_modes: int = 6,
    motor_end: MotorEnd = MotorEnd.FREE,
    drop: bool = False,
) -> ModeAssignment:
    """Give each measured peak the one of the model's ``n_modes`` lowest elastic modes that it belongs to.

    Repeated readings of one peak are averaged before; the ``order`` of observations plays no part. Peaks that can be no
    axial mode may ``drop``. Raises NotIdentifiableError if another peak is farther than ``largest_shift``, relative,
    from every mode, or two peaks at one position belong to one.
    """
    if not observations:
        raise NotIdentifiableError("modes must be assigned to one peak at least; the table has none")
    conditions = conditions_in_order(observations)
    tracks = track_modes(parameters, conditions, n_modes=n_modes, motor_end=motor_end)
    condition = np.array([conditions.index(observation.conditions) for observation in observations])
    table = _Table(observations, np.log([each.frequency for each in observations]), condition, tracks)
    limit = math.log1p(largest_shift)
    modes, shift = _placed(table, limit)
    if np.any(table.distance(modes) > limit):
        if not drop:
            raise NotIdentifiableError(_refusal(table, int(table.distance(modes).argmax()), largest_shift))
        modes, shift = _placed(table, limit, spare=limit**2 + _MASKED_COST)
        modes = _without_companions(table, np.where(table.distance(modes) > limit, -1, modes))
        shift = np.where(np.isin(np.arange(n_modes), modes), shift, 0.0)
    kept = np.flatnonzero(modes >= 0)
    dropped = tuple(_dropped(table, int(k), modes, shift, largest_shift) for k in np.flatnonzero(modes < 0))
    if not kept.size:
        raise NotIdentifiableError(f"no peak is left: {'; '.join(peak.sentence for peak in dropped)}")
    peaks = tuple(AssignedPeak(observations[int(k)], int(modes[k]) + 1) for k in kept)
    shown = sorted(set(modes[kept].tolist()))
    return ModeAssignment(
        peaks,
        _missing(tracks, condition[kept], modes[kept], shift),
        {mode + 1: float(shift[mode]) for mode in shown},
        dropped,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """What was measured beside the modes of the model; shape (n_peaks,)."""

    observations: Sequence[ModalObservation]
    measured: FloatArray  # ln f
    condition: IndexArray  # of ``tracks``
    tracks: ModeTracks

    def distance(self, modes: IndexArray) -> FloatArray:
        """Return how far each peak is from its mode, in ln f; infinite where it has none."""
        away = np.abs(self.measured - np.log(self.tracks.frequency[self.condition, modes]))
        return np.where(modes < 0, np.inf, away)

    def alike(self, k: int, other: int, moves: float = 0.0) -> bool:
        """Tell whether a peak is, within uncertainties, where another one would be that moves by so much in ln f."""
        both = [relative_frequency_uncertainty(self.observations[peak]) for peak in (k, other)]
        return bool(abs(self.measured[k] - self.measured[other] - moves) <= _OTHERWISE * math.hypot(*both))


def _placed(table: _Table, limit: float, spare: float | None = None) -> tuple[IndexArray, FloatArray]:
    """Return the mode of each peak, counted from 0, and the shift of each mode.

    A peak may stay without a mode, −1, at the cost of ``spare``.
    """
    tracks, measured, condition = table.tracks, table.measured, table.condition
    model = np.log(tracks.frequency)
    masked = _MASKED_COST * (tracks.table_share < MASKED_BELOW)
    shift, modes = np.zeros(tracks.n_modes), np.full(measured.size, -1)
    for _ in range(_ROUNDS):
        before = modes.copy()
        for place in range(len(tracks.conditions)):
            here = np.flatnonzero(condition == place)
            # more peaks than modes: the last of them stay without one, which is refused by their distance
            cost = (measured[here, None] - model[place] - shift) ** 2 + masked[place]
            modes[here] = np.argmin(cost, axis=1)
            if spare is not None:
                cost = np.hstack([cost, np.full((here.size, here.size), spare)])
            rows, columns = scipy.optimize.linear_sum_assignment(cost)
            modes[here[rows]] = np.where(columns < tracks.n_modes, columns, -1)
        if np.array_equal(before, modes):
            break
        for mode in range(tracks.n_modes):
            own = modes == mode
            if np.any(own):
                shift[mode] = np.clip(np.mean(measured[own] - model[condition[own], mode]), -limit, limit)
    return modes, shift


def _without_companions(table: _Table, modes: IndexArray) -> IndexArray:
    """Take their modes from peaks that stay where others are without one, and do not move with those of their mode."""
    without = np.flatnonzero(modes < 0)
    taken = modes.copy()
    for k, mode in enumerate(modes.tolist()):
        model = np.log(table.tracks.frequency[table.condition, mode])
        others = [peak for peak in np.flatnonzero(modes == mode) if peak != k]
        if mode >= 0 and any(table.alike(k, int(peak)) for peak in without):
            farthest = int(max(others, key=lambda peak: abs(model[peak] - model[k]), default=k))
            if farthest == k or not table.alike(k, farthest, float(model[k] - model[farthest])):
                taken[k] = -1
    return taken


def _dropped(table: _Table, k: int, modes: IndexArray, shift: FloatArray, largest_shift: float) -> DroppedPeak:
    """Return why a peak without a mode is no axial mode; raises NotIdentifiableError where it may be one."""
    here, limit = table.condition[k], math.log1p(largest_shift)
    away = table.measured[k] - np.log(table.tracks.frequency[here]) - shift
    below, above = np.flatnonzero(away >= 0.0), np.flatnonzero(away < 0.0)
    if not (below.size and above.size):  # beyond the modes that are followed there may be another
        raise NotIdentifiableError(_refusal(table, k, largest_shift))
    beside = [int(side[np.abs(away[side]).argmin()]) for side in (below, above)]
    again = [peak for peak in np.flatnonzero(table.condition == here) if peak != k and table.alike(k, int(peak))]
    # a mode that has its own peak, and is far away, is none of this one
    taken = set(modes[table.condition == here].tolist()) & set(np.flatnonzero(np.abs(away) > limit).tolist())
    if again or any(mode not in taken and _moves_alike(table, k, mode, modes, limit) for mode in beside):
        raise NotIdentifiableError(_refusal(table, k, largest_shift))
    mode = min(beside, key=lambda mode: (mode in taken, float(abs(away[mode]))))
    elsewhere, moves = _elsewhere(table, k, mode, modes, limit)
    return DroppedPeak(
        table.observations[k],
        mode + 1,
        float(table.tracks.frequency[here, mode] * math.exp(shift[mode])),
        tuple(mode + 1 for mode in beside) if taken.issuperset(beside) else (),
        None if elsewhere is None else table.observations[elsewhere],
        0.0 if elsewhere is None else table.observations[elsewhere].frequency * math.expm1(moves),
    )


def _elsewhere(table: _Table, k: int, mode: int, modes: IndexArray, limit: float) -> tuple[int | None, float]:
    """Return the peak next to one in frequency at the position from which a mode moves most, and its move in ln f.

    Positions at which that peak has no mode either come first.
    """
    model, stated = np.log(table.tracks.frequency[:, mode]), table.tracks.conditions
    here = table.condition[k]
    found: list[tuple[bool, float, int]] = []
    for place, conditions in enumerate(stated):
        if place != here and replace(conditions, position=stated[here].position) == stated[here]:
            there = np.flatnonzero(table.condition == place)
            nearest = int(there[np.abs(table.measured[there] - table.measured[k]).argmin()])
            if abs(table.measured[nearest] - table.measured[k]) <= limit:
                found.append((bool(modes[nearest] < 0), abs(float(model[here] - model[place])), nearest))
    if not found:
        return None, 0.0
    nearest = max(found)[-1]
    return nearest, float(model[here] - model[table.condition[nearest]])


def _moves_alike(table: _Table, k: int, mode: int, modes: IndexArray, limit: float) -> bool:
    """Tell whether a peak may have moved as a mode does; where nothing is near it elsewhere nobody knows."""
    elsewhere, moves = _elsewhere(table, k, mode, modes, limit)
    return elsewhere is None or table.alike(k, elsewhere, moves)


def _refusal(table: _Table, worst: int, largest_shift: float) -> str:
    """Say which peak is near no mode, or which two are near one."""
    away = np.abs(table.measured[:, None] - np.log(table.tracks.frequency[table.condition]))
    nearest = away.min(axis=1)
    k = int(nearest.argmax())
    if nearest[k] <= math.log1p(largest_shift):
        return _two_for_one(table, worst)
    model = table.tracks.frequency[table.condition[k], away[k].argmin()]
    return (
        f"a peak must lie within {largest_shift:.0%} of a mode of the model; {table.observations[k].name} is nearest "
        f"to one at {model:.0f} Hz"
    )


def _two_for_one(table: _Table, worst: int) -> str:
    """Name the two peaks, at the position of the one that found no mode, that are nearest to the same mode."""
    here = np.flatnonzero(table.condition == table.condition[worst])
    model = np.log(table.tracks.frequency[table.condition[worst]])
    nearest = np.abs(table.measured[here, None] - model).argmin(axis=1)
    shared = next((mode for mode in nearest if np.sum(nearest == mode) > 1), None)
    if shared is None:
        return f"{table.observations[worst].name} belongs to no mode once the others at its position have theirs"
    peak, other = (table.observations[k] for k in here[nearest == shared][:2])
    return (
        f"a mode has one peak at a position; {peak.name} and that at {other.frequency:g} Hz both belong to mode "
        f"{shared + 1}; average repeated readings, leave out what is no mode"
    )


def _missing(
    tracks: ModeTracks, condition: IndexArray, modes: IndexArray, shift: FloatArray
) -> tuple[MissingPeak, ...]:
    present = set(zip(condition.tolist(), modes.tolist(), strict=True))
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


#: Relative uncertainty of an amplitude that nobody reads: so large that it says nothing.
_NOT_READ = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class PeakCase:
    """Peaks of the table's receptance, assigned to modes; made by :func:`peak_case`."""

    drive: FreeParameters
    assignment: ModeAssignment
    bands: Mapping[int, Band]
    weighting: Weighting = Weighting.UNCERTAINTY
    priors: FloatArray | None = None  # of the coordinates, shape (2, n_parameters)

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each peak."""
        return tuple(peak.observation.conditions for peak in self.assignment.peaks)

    def with_priors(self, priors: FloatArray) -> "PeakCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float], minimum_positions: int = POSITIONS_OF_PEAKS) -> Problem:
        """Return relative errors of the peaks at these positions, weighted."""
        return with_priors(self._problem(positions, self.weighting, minimum_positions), self.priors)

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return the same: errors of peaks can be followed from afar."""
        return self.problem(positions)

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return the relative error of each frequency; 100 % where the model has no peak."""
        problem = self._problem(positions, self.weighting, 1, minimum_data=1)
        here = problem.predict(coordinates)
        return tuple(
            PredictionError(
                peak.observation.conditions,
                float(frequency / peak.observation.frequency - 1.0) if is_found else -1.0,
                peak.mode,
                peak.observation.frequency,
                float(frequency) if is_found else None,
            )
            for peak, is_found, frequency in zip(problem.peaks, here.found, here.frequency, strict=True)
        )

    def planned(self, coordinates: FloatArray, conditions: Sequence[DriveConditions]) -> PlannedMeasurements:
        """Return the Jacobian of the peaks that would be read, as certain as those measured are in the median."""
        of_frequency, of_amplitude = self._uncertainties()
        return planned_peaks(
            self.drive, coordinates, conditions, self.bands, of_frequency=of_frequency, of_amplitude=of_amplitude
        )

    def paper_objective(self, coordinates: FloatArray, positions: Collection[float]) -> float:
        """Return y of Eq. (26) as printed, for comparison [-]."""
        return paper_objective(self._problem(positions, Weighting.UNIT, 1, minimum_data=1), coordinates)

    def _uncertainties(self) -> tuple[float, float]:
        """Return what errors of a frequency and of an amplitude are divided by, in the median [-]."""
        peaks = [peak.observation for peak in self.assignment.peaks]
        with_amplitude = [peak for peak in peaks if peak.amplitude is not None]
        if self.weighting is Weighting.UNIT:
            return 1.0, 1.0 if with_amplitude else _NOT_READ
        of_amplitude = [relative_amplitude_uncertainty(peak) for peak in with_amplitude] or [_NOT_READ]
        of_frequency = [relative_frequency_uncertainty(peak) for peak in peaks]
        return float(np.median(of_frequency)), float(np.median(of_amplitude))

    def _problem(
        self,
        positions: Collection[float],
        weighting: Weighting,
        minimum_positions: int,
        minimum_data: int | None = None,
    ) -> PeakProblem:
        return peak_problem(
            self.drive,
            [peak for peak in self.assignment.peaks if peak.observation.conditions.position in positions],
            bands=self.bands,
            weighting=weighting,
            minimum_positions=minimum_positions,
            minimum_data=minimum_data,
        )


def peak_case(
    drive: FreeParameters,
    observations: Sequence[ModalObservation],
    *,
    near: FreeParameters | None = None,
    bands: Mapping[int, Band] | None = None,
    weighting: Weighting = Weighting.UNCERTAINTY,
) -> PeakCase:
    """Give measured peaks their modes, by where a receptance model has them: as stated, or the one that is ``near``.

    ``bands`` are where the peak of each mode is looked for; by default around the measured ones, between the other
    modes. Peaks that can be no axial mode are dropped. Raises NotIdentifiableError if another belongs to no mode, or
    two at one position to the same; OutsideValidityError if modes change places along the screw, so that no band holds
    one of them alone.
    """
    assignment = assign_modes(receptance_axis(near or drive), observations, drop=True)
    if bands is None:
        bands = _bands_between_modes(near or drive, assignment.peaks)
    return PeakCase(drive, assignment, bands, weighting, drive.priors)


def assigned_peaks(drive: FreeParameters, observations: Sequence[ModalObservation]) -> tuple[AssignedPeak, ...]:
    """Return measured peaks with the modes of a receptance drive as stated; raises as :func:`peak_case`."""
    return assign_modes(receptance_axis(drive), observations).peaks


def planned_peaks(
    drive: FreeParameters,
    coordinates: FloatArray,
    conditions: Sequence[DriveConditions],
    bands: Mapping[int, Band],
    *,
    of_frequency: float = FREQUENCY_UNCERTAINTY,
    of_amplitude: float = AMPLITUDE_UNCERTAINTY,
) -> PlannedMeasurements:
    """Return for each position the Jacobian of the peaks that would be read there, unless there is none.

    ``of_frequency`` and ``of_amplitude`` are relative standard uncertainties of what would be read [-].
    """
    parameters, planned = drive.record(coordinates), []
    for stated in conditions:
        grid = peak_grid(receptance_axis(drive), [Place(stated, band) for band in bands.values()])
        tops = find_peaks(grid, joints_of(parameters, stated))
        read = zip(bands, tops.found, tops.frequency.tolist(), tops.amplitude.tolist(), strict=True)
        expected = [
            AssignedPeak(
                ModalObservation(stated, frequency, of_frequency * frequency, amplitude, of_amplitude * amplitude), mode
            )
            for mode, is_found, frequency, amplitude in read
            if is_found
        ]
        if expected:
            problem = peak_problem(drive, expected, bands=bands, minimum_positions=0, minimum_data=1)
            planned.append((stated, problem.jacobian(coordinates)))
    return tuple(planned)


def _bands_between_modes(drive: FreeParameters, peaks: Sequence[AssignedPeak]) -> dict[int, Band]:
    """Return a band for each measured mode, up to half way to modes of the model that nobody measured too."""
    conditions = conditions_in_order(peak.observation for peak in peaks)
    measured = {peak.mode for peak in peaks}
    columns = enumerate(track_modes(receptance_axis(drive), conditions).frequency.T.tolist(), start=1)
    others = [frequency for mode, column in columns if mode not in measured for frequency in column]
    bands = {}
    for mode, band in mode_bands(peaks).items():
        own = [peak.observation.frequency for peak in peaks if peak.mode == mode]
        lower = max([band.lower, *(math.sqrt(min(own) * other) for other in others if other < min(own))])
        upper = min([band.upper, *(math.sqrt(max(own) * other) for other in others if other > max(own))])
        bands[mode] = Band(lower, upper)
    return bands
