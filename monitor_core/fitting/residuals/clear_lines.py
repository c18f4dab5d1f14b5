"""The lines of a measured response that a logarithm can hold, and misfits whose phases wrap."""

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.extended import ResponseCase
from monitor_core.models.protocol import MotorEnd, motor_end_of


def clear_lines(one: FrequencyResponseObservation, least_signal_to_noise: float) -> BoolArray:
    """Tell which lines stand so many times above their noise, shape (n_lines,)."""
    return np.asarray(np.abs(one.response) >= least_signal_to_noise * one.standard_deviation)


def case_of(
    one: FrequencyResponseObservation, chosen: BoolArray, otherwise_held: MotorEnd = MotorEnd.FREE
) -> ResponseCase:
    """Return what a model is asked for the chosen lines of a response; a force at the table leaves the motor held."""
    motor_end = motor_end_of(one.excitation, otherwise_held)
    return ResponseCase(one.frequency[chosen], one.conditions, one.excitation, one.response_point, motor_end)


def with_phase_within_half_a_turn(log_ratio: ComplexArray) -> ComplexArray:
    """Return logarithms with their imaginary parts within ±π."""
    return np.asarray(log_ratio - 2j * np.pi * np.round(log_ratio.imag / (2.0 * np.pi)))
