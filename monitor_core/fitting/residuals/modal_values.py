"""Turn modal observations into values, and assign measured natural frequencies to the modes of a model."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.observations import ModalObservation
from monitor_core.models.protocol import DriveConditions

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


def assign_modes(predicted: FloatArray, measured: FloatArray, missed: float) -> tuple[FloatArray, Indices]:
    """Return predicted less measured values and which predicted value each measured one has, −1 for a missed one.

    Both are rising logarithms of frequencies. The assignment has the smallest sum of differences. It is found by
    dynamic programming over both in order: to skip a predicted value costs nothing, to miss a measured one costs
    ``missed``.
    """
    n, m = measured.size, predicted.size
    of_model: list[float] = predicted.tolist()
    before = [0.0] * (m + 1)  # cost without the measured value, by how many predicted ones are used up
    came_from = [[0] * (m + 1)]  # 1: matched, 2: measured missed, 0: predicted skipped
    for value in measured.tolist():
        least, steps = [before[0] + missed], [2]
        for j, at in enumerate(of_model):
            choices = [(least[j], 0), (before[j] + abs(at - value), 1), (before[j + 1] + missed, 2)]
            cost, step = min(choices)
            least.append(cost)
            steps.append(step)
        before = least
        came_from.append(steps)
    misfit, whose = np.empty(n), np.full(n, -1, dtype=np.intp)
    i, j = n, m
    while i:
        step = came_from[i][j]
        if step == 0:
            j -= 1
            continue
        misfit[i - 1] = -missed
        if step == 1:
            j -= 1
            misfit[i - 1], whose[i - 1] = predicted[j] - measured[i - 1], j
        i -= 1
    return misfit, whose
