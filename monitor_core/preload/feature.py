"""Compute the preload feature: the axial natural frequency with the table position removed (ISO 13374: HA).

One relation read in three directions: frequency → feature → preload, and back to the frequency a preload would give.
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
    r"""Remove the table position from the axial natural frequency.

    .. math::

        \frac{1}{P^2} = \frac{1}{f_{ax}^2} - k_1 x^2 - k_2 x - k_4 = \frac{k_3}{\sqrt[3]{\mathrm{preload}}}

    Eq. (8) of Nguyen et al. (2018). What is left depends on the preload alone.

    ``axial_frequency``: first axial natural frequency :math:`f_{ax}` [Hz], shape (n_windows,); ``position``: table
    position :math:`x` from the fixed bearing [m], shape (n_windows,); ``coefficients``: from
    :func:`monitor_core.preload.calibrate`. Returned: :math:`1/P^2`; it falls as the preload rises. Not positive
    where the frequency is above what any preload gives [s²], shape (n_windows,). ``OutsideValidityError`` if a
    frequency is not positive.

    Notes
    -----
    The paper writes :math:`P` for this feature and, in Eq. (1), for the preload itself; here the force is always
    ``preload``. It calls :math:`P^2` "proportional to the preload level"; by its own Eq. (8) :math:`P^2` grows with
    the cube root of it (``docs/reference/errata.md``). Eq. (1) is stated for preloads up to 10 % of the dynamic
    load rating.

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
