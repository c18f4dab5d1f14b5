r"""Natural frequencies against an axis: the misfit is the logarithm of predicted over measured frequency.

Each measured frequency belongs to one mode of the model, in order of frequency, by the assignment with the smallest
sum of misfits; a mode of the model that nobody measured costs nothing. A measured frequency that no mode comes near
counts as missed by a quarter.

A damping ratio that is stated with a frequency is compared with that of the same mode; its misfit is relative,
:math:`\zeta / \zeta_{measured} - 1`, which an axis without damping has, too.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.comparison import Layout, Panel
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.conditions.settings import KNOWN_MASS, SettingTolerances, setting_of
from monitor_core.fitting.observations import ModalObservation, conditions_in_order
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.extended.modes import DriveModes, drive_modes, with_damping
from monitor_core.models.protocol import DriveConditions, MotorEnd

#: Misfit of a frequency that no mode of the model comes near: as of one a quarter too low.
_MISSED = -math.log(0.75)
#: Standard deviation of a frequency that is stated without one: what two modal tests of one machine differ by.
_UNSTATED = 0.015
#: The same of a damping ratio, which the same tests tell to a fifth.
_UNSTATED_DAMPING = 0.2
#: By how much a model of an axis is off in a frequency even where nothing is missing.
_FORM = 0.001
_HIGHEST = 2.0  # modes are sought up to so many times the highest measured frequency
_LOWEST = 1.0  # [Hz]: below it the axis moves as a rigid body
_STEP = 0.1  # of the standard deviation of position and preload


@dataclass(frozen=True, eq=False)
class ModesComparison:
    """Measured natural frequencies of one axis, some with damping ratios; build it with :func:`compare_modes`."""

    layout: Layout
    conditions: tuple[DriveConditions, ...]  # of the settings
    motor_end: MotorEnd
    measured: FloatArray  # ln f or ζ in the order of the values, shape (n_values,)
    frequency_of: Indices  # which value is the frequency of the mode of each value: of a frequency itself, (n_values,)
    unit: str  # sigma where there are damping ratios: a gap of them in % would hide that of the frequencies
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
        return self.gap(deviation, np.ones_like(deviation), np.ones(deviation.size, dtype=np.bool_))

    @property
    def damping(self) -> BoolArray:
        """Tell which values are damping ratios, shape (n_values,)."""
        return np.asarray(self.frequency_of != np.arange(self.measured.size))

    @property
    def _one_order(self) -> bool:
        """Tell whether all frequencies are of one mode, which then is the nearest one however far."""
        return np.unique(self.layout.channel[~self.damping]).size == 1

    def misfit(self, physics: AxisPhysics) -> FloatArray:
        """Return ln(predicted/measured) of frequencies, predicted/measured − 1 of damping ratios, shape (n_values,)."""
        return np.asarray(self._misfits(physics, self.conditions)[0])

    def setting_errors(self, physics: AxisPhysics, misfit: FloatArray) -> FloatArray:
        """Return the change of the misfit by errors of position and preload, shape (2, n_values)."""
        position = [replace(one, position=one.position - _STEP * self.tolerances.position) for one in self.conditions]
        preload = [
            one
            if one.preload is None
            else replace(one, preload=one.preload * (1.0 - _STEP * self.tolerances.preload_share))
            for one in self.conditions
        ]
        return np.asarray((misfit - self._misfits(physics, position, preload)) / _STEP)

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

    def resolved(self, physics: AxisPhysics, errors: FloatArray) -> "ModesComparison":
        """Return the comparison as it is: a frequency of a mode is free of the resolution of lines."""
        del physics, errors
        return self

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
        """Return the rms error over the chosen values: of frequencies in Hz or %, with damping ratios in sigma."""
        if self.unit == "sigma":
            return float(np.sqrt(np.mean(standardised[chosen] ** 2)))
        relative = np.expm1(misfit[chosen])
        if self.unit == "%":
            return 100.0 * float(np.sqrt(np.mean(relative**2)))
        return float(np.sqrt(np.mean((relative * np.exp(self.measured[chosen])) ** 2)))

    def panels(self, models: Mapping[str, AxisPhysics]) -> tuple[Panel, ...]:
        """Return frequencies and damping ratios over the position, one picture for each mode and preload."""
        measured = self._values(np.zeros_like(self.measured))
        predicted = {name: self._values(self.misfit(physics)) for name, physics in models.items()}
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
                    y_name="damping ratio [-]" if np.any(at & self.damping) else "natural frequency [Hz]",
                    x=1e3 * position[at],
                    measured=measured[at],
                    models={name: values[at] for name, values in predicted.items()},
                )
            )
        return tuple(pictures)

    def _values(self, misfit: FloatArray) -> FloatArray:
        """Return the frequencies and damping ratios that have a misfit."""
        with np.errstate(over="ignore"):  # of values of the other kind
            return np.where(self.damping, self.measured * (1.0 + misfit), np.exp(self.measured + misfit))

    def _misfits(self, physics: AxisPhysics, *conditions: Sequence[DriveConditions]) -> FloatArray:
        """Return the misfit under several conditions of each setting, all asked at once, shape (n_asked, n_values)."""
        highest = _HIGHEST * float(np.exp(np.max(self.measured[~self.damping])))
        # without damping where none was measured: axes that differ in nothing else then are one
        damped = physics if np.any(self.damping) else with_damping(physics, 0.0)
        every = tuple(one for of_settings in conditions for one in of_settings)
        modes = _modes(damped, every, self.motor_end, highest)
        elastic = modes.undamped_omega > 2.0 * np.pi * _LOWEST
        misfits = np.empty((len(conditions), self.measured.size))
        for number in range(len(every)):
            asked, setting = divmod(number, len(self.conditions))
            here = np.flatnonzero(self.layout.setting == setting)
            chosen = (modes.condition == number) & elastic
            misfits[asked, here] = self._misfit_of(here, modes.undamped_omega[chosen], modes.pole[chosen])
        return misfits

    def _misfit_of(self, here: Indices, omega: FloatArray, pole: ComplexArray) -> FloatArray:
        """Return the misfit of the values of one setting, from its modes in order of frequency."""
        damping, measured = self.damping[here], self.measured[here]
        missed = math.inf if self._one_order and omega.size else _MISSED
        misfit, mode = _assigned(np.log(omega / (2.0 * np.pi)), measured[~damping], missed)
        ratio = np.append(-pole.real / np.abs(pole), 0.0)[mode]  # none of a mode that is missed, which is −1
        of_frequency = np.searchsorted(here[~damping], self.frequency_of[here[damping]])
        return np.concatenate([misfit, ratio[of_frequency] / measured[damping] - 1.0])


def compare_modes(
    observations: Sequence[ModalObservation],
    motor_end: MotorEnd,
    *,
    held_out: Sequence[frozenset[DriveConditions]] = (),
    tolerances: SettingTolerances | None = None,
) -> ModesComparison:
    """Put measured natural frequencies, and damping ratios where they are stated, into the form to be compared.

    Parameters
    ----------
    observations : sequence of ModalObservation
        A frequency without stated uncertainty is taken to be known to 1.5 %, a damping ratio to 20 %.
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
    rows = _rows(ordered, orders)
    # of one setting one after the other, frequencies first
    rows = sorted(rows, key=lambda one: (setting[one.observation], one.is_damping, one.observation))
    at = {one.observation: index for index, one in enumerate(rows) if not one.is_damping}
    channels = sorted({(one.is_damping, one.order) for one in rows})
    of_value = setting[[one.observation for one in rows]]
    with_damping_ratios = any(one.is_damping for one in rows)
    return ModesComparison(
        layout=Layout(
            settings=tuple(setting_of(one) for one in conditions),
            setting=of_value,
            channel=np.array([channels.index((one.is_damping, one.order)) for one in rows]),
            channels=tuple(f"mode {order}{', damping ratio' * is_damping}" for is_damping, order in channels),
            frequency=np.array([math.nan if one.is_damping else math.exp(one.measured) for one in rows]),
            standard_deviation=np.array([one.deviation for one in rows]),
            period=np.full(len(rows), np.inf),
            held_out=tuple(np.array([one in fold for one in conditions])[of_value] for fold in held_out),
        ),
        conditions=conditions,
        motor_end=motor_end,
        measured=np.array([one.measured for one in rows]),
        frequency_of=np.array([at[one.observation] for one in rows]),
        unit="sigma" if with_damping_ratios else "Hz" if len(distinct) == 1 else "%",
        tolerances=tolerances or SettingTolerances(),
    )


