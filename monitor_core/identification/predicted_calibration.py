"""Predict a calibration from identified joints, for an axis whose nut was never adjusted."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.identification.feature_prediction import MonitoredMode, predict_coefficients
from monitor_core.models.protocol import DriveModel, MotorEnd
from monitor_core.preload import Calibration, CoefficientPrior, ValidRange, calibration_from_prior
from monitor_core.recording import ExcitationSource
from monitor_core.uncertainty import Estimate, VectorEstimate

#: Preloads that the prediction is made for, as parts of the preload that the joints were identified at.
PRELOADS = (0.4, 0.6, 0.8, 1.0, 1.2)
N_POSITIONS = 5


@dataclass(frozen=True, slots=True)
class PredictionRequest:
    """Which mode will be monitored, how, and the preload that the identified nut had."""

    band: tuple[float, float]  # holds the mode alone wherever it is monitored [Hz]
    preload: Estimate  # [N]
    scatter: float  # standard deviation between measurements of one setting [Hz]
    excitation_source: ExcitationSource = ExcitationSource.SENSOR


def predicted_calibration(
    request: PredictionRequest,
    model_at: Callable[[FloatArray], DriveModel],
    coordinates: VectorEstimate,
    positions: tuple[float, float],
) -> Calibration:
    """Return the calibration that a preload is estimated with, or that is joined with readings as a prior.

    ``positions`` are the first and the last that the axis was identified at [m]. Raises OutsideValidityError or
    NotIdentifiableError if the band does not hold exactly one mode everywhere, or the prediction says nothing of the
    preload.
    """
    preloads = tuple(share * request.preload.value for share in PRELOADS)
    measured = request.excitation_source is ExcitationSource.SENSOR
    mode = MonitoredMode(
        request.band,
        tuple(np.linspace(*positions, N_POSITIONS).tolist()),
        preloads,
        MotorEnd.PRESCRIBED if measured else MotorEnd.FREE,
    )
    follows = getattr(model_at(coordinates.values).parameters, "dynamic_load_rating", None) is not None
    predicted = predict_coefficients(model_at, coordinates, mode, None if follows else request.preload)
    prior = CoefficientPrior(
        predicted.coefficients,
        math.hypot(predicted.form_misfit, request.scatter),
        ValidRange(*positions),
        ValidRange(preloads[0], preloads[-1]),
        f"joints identified at {request.preload.value:g} N",
        excitation_source=request.excitation_source,
    )
    return calibration_from_prior(prior)
