"""Lead a frequency step by step to its preload: what position, payload, temperature and friction make of 1/f²."""

from dataclasses import dataclass

from monitor_core.preload.calibration import Calibration
from monitor_core.preload.feature import position_part, preload_from_feature
from monitor_core.preload.influence import payload_factor
from monitor_core.recording import Conditions


@dataclass(frozen=True, slots=True)
class PreloadLadder:
    r"""The terms between a frequency and its preload.

    .. math:: g = \frac{1}{f^2} - \text{payload} - \text{temperature} - k_1 x^2 - k_2 x - k_4 - \text{friction},
        \qquad \mathrm{preload} = (k_3 / g)^3

    Eq. (8) of Nguyen et al. (2018), with the corrections of :mod:`monitor_core.preload.influence` before it.
    """

    frequency: float  # [Hz]
    inverse_square: float  # 1/f² as measured [s²]
    payload: float  # what a payload other than the calibration's adds to 1/f² [s²]
    temperature: float  # what a temperature other than the calibration's adds [s²]
    quadratic: float  # k1·x² [s²]
    linear: float  # k2·x [s²]
    constant: float  # k4 [s²]
    friction: float  # what friction other than the usual adds [s²]
    feature: float  # what is left: of the preload alone [s²]
    preload: float  # [N]

    @property
    def position(self) -> float:
        """What the position explains of 1/f²: k1·x² + k2·x + k4 [s²]."""
        return self.quadratic + self.linear + self.constant


def preload_ladder(
    frequency: float, conditions: Conditions, calibration: Calibration, *, feature: float | None = None
) -> PreloadLadder:
    """Return the terms between an axial natural frequency [Hz] and its preload.

    ``feature`` is the preload feature of the estimate that is explained [s²]: what it lacks to the other terms is the
    correction for friction. Without it the friction is taken as the usual. Raises ``OutsideValidityError`` where no
    preload gives the frequency.
    """
    k, x = calibration.coefficients, conditions.position
    payload_excess, temperature_excess = calibration.excess(conditions)
    inverse_square = frequency**-2.0
    factor = float(payload_factor(payload_excess, calibration.influence.inverse_moving_mass))
    payload = inverse_square - inverse_square / factor
    temperature = calibration.influence.temperature * temperature_excess
    at_usual = inverse_square - payload - temperature - float(position_part(x, k))
    left = at_usual if feature is None else feature
    return PreloadLadder(
        frequency=frequency,
        inverse_square=inverse_square,
        payload=payload,
        temperature=temperature,
        quadratic=k.k1 * x**2,
        linear=k.k2 * x,
        constant=k.k4,
        friction=at_usual - left,
        feature=left,
        preload=preload_from_feature(left, k),
    )
