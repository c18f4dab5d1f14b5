"""Choose the lines of measured responses that a logarithm can hold, and keep phases within half a turn."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.model_form import FormSpectrum
from monitor_core.fitting.residuals.resolution import spread_under_random_excitation
from monitor_core.models.extended import ResponseCase
from monitor_core.models.protocol import DriveConditions, MotorEnd, motor_end_of
from monitor_core.response import LineSpread


def clear_lines(observation: FrequencyResponseObservation, least_signal_to_noise: float) -> BoolArray:
    """Return which lines stand so many times above their noise, shape (n_lines,)."""
    return np.asarray(np.abs(observation.response) >= least_signal_to_noise * observation.standard_deviation)


def case_of(
    observation: FrequencyResponseObservation, chosen: BoolArray, otherwise_held: MotorEnd = MotorEnd.FREE
) -> ResponseCase:
    """Return the case that a model computes for the chosen lines; a force at the table leaves the motor end held."""
    motor_end = motor_end_of(observation.excitation, otherwise_held)
    return ResponseCase(
        observation.frequency[chosen],
        observation.conditions,
        observation.excitation,
        observation.response_point,
        motor_end,
    )


def with_phase_within_half_a_turn(log_ratio: ComplexArray) -> ComplexArray:
    """Return logarithms with their imaginary parts within ±π."""
    return np.asarray(log_ratio - 2j * np.pi * np.round(log_ratio.imag / (2.0 * np.pi)))


@dataclass(frozen=True, eq=False)
class ClearResponse:
    """The clear lines of a measured response, and which setting and which gain of that it has."""

    setting: int
    gain: int
    observation: FrequencyResponseObservation
    clear: BoolArray  # of its lines

    @cached_property
    def response(self) -> ComplexArray:
        """Return the measured response on the clear lines, shape (n_clear,)."""
        return self.observation.response[self.clear]

    @property
    def noise(self) -> FloatArray:
        """Return the standard deviation of the logarithm by noise alone, shape (n_clear,)."""
        return (self.observation.standard_deviation / np.abs(self.observation.response))[self.clear]

    def form_deviation(self, spectrum: FormSpectrum) -> FloatArray:
        """Return the standard deviation of the logarithm by the form of the model, shape (n_clear,)."""
        return spectrum.relative_deviation(self.observation.frequency[self.clear], self.response)

    def spread(self) -> LineSpread | None:
        """Return how the windows of the estimate spread a response over lines; None if that is not stated."""
        if self.observation.spread is not None:
            return self.observation.spread.of_lines(self.clear)
        if self.observation.resolution:
            return spread_under_random_excitation(self.observation.resolution, self.response.size)
        return None


def clear_responses(
    observations: Sequence[FrequencyResponseObservation], least_signal_to_noise: float
) -> list[ClearResponse]:
    """Return the responses that have clear lines, by setting in order of appearance, then by gain.

    Equal conditions are one setting until a point repeats: a second response of the same point was taken another time.
    """
    numbers: dict[tuple[DriveConditions, int], int] = {}
    seen: dict[tuple[DriveConditions, str, str], int] = {}
    gains: dict[int, int] = {}
    found = []
    for observation in observations:
        point = (observation.conditions, str(observation.excitation), str(observation.response_point))
        repeat = seen.get(point, 0)
        seen[point] = repeat + 1
        number = numbers.setdefault((observation.conditions, repeat), len(numbers))
        gain = gains.get(number, 0)
        gains[number] = gain + 1
        found.append(ClearResponse(number, gain, observation, clear_lines(observation, least_signal_to_noise)))
    ordered = sorted(found, key=lambda response: (response.setting, response.gain))
    return [response for response in ordered if np.any(response.clear)]
