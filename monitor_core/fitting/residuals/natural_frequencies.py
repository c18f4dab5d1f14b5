r"""Assign measured natural frequencies to the modes of a drive model of any family, and compare them.

The model answers by the common protocol, once per condition. A measured frequency leaves

.. math::

    r = \frac{1}{u} \ln\frac{f_c}{f_t}, \qquad u = \frac{\sigma(f_t)}{f_t}

(c calculated, t tested), where f_c is a natural frequency, ω_n/2π of a pole, and not the top of a peak: the two differ
by a share of the order of ζ², and by more where modes are close.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.problem import central_differences
from monitor_core.fitting.residuals.peak_search import IndexArray, relative_frequency_uncertainty
from monitor_core.models.extended import elastic_frequencies
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd

#: Standard deviation of a frequency without a stated uncertainty: what two modal tests of one machine differ by.
_UNSTATED = 0.015
#: The same for a damping ratio, which the same tests determine to a fifth.
_UNSTATED_DAMPING = 0.2
#: By how much a model of an axis is off in a frequency even where nothing is missing.
_FORM = 0.001


@dataclass(frozen=True, slots=True)
class ModalValue:
    """The frequency of an observation, or its damping ratio."""

    observation: int  # in the order of settings and frequencies
    setting: int
    order: int
    is_damping: bool
    measured: float  # ln f or ζ
    deviation: float  # of the misfit


def modal_values(
    observations: Sequence[ModalObservation], setting_of: Mapping[DriveConditions, int]
) -> list[ModalValue]:
    """Return the values setting by setting, frequencies before damping ratios, both in order of frequency.

    An observation without an order has that of its frequency among all of its setting.
    """
    ordered = sorted(observations, key=lambda observation: (setting_of[observation.conditions], observation.frequency))
    settings = [setting_of[observation.conditions] for observation in ordered]
    ranks = np.concatenate([np.arange(count) for count in np.bincount(settings)]).tolist()
    values = []
    for number, (observation, setting, rank) in enumerate(zip(ordered, settings, ranks, strict=True)):
        order = rank + 1 if observation.order is None else observation.order
        frequency, error = observation.frequency, observation.frequency_uncertainty
        deviation = _UNSTATED if error is None else math.hypot(error / frequency, _FORM)
        values.append(ModalValue(number, setting, order, False, math.log(frequency), deviation))
        if (ratio := observation.damping_ratio) is not None:
            error = observation.damping_ratio_uncertainty
            deviation = _UNSTATED_DAMPING if error is None else error / ratio
            values.append(ModalValue(number, setting, order, True, ratio, deviation))
    return sorted(values, key=lambda value: (value.setting, value.is_damping, value.observation))


def assign_modes(predicted: FloatArray, measured: FloatArray, missed: FloatArray) -> tuple[FloatArray, Indices]:
    """Return predicted less measured values and which predicted value each measured one has, −1 for a missed one.

    Both are rising logarithms of frequencies, a row for each setting, (n_settings, n_predicted) and (n_settings,
    n_measured); behind the last one of a setting inf. The assignment has the smallest sum of differences. It is found
    by dynamic programming over both in order: to skip a predicted value costs nothing, to miss a measured one costs
    ``missed``, (n_settings,).
    """
    n_settings, m = predicted.shape
    rows = np.arange(n_settings)
    before = np.zeros((m + 1, n_settings))  # cost without the measured value, by how many predicted ones are used up
    came_from = []  # 1: matched, 2: measured missed, 0: predicted skipped
    for value in measured.T:
        absent = np.isinf(value)
        miss = np.where(absent, 0.0, missed)
        steps = np.full((m + 1, n_settings), 2)
        least = before + miss
        apart = np.where(absent | np.isinf(predicted.T), np.inf, np.abs(predicted.T - np.where(absent, 0.0, value)))
        for j in range(m):
            choices = np.stack([least[j], before[j] + apart[j], least[j + 1]])
            steps[j + 1] = np.argmin(choices, axis=0)
            least[j + 1] = choices[steps[j + 1], rows]
        before = least
        came_from.append(steps)
    whose = np.full(measured.shape, -1, dtype=np.intp)
    left = np.full(n_settings, m)
    for i, steps in reversed(list(enumerate(came_from))):
        left = np.maximum.accumulate(np.where(steps > 0, np.arange(m + 1)[:, None], 0), axis=0)[left, rows]
        matched = steps[left, rows] == 1
        left = left - matched
        whose[matched, i] = left[matched]
    of_mode = np.take_along_axis(np.pad(predicted, ((0, 0), (0, 1)), constant_values=np.nan), whose, axis=1)
    return np.where(whose < 0, -missed[:, None], of_mode - measured), whose


#: Of a coordinate, in decades. Slopes of ln f are off by 4e-10 of the largest over the four families, as much by
#: truncation as by the rounding of poles; at a tenth of the step by 6e-9, at ten times by 2e-7.
_STEP = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class NaturalFrequencyProblem:
    """Logarithmic errors of natural frequencies; made by :func:`natural_frequency_problem`.

    A mode is the n-th elastic one of the model, whatever the coordinates. That fails where two modes pass each other
    on the way of the fit (of the lumped model with a clamped motor end, f_ax and f_rot: neither knows of the other),
    and where one below stops oscillating and is no longer counted: the number then goes to another mode, and the
    residual has a kink or a jump. Assign again at the coordinates found and see whether the numbers are the same.
    """

    drive: FreeParameters
    peaks: tuple[AssignedPeak, ...]
    motor_end: MotorEnd | None = None  # while the frequencies were measured; None: as in the family's paper
    _places: tuple[tuple[DriveConditions, tuple[int, ...]], ...] = field(init=False)  # with the places of their peaks

    def __post_init__(self) -> None:
        places: dict[DriveConditions, list[int]] = {}
        for k, peak in enumerate(self.peaks):
            places.setdefault(peak.observation.conditions, []).append(k)
        object.__setattr__(self, "_places", tuple((place, tuple(members)) for place, members in places.items()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.drive.free

    @property
    def frequency(self) -> FloatArray:
        """Measured, shape (n_peaks,) [Hz]."""
        return np.array([peak.observation.frequency for peak in self.peaks])

    def predict(self, coordinates: FloatArray) -> FloatArray:
        """Return the model's natural frequency for each measured one, shape (n_peaks,) [Hz].

        Raises OutsideValidityError if the model has no such parameters, or fewer elastic modes than were measured.
        """
        model, predicted = self.drive.model(coordinates), np.zeros(len(self.peaks))
        under = elastic_frequencies(model, [conditions for conditions, _ in self._places], self.motor_end)
        for (_, members), elastic in zip(self._places, under, strict=True):
            for k in members:
                mode = self.peaks[k].mode
                if mode > elastic.size:
                    raise OutsideValidityError(
                        f"{self.peaks[k].observation.name} needs elastic mode {mode} of the model, which has "
                        f"{elastic.size} there"
                    )
                predicted[k] = elastic[mode - 1]
        return predicted

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the weighted errors, shape (n_peaks,) [-]."""
        return np.asarray(np.log(self.predict(coordinates) / self.frequency) * self._weight())

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, shape (n_peaks, n_parameters)."""
        slopes = central_differences(lambda x: np.asarray(np.log(self.predict(x))), coordinates, _STEP)
        return slopes.T * self._weight()[:, None]

    def _weight(self) -> FloatArray:
        return np.array([1.0 / relative_frequency_uncertainty(peak.observation) for peak in self.peaks])


def natural_frequency_problem(
    drive: FreeParameters, peaks: Sequence[AssignedPeak], *, motor_end: MotorEnd | None = None
) -> NaturalFrequencyProblem:
    """Make the problem of finding the free parameters from natural frequencies; amplitudes play no part.

    The frequencies have their elastic modes from :func:`assign_by_frequency` or as a source states them; one without an
    uncertainty has 1 %. Priors are not in it: :func:`monitor_core.fitting.problem.with_priors` adds
    ``drive.priors``.

    Raises NotIdentifiableError if there are fewer data than free parameters, or one of these moves no datum and has no
    prior; OutsideValidityError if the model as stated has no such mode, or no answer under the conditions.
    """
    drive.require_enough(len(peaks), "natural frequencies")
    problem = NaturalFrequencyProblem(drive, tuple(peaks), motor_end)
    drive.require_seen(problem.jacobian(drive.start))
    return problem


def assign_by_frequency(
    model: DriveModel,
    observations: Sequence[ModalObservation],
    *,
    largest_shift: float = 0.25,
    motor_end: MotorEnd | None = None,
) -> tuple[AssignedPeak, ...]:
    """Give each measured natural frequency the elastic mode of the model that it is next to, one to one and in order.

    For any family, by frequency alone: under each condition the sum of (ln f_t/f_c)² is least, so that peaks keep the
    order of their modes. The receptance family has shapes too, which
    :func:`monitor_core.identification.cases.peaks.assign_modes` follows along the screw.

    Raises NotIdentifiableError if a peak is farther than ``largest_shift``, relative, from every mode, or two under one
    condition belong to one mode.
    """
    modes = np.zeros(len(observations), dtype=np.int_)
    for conditions in dict.fromkeys(observation.conditions for observation in observations):
        here = [k for k, observation in enumerate(observations) if observation.conditions == conditions]
        (elastic,) = elastic_frequencies(model, [conditions], motor_end)
        modes[here] = _nearest_modes([observations[k] for k in here], elastic, largest_shift)
    return tuple(AssignedPeak(observation, int(mode)) for observation, mode in zip(observations, modes, strict=True))


def _nearest_modes(here: Sequence[ModalObservation], elastic: FloatArray, largest_shift: float) -> IndexArray:
    """Return the mode of each peak under one condition, counted from 1, shape (n_peaks,)."""
    away = np.abs(np.log(np.array([[peak.frequency] for peak in here]) / elastic))
    for peak, distance in zip(here, away, strict=True):
        if distance.min() > math.log1p(largest_shift):
            raise NotIdentifiableError(
                f"a peak must lie within a factor of {1.0 + largest_shift:g} of an elastic mode of the model; "
                f"{peak.name} is nearest to one at {elastic[distance.argmin()]:.0f} Hz"
            )
    rows, columns = scipy.optimize.linear_sum_assignment(away**2)
    placed = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    for k, peak in enumerate(here):
        if k not in placed or away[k, placed[k]] > math.log1p(largest_shift):
            raise NotIdentifiableError(
                f"a mode has one peak under a condition; {peak.name} and another there belong to that at "
                f"{elastic[away[k].argmin()]:.0f} Hz; average repeated readings, leave out what is no mode"
            )
    return np.array([placed[k] + 1 for k in range(len(here))])
