r"""Predict a calibration from identified joints, for an axis whose nut was never adjusted.

k1…k4 of the preload feature, Eq. (8) of Nguyen et al. (2018), of an axis whose joints are known.

The model is asked for one natural frequency over the positions and preloads of interest, and Eq. (8) is fitted to
:math:`1/f^2`. How well the joints are known becomes the covariance of k1…k4; how far the model is from the form of
Eq. (8) is stated with it, in hertz.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.models.extended import ExtendedModel
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd
from monitor_core.preload import (
    USUAL_SCATTER,
    Calibration,
    CoefficientPrior,
    ExpectedReadings,
    PreloadFeatureCoefficients,
    ValidRange,
    calibration_from_prior,
)
from monitor_core.recording import ExcitationSource
from monitor_core.uncertainty import Estimate, VectorEstimate

#: Derivatives are taken over this part of the standard uncertainty of a coordinate, and over no more than that of
#: ``_LARGEST_STEP`` decades: a joint that is hardly known moves the frequency too far for one slope.
_STEP, _LARGEST_STEP = 0.1, 0.01


@dataclass(frozen=True, slots=True)
class MonitoredMode:
    """Which natural frequency is monitored, and where the axis will be measured."""

    band: tuple[float, float]  # holds this mode alone at every position and preload [Hz]
    positions: tuple[float, ...]  # three or more [m]
    preloads: tuple[float, ...]  # two or more [N]
    motor_end: MotorEnd | None = None  # None: as in the paper of the model
    payload_mass: float = 0.0  # [kg]

    def __post_init__(self) -> None:
        low, high = self.band
        if not 0.0 < low < high < math.inf:
            raise OutsideValidityError(f"the band of a mode must rise from above 0 Hz; got {low:g} to {high:g} Hz")
        if not min(self.preloads, default=1.0) > 0.0:
            raise OutsideValidityError(f"preloads must be positive; got {min(self.preloads):g} N")
        positions, preloads = len(set(self.positions)), len(set(self.preloads))
        if positions < 3 or preloads < 2:
            raise NotIdentifiableError(
                f"k1 to k4 need at least three positions and two preloads; got {positions} and {preloads}"
            )

    @property
    def settings(self) -> list[tuple[float, float]]:
        """Every position [m] with every preload [N]."""
        return [(x, force) for x in self.positions for force in self.preloads]


@dataclass(frozen=True, slots=True, eq=False)
class FeaturePrediction:
    """k1…k4 as a model has them.

    The misfit of the form is systematic: the same at a position and preload each time. Between settings it acts like a
    scatter of readings about Eq. (8), so it counts as a reproducibility beside that of the measurements; an average
    over readings of one setting does not make it smaller.
    """

    coefficients: VectorEstimate  # k1…k4, SI units
    form_misfit: float  # of the model's frequency about Eq. (8), root mean square with n − 4 [Hz]
    form_misfit_max: float  # [Hz]
    frequencies: FloatArray  # of the mode, shape (n_positions, n_preloads) [Hz]

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequencies", read_only(self.frequencies))


def mode_frequencies(model: DriveModel, mode: MonitoredMode, reference_preload: float | None = None) -> FloatArray:
    """Return the natural frequency of the mode at every position and preload, in the order of ``mode.settings`` [Hz].

    At the ``reference_preload`` :math:`P_0` [N] the nut has the rigidity of the model; it follows :math:`K_0
    (P/P_0)^{1/3}`, Eq. (1) of Nguyen et al. (2018). Without it the nut of the model must follow the preload itself.
    Raises OutsideValidityError if the band holds no natural frequency or several somewhere, or if it is not stated, or
    stated twice, how the nut follows the preload.
    """
    follows = getattr(model.parameters, "dynamic_load_rating", None) is not None
    if follows == (reference_preload is not None):
        raise OutsideValidityError(
            "the nut must follow the preload by a dynamic_load_rating_n of the model or by the preload that its "
            f"rigidity belongs to; got {'both' if follows else 'neither'}"
        )
    return np.array([_mode_frequency(model, mode, setting, reference_preload) for setting in mode.settings])


def predict_coefficients(
    model_at: Callable[[FloatArray], DriveModel],
    coordinates: VectorEstimate,
    mode: MonitoredMode,
    reference_preload: Estimate | None = None,
) -> FeaturePrediction:
    r"""Predict k1…k4 of Eq. (8) with their covariance from identified joints.

    .. math::

        k = X^{+} f^{-2}(c, P_0), \qquad
        C_k = J_c C_c J_c^T + J_P J_P^T \left( \frac{u(P_0)}{P_0} \right)^2

    with X the design of Eq. (8) of [1]_, c the coordinates, and J the derivatives of k with respect to c and :math:`\ln
    P_0`, by central differences. The covariance is linear in the coordinates: for joints known to some 20 %, which move
    a frequency by a few per cent. What the model does not hold is not in it; readings joined with the prediction are
    what tests it.

    The coordinates, shape (n_parameters,), are decimal logarithms of the identified parameters, as a fit leaves them;
    those of zero variance are known, and their degrees of freedom are those of the coefficients. The joints were
    identified under the reference preload :math:`P_0` [N]; its uncertainty makes k3 uncertain by a third of it, see
    :func:`mode_frequencies`. ``OutsideValidityError`` as there, also where a step in a coordinate takes the mode out of
    its band.

    References
    ----------
    .. [1] T. L. Nguyen et al., J. Korean Soc. Precis. Eng., 2018.
    """
    design = _feature_design(mode)
    scale = np.linalg.norm(design, axis=0)
    to_coefficients = np.linalg.pinv(design / scale) / scale[:, np.newaxis]

    def frequencies_at(coordinates: FloatArray) -> FloatArray:
        preload = None if reference_preload is None else reference_preload.value * math.exp(coordinates[-1])
        return mode_frequencies(model_at(coordinates[:n]), mode, preload)

    def coefficients_of(frequencies: FloatArray) -> FloatArray:
        return np.asarray(to_coefficients @ frequencies**-2.0)

    n = coordinates.values.size
    centre, covariance = np.append(coordinates.values, 0.0), np.zeros((n + 1, n + 1))  # the last is ln P/P_0
    covariance[:n, :n] = coordinates.covariance
    if reference_preload is not None:
        covariance[n, n] = (reference_preload.standard_uncertainty / reference_preload.value) ** 2
    jacobian = _central_differences(lambda x: coefficients_of(frequencies_at(x)), centre, np.sqrt(np.diag(covariance)))
    frequencies = frequencies_at(centre)
    values = coefficients_of(frequencies)
    misfit = frequencies - (design @ values) ** -0.5
    return FeaturePrediction(
        coefficients=VectorEstimate(values, jacobian @ covariance @ jacobian.T, coordinates.degrees_of_freedom),
        form_misfit=float(np.sqrt(np.sum(misfit**2) / (misfit.size - values.size))),
        form_misfit_max=float(np.max(np.abs(misfit))),
        frequencies=frequencies.reshape(len(mode.positions), len(mode.preloads)),
    )


def _mode_frequency(
    model: DriveModel, mode: MonitoredMode, setting: tuple[float, float], reference_preload: float | None
) -> float:
    position, preload = setting
    conditions = DriveConditions(position, preload, mode.payload_mass)
    if reference_preload is not None:
        model = _with_nut_following(model, preload / reference_preload)
        conditions = replace(conditions, preload=None)
    low, high = mode.band
    all_modes = [pole.frequency for pole in model.natural_frequencies(conditions, mode.motor_end)]
    inside = [frequency for frequency in all_modes if low <= frequency <= high]
    if len(inside) != 1:
        raise OutsideValidityError(
            f"the band of the monitored mode must hold one natural frequency everywhere; got {len(inside)} within "
            f"{low:g} and {high:g} Hz at {position * 1e3:g} mm and {preload:g} N, of "
            f"{', '.join(f'{frequency:.1f}' for frequency in all_modes)} Hz"
        )
    return inside[0]


def _with_nut_following(model: DriveModel, ratio: float) -> DriveModel:
    """Return the model with its nut under ``ratio`` times the preload; the models are records of their parameters."""
    if isinstance(model, ExtendedModel):
        joints = model.physics.joints
        followed = replace(joints, nut_stiffness=joints.nut_stiffness * ratio ** (1.0 / 3.0))
        return replace(model, physics=replace(model.physics, joints=followed))
    record = cast(Any, model)
    rigidity = record.parameters.nut_stiffness * ratio ** (1.0 / 3.0)
    return cast(DriveModel, replace(record, parameters=replace(record.parameters, nut_stiffness=rigidity)))


def _feature_design(mode: MonitoredMode) -> FloatArray:
    """Columns x², x, preload^(−1/3), 1 of Eq. (8), shape (n_settings, 4)."""
    x, preload = np.array(mode.settings).T
    return np.column_stack([x**2, x, np.cbrt(1.0 / preload), np.ones_like(x)])


def _central_differences(
    function: Callable[[FloatArray], FloatArray], centre: FloatArray, uncertainty: FloatArray
) -> FloatArray:
    """Return the derivatives of a function, shape (4, n); zero for what is known and so plays no part."""
    columns = np.zeros((4, centre.size))
    for i in np.flatnonzero(uncertainty):
        step = np.zeros_like(centre)
        step[i] = min(_STEP * uncertainty[i], _LARGEST_STEP)
        columns[:, i] = (function(centre + step) - function(centre - step)) / (2.0 * step[i])
    return columns


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


def readings_expected_of(
    model: DriveModel,
    band: tuple[float, float],
    settings: tuple[tuple[float, ...], tuple[float, ...]],
    excitation_source: ExcitationSource = ExcitationSource.SENSOR,
) -> ExpectedReadings:
    """Return what a model lets expect of readings at positions [m] and preloads [N], before anything is measured.

    They scatter as is usual, and by what the model is from the form of Eq. (8). ``OutsideValidityError`` or
    ``NotIdentifiableError`` if the band [Hz] does not hold exactly one natural frequency at each setting, or Eq. (8)
    cannot be fitted to them.
    """
    quick = model if isinstance(model, ExtendedModel) else ExtendedModel.of(model.parameters)
    measured = excitation_source is ExcitationSource.SENSOR
    mode = MonitoredMode(band, *settings, MotorEnd.PRESCRIBED if measured else MotorEnd.FREE)
    nothing = VectorEstimate(np.zeros(1), np.zeros((1, 1)))
    predicted = predict_coefficients(lambda _: quick, nothing, mode)
    k1, k2, k3, k4 = predicted.coefficients.values.tolist()
    usual = USUAL_SCATTER * float(predicted.frequencies.mean())
    return ExpectedReadings(PreloadFeatureCoefficients(k1, k2, k3, k4), math.hypot(usual, predicted.form_misfit))
