"""Learn the form error of a model from machines on which nothing is missing."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.model_form import FormSpectrum, ModelFormError, steepness
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.protocol import ResponsePoint

_BANDS = 12  # logarithmic, over all lines
#: No model is counted on to be better than that: its errors are alike at every setting, and many lines of many settings
#: would make a finding of the smallest of them. [-]
_LEAST = 5e-4
_LEAST_TOLERANCE = 5e-5  # of frequencies [-]

Machine = tuple[Sequence[FrequencyResponseObservation], DescribedAxis[AxisPhysics]]


def learn_form_error(healthy: Sequence[Machine]) -> ModelFormError:
    """Return what a model leaves of healthy machines of one kind beyond the noise of their measurements.

    Each machine's uncertain parameters are adjusted first. In bands, the square of what is left, less that of the
    noise, is put down to a constant and to the square of the steepness, neither below zero, by weighted least squares.
    Raises NotIdentifiableError if there is no machine.
    """
    if not healthy:
        raise NotIdentifiableError("a form error is learnt from at least one healthy machine; got none")
    lines: dict[ResponsePoint, list[FloatArray]] = {}
    for observations, axis in healthy:
        for point, excess in _excess(observations, axis).items():
            lines.setdefault(point, []).append(excess)
    return ModelFormError({point: _spectrum(np.concatenate(excess, axis=1)) for point, excess in lines.items()})


def _excess(
    observations: Sequence[FrequencyResponseObservation], axis: DescribedAxis[AxisPhysics]
) -> dict[ResponsePoint, FloatArray]:
    """Return of every value the columns of :func:`_spectrum`, shape (4, n_values)."""
    comparison = compare_responses(observations)
    # what settings share is what is sought here: it must not be taken out
    comparison = replace(comparison, layout=replace(comparison.layout, common=None))
    hypothesis = Hypothesis(axis)
    fitted = fit(comparison, hypothesis, hypothesis.null)
    layout = comparison.layout
    left = fitted.standardised * layout.standard_deviation
    # of the model: what a measurement is off by would show in its own steepness
    response = np.exp(comparison.shifted(fitted.around.errors).log_responses(fitted.physics()))
    steep = np.zeros(response.size)
    for number in range(len(comparison.titles)):
        chosen = comparison.response_of_line == number
        steep[chosen] = steepness(comparison.lines.omega[chosen] / (2.0 * np.pi), response[chosen])
    columns = np.array([layout.frequency, steep[comparison.line_of_value], left, comparison.noise])
    points = [ResponsePoint(name.split(",")[0]) for name in layout.channels]
    return {
        point: columns[:, chosen]
        for point in dict.fromkeys(points)
        if np.any(chosen := np.array([points[channel] is point for channel in layout.channel]))
    }


def _spectrum(values: FloatArray) -> FormSpectrum:
    """Return the spectrum by frequency, steepness, what is left, and the noise, shape (4, n_values)."""
    frequency, steep, left, noise = values
    edges = np.geomspace(np.min(frequency), np.max(frequency) * (1.0 + 1e-9), _BANDS + 1)
    band = np.searchsorted(edges, frequency, side="right") - 1
    knots, deviations = [], []
    for number in np.unique(band):
        in_band = band == number
        knots.append(float(np.exp(np.mean(np.log(frequency[in_band])))))
        weight = 1.0 / (noise[in_band] ** 2 + _LEAST**2)
        design = np.column_stack([np.ones(weight.size), steep[in_band] ** 2])
        deviations.append(
            scipy.optimize.nnls(design * weight[:, None], (left[in_band] ** 2 - noise[in_band] ** 2) * weight)[0]
        )
    deviation, tolerance = np.maximum(np.sqrt(deviations), [_LEAST, _LEAST_TOLERANCE]).T.tolist()
    return FormSpectrum(tuple(knots), tuple(deviation), tuple(tolerance), learnt=True)
