"""Compute the preload feature: 1/f² of the axial mode with position, payload and temperature removed (ISO 13374: HA).

One relation read in three directions: frequency → feature → preload, and back to the frequency a preload would give.

A mass m on the table lowers the frequency as 1/√(M + m) (Eq. (6) of Nguyen et al., 2018, with M the mass that moves),
so 1/f² is *multiplied* by 1 + m/M. A temperature changes the compliances behind Eq. (8) a little; to first order a
multiple of its deviation is *added* to 1/f². Both are read relative to the conditions of the calibration::

    1/f² = (1 + µ·Δm)·(Eq. (8) + k_T·ΔT),     µ = 1/(M + reference payload)

µ and k_T are common to all measurements: their errors are systematic and never average out. Only the part that
multiplies the measured 1/f² is random from one measurement to the next.
"""

from dataclasses import dataclass
from typing import overload

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError


@dataclass(frozen=True, slots=True)
class PreloadFeatureCoefficients:
    """Coefficients of Eq. (8) of Nguyen et al. (2018), in SI units. Positions count from the fixed bearing."""

    k1: float  # of x² [s²/m²]
    k2: float  # of x [s²/m]
    k3: float  # of preload^(−1/3) [s²·N^(1/3)]
    k4: float  # constant [s²]

    def __post_init__(self) -> None:
        if not self.k3 > 0.0:
            raise OutsideValidityError(f"k3 must be positive (frequency rises with preload); got {self.k3} s²·N^(1/3)")


