r"""State what a drive model alone lets expect of k1…k4 of Eq. (8) of Nguyen et al. (2018), before anything is measured.

A model file states its parameters with relative standard deviations. Joints are known to 20 or 40 %, too badly for one
slope, so the distribution is propagated (GUM Supplement 1): each draw of the parameters is an axis, whose first elastic
natural frequency over places and preloads has its own k1…k4; their mean and covariance over the draws are the prior.
The nut follows :math:`P^{1/3}` in every draw, with the load rating of the model.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.models.extended import ExtendedModel, elastic_frequencies
from monitor_core.models.preload_share import HIGHEST_SHARE, usual_log_preload
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.preload import USUAL_SCATTER, CoefficientPrior, ValidRange
from monitor_core.preload.calibration import feature_design
from monitor_core.preload.fit import BETWEEN_SESSIONS
from monitor_core.recording import ExcitationSource
from monitor_core.uncertainty import Estimate, VectorEstimate

#: Draws of the parameters, a power of two: points of Sobol, so that these few do.
_DRAWS: Final = 128
#: Part of the screw that a table can be near its ends, and places in between.
_MARGIN, _PLACES = 0.1, 5
#: Preloads over the dynamic load rating that are asked for [-].
_SHARES: Final = (0.02, 0.05, HIGHEST_SHARE)


def prior_of_drive(
    description: AxisDescription,
    excitation_source: ExcitationSource = ExcitationSource.SENSOR,
    travel: tuple[float, float] | None = None,
) -> CoefficientPrior:
    """Return what a drive model alone says of k1…k4, with the covariance that its tolerances leave.

    Parameters
    ----------
    description : AxisDescription
        Of a drive whose nut follows its preload, with the tolerances of its parameters (``uncertain``).
    excitation_source : ExcitationSource
        How the torque is measured when the axis is monitored: it says how the motor end is held.
    travel : tuple of float, optional
        First and last place of the table [m]; without it all of the screw but a tenth at each end.

    Returns
    -------
    CoefficientPrior
        For no payload, from 2 to 10 % of the load rating. What the model leaves out is not in its covariance.

    Raises
    ------
    OutsideValidityError
        If the model states no load rating or no tolerance, or has no elastic mode somewhere.
    """
    rating = description.parameters.get("dynamic_load_rating_n")
    if rating is None or not description.uncertain:
        missing = "dynamic_load_rating_n" if rating is None else "[uncertain]"
        raise OutsideValidityError(
            "a calibration of a drive model needs the load rating, by which the nut follows its preload, and how well "
            f"the parameters are known; expected {missing} in the model; got none"
        )
    drive = description.drive()
    length = float(getattr(drive.stated, "screw_length"))  # noqa: B009  # each family has its own record
    low, high = travel or (_MARGIN * length, (1.0 - _MARGIN) * length)
    places, preloads = np.linspace(low, high, _PLACES), rating * np.array(_SHARES)
    settings = [DriveConditions(float(x), float(force)) for x in places for force in preloads]
    end = MotorEnd.PRESCRIBED if excitation_source is ExcitationSource.SENSOR else MotorEnd.FREE
    design = feature_design(np.repeat(places, preloads.size), np.tile(preloads, places.size))
    to_coefficients = np.linalg.pinv(design / (scale := np.linalg.norm(design, axis=0))) / scale[:, np.newaxis]

    drawn, misfit, mean_frequency = [], [], []
    for ratios in _drawn_ratios(description.uncertain):
        elastic = elastic_frequencies(ExtendedModel(drive.stated, drive.physics(ratios)), settings, end)
        if not all(each.size for each in elastic):
            raise OutsideValidityError("a drive of these tolerances must have an elastic mode everywhere; got none")
        frequency = np.array([each[0] for each in elastic])
        k = to_coefficients @ frequency**-2.0
        drawn.append(k)
        misfit.append(np.sum((frequency - (design @ k) ** -0.5) ** 2) / (frequency.size - k.size))
        mean_frequency.append(frequency.mean())
    return CoefficientPrior(
        VectorEstimate(np.mean(drawn, axis=0), np.cov(np.array(drawn).T)),
        math.hypot(USUAL_SCATTER * float(np.mean(mean_frequency)), math.sqrt(float(np.mean(misfit)))),
        ValidRange(low, high),
        ValidRange(float(preloads[0]), float(preloads[-1])),
        "the drive model",
        excitation_source=excitation_source,
        between_sessions=BETWEEN_SESSIONS,
    )


def usual_preload_of(description: AxisDescription) -> Estimate:
    """Return ln(preload/N) of a nut that nobody measured: slightly to tightly preloaded, each as likely.

    ``OutsideValidityError`` where the model states no load rating.
    """
    rating = description.parameters.get("dynamic_load_rating_n")
    if rating is None:
        raise OutsideValidityError("the usual preload follows from dynamic_load_rating_n of the model; got none")
    return usual_log_preload(rating)


def _drawn_ratios(uncertain: Mapping[str, float]) -> list[dict[str, float]]:
    """Return ln(drawn/stated) of each parameter: lognormal, so that a stiffness stays one."""
    sobol = scipy.stats.qmc.Sobol(len(uncertain), rng=1)  # scrambled: no point at 0
    normal: FloatArray = scipy.special.ndtri(sobol.random(_DRAWS))
    spread = np.sqrt(np.log1p(np.square(list(uncertain.values()))))
    return [dict(zip(uncertain, row.tolist(), strict=True)) for row in normal * spread]
