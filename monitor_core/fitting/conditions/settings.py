"""Describe the conditions of measurements: names, tolerances, what is held out, what varies."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

import numpy as np

from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout, Setting
from monitor_core.fitting.conditions.groups import has_lines, modes_that_stay
from monitor_core.models.protocol import DriveConditions

#: With fewer positions or preloads than this every one is needed for the fit.
_FEWEST_TO_HOLD_OUT = 5
_FEWEST_TO_LEAVE_OUT_IN_TURN = 4
_FEWEST_OF_A_VARIATION = 2
#: What is varied besides position and preload, at few settings.
_VARIED = ("payload_mass", "temperature_deviation", "excitation_level")
#: What is easily done to an axis to see more: a mass put on the table, of what moves [-], a morning's warming [K].
_KNOWN_MASS = 0.25
WARMER = 15.0
#: Masses come in these, times powers of ten; between two of them the geometric mean decides.
_MASSES = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class SettingTolerances:
    """Standard deviations of what a measurement is tagged with; those of payload and temperature count as exact."""

    position: float = 0.3e-3  # [m]
    preload_share: float = 0.03  # of the stated preload [-]
    gain_share: float = 0.005  # of the response [-]
    payload: float = 0.0  # [kg]
    temperature: float = 0.0  # [K]

    def __post_init__(self) -> None:
        exact = {"payload", "temperature"}
        for name in ("position", "preload_share", "gain_share", "payload", "temperature"):
            value = getattr(self, name)
            if not (0.0 < value < math.inf or (value == 0.0 and name in exact)):
                raise OutsideValidityError(f"the tolerance of {name} must be positive and finite; got {value}")

    @property
    def of_conditions(self) -> dict[str, float]:
        """By the names of conditions, what else is not exact: a payload, a temperature."""
        stated = {"payload_mass": self.payload, "temperature_deviation": self.temperature}
        return {name: tolerance for name, tolerance in stated.items() if tolerance}


def known_mass(moving_mass: float) -> float:
    """Return a mass that is worth putting on a table, a quarter of what moves as masses come: 1, 2, 5, 10 … kg."""
    wanted = _KNOWN_MASS * moving_mass
    decade = 10.0 ** math.floor(math.log10(wanted))
    return min((decade * mass for mass in _MASSES), key=lambda mass: abs(math.log(mass / wanted)))


def setting_of(conditions: DriveConditions) -> Setting:
    """Return what a sentence calls the conditions, and their values."""
    values = {ConditionAxis.POSITION: conditions.position}
    words = [f"{conditions.position * 1e3:g} mm"]
    if conditions.preload is not None:
        values[ConditionAxis.PRELOAD] = conditions.preload
        words.append(f"{conditions.preload:g} N")
    values[ConditionAxis.PAYLOAD] = conditions.payload_mass
    if conditions.payload_mass:
        words.append(f"+{conditions.payload_mass:g} kg")
    values[ConditionAxis.TEMPERATURE] = conditions.temperature_deviation
    if conditions.temperature_deviation:
        words.append(f"{conditions.temperature_deviation:+g} K")
    if conditions.excitation_level:
        values[ConditionAxis.LEVEL] = conditions.excitation_level
        words.append(f"level {conditions.excitation_level:.3g}")
    return Setting(", ".join(words), values)


def default_folds(conditions: Iterable[DriveConditions]) -> tuple[frozenset[DriveConditions], ...]:
    """Return what to hold out by default: two inner positions of five or more, else each preload in turn.

    With five positions or more a model is judged where it was not fitted, and of payloads, temperatures and levels that
    were varied the last measurement each is held out, too. At least half of what was measured with each of them is
    fitted, at an inner position if it must be: what nothing fitted shows cannot be found. A table of few positions
    cannot spare one, and leaves out each of at least four preloads in turn; with fewer than that nothing is held out.
    """
    distinct = list(dict.fromkeys(conditions))
    positions = sorted({setting.position for setting in distinct})
    if len(positions) >= _FEWEST_TO_HOLD_OUT:
        inner = {positions[1], positions[-2]}
        held_out = {setting for setting in distinct if setting.position in inner}
        held_out |= _last_of_each_variation(setting for setting in distinct if setting not in held_out)
        return (frozenset(held_out - _needed_for_the_fit(distinct, held_out)),)
    preloads = sorted({setting.preload for setting in distinct if setting.preload is not None})
    if len(preloads) >= _FEWEST_TO_LEAVE_OUT_IN_TURN:
        return tuple(frozenset(setting for setting in distinct if setting.preload == preload) for preload in preloads)
    return ()


def _needed_for_the_fit(conditions: Sequence[DriveConditions], held_out: Set[DriveConditions]) -> set[DriveConditions]:
    """Return what must not be held out, so that half of the settings of each unusual value are fitted.

    Those nearest to the fixed bearing are taken, so that the other inner position stays unseen if that is enough. What
    is usual in less than half of all settings was not varied but drifts, and enough of it is fitted in any case.
    """
    needed: set[DriveConditions] = set()
    for name in _VARIED:
        counts = Counter(getattr(setting, name) for setting in conditions)
        usual, n_usual = counts.most_common(1)[0]
        if 2 * n_usual < len(conditions):
            continue
        for value in counts.keys() - {usual}:
            alike = [setting for setting in conditions if getattr(setting, name) == value]
            out = sorted((setting for setting in alike if setting in held_out), key=lambda setting: setting.position)
            needed.update(out[: max(len(out) - len(alike) // 2, 0)])
    return needed


def fitted_still(
    fold: frozenset[DriveConditions], before: Iterable[DriveConditions], left: Iterable[DriveConditions]
) -> frozenset[DriveConditions]:
    """Return a fold without the settings that are all that is left of a payload, temperature or level that was fitted.

    ``before`` are all settings, ``left`` those that are left of them: what nothing fitted shows cannot be found.
    """
    before, left = tuple(before), tuple(left)
    needed: set[DriveConditions] = set()
    for name in _VARIED:
        was, still = ({getattr(each, name) for each in settings if each not in fold} for settings in (before, left))
        needed.update(each for each in left if getattr(each, name) in was - still)
    return fold - needed


def _last_of_each_variation(conditions: Iterable[DriveConditions]) -> set[DriveConditions]:
    """Return the last of several conditions that differ from most in one payload, temperature or level.

    Without them nothing held out would respond to an effect that only such a variation shows.
    """
    remaining = list(conditions)
    last: set[DriveConditions] = set()
    for name in _VARIED:
        counts = Counter(getattr(setting, name) for setting in remaining)
        usual = counts.most_common(1)[0][0] if counts else None
        several = sorted(value for value, count in counts.items() if count >= _FEWEST_OF_A_VARIATION)
        if name == "temperature_deviation":  # many where it drifts: the coldest and the warmest
            several = [*several[:1], *several[-1:]]
        for value in several:
            if value != usual:
                last.add([setting for setting in remaining if getattr(setting, name) == value][-1])
    return last


def varied_conditions(layout: Layout) -> frozenset[ConditionAxis]:
    """Return the conditions that take more than one value in the data."""
    values: dict[ConditionAxis, set[float]] = {}
    for setting in layout.settings:
        for axis, value in setting.values.items():
            values.setdefault(axis, set()).add(value)
    varied = {axis for axis, different in values.items() if len(different) > 1}
    if has_lines(layout):
        varied.add(ConditionAxis.FREQUENCY)
    return frozenset(varied)


def is_testable(effect: Effect[Physics], layout: Layout) -> bool:
    """Return whether the data vary what an effect needs to be seen as such.

    What has a frequency of its own shows in a natural frequency, too, if one stays where it is.
    """
    missing = effect.needs - varied_conditions(layout)
    own = effect.frequency
    if missing != {ConditionAxis.FREQUENCY} or own is None:
        return not missing
    stays = [layout.frequency[layout.channel == channel] for channel in modes_that_stay(layout)]
    return any(own.lower <= float(np.nanmean(frequency)) <= own.upper for frequency in stays)
