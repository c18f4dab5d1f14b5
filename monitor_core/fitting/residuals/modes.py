r"""Compare natural frequencies with an axis: the misfit is the logarithm of predicted over measured frequency.

Each measured frequency belongs to one mode of the model, in order of frequency, by the assignment with the smallest
sum of misfits. A mode of the model that was not measured costs nothing. A measured frequency that no mode comes near
counts as missed by a quarter.

A damping ratio that is stated with a frequency is compared with that of the same mode. Its misfit is relative,
:math:`\zeta / \zeta_{measured} - 1`, which is defined for an axis without damping, too.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.comparison import AsMeasured, ChangedConditions, Layout
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.conditions.settings import SettingTolerances, known_mass, setting_of
from monitor_core.fitting.observations import ModalObservation, conditions_in_order
from monitor_core.fitting.residuals.natural_frequencies import assign_modes, modal_values
from monitor_core.models.extended import AxisPhysics, Move, moving_mass
from monitor_core.models.extended.modes import DriveModes, FollowedModes, omega_changes, with_damping
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.shown import Panel

#: Misfit of a frequency that no mode of the model comes near: as if it were a quarter too low.
_MISSED = -math.log(0.75)
_HIGHEST = 2.0  # modes are sought up to so many times the highest measured frequency
_LOWEST = 1.0  # [Hz]: below it the axis moves as a rigid body
_STEP = 0.1  # of the standard deviation of position and preload


@dataclass(frozen=True, eq=False)
class ModesComparison(AsMeasured):
    """Measured natural frequencies of one axis, some with damping ratios; build it with :func:`compare_modes`.

    The frequency of a mode does not depend on the resolution of lines.
    """

    layout: Layout
    conditions: tuple[DriveConditions, ...]  # of the settings
    motor_end: MotorEnd
    measured: FloatArray  # ln f or ζ in the order of the values, shape (n_values,)
    frequency_of: Indices  # which value is the frequency of the mode of each value: of a frequency itself, (n_values,)
    unit: str  # sigma where there are damping ratios: a gap of them in % would hide that of the frequencies
    tolerances: SettingTolerances
    followed: FollowedModes = field(default_factory=FollowedModes)  # from one axis of a search to the next

    least_delta_bic = 10.0  # few and independent values: very strong evidence by Kass and Raftery (1995)
    condition_error_names = ("position", "preload")

    @property
    def noise_floor(self) -> float:
        """Return the gap that the stated uncertainties leave, in the unit of the gap."""
        deviation = self.layout.standard_deviation
        return self.gap(deviation, np.ones_like(deviation), np.ones(deviation.size, dtype=np.bool_))

    @cached_property
    def damping(self) -> BoolArray:
        """Return which values are damping ratios, shape (n_values,)."""
        return np.asarray(self.frequency_of != np.arange(self.measured.size))

    @cached_property
    def _single_order(self) -> bool:
        """Return whether all frequencies are of one mode: then the nearest is assigned, however far it is."""
        return np.unique(self.layout.channel[~self.damping]).size == 1

    def misfit(self, physics: AxisPhysics) -> FloatArray:
        """Return ln(predicted/measured) of frequencies, predicted/measured − 1 of damping ratios, shape (n_values,)."""
        return np.asarray(self._misfits(physics, self.conditions)[0])

    def slopes(self, physics: AxisPhysics, moves: Sequence[Move[AxisPhysics]]) -> Sequence[FloatArray | None]:
        """Return the derivatives of the misfit by moves; None of all where a damping ratio was measured."""
        axes = [axis for move in moves for axis in (move.ahead, move.behind)]
        if np.any(self.damping) or any(axis.by_setting for axis in (physics, *axes)):
            return [None] * len(moves)
        change, slopes = self._change(physics), list[FloatArray | None]()
        for move in moves:
            try:
                ahead, behind = (
                    0.0 if axis is physics else change(axis, self.conditions) for axis in (move.ahead, move.behind)
                )
            except OutsideValidityError:
                slopes.append(None)
            else:
                slopes.append(np.asarray((ahead - behind) / move.distance))
        return slopes

    def _change(self, physics: AxisPhysics) -> Callable[[AxisPhysics, Sequence[DriveConditions]], FloatArray]:
        """Return how far the misfit goes to another axis or to other conditions, to first order."""
        ((_, modes, whose),) = self._assigned(physics, self.conditions)
        changes = omega_changes(modes, [self.motor_end] * len(self.conditions), physics, self.conditions)
        omega = np.append(modes.undamped_omega, 1.0)[whose]  # a missed value stays where it is
        return lambda axis, conditions: np.append(changes(axis, conditions), 0.0)[whose] / omega

    def condition_errors(self, physics: AxisPhysics, misfit: FloatArray) -> FloatArray:
        """Return the change of the misfit by errors of position and preload, shape (2, n_values)."""
        by_position = [self._moved(stated, -_STEP, 0.0) for stated in self.conditions]
        by_preload = [self._moved(stated, 0.0, -_STEP) for stated in self.conditions]
        if np.any(self.damping) or physics.by_setting:
            return np.asarray((misfit - self._misfits(physics, by_position, by_preload)) / _STEP)
        change = self._change(physics)
        return np.stack([change(physics, moved) / -_STEP for moved in (by_position, by_preload)])

    def shifted(self, errors: FloatArray) -> "ModesComparison":
        """Return the comparison with positions and preloads moved by errors in standard deviations."""
        moved = (self._moved(stated, *error) for stated, error in zip(self.conditions, errors.tolist(), strict=True))
        return replace(self, conditions=tuple(moved))

    def _moved(self, stated: DriveConditions, position: float, preload: float) -> DriveConditions:
        """Return conditions with position and preload moved by errors in standard deviations."""
        factor = 1.0 + self.tolerances.preload_share * preload
        return replace(
            stated,
            position=stated.position + self.tolerances.position * position,
            preload=None if stated.preload is None else stated.preload * factor,
        )

    def imagined(self, physics: AxisPhysics) -> Mapping[ChangedConditions, "ModesComparison"]:
        """Return the settings with a known mass on the table, and halfway to the next position."""
        mass = known_mass(moving_mass(physics))
        heavier = tuple(replace(stated, payload_mass=stated.payload_mass + mass) for stated in self.conditions)
        positions = sorted({stated.position for stated in self.conditions})
        between = {low: 0.5 * (low + high) for low, high in pairwise(positions)}
        moved = tuple(
            replace(stated, position=between.get(stated.position, stated.position)) for stated in self.conditions
        )
        return {
            ChangedConditions(ConditionAxis.PAYLOAD, mass): replace(self, conditions=heavier),
            ChangedConditions(ConditionAxis.POSITION, 0.5): replace(self, conditions=moved),
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
        position = np.array([stated.position for stated in self.conditions])[self.layout.setting]
        series = [
            (self.layout.channel[value], self.conditions[self.layout.setting[value]].preload)
            for value in range(self.measured.size)
        ]
        panels = []
        for channel, preload in dict.fromkeys(series):
            of_series = np.array([pair == (channel, preload) for pair in series])
            panels.append(
                Panel(
                    title=self.layout.channels[channel] + ("" if preload is None else f", {preload:g} N"),
                    x_name="position [mm]",
                    y_name="damping ratio [-]" if np.any(of_series & self.damping) else "natural frequency [Hz]",
                    x=1e3 * position[of_series],
                    measured=measured[of_series],
                    models={name: values[of_series] for name, values in predicted.items()},
                )
            )
        return tuple(panels)

    def _values(self, misfit: FloatArray) -> FloatArray:
        """Return the frequencies and damping ratios that have a misfit."""
        with np.errstate(over="ignore"):  # of values of the other kind
            return np.where(self.damping, self.measured * (1.0 + misfit), np.exp(self.measured + misfit))

    def _misfits(self, physics: AxisPhysics, *conditions: Sequence[DriveConditions]) -> FloatArray:
        """Return the misfit under several conditions of each setting, at once, shape (n_conditions, n_values)."""
        return np.stack([misfit for misfit, _, _ in self._assigned(physics, *conditions)])

    def _assigned(
        self, physics: AxisPhysics, *conditions: Sequence[DriveConditions]
    ) -> Iterator[tuple[FloatArray, DriveModes, Indices]]:
        """Yield misfits under several conditions of each setting, the modes, and which of them each value has."""
        modes = self._modes(physics, tuple(stated for of_settings in conditions for stated in of_settings))
        n_asked, n_settings = len(conditions), len(self.conditions)
        elastic = np.flatnonzero(modes.undamped_omega > 2.0 * np.pi * _LOWEST)
        condition = modes.condition[elastic]
        n_modes = np.bincount(condition, minlength=n_asked * n_settings)
        order = np.arange(elastic.size) - (np.cumsum(n_modes) - n_modes)[condition]
        number = np.full((n_modes.size, int(np.max(n_modes)) + 1), -1)
        number[condition, order] = elastic
        predicted = np.full(number[:, :-1].shape, np.inf)
        predicted[condition, order] = np.log(modes.undamped_omega[elastic] / (2.0 * np.pi))
        missed = np.where((n_modes > 0) & self._single_order, np.inf, _MISSED)
        place, measured = self._frequencies
        misfits, mode = assign_modes(predicted, np.tile(measured, (n_asked, 1)), missed)
        mode = np.take_along_axis(number, mode, axis=1)
        for asked in range(n_asked):
            here = slice(asked * n_settings, (asked + 1) * n_settings)
            misfit, whose = np.empty(self.measured.size), np.empty(self.measured.size, dtype=np.intp)
            there = np.isfinite(measured)
            misfit[place[there]], whose[place[there]] = misfits[here][there], mode[here][there]
            whose = whose[self.frequency_of]
            if np.any(self.damping):
                ratio = np.append(-modes.pole.real / np.abs(modes.pole), 0.0)[whose]  # none of a mode that is missed
                misfit = np.where(self.damping, ratio / self.measured - 1.0, misfit)
            yield misfit, modes, whose

    @cached_property
    def _frequencies(self) -> tuple[Indices, FloatArray]:
        """Return the values of each setting that are frequencies, and these; behind the last one inf."""
        values = np.flatnonzero(~self.damping)
        setting = self.layout.setting[values]
        each = np.bincount(setting, minlength=len(self.conditions))
        order = np.arange(values.size) - (np.cumsum(each) - each)[setting]
        place, measured = (
            np.zeros((each.size, int(np.max(each))), dtype=np.intp),
            np.full((each.size, int(np.max(each))), np.inf),
        )
        place[setting, order], measured[setting, order] = values, self.measured[values]
        return place, measured

    def _modes(self, physics: AxisPhysics, conditions: tuple[DriveConditions, ...]) -> DriveModes:
        highest = _HIGHEST * float(np.exp(np.max(self.measured[~self.damping])))
        # without damping where none was measured: axes that differ in nothing else are then equal
        damped = physics if np.any(self.damping) else with_damping(physics, 0.0)
        return _modes(self.followed, damped, conditions, self.motor_end, highest)


def compare_modes(
    observations: Sequence[ModalObservation],
    motor_end: MotorEnd,
    *,
    held_out: Sequence[frozenset[DriveConditions]] = (),
    tolerances: SettingTolerances | None = None,
) -> ModesComparison:
    """Put measured natural frequencies, and damping ratios where they are stated, into the form to be compared.

    A frequency without stated uncertainty is taken to be known to 1.5 %, a damping ratio to 20 %. ``held_out`` are the
    conditions that each fold leaves out. Raises NotIdentifiableError if there is no frequency.
    """
    if not observations:
        raise NotIdentifiableError("a comparison needs at least one natural frequency; got none")
    conditions = conditions_in_order(observations)
    values = modal_values(observations, {stated: index for index, stated in enumerate(conditions)})
    place_of = {value.observation: index for index, value in enumerate(values) if not value.is_damping}
    channels = sorted({(value.is_damping, value.order) for value in values})
    setting = np.array([value.setting for value in values])
    with_damping_ratios = any(value.is_damping for value in values)
    single_order = len({value.order for value in values}) == 1
    return ModesComparison(
        layout=Layout(
            settings=tuple(setting_of(stated) for stated in conditions),
            setting=setting,
            channel=np.array([channels.index((value.is_damping, value.order)) for value in values]),
            channels=tuple(f"mode {order}{', damping ratio' * is_damping}" for is_damping, order in channels),
            frequency=np.array([math.nan if value.is_damping else math.exp(value.measured) for value in values]),
            standard_deviation=np.array([value.deviation for value in values]),
            period=np.full(len(values), np.inf),
            held_out=tuple(np.array([stated in fold for stated in conditions])[setting] for fold in held_out),
        ),
        conditions=conditions,
        motor_end=motor_end,
        measured=np.array([value.measured for value in values]),
        frequency_of=np.array([place_of[value.observation] for value in values]),
        unit="sigma" if with_damping_ratios else "Hz" if single_order else "%",
        tolerances=tolerances or SettingTolerances(),
    )


@lru_cache(maxsize=64)  # a search needs the same axis again, and axes that differ in damping alone
def _modes(
    followed: FollowedModes,
    physics: AxisPhysics,
    conditions: tuple[DriveConditions, ...],
    motor_end: MotorEnd,
    highest_frequency: float,
) -> DriveModes:
    modes = followed.of(physics, conditions, [motor_end] * len(conditions), highest_frequency)
    for values in (modes.condition, modes.undamped_omega, modes.pole):
        values.setflags(write=False)
    return modes