def _positive(name: str, values: float | FloatArray, unit: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if not np.all((array > 0.0) & np.isfinite(array)):
        raise OutsideValidityError(f"{name} must be positive and finite; got {values} {unit}")
    return array


def _like_given(values: FloatArray) -> float | FloatArray:
    """Return a scalar for scalars."""
    return values if values.ndim else float(values)


def position_part(position: float | FloatArray, k: PreloadFeatureCoefficients) -> FloatArray:
    """Return k1·x² + k2·x + k4 [s²], the part of Eq. (8) that the table position [m] explains."""
    x = np.asarray(position, dtype=np.float64)
    return k.k1 * x**2 + k.k2 * x + k.k4


@overload
def preload_feature(axial_frequency: float, position: float, coefficients: PreloadFeatureCoefficients) -> float: ...
@overload
def preload_feature(
    axial_frequency: FloatArray, position: float | FloatArray, coefficients: PreloadFeatureCoefficients
) -> FloatArray: ...
def preload_feature(
    axial_frequency: float | FloatArray, position: float | FloatArray, coefficients: PreloadFeatureCoefficients
) -> float | FloatArray:
    r"""Remove the table position from the axial natural frequency [Hz], which leaves the feature :math:`1/P^2` [s²].

    .. math:: \frac{1}{P^2} = \frac{1}{f_{ax}^2} - k_1 x^2 - k_2 x - k_4 = \frac{k_3}{\sqrt[3]{\mathrm{preload}}}

    Eq. (8) of Nguyen et al. (2018). What is left depends on the preload alone, and falls as it rises; it is not
    positive where the frequency is above what any preload gives. The position [m] is counted from the fixed bearing,
    the coefficients come from :func:`monitor_core.preload.calibrate`. A measurement at another payload or temperature
    is brought to the reference ones first (:func:`monitor_core.preload.estimate_preload`). ``OutsideValidityError`` if
    a frequency is not positive.

    The paper writes :math:`P` for this feature and, in Eq. (1), for the preload itself; here the force is always
    ``preload``. It calls :math:`P^2` "proportional to the preload level"; by its own Eq. (8) :math:`P^2` grows with the
    cube root of it (``docs/reference/errata.md``). Eq. (1) is stated for preloads up to 10 % of the dynamic load
    rating.

    Examples
    --------
    Table 2 of Nguyen et al. (2018), 100 N at 500 mm, with the regressed k of Table 3:

    >>> k = PreloadFeatureCoefficients(-4872e-8, 5561e-8, 2097e-8, 1228e-8)
    >>> round(preload_feature(176.052, 0.500, k) * 1e6, 3)
    4.359
    """
    inverse_square = 1.0 / _positive("axial_frequency", axial_frequency, "Hz") ** 2
    return _like_given(inverse_square - position_part(position, coefficients))


@overload
def preload_from_feature(feature: float, coefficients: PreloadFeatureCoefficients) -> float: ...
@overload
def preload_from_feature(feature: FloatArray, coefficients: PreloadFeatureCoefficients) -> FloatArray: ...
def preload_from_feature(feature: float | FloatArray, coefficients: PreloadFeatureCoefficients) -> float | FloatArray:
    r"""Read the preload in newtons from its feature, :math:`(k_3 P^2)^3`: Eq. (8) of Nguyen et al. (2018), solved.

    Feature [s²] and coefficients are of one calibration. A feature that is not positive raises
    ``OutsideValidityError``: no preload, however high, gives that frequency.

    Examples
    --------
    The feature of the example above; Table 2 was taken at 100 N (the printed k miss it, see
    ``docs/reference/errata.md``):

    >>> k = PreloadFeatureCoefficients(-4872e-8, 5561e-8, 2097e-8, 1228e-8)
    >>> round(preload_from_feature(4.359e-6, k), 1)
    111.3
    """
    return _like_given((coefficients.k3 / _positive("feature", feature, "s²")) ** 3)


@overload
def axial_frequency(position: float, preload: float, coefficients: PreloadFeatureCoefficients) -> float: ...
@overload
def axial_frequency(
    position: FloatArray, preload: float | FloatArray, coefficients: PreloadFeatureCoefficients
) -> FloatArray: ...
@overload
def axial_frequency(position: float, preload: FloatArray, coefficients: PreloadFeatureCoefficients) -> FloatArray: ...
def axial_frequency(
    position: float | FloatArray, preload: float | FloatArray, coefficients: PreloadFeatureCoefficients
) -> float | FloatArray:
    r"""Predict the axial natural frequency in hertz of a preload [N] at a table position [m].

    :math:`f_{ax} = (k_1 x^2 + k_2 x + k_3\,\mathrm{preload}^{-1/3} + k_4)^{-1/2}`, Eq. (8) of Nguyen et al. (2018).
    A preload that is not positive, or a position where the polynomial falls below zero, raise ``OutsideValidityError``.

    Examples
    --------
    Least squares on Table 2 of the paper; measured at 200 N and 500 mm were 178.724 Hz:

    >>> k = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
    >>> round(axial_frequency(0.500, 200.0, k), 1)
    178.4
    """
    theta = np.cbrt(1.0 / _positive("preload", preload, "N"))
    inverse_square = position_part(position, coefficients) + coefficients.k3 * theta
    return _like_given(_positive("1/f² (Eq. 8)", inverse_square, "s²") ** -0.5)


def preload_sensitivity(axial_frequency: float, preload: float, coefficients: PreloadFeatureCoefficients) -> float:
    r"""Tell how many newtons of preload one hertz stands for, at a frequency [Hz] and its preload [N], both positive.

    .. math:: \frac{d\,\mathrm{preload}}{d f_{ax}} = \frac{6\,\mathrm{preload}^{4/3}}{k_3 f_{ax}^3}

    Derivative of Eq. (8) of Nguyen et al. (2018).

    Examples
    --------
    Table 2 of the paper, 100 N at 500 mm: about 27 N/Hz.

    >>> k = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
    >>> round(preload_sensitivity(176.052, 100.0, k), 1)
    26.6
    """
    f = _positive("axial_frequency", axial_frequency, "Hz")
    p = _positive("preload", preload, "N")
    return float(6.0 * p ** (4.0 / 3.0) / (coefficients.k3 * f**3))


#: Temperatures that differ by less are taken as equal [K]. Steel loses about 0.03 % of its modulus per kelvin, hence
#: 0.015 % of the frequency: 3 K stay below 0.05 %, some 8 N at 300 N on the axis of Nguyen et al.
TEMPERATURE_RESOLUTION = 3.0
#: Standard uncertainty of k_T relative to 1/f² where a calibration has seen one temperature only [1/K]: the modulus of
#: steel changes by about 3e-4 per kelvin, and joints and preload change with it in either direction.
UNKNOWN_TEMPERATURE_COEFFICIENT = 3e-4
#: What friction as large as the usual takes off 1/f², relative, before a calibration tells: the springs of what is not
#: yet sliding against those of screw and nut (declared; the standard uncertainty is as large as the value).
USUAL_FRICTION_SHARE = 0.005


@dataclass(frozen=True, slots=True)
class InfluenceCoefficients:
    """What payload and temperature do to 1/f²; zero where an influence is not known and not corrected."""

    inverse_moving_mass: float = 0.0  # µ, of the mass that moves at the reference payload [1/kg]
    temperature: float = 0.0  # k_T [s²/K]


@dataclass(frozen=True, slots=True)
class InfluenceSensitivities:
    """Derivatives of 1/f² at the reference conditions: with respect to 1/f² as measured, to µ and to k_T."""

    inverse_square: FloatArray  # [-]
    inverse_moving_mass: FloatArray  # [s²·kg]
    temperature: FloatArray  # [K]


def payload_factor(payload_excess: float | FloatArray, inverse_moving_mass: float) -> FloatArray:
    """Return 1 + µ·Δm, the factor by which a payload Δm above that of the reference [kg] multiplies 1/f².

    Eq. (6) of Nguyen et al. (2018): f is proportional to the inverse root of the mass 1/µ [kg] that moves at the
    reference payload. ``OutsideValidityError`` if the mass taken away is not less than it.

    Examples
    --------
    The axis of Nguyen et al. moves 23.864 kg (Table 1); 1 kg more lowers its frequency by 2.03 %:

    >>> round(float(1.0 - payload_factor(1.0, 1.0 / 23.864) ** -0.5), 4)
    0.0203
    """
    factor = 1.0 + inverse_moving_mass * np.asarray(payload_excess, dtype=np.float64)
    if not np.all(factor > 0.0):
        raise OutsideValidityError(
            f"payload must stay above the reference minus the moving mass; got an excess of {payload_excess} kg "
            f"at µ = {inverse_moving_mass} 1/kg"
        )
    return factor


def to_reference(
    inverse_square: float | FloatArray,
    payload_excess: float | FloatArray,
    temperature_excess: float | FloatArray,
    influence: InfluenceCoefficients,
) -> FloatArray:
    """Correct a measured 1/f² [s²] for payload [kg] and temperature [K] above the calibration's, shape (n_windows,).

    ``OutsideValidityError`` as of :func:`payload_factor`.
    """
    factor = payload_factor(payload_excess, influence.inverse_moving_mass)
    return inverse_square / factor - influence.temperature * np.asarray(temperature_excess, dtype=np.float64)


def from_reference(
    inverse_square: float | FloatArray,
    payload_excess: float | FloatArray,
    temperature_excess: float | FloatArray,
    influence: InfluenceCoefficients,
) -> FloatArray:
    """Undo :func:`to_reference`: 1/f² [s²] as it will be measured under a payload [kg] and at a temperature [K]."""
    factor = payload_factor(payload_excess, influence.inverse_moving_mass)
    return factor * (inverse_square + influence.temperature * np.asarray(temperature_excess, dtype=np.float64))


def correction_sensitivities(
    inverse_square: float | FloatArray,
    payload_excess: float | FloatArray,
    temperature_excess: float | FloatArray,
    influence: InfluenceCoefficients,
) -> InfluenceSensitivities:
    """Differentiate :func:`to_reference`; its arguments, and shapes like theirs.

    The first derivative carries the random error of a measurement, the other two the systematic ones.
    """
    factor = payload_factor(payload_excess, influence.inverse_moving_mass)
    return InfluenceSensitivities(
        inverse_square=1.0 / factor,
        inverse_moving_mass=-np.asarray(inverse_square * payload_excess) / factor**2,
        temperature=-np.asarray(temperature_excess, dtype=np.float64),
    )