@lru_cache(maxsize=64)  # a search asks for one axis again, and for axes that differ in damping alone
def _modes(
    physics: AxisPhysics, conditions: tuple[DriveConditions, ...], motor_end: MotorEnd, highest_frequency: float
) -> DriveModes:
    modes = drive_modes(physics, conditions, [motor_end] * len(conditions), highest_frequency)
    for values in (modes.condition, modes.undamped_omega, modes.pole):
        values.setflags(write=False)
    return modes


@dataclass(frozen=True, slots=True)
class _Row:
    """One value: the frequency of an observation, or its damping ratio."""

    observation: int
    order: int
    is_damping: bool
    measured: float  # ln f or ζ
    deviation: float  # of the misfit


def _rows(observations: Sequence[ModalObservation], orders: Sequence[int]) -> list[_Row]:
    rows = []
    for number, (one, order) in enumerate(zip(observations, orders, strict=True)):
        error = one.frequency_uncertainty
        deviation = _UNSTATED if error is None else math.hypot(error / one.frequency, _FORM)
        rows.append(_Row(number, order, False, math.log(one.frequency), deviation))
        if one.damping_ratio is not None:
            error = one.damping_ratio_uncertainty
            deviation = _UNSTATED_DAMPING if error is None else error / one.damping_ratio
            rows.append(_Row(number, order, True, one.damping_ratio, deviation))
    return rows


def _assigned(predicted: FloatArray, measured: FloatArray, missed: float) -> tuple[FloatArray, Indices]:
    """Return predicted less measured for rising values, each measured one with its own predicted one, and which.

    That is −1 for one that is missed. Dynamic programming over both in order: a predicted value may be passed over for
    nothing, a measured one for the price of being missed.
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
    misfit, whose = np.empty(n), np.full(n, -1, dtype=np.intp)
    i, j = n, m
    while i:
        step = came_from[i, j]
        if step == 0:
            j -= 1
            continue
        misfit[i - 1] = -missed
        if step == 1:
            j -= 1
            misfit[i - 1], whose[i - 1] = predicted[j] - measured[i - 1], j
        i -= 1
    return misfit, whose
