r"""Model how the finite windows of an estimate spread a frequency response over neighbouring lines.

Where the excitation of the windows is at hand, :func:`monitor_core.spectral.spectra` computes it. Otherwise H1 of a
random excitation that is flat around a line, averaged over segments under a window w, is in expectation

.. math:: \bar H(f) = \frac{\int |W(\nu)|^2 H(f - \nu)\,d\nu}{\int |W(\nu)|^2\,d\nu}

of what is recorded: peaks become lower and wider (Schmidt, J. Sound Vib. 101 (1985) 347: resolution bias errors).
Under the integral the impulse response h(τ) is weighed by the autocorrelation a(τ) of the window, which ends after the
duration T of a segment. A sum in steps of 1/(2T) weighs it by a(τ) + a(2T − τ) instead, which is the same where motion
has died away after T: it errs by less than 0.1 % where a peak is 2/T wide between its half-power points, and by less
than 1 % at 1/T. Of Hann's window seven terms count. What is recorded is taken to be an acceleration: displacements and
angles from it are quotients by :math:`-(2 \pi f)^2`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, logarithm
from monitor_core.models.extended import AxisPhysics, PreparedLines, ResponseCase, prepare_lines, responses
from monitor_core.models.extended.conditions import ConditionArrays
from monitor_core.models.protocol import ResponsePoint
from monitor_core.response import LineSpread

#: From a line, in resolutions 1/T: the line itself, then its neighbours.
STEPS = np.array([0.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5])
#: |W|² of Hann's window, whose transform is that of a cut in halves: sinc(ν) + [sinc(ν − 1) + sinc(ν + 1)]/2.
_POWERS = (np.sinc(STEPS) + 0.5 * (np.sinc(STEPS - 1.0) + np.sinc(STEPS + 1.0))) ** 2
WEIGHTS = _POWERS / np.sum(_POWERS)
#: Of a line: a model has no answer at 0 Hz, where the mean of a window lies.
_LEAST_SHARE = 0.01
_DECIMALS = 9  # of a hertz: neighbours of different lines are the same line, whatever the last bits of their sums are


@dataclass(frozen=True, eq=False)
class Smearing:
    """The measured lines with their neighbours; build it with :func:`smearing`."""

    lines: PreparedLines
    place: npt.NDArray[np.intp]  # of each line and its neighbours among them, shape (n_steps, n_lines)
    mirrored: BoolArray  # whether it lies below zero, where a response is the conjugate, shape (n_steps, n_lines)
    weights: ComplexArray  # of their responses, shape (n_steps, n_lines)

    def log_ratio(self, physics: AxisPhysics) -> ComplexArray:
        """Return ln(H̄/H) of the measured lines, shape (n_lines,)."""
        response = responses(physics, self.lines)[self.place]
        response = np.where(self.mirrored, response.conj(), response)
        return logarithm(np.sum(self.weights * response, axis=0) / response[0])

    def under(self, conditions: ConditionArrays) -> "Smearing":
        """Return the same lines under other conditions."""
        return replace(self, lines=replace(self.lines, conditions=conditions))


def spread_under_random_excitation(resolution: float, n_lines: int) -> LineSpread:
    """Return what Hann windows of a resolution in hertz show where the excitation is random and flat around a line."""
    return LineSpread(resolution * STEPS, np.repeat(WEIGHTS[:, None], n_lines, axis=1))


def smearing(cases: Sequence[ResponseCase], spreads: Sequence[LineSpread | None]) -> Smearing | None:
    """Return how estimates spread the lines of each case, exact where no spread is given; None where none is of any."""
    if all(spread is None for spread in spreads):
        return None
    n_steps = max(spread.offsets.size for spread in spreads if spread is not None)
    widened, places, mirrored, weights, n_before = [], [], [], [], 0
    for case, spread in zip(cases, spreads, strict=True):
        offsets, of_case = np.zeros(n_steps), np.zeros((n_steps, case.frequency.size), dtype=np.complex128)
        of_case[0] = 1.0
        if spread is not None:
            offsets[: spread.offsets.size], of_case[: spread.offsets.size] = spread.offsets, spread.weights
        neighbours = case.frequency + offsets[:, None]
        wanted = np.maximum(np.abs(neighbours), _LEAST_SHARE * case.frequency)
        frequency, place = np.unique(np.asarray(np.round(wanted, _DECIMALS), dtype=np.float64), return_inverse=True)
        widened.append(replace(case, frequency=frequency))
        places.append(place.reshape(wanted.shape) + n_before)
        mirrored.append(neighbours < 0.0)
        weights.append(of_case * _of_recorded(case.response, wanted / case.frequency))
        n_before += frequency.size
    return Smearing(
        prepare_lines(widened),
        place=np.concatenate(places, axis=1),
        mirrored=np.concatenate(mirrored, axis=1),
        weights=np.concatenate(weights, axis=1),
    )


def _of_recorded(point: ResponsePoint, ratio: FloatArray) -> FloatArray:
    """Return the weight of a neighbouring acceleration in the quotient by the line's frequency, by their ratio."""
    return np.ones_like(ratio) if point.is_acceleration else np.asarray(ratio**2)
