"""Correct 1/f² for payload and temperature, the influence quantities of the axial frequency.

A mass m on the table lowers the frequency as 1/√(M + m) (Eq. (6) of Nguyen et al., 2018, with M the mass that moves),
so 1/f² is *multiplied* by 1 + m/M. A temperature changes the compliances behind Eq. (8) a little; to first order a
multiple of its deviation is *added* to 1/f². Both are read relative to the conditions of the calibration::

    1/f² = (1 + µ·Δm)·(Eq. (8) + k_T·ΔT),     µ = 1/(M + reference payload)

µ and k_T are common to all measurements: their errors are systematic and never average out. Only the part that
multiplies the measured 1/f² is random from one measurement to the next.
"""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError

#: Temperatures that differ by less are taken as equal [K]. Steel loses about 0.03 % of its modulus per kelvin, hence
#: 0.015 % of the frequency: 3 K stay below 0.05 %, some 8 N at 300 N on the axis of Nguyen et al.
TEMPERATURE_RESOLUTION = 3.0
#: Standard uncertainty of k_T relative to 1/f² where a calibration has seen one temperature only [1/K]: the modulus of
#: steel changes by about 3e-4 per kelvin, and joints and preload change with it in either direction.
UNKNOWN_TEMPERATURE_COEFFICIENT = 3e-4


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
