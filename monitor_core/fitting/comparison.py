"""Define the form in which all kinds of data are compared with a model: values, misfits, gaps and pictures.

Modal tables, frequency responses and motion records each have one module that turns them into this form. Everything
after it, from the fit to the decision, is the same for all of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray, read_only
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import Move
from monitor_core.shown import Panel

Physics = TypeVar("Physics")
Physics_contra = TypeVar("Physics_contra", contravariant=True)


@dataclass(frozen=True, slots=True)
class Setting:
    """What the axis was set to while some of the data were taken; data of one setting share its condition errors."""

    name: str  # as a sentence calls it: "300 mm, 250 N, +6 kg"
    values: Mapping[ConditionAxis, float] = field(default_factory=dict)  # SI, of what is stated


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrors:
    """Errors that values of different settings share, as those of the form of a model at one frequency."""

    group: npt.NDArray[np.intp]  # which values share an error, shape (n_values,)
    deviation: FloatArray  # standard deviation of the error, in the unit of the misfit, shape (n_values,)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What each value of the data belongs to."""

    settings: tuple[Setting, ...]
    setting: npt.NDArray[np.intp]  # index of the setting of each value, shape (n_values,)
    channel: npt.NDArray[np.intp]  # index of the channel of each value, shape (n_values,)
    channels: tuple[str, ...]  # names, such as "acceleration-at-table, real part"
    frequency: FloatArray  # of the line or the mode; NaN where a value has none, shape (n_values,) [Hz]
    standard_deviation: FloatArray  # of the misfit, measurement and model's form, shape (n_values,)
    period: FloatArray  # by whole multiples of which a misfit is undetermined, as a phase; inf otherwise, (n_values,)
    common: CommonErrors | None = None
    held_out: tuple[BoolArray, ...] = ()  # values each fold leaves out; one: never fitted; several: in turn

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequency", read_only(self.frequency))
        object.__setattr__(self, "standard_deviation", read_only(self.standard_deviation))
        object.__setattr__(self, "period", read_only(self.period))
        sizes = {self.setting.size, self.channel.size, self.frequency.size, self.standard_deviation.size}
        if len(sizes) != 1 or not self.setting.size:
            raise OutsideValidityError(
                "a comparison needs one setting, channel and deviation for each value, at least one"
            )
        if not np.all(self.standard_deviation > 0.0):
            raise OutsideValidityError("the standard deviation of every value must be positive")

    def difference(self, misfit: FloatArray, other: FloatArray) -> FloatArray:
        """Return one misfit less another, each value within half its period of zero, shape (n_values,)."""
        difference = misfit - other
        turns = np.round(difference / self.period)
        return difference - turns * np.where(turns != 0.0, self.period, 0.0)

    @property
    def n_values(self) -> int:
        """How many numbers are compared."""
        return self.setting.size


@dataclass(frozen=True, slots=True)
class ChangedConditions:
    """Conditions under which all settings might be measured again."""

    axis: ConditionAxis
    amount: float  # added mass [kg], warming [K], ratio of levels [-], share of the way to the next position [-]


class Comparison(Protocol[Physics_contra]):
    """Data of one axis, and how far a description of it is from them."""

    @property
    def layout(self) -> Layout:
        """What the values belong to."""
        ...

    @property
    def unit(self) -> str:
        """Unit in which a gap is stated: sigma, Hz or %."""
        ...

    @property
    def noise_floor(self) -> float:
        """Gap that noise, condition errors and the form of the model leave where nothing is missing, in ``unit``."""
        ...

    @property
    def least_delta_bic(self) -> float:
        """Evidence that an effect needs: more where the form of the model may pass for one in thousands of values."""
        ...

    @property
    def condition_error_names(self) -> tuple[str, ...]:
        """Names of the rows of ``condition_errors``; the error that may act strongly stands first."""
        ...

    def misfit(self, physics: Physics_contra) -> FloatArray:
        """Return prediction less measurement, shape (n_values,); raises OutsideValidityError where there is none."""
        ...

    def condition_errors(self, physics: Physics_contra, misfit: FloatArray) -> FloatArray:
        """Return the change of the misfit per standard deviation of each condition error, (n_errors, n_values).

        ``misfit`` is that of the same physics. The errors are independent from setting to setting and standard normal:
        where the table really stood, what the preload really was, what the gain really is.
        """
        ...

    def shifted(self, errors: FloatArray) -> "Comparison[Physics_contra]":
        """Return the same data with condition errors taken into account, shape (n_settings, n_errors).

        What was set, and the gains, are moved by so many standard deviations from where they are taken to be already;
        everything else stays.
        """
        ...

    def resolved(self, physics: Physics_contra, errors: FloatArray) -> "Comparison[Physics_contra]":
        """Return the data as a finer resolution would have shown them, for such an axis and such condition errors.

        For these physics and errors the misfit is that of this comparison, for similar ones nearly so; it costs less.
        """
        ...

    def imagined(self, physics: Physics_contra) -> Mapping[ChangedConditions, "Comparison[Physics_contra]"]:
        """Return the same settings under other conditions, changed by as much as such an axis needs.

        Nothing was measured there; two models are compared through the difference of their misfits.
        """
        ...

    def gap(self, misfit: FloatArray, standardised: FloatArray, chosen: BoolArray) -> float:
        """Return the size of the gap over the chosen values in ``unit``.

        ``standardised`` is the misfit after the condition errors have explained what they can, in standard deviations.
        """
        ...

    def panels(self, models: Mapping[str, Physics_contra]) -> tuple[Panel, ...]:
        """Return pictures of the measurement and of several models by their names."""
        ...


