r"""What the finite resolution of an estimate does to a frequency response.

H1 of a random excitation that is flat around a line, averaged over segments under a window w, is in expectation

.. math:: \bar H(f) = \frac{\int |W(\nu)|^2 H(f - \nu)\,d\nu}{\int |W(\nu)|^2\,d\nu}

of what is recorded: peaks become lower and wider (Schmidt, J. Sound Vib. 101 (1985) 347: resolution bias errors).
Under the integral the impulse response h(τ) is weighed by the autocorrelation a(τ) of the window, which ends after the
duration T of a segment. A sum in steps of 2/(3T) weighs it by a(τ) + a(3T/2 − τ) instead, which is the same where
motion has died away after T; of Hann's window it has five terms that count. What is recorded is taken to be an
acceleration: displacements and angles from it are quotients by :math:`-(2 \pi f)^2`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.extended import AxisPhysics, PreparedLines, ResponseCase, prepare_lines, responses
from monitor_core.models.extended.conditions import ConditionArrays
from monitor_core.models.protocol import ResponsePoint

#: From a line, in resolutions 1/T: the line itself, then those beside it.
STEPS = np.array([0.0, -4.0, -2.0, 2.0, 4.0]) / 3.0
_POWERS = (np.sinc(STEPS) / (1.0 - STEPS**2)) ** 2  # |W|² of Hann's window
WEIGHTS = _POWERS / np.sum(_POWERS)


@dataclass(frozen=True, eq=False)
class Smearing:
    """Lines beside the measured ones; build it with :func:`smearing`."""

    beside: tuple[PreparedLines, ...]  # the same line of each response in each of them
    weights: tuple[FloatArray, ...]  # of their responses, shape (n_lines,)

    def log_ratio(self, physics: AxisPhysics, response: ComplexArray) -> ComplexArray:
        """Return ln(H̄/H) for the responses H on the lines themselves, shape (n_lines,)."""
        beside = sum(
            weight * responses(physics, lines) for weight, lines in zip(self.weights, self.beside, strict=True)
        )
        return np.asarray(np.log(WEIGHTS[0] + beside / response))

    def under(self, conditions: ConditionArrays) -> "Smearing":
        """Return the same lines under other conditions."""
        return replace(self, beside=tuple(replace(lines, conditions=conditions) for lines in self.beside))


def smearing(cases: Sequence[ResponseCase], resolution: Sequence[float]) -> Smearing | None:
    """Return what the resolutions of responses do to them; None where all are so fine that they do nothing.

    Parameters
    ----------
    cases : sequence of ResponseCase
        The lines.
    resolution : sequence of float
        Of each case; 0: as fine as can be. [Hz]
    """
    if not any(resolution):
        return None
    beside, weights = [], []
    for step, weight in zip(STEPS[1:], WEIGHTS[1:], strict=True):
        # next to zero, where a window does not separate lines from the mean, no line can be further below
        there = [
            replace(one, frequency=np.maximum(one.frequency + step * width, 0.5 * one.frequency))
            for one, width in zip(cases, resolution, strict=True)
        ]
        beside.append(prepare_lines(there))
        recorded = [_of_recorded(one, other) for one, other in zip(cases, there, strict=True)]
        weights.append(weight * np.concatenate(recorded))
    return Smearing(tuple(beside), tuple(weights))


def _of_recorded(case: ResponseCase, beside: ResponseCase) -> FloatArray:
    """Return how much the recorded acceleration beside a line is of its quotient there times that on the line."""
    if case.response is ResponsePoint.ACCELERATION_AT_TABLE:
        return np.ones_like(case.frequency)
    return np.asarray((beside.frequency / case.frequency) ** 2)
