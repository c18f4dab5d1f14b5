"""Verify a calibration (VIM 2.44): at both ends of its own ranges it gives a preload back, with what is uncertain.

A calibration that was fitted does. One from a file may hold numbers of which each could be, and all together cannot.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from monitor_core.errors import MonitorCoreError, OutsideValidityError
from monitor_core.preload.calibration import Calibration, expected_band, expected_frequency, minimum_detectable_loss
from monitor_core.preload.estimate import estimate_preload
from monitor_core.recording import Conditions, Rejection
from monitor_core.uncertainty import Estimate

#: By so much the preload that is given back may differ from the one that the frequency was predicted for [-].
_ROUNDING = 1e-6
#: Of a witness over what is expected of it: a difference that contradicts no calibration [-].
_OFF = 1.05


def verify_calibration(calibration: Calibration) -> None:
    """Raise ``OutsideValidityError`` where a calibration does not answer at the ends of its calibrated ranges.

    An answer is the preload itself, a positive standard uncertainty and a finite minimum detectable loss.
    """
    for conditions, preload, off in _ends(calibration):
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                got = _fault(calibration, conditions, preload, off)
        except MonitorCoreError as error:
            got = str(error)
        except (ArithmeticError, ValueError) as error:
            got = f"numbers that cannot be computed with ({error.args[-1]})"
        if got is not None:
            raise OutsideValidityError(
                f"expected a calibration that answers at {conditions.position * 1e3:g} mm and {preload:g} N "
                f"with this preload, a positive standard uncertainty and a finite minimum detectable loss; got {got}"
            )


def _ends(calibration: Calibration) -> Iterator[tuple[Conditions, float, float]]:
    """Yield ends of all ranges, the preload there [N], and the factor of witnesses over what is expected of them.

    Witnesses are as expected where payload and temperature are stated, and off where they are not.
    """
    payload, temperature = calibration.payload, calibration.temperature
    lower = (calibration.position.lower, payload.lower, None if temperature is None else temperature.lower)
    upper = (calibration.position.upper, payload.upper, None if temperature is None else temperature.upper)
    for position, mass, warmth in (lower, upper):
        for preload in (calibration.preload.lower, calibration.preload.upper):
            yield Conditions(position, mass, warmth, preload), preload, 1.0
            yield Conditions(position, preload=preload), preload, _OFF


def _fault(calibration: Calibration, stated: Conditions, preload: float, off: float) -> str | None:
    """Return what is wrong with the answer under stated conditions; ``None`` if nothing is."""
    frequency = Estimate(expected_frequency(calibration, stated), 0.0)
    setting = calibration.setting(stated, preload)
    witnesses = {witness.name: off * witness.expected(setting) for witness in calibration.witnesses}
    estimate = estimate_preload(frequency, replace(stated, preload=None), calibration, witnesses=witnesses)
    if isinstance(estimate, Rejection):
        return estimate.detail
    if off == 1.0 and not math.isclose(estimate.preload, preload, rel_tol=_ROUNDING):
        return f"a preload of {estimate.preload:g} N"
    if not 0.0 < estimate.feature.standard_uncertainty < math.inf:
        return f"a standard uncertainty of {estimate.feature.standard_uncertainty:g} s² of the preload feature"
    band = expected_band(calibration, stated)
    derived = (
        minimum_detectable_loss(calibration, preload, stated.position),
        *band,
        0.0 if calibration.moving_mass is None else calibration.moving_mass.value,
    )
    sound = band[0] > 0.0 and all(map(math.isfinite, derived))
    return None if sound else f"loss [N], band of the mode [Hz] and moving mass [kg] of {derived}"
