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
import numpy.typing as npt

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
    """The measured lines with those beside them; build it with :func:`smearing`."""

    lines: PreparedLines
    place: npt.NDArray[np.intp]  # of each line and those beside it among them, shape (n_steps, n_lines)
    weights: FloatArray  # of their responses, shape (n_steps, n_lines)

    def log_ratio(self, physics: AxisPhysics) -> ComplexArray:
        """Return ln(H̄/H) of the measured lines, shape (n_lines,)."""
        response = responses(physics, self.lines)[self.place]
        return np.asarray(np.log(np.sum(self.weights * response, axis=0) / response[0]))

    def under(self, conditions: ConditionArrays) -> "Smearing":
        """Return the same lines under other conditions."""
        return replace(self, lines=replace(self.lines, conditions=conditions))


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
    widened, places, weights, n_before = [], [], [], 0
    for case, width in zip(cases, resolution, strict=True):
        # next to zero, where a window does not separate lines from the mean, no line can be further below
        wanted = np.maximum(case.frequency + width * STEPS[:, None], 0.5 * case.frequency)
        frequency, place = np.unique(wanted, return_inverse=True)
        widened.append(replace(case, frequency=frequency))
        places.append(place.reshape(wanted.shape) + n_before)
        weights.append(WEIGHTS[:, None] * _of_recorded(case.response, wanted / case.frequency))
        n_before += frequency.size
    return Smearing(prepare_lines(widened), np.concatenate(places, axis=1), np.concatenate(weights, axis=1))


def _of_recorded(point: ResponsePoint, ratio: FloatArray) -> FloatArray:
    """Return how much an acceleration beside a line counts in the quotient by the line's frequency, by their ratio."""
    return np.ones_like(ratio) if point is ResponsePoint.ACCELERATION_AT_TABLE else np.asarray(ratio**2)
