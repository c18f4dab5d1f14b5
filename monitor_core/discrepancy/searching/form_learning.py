"""The form error of a model, learnt from machines on which nothing is missing."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.comparing.model_form import FormSpectrum, ModelFormError
from monitor_core.discrepancy.comparing.responses import compare_responses
from monitor_core.discrepancy.hypothesis import Hypothesis
from monitor_core.discrepancy.searching.fit import fit
from monitor_core.discrepancy.subject import Subject
from monitor_core.errors import NotIdentifiableError
from monitor_core.identification.observations import FrequencyResponseObservation
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.protocol import ResponsePoint

_BANDS = 12  # logarithmic, over all lines
#: No model is counted on to be better than that: its errors are alike at every setting, and many lines of many settings
#: would make a finding of the smallest of them. [-]
_LEAST = 5e-4
_FREQUENCY_TOLERANCE = 5e-5  # [-]

Machine = tuple[Sequence[FrequencyResponseObservation], Subject[AxisPhysics]]


def learn_form_error(healthy: Sequence[Machine]) -> ModelFormError:
    """Return what a model leaves of healthy machines beyond the noise of their measurements.

    Each machine's uncertain parameters are adjusted first. What is left, less the noise, is averaged in bands.

    Parameters
    ----------
    healthy : sequence of (observations, subject)
        Machines of one kind that their description fits, with the responses measured on them.

    Raises
    ------
    NotIdentifiableError
        If there is no machine.
    """
    if not healthy:
        raise NotIdentifiableError("a form error is learnt from at least one healthy machine; got none")
    lines: dict[ResponsePoint, list[FloatArray]] = {}
    for observations, subject in healthy:
        for point, found in _excess(observations, subject).items():
            lines.setdefault(point, []).append(found)
    return ModelFormError({point: _spectrum(np.concatenate(found, axis=1)) for point, found in lines.items()})


def _excess(
    observations: Sequence[FrequencyResponseObservation], subject: Subject[AxisPhysics]
) -> dict[ResponsePoint, FloatArray]:
    """Return frequency, and square of what is left less that of the noise, of every value, shape (2, n_values)."""
    comparison = compare_responses(observations)
    # what settings share is what is sought here: it must not be taken out
    comparison = replace(comparison, layout=replace(comparison.layout, common=None))
    hypothesis = Hypothesis(subject)
    fitted = fit(comparison, hypothesis, hypothesis.null)
    layout = comparison.layout
    left = fitted.standardised * layout.standard_deviation
    square = left**2 - comparison.noise**2
    points = [ResponsePoint(name.split(",")[0]) for name in layout.channels]
    return {
        point: np.array([layout.frequency[at], square[at]])
        for point in dict.fromkeys(points)
        if np.any(at := np.array([points[channel] is point for channel in layout.channel]))
    }


def _spectrum(lines: FloatArray) -> FormSpectrum:
    frequency, square = lines
    edges = np.geomspace(np.min(frequency), np.max(frequency) * (1.0 + 1e-9), _BANDS + 1)
    band = np.searchsorted(edges, frequency, side="right") - 1
    knots, found = [], []
    for number in np.unique(band):
        at = band == number
        knots.append(float(np.exp(np.mean(np.log(frequency[at])))))
        found.append(float(np.sqrt(max(np.mean(square[at]), 0.0))))
    deviation = tuple(max(one, _LEAST) for one in found)
    return FormSpectrum(tuple(knots), deviation, _FREQUENCY_TOLERANCE, learnt=True)
