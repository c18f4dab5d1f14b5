r"""Natural frequencies against an axis: the misfit is the logarithm of predicted over measured frequency.

Each measured frequency belongs to one mode of the model, in order of frequency, by the assignment with the smallest
sum of misfits; a mode of the model that nobody measured costs nothing. A measured frequency that no mode comes near
counts as missed by a quarter.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.comparing.comparison import Layout, Panel
from monitor_core.discrepancy.comparing.conditions import KNOWN_MASS, SettingTolerances, setting_of
from monitor_core.errors import NotIdentifiableError
from monitor_core.identification.observations import ModalObservation, conditions_in_order
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.extended.modes import drive_modes, with_damping
from monitor_core.models.protocol import DriveConditions, MotorEnd

#: Misfit of a frequency that no mode of the model comes near.
_MISSED = math.log(1.25)
#: Standard deviation of a frequency that is stated without one: what two modal tests of one machine differ by.
_UNSTATED = 0.015
#: By how much a model of an axis is off in a frequency even where nothing is missing.
_FORM = 0.001
_HIGHEST = 2.0  # modes are sought up to so many times the highest measured frequency
_LOWEST = 1.0  # [Hz]: below it the axis moves as a rigid body
_STEP = 0.1  # of the standard deviation of position and preload


@dataclass(frozen=True, eq=False)
class ModesComparison:
    """Measured natural frequencies of one axis; build it with :func:`compare_modes`."""

    layout: Layout
    conditions: tuple[DriveConditions, ...]  # of the settings
    motor_end: MotorEnd
    measured: FloatArray  # ln f in the order of the values, shape (n_values,)
    unit: str
    tolerances: SettingTolerances

    least_delta_bic = 10.0  # few and independent values: very strong evidence by Kass and Raftery (1995)

    @property
    def setting_error_names(self) -> tuple[str, ...]:
        """Return position and preload."""
        return ("position", "preload")

    @property
    def noise_floor(self) -> float:
        """Return the gap that the stated uncertainties leave, in the unit of the gap."""
        deviation = self.layout.standard_deviation
        return self.gap(deviation, deviation, np.ones(deviation.size, dtype=np.bool_))

    def misfit(self, physics: AxisPhysics) -> FloatArray:
        """Return ln(predicted/measured), shape (n_values,)."""
        return self._misfit(physics, self.conditions)

    def setting_errors(self, physics: AxisPhysics) -> FloatArray:
        """Return the change of the misfit by errors of position and preload, shape (2, n_values)."""
        here = self._misfit(physics, self.conditions)
        position = [replace(one, position=one.position - _STEP * self.tolerances.position) for one in self.conditions]
        preload = [
            one
            if one.preload is None
            else replace(one, preload=one.preload * (1.0 - _STEP * self.tolerances.preload_share))
            for one in self.conditions
        ]
        return np.array([(here - self._misfit(physics, moved)) / _STEP for moved in (position, preload)])

    def shifted(self, errors: FloatArray) -> "ModesComparison":
        """Return the comparison with positions and preloads moved by errors in standard deviations."""
        moved = (
            replace(
                one,
                position=one.position + self.tolerances.position * position,
                preload=None if one.preload is None else one.preload * (1.0 + self.tolerances.preload_share * preload),
            )
            for one, (position, preload) in zip(self.conditions, errors.tolist(), strict=True)
        )
        return replace(self, conditions=tuple(moved))

    def imagined(self) -> Mapping[str, "ModesComparison"]:
        """Return the settings with a known mass on the table, and halfway to the next position."""
        heavier = tuple(replace(one, payload_mass=one.payload_mass + KNOWN_MASS) for one in self.conditions)
        positions = sorted({one.position for one in self.conditions})
        between = {low: 0.5 * (low + high) for low, high in pairwise(positions)}
        moved = tuple(replace(one, position=between.get(one.position, one.position)) for one in self.conditions)
        return {
            f"with {KNOWN_MASS:g} kg more on the table": replace(self, conditions=heavier),
            "at positions in between": replace(self, conditions=moved),
        }

    def gap(self, misfit: FloatArray, standardised: FloatArray, chosen: BoolArray) -> float:
        """Return the rms error of the frequencies over the chosen values, in Hz or in %."""
        del standardised
        relative = np.expm1(misfit[chosen])
        if self.unit == "%":
            return 100.0 * float(np.sqrt(np.mean(relative**2)))
        return float(np.sqrt(np.mean((relative * np.exp(self.measured[chosen])) ** 2)))

    def panels(self, models: Mapping[str, AxisPhysics]) -> tuple[Panel, ...]:
        """Return the frequencies over the position, one picture for each mode and preload."""
        predicted = {name: np.exp(self.misfit(physics) + self.measured) for name, physics in models.items()}
        position = np.array([one.position for one in self.conditions])[self.layout.setting]
        series = [
            (self.layout.channel[value], self.conditions[self.layout.setting[value]].preload)
            for value in range(self.measured.size)
        ]
        pictures = []
        for channel, preload in dict.fromkeys(series):
            at = np.array([one == (channel, preload) for one in series])
            title = self.layout.channels[channel] + ("" if preload is None else f", {preload:g} N")
            pictures.append(
                Panel(
                    title=title,
                    x_name="position [mm]",
                    y_name="natural frequency [Hz]",
                    x=1e3 * position[at],
                    measured=np.exp(self.measured[at]),
                    models={name: values[at] for name, values in predicted.items()},
                )
            )
        return tuple(pictures)

    def _misfit(self, physics: AxisPhysics, conditions: Sequence[DriveConditions]) -> FloatArray:
        highest = _HIGHEST * float(np.exp(np.max(self.measured)))
        modes = drive_modes(with_damping(physics, 0.0), conditions, [self.motor_end] * len(conditions), highest)
        frequency = modes.undamped_omega / (2.0 * np.pi)
        misfit = np.empty_like(self.measured)
        single = len(self.layout.channels) == 1
        for number in range(len(conditions)):
            at = self.layout.setting == number
            predicted = np.log(frequency[(modes.condition == number) & (frequency > _LOWEST)])
            misfit[at] = _assigned(predicted, self.measured[at], math.inf if single and predicted.size else _MISSED)
        return misfit


def compare_modes(
    observations: Sequence[ModalObservation],
    motor_end: MotorEnd,
    *,
    held_out: Sequence[frozenset[DriveConditions]] = (),
    tolerances: SettingTolerances | None = None,
) -> ModesComparison:
    """Put measured natural frequencies into the form that the workflow compares.

    Parameters
    ----------
    observations : sequence of ModalObservation
        A frequency without stated uncertainty is taken to be known to 1.5 %.
    motor_end : MotorEnd
        What held the motor end.
    held_out : sequence of sets of DriveConditions
        The conditions that each fold leaves out.
    tolerances : SettingTolerances, optional

    Raises
    ------
    NotIdentifiableError
        If there is no frequency.
    """
    if not observations:
        raise NotIdentifiableError("a comparison needs at least one natural frequency; got none")
    conditions = conditions_in_order(observations)
    number = {one: index for index, one in enumerate(conditions)}
    ordered = sorted(observations, key=lambda one: (number[one.conditions], one.frequency))
    setting = np.array([number[one.conditions] for one in ordered])
    ranks = np.concatenate([np.arange(count) for count in np.bincount(setting)])
    orders = [rank + 1 if one.order is None else one.order for one, rank in zip(ordered, ranks.tolist(), strict=True)]
    distinct = sorted(set(orders))
    frequency = np.array([one.frequency for one in ordered])
    relative = [
        _UNSTATED if one.frequency_uncertainty is None else math.hypot(one.frequency_uncertainty / one.frequency, _FORM)
        for one in ordered
    ]
    return ModesComparison(
        layout=Layout(
            settings=tuple(setting_of(one) for one in conditions),
            setting=setting,
            channel=np.array([distinct.index(order) for order in orders]),
            channels=tuple(f"mode {order}" for order in distinct),
            frequency=frequency,
            standard_deviation=np.array(relative),
            period=np.full(frequency.size, np.inf),
            held_out=tuple(np.array([one in fold for one in conditions])[setting] for fold in held_out),
        ),
        conditions=conditions,
        motor_end=motor_end,
        measured=np.log(frequency),
        unit="Hz" if len(distinct) == 1 else "%",
        tolerances=tolerances or SettingTolerances(),
    )


def _assigned(predicted: FloatArray, measured: FloatArray, missed: float) -> FloatArray:
    """Return predicted less measured for rising values, each measured one with its own predicted one.

    Dynamic programming over both in order: a predicted value may be passed over for nothing, a measured one for the
    price of being missed.
    """
    n, m = measured.size, predicted.size
    cost = np.full((n + 1, m + 1), np.inf)
    cost[0] = 0.0
    came_from = np.zeros((n + 1, m + 1), dtype=np.int8)  # 1: matched, 2: measured one missed, 0: predicted one passed
    for i in range(1, n + 1):
        for j in range(m + 1):
            choices = [
                (cost[i, j - 1] if j else math.inf, 0),
                (cost[i - 1, j - 1] + abs(predicted[j - 1] - measured[i - 1]) if j else math.inf, 1),
                (cost[i - 1, j] + missed, 2),
            ]
            cost[i, j], came_from[i, j] = min(choices)
    misfit = np.empty(n)
    i, j = n, m
    while i:
        step = came_from[i, j]
        if step == 0:
            j -= 1
            continue
        misfit[i - 1] = predicted[j - 1] - measured[i - 1] if step == 1 else -missed
        i, j = i - 1, j - (step == 1)
    return misfit