@runtime_checkable
class HasSlopes(Comparison[Physics], Protocol[Physics]):
    """Comparisons that know how the misfit changes as the physics goes a way, for less than the misfit at each."""

    def slopes(self, physics: Physics, moves: Sequence[Move[Physics]]) -> Sequence[FloatArray | None]:
        """Return the derivative of the misfit by each move, shape (n_values,); None of a move that it is not known of.

        Raises OutsideValidityError where there is no misfit.
        """
        ...


@runtime_checkable
class HasRecords(Comparison[Physics_contra], Protocol[Physics_contra]):
    """Comparisons whose settings are records of their own: each may be tagged wrongly, or be wrong altogether."""

    @property
    def records(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the observations, from 0 as they were given, that each setting was measured by."""
        ...

    @property
    def response_of_value(self) -> npt.NDArray[np.intp]:
        """Which response each value belongs to: a response has a gain of its own, shape (n_values,)."""
        ...

    def tags(self, tag: str) -> FloatArray:
        """Return what each setting states of a condition, 0 where nothing, shape (n_settings,)."""
        ...

    def retagged(self, tag: str, values: FloatArray) -> "HasRecords[Physics_contra]":
        """Return the comparison with other values of a condition in the place of what is stated, (n_settings,)."""
        ...

    def tag_ranges(self, physics: Physics_contra, setting: int) -> Mapping[str, tuple[float, float]]:
        """Return within which values the tags of a setting may have gone wrong, by their names."""
        ...

    def only(self, settings: frozenset[int]) -> "HasRecords[Physics_contra]":
        """Return the comparison of these settings alone."""
        ...


class GapInSigma:
    """Comparisons whose gap is the rms of the standardised misfit."""

    def gap(self, misfit: FloatArray, standardised: FloatArray, chosen: BoolArray) -> float:
        """Return the rms of the standardised misfit over the chosen values."""
        del misfit
        return float(np.sqrt(np.mean(standardised[chosen] ** 2)))


class AsMeasured:
    """Comparisons of data that no finer resolution would change."""

    def resolved(self, physics: object, errors: FloatArray) -> Self:
        """Return the comparison as it is."""
        del physics, errors
        return self


class WithoutOtherConditions:
    """Comparisons of data that are measured as they are."""

    def imagined(self, physics: object) -> Mapping[ChangedConditions, Self]:
        """Return nothing: no other conditions are proposed."""
        del physics
        return {}


def amplitude_panels(
    rows: Sequence[tuple[str, BoolArray]],
    y_name: str,
    frequency: FloatArray,
    measured: FloatArray,
    models: Mapping[str, FloatArray],
    *,
    held_out: Sequence[bool] = (),
) -> tuple[Panel, ...]:
    """Return a picture over the frequency for each title and its rows of all the amplitudes."""
    return tuple(
        Panel(
            title=title,
            x_name="frequency [Hz]",
            y_name=y_name,
            x=frequency[lines_of_row],
            measured=measured[lines_of_row],
            models={name: values[lines_of_row] for name, values in models.items()},
            logarithmic=True,
            held_out=bool(held_out) and held_out[index],
        )
        for index, (title, lines_of_row) in enumerate(rows)
    )
