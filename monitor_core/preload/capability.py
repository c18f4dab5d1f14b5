"""Predict from a calibration alone where the mode will lie, and which loss of preload can be detected."""

import numpy as np
from scipy import special

from monitor_core.preload.calibration import Calibration
from monitor_core.preload.feature import axial_frequency, preload_from_feature
from monitor_core.preload.influence import from_reference
from monitor_core.recording import Conditions

#: The band reaches from a preload nearly lost to one a bit over the highest calibrated, by these factors.
NEARLY_LOST, OVERLOADED = 0.1, 1.5
#: What an untagged payload or temperature may shift the frequency by, relative.
BAND_MARGIN = 0.01


def expected_band(calibration: Calibration, conditions: Conditions) -> tuple[float, float]:
    """Tell between which frequencies the axial mode can be, in hertz.

    Eq. (8) of Nguyen et al. (2018) from 10 % of the lowest to 150 % of the highest calibrated preload, under the stated
    payload and temperature, widened by 1 % and four standard deviations of a reading. ``OutsideValidityError`` if it
    gives no frequency at that position (far outside the calibrated ones).

    With Table 2 of the paper (measured there from 50 to 300 N: 172.9 to 179.8 Hz), the band at 500 mm is about 157 to
    183 Hz.
    """
    payload, temperature = calibration.excess(conditions)
    preload = np.array([NEARLY_LOST * calibration.preload.lower, OVERLOADED * calibration.preload.upper])
    at_reference = axial_frequency(conditions.position, preload, calibration.coefficients) ** -2.0
    low, high = from_reference(at_reference, payload, temperature, calibration.influence) ** -0.5
    scatter = 4.0 * calibration.residual_sd
    return float(low * (1.0 - BAND_MARGIN) - scatter), float(high * (1.0 + BAND_MARGIN) + scatter)


def minimum_detectable_loss(
    calibration: Calibration,
    preload: float | None = None,  # healthy; the highest calibrated one if not given [N]
    position: float | None = None,  # if not given, the calibrated one where the loss is hardest to see [m]
    n_measurements: int = 1,  # that are averaged
) -> float:
    r"""Tell the smallest loss of preload that will be seen, in newtons.

    Seen means: starting from a healthy preload that is known from many measurements, the mean of ``n_measurements``
    lies below the one-sided 95 % prediction bound with a probability of 90 %. With s the standard deviation of a
    reading in the calibration (n − p degrees of freedom) the frequency must fall by
    :math:`(t_{.95} + t_{.90})\,s/\sqrt{n}`; Eq. (8) of Nguyen et al. (2018) turns the fall into newtons. A preload that
    is not positive raises ``OutsideValidityError``.

    With Table 2 of the paper (means of 20 readings, 0.25 Hz) at 300 N and 500 mm, 0.78 Hz at about 100 N/Hz: some 70 N.
    """
    k, dof = calibration.coefficients, calibration.parameters.degrees_of_freedom
    healthy = calibration.preload.upper if preload is None else preload
    where = np.linspace(calibration.position.lower, calibration.position.upper, 101)
    f = axial_frequency(where if position is None else np.array([position]), healthy, k)
    fall = (special.stdtrit(dof, 0.95) + special.stdtrit(dof, 0.90)) * calibration.residual_sd / np.sqrt(n_measurements)
    feature = k.k3 * np.cbrt(1.0 / healthy) + 2.0 * fall / f**3
    return float(np.max(healthy - preload_from_feature(feature, k)))
