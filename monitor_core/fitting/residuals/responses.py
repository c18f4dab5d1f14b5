r"""Compare frequency responses with an axis: the misfit is the complex logarithm of model over measurement.

.. math::

    m = \ln \frac{H(f)}{Y(f)}, \qquad
    \sigma^2 = \left( \frac{\sigma_Y}{|Y|} \right)^2 + \sigma_{form}^2(f)

Its real part is an error of the amplitude and its imaginary part one of the phase; noise of a line has one deviation in
both. A logarithm lets a resonance that stands a little off be drawn towards the measured one, where the plain
difference of two peaks side by side has no slope that leads there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, logarithm
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.comparison import (
    ChangedConditions,
    CommonErrors,
    GapInSigma,
    Layout,
    amplitude_panels,
)
from monitor_core.fitting.conditions.settings import WARMER, SettingTolerances, fitted_still, known_mass, setting_of
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.lines import case_of, clear_responses, with_phase_within_half_a_turn
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.fitting.residuals.resolution import Smearing, smearing
from monitor_core.models.extended import (
    AxisPhysics,
    Move,
    PreparedLines,
    log_response_slopes,
    moving_mass,
    prepare_lines,
    responses,
)
from monitor_core.models.extended.conditions import ConditionArrays
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.shown import Panel

#: A line whose amplitude is not this many times its noise says nothing that a logarithm could hold.
_LEAST_SIGNAL_TO_NOISE = 8.0
#: By which conditions are moved to see what their errors do, in their standard deviations (a choice). A shorter move
#: lets the balance of friction or a hardening nut follow to first order; a longer one averages over what is steep.
_STEP = 0.01
#: Where a wrong tag is sought: a position beyond what was travelled, of that; a preload by a factor; a payload in
#: moving masses; a temperature by so many kelvins.
_BEYOND_TRAVEL, _WRONG_PRELOAD, _WRONG_PAYLOAD, _WRONG_WARMTH = 0.1, 4.0, 2.0, 60.0


@dataclass(frozen=True, eq=False)
class ResponsesComparison(GapInSigma):
    """Measured responses of one axis under several conditions; build it with :func:`compare_responses`."""

    layout: Layout
    lines: PreparedLines
    smearing: Smearing | None  # by the windows of the estimates; None: lines are exact
    measured: npt.NDArray[np.complex128]  # ln of the response of every line, shape (n_lines,)
    line_of_value: npt.NDArray[np.intp]  # line of each value; real parts of a response, then its imaginary parts
    imaginary: BoolArray  # which values are imaginary parts
    response_of_line: npt.NDArray[np.intp]  # which response a line belongs to
    setting_of_response: npt.NDArray[np.intp]
    gain_column: npt.NDArray[np.intp]  # which gain of its setting a response has
    tolerances: SettingTolerances
    noise: FloatArray  # standard deviation of each value by the noise of its line alone, shape (n_values,)
    noise_floor: float  # rms of the standardised misfit where nothing is missing [-]
    titles: tuple[str, ...]  # of the responses
    source: "ResponsesSource"

    unit = "sigma"
    least_delta_bic = 50.0  # thousands of lines, and the form of the model is in all of them alike

    @property
    def condition_error_names(self) -> tuple[str, ...]:
        """Return position, preload, one gain for each response of a setting, and what else is not exact."""
        gains = (f"gain {index + 1}" for index in range(self._n_gains))
        return ("position", "preload", *gains, *(name.split("_")[0] for name in self.tolerances.of_conditions))

    @property
    def _n_gains(self) -> int:
        return int(np.max(self.gain_column)) + 1

    def misfit(self, physics: AxisPhysics) -> FloatArray:
        """Return Re and Im of ln(H/Y), shape (n_values,)."""
        return self._values(self.log_responses(physics) - self.measured)

    def slopes(self, physics: AxisPhysics, moves: Sequence[Move[AxisPhysics]]) -> Sequence[FloatArray | None]:
        """Return the derivatives of the misfit by moves; None of smeared lines, which know their neighbours."""
        if self.smearing is not None:
            return [None] * len(moves)
        slopes = log_response_slopes(physics, self.lines, moves)
        return [None if slope is None else self._parts(slope) for slope in slopes]

    def condition_errors(self, physics: AxisPhysics, misfit: FloatArray) -> FloatArray:
        """Return the change of the misfit by the errors of ``condition_error_names``."""
        conditions = self.lines.conditions
        alike = np.ones_like(conditions.position)

        def by(name: str, tolerance: FloatArray) -> FloatArray:
            moved = _with(conditions, name, getattr(conditions, name) - _STEP * tolerance)
            return self.layout.difference(misfit, self._under(moved).misfit(physics)) / _STEP

        rows = [
            by("position", self.tolerances.position * alike),
            by("preload", self.tolerances.preload_share * conditions.preload),
        ]
        gain = self.gain_column[self.response_of_value]
        for column in range(self._n_gains):
            rows.append(np.where((gain == column) & ~self.imaginary, self.tolerances.gain_share, 0.0))
        rows += [by(name, tolerance * alike) for name, tolerance in self.tolerances.of_conditions.items()]
        return np.array(rows)

    def shifted(self, errors: FloatArray) -> "ResponsesComparison":
        """Return the comparison with what was set, and the gains, moved by errors in standard deviations."""
        of_case = errors[self.setting_of_response]
        gain = self.tolerances.gain_share * of_case[np.arange(of_case.shape[0]), 2 + self.gain_column]
        return replace(self._under(self._moved(errors)), measured=self.measured - gain[self.response_of_line])

    def resolved(self, physics: AxisPhysics, errors: FloatArray) -> "ResponsesComparison":
        """Return the comparison with the responses as estimates of a finer resolution would have been."""
        if self.smearing is None:
            return self
        smearing = self.smearing.under(self._moved(errors))
        return replace(self, smearing=None, measured=self.measured - smearing.log_ratio(physics))

    def imagined(self, physics: AxisPhysics) -> Mapping[ChangedConditions, "ResponsesComparison"]:
        """Return the settings with a known mass on the table, warmer, and excited more."""
        now, mass = self.lines.conditions, known_mass(moving_mass(physics))
        heavier = replace(now, payload_mass=now.payload_mass + mass)
        warmer = replace(now, temperature_deviation=now.temperature_deviation + WARMER)
        softly = replace(now, excitation_level=now.excitation_level / 3.0)
        return {
            ChangedConditions(ConditionAxis.PAYLOAD, mass): self._under(heavier),
            ChangedConditions(ConditionAxis.TEMPERATURE, WARMER): self._under(warmer),
            ChangedConditions(ConditionAxis.LEVEL, 1.0 / 3.0): self._under(softly),
        }

    @property
    def records(self) -> tuple[tuple[int, ...], ...]:
        """Return the numbers of the observations, from 0 as they were given, that each setting was measured by."""
        numbers: list[list[int]] = [[] for _ in self.layout.settings]
        for number, setting in zip(self.source.numbers, self.setting_of_response.tolist(), strict=True):
            numbers[setting].append(number)
        return tuple(map(tuple, numbers))

    @property
    def response_of_value(self) -> npt.NDArray[np.intp]:
        """Return which response each value belongs to, shape (n_values,)."""
        return self.response_of_line[self.line_of_value]

    def tags(self, tag: str) -> FloatArray:
        """Return what each setting states of a condition, by its name in :class:`ConditionArrays`, (n_settings,)."""
        first = np.unique(self.setting_of_response, return_index=True)[1]
        return np.asarray(getattr(self.lines.conditions, tag)[first], dtype=np.float64)

    def retagged(self, tag: str, values: FloatArray) -> "ResponsesComparison":
        """Return the comparison with other values of a condition in the place of what is stated, (n_settings,)."""
        return self._under(_with(self.lines.conditions, tag, values[self.setting_of_response]))

    def tag_ranges(self, physics: AxisPhysics, setting: int) -> Mapping[str, tuple[float, float]]:
        """Return within which values the tags of a setting may have gone wrong; a preload only where it is stated."""
        positions, preload = self.tags("position"), float(self.tags("preload")[setting])
        low, high = float(np.min(positions)), float(np.max(positions))
        beyond = _BEYOND_TRAVEL * (high - low)
        warmth = float(self.tags("temperature_deviation")[setting])
        ranges = {
            "position": (max(low - beyond, 0.5 * low), high + beyond),
            "preload": (preload / _WRONG_PRELOAD, preload * _WRONG_PRELOAD),
            "payload_mass": (0.0, _WRONG_PAYLOAD * moving_mass(physics)),
            "temperature_deviation": (warmth - _WRONG_WARMTH, warmth + _WRONG_WARMTH),
        }
        return {tag: ends for tag, ends in ranges.items() if ends[1] > ends[0]}

    def only(self, settings: frozenset[int]) -> "ResponsesComparison":
        """Return the comparison of these settings alone."""
        kept = [each in settings for each in self.setting_of_response.tolist()]
        return self.source.compared(kept)

    def panels(self, models: Mapping[str, AxisPhysics]) -> tuple[Panel, ...]:
        """Return the amplitude of every response, measured and modelled."""
        held_out = np.zeros(len(self.titles), dtype=np.bool_)
        for fold in self.layout.held_out if len(self.layout.held_out) == 1 else ():
            held_out |= np.bincount(self.response_of_value, ~fold, len(self.titles)) == 0
        return amplitude_panels(
            [(title, self.response_of_line == index) for index, title in enumerate(self.titles)],
            "amplitude of the response",
            self.lines.omega / (2.0 * np.pi),
            np.exp(self.measured.real),
            {name: np.exp(self.log_responses(physics).real) for name, physics in models.items()},
            held_out=held_out.tolist(),
        )

    def log_responses(self, physics: AxisPhysics) -> ComplexArray:
        """Return the logarithms of the modelled responses as the measurement would show them, shape (n_lines,)."""
        smeared = 0.0 if self.smearing is None else self.smearing.log_ratio(physics)
        return np.asarray(logarithm(responses(physics, self.lines)) + smeared)

    def _moved(self, errors: FloatArray) -> ConditionArrays:
        """Return the conditions of the cases, moved by errors in standard deviations."""
        conditions, of_case = self.lines.conditions, errors[self.setting_of_response]
        moved = replace(
            conditions,
            position=conditions.position + self.tolerances.position * of_case[:, 0],
            preload=conditions.preload * (1.0 + self.tolerances.preload_share * of_case[:, 1]),
        )
        for column, (name, tolerance) in enumerate(self.tolerances.of_conditions.items(), 2 + self._n_gains):
            moved = _with(moved, name, getattr(moved, name) + tolerance * of_case[:, column])
        return moved

    def _under(self, conditions: ConditionArrays) -> "ResponsesComparison":
        smearing = None if self.smearing is None else self.smearing.under(conditions)
        return replace(self, lines=replace(self.lines, conditions=conditions), smearing=smearing)

    def _values(self, per_line: npt.NDArray[np.complex128]) -> FloatArray:
        """Return real and imaginary parts in the order of the values; phases within ±π."""
        return self._parts(with_phase_within_half_a_turn(per_line))

    def _parts(self, per_line: npt.NDArray[np.complex128]) -> FloatArray:
        """Return real and imaginary parts in the order of the values."""
        of_values = per_line[self.line_of_value]
        return np.where(self.imaginary, of_values.imag, of_values.real)


@dataclass(frozen=True, slots=True, eq=False)
class ResponsesSource:
    """What a comparison was made of, so that one of some of its responses can be made."""

    observations: tuple[FrequencyResponseObservation, ...]  # with clear lines, in the order of the comparison
    numbers: tuple[int, ...]  # of these among those that were given
    held_out: tuple[frozenset[DriveConditions], ...]
    tolerances: SettingTolerances
    form: ModelFormError
    otherwise_held: MotorEnd

    def compared(self, kept: Sequence[bool]) -> ResponsesComparison:
        """Return the comparison of some of the responses, chosen in the order of the observations."""
        observations = [each for each, so in zip(self.observations, kept, strict=True) if so]
        numbers = tuple(number for number, so in zip(self.numbers, kept, strict=True) if so)
        there = {observation.conditions for observation in observations}
        held_out = self.held_out
        if len(held_out) == 1:
            held_out = (fitted_still(held_out[0], (each.conditions for each in self.observations), there),)
        again = compare_responses(
            observations,
            held_out=[fold for fold in held_out if fold & there and there - fold],
            tolerances=self.tolerances,
            form=self.form,
            otherwise_held=self.otherwise_held,
        )
        numbers = tuple(numbers[place] for place in again.source.numbers)
        return replace(again, source=replace(again.source, numbers=numbers))


def compare_responses(
    observations: Sequence[FrequencyResponseObservation],
    *,
    held_out: Sequence[frozenset[DriveConditions]] = (),
    tolerances: SettingTolerances | None = None,
    form: ModelFormError | None = None,
    otherwise_held: MotorEnd = MotorEnd.FREE,
) -> ResponsesComparison:
    """Put measured responses into the form that the workflow compares.

    Responses with the same conditions and different points were taken together and share position and preload.
    ``held_out`` are the conditions that each fold leaves out, ``form`` says by how much any model of this kind is off,
    and ``otherwise_held`` what holds the motor end while a force at the table drives the axis. Raises
    NotIdentifiableError if no line stands above its noise.
    """
    tolerances, form = tolerances or SettingTolerances(), form or ModelFormError()
    kept = clear_responses(observations, _LEAST_SIGNAL_TO_NOISE)
    if not kept:
        raise NotIdentifiableError(
            f"a comparison needs lines that stand {_LEAST_SIGNAL_TO_NOISE:g} times above their noise; got none"
        )
    observed = [response.observation for response in kept]
    cases = [case_of(response.observation, response.clear, otherwise_held) for response in kept]
    lines = prepare_lines(cases)
    distinct = sorted({response.setting for response in kept})
    setting_of_response = np.array([distinct.index(response.setting) for response in kept])
    order = setting_of_response / max(len(distinct) - 1, 1)  # settings are numbered as they were measured
    lines = replace(lines, conditions=replace(lines.conditions, order=order))
    sizes = [case.frequency.size for case in cases]
    starts = np.r_[0, np.cumsum(sizes)[:-1]]
    line_of_value = np.concatenate(
        [np.tile(np.arange(start, start + size), 2) for start, size in zip(starts, sizes, strict=True)]
    )
    imaginary = np.concatenate([np.repeat([False, True], size) for size in sizes])
    frequency = (lines.omega / (2.0 * np.pi))[line_of_value]
    spectra = [form.of(observation.response_point) for observation in observed]
    noise = np.concatenate([response.noise for response in kept])
    of_form = np.concatenate(
        [response.form_deviation(spectrum) for response, spectrum in zip(kept, spectra, strict=True)]
    )
    deviation = np.hypot(noise, of_form)
    unlearnt = np.repeat([not spectrum.learnt for spectrum in spectra], sizes)
    points = list(dict.fromkeys(observation.response_point for observation in observed))
    point_of_line = np.repeat([points.index(observation.response_point) for observation in observed], sizes)
    setting = np.repeat(setting_of_response, sizes)[line_of_value]
    conditions = list({response.setting: response.observation.conditions for response in kept}.values())
    in_fold = [np.array([stated in fold for stated in conditions])[setting] for fold in held_out]
    channel = 2 * point_of_line[line_of_value] + imaginary
    held = np.any(in_fold, axis=0) if in_fold else np.zeros(setting.size, dtype=np.bool_)
    group = np.unique(np.column_stack([channel, frequency, held]), axis=0, return_inverse=True)[1].reshape(-1)
    smeared = smearing(cases, [response.spread() for response in kept])
    return ResponsesComparison(
        layout=Layout(
            settings=tuple(setting_of(stated) for stated in conditions),
            setting=setting,
            channel=channel,
            channels=tuple(f"{point}, {part}" for point in points for part in ("amplitude", "phase")),
            frequency=frequency,
            standard_deviation=deviation[line_of_value],
            period=np.where(imaginary, 2.0 * np.pi, np.inf),
            common=CommonErrors(group, of_form[line_of_value]),
            held_out=tuple(in_fold),
        ),
        lines=lines,
        smearing=None if smeared is None else smeared.under(lines.conditions),
        measured=np.log(np.concatenate([response.response for response in kept])),
        line_of_value=line_of_value,
        imaginary=imaginary,
        response_of_line=np.repeat(np.arange(len(kept)), sizes),
        setting_of_response=setting_of_response,
        gain_column=np.array([response.gain for response in kept]),
        tolerances=tolerances,
        noise=noise[line_of_value],
        noise_floor=_floor(group, ((of_form / deviation) ** 2)[line_of_value], unlearnt[line_of_value]),
        titles=tuple(
            f"{setting_of(observation.conditions).name}, {observation.response_point}" for observation in observed
        ),
        source=ResponsesSource(
            tuple(observed),
            tuple(response.number for response in kept),
            tuple(held_out),
            tolerances,
            form,
            otherwise_held,
        ),
    )


def _with(conditions: ConditionArrays, name: str, values: FloatArray) -> ConditionArrays:
    """Return conditions with other values of one of them."""
    changed: Any = {name: values}
    return replace(conditions, **changed)


def _floor(group: npt.NDArray[np.intp], share: FloatArray, unlearnt: BoolArray) -> float:
    r"""Return the rms that a healthy machine leaves.

    A learnt form error is the same in all settings, so of its share p of the variance of a value whitening leaves only
    :math:`p^2/(1 + P)`, with P the sum of the shares of all values that share the error. What is not learnt may differ
    from setting to setting.
    """
    of_group = np.bincount(group, weights=share)[group]
    return float(np.sqrt(np.mean(np.where(unlearnt, 1.0, 1.0 - share + share**2 / (1.0 + of_group)))))
