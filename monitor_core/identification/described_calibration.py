r"""State what a drive model alone lets expect of k1…k4 of Eq. (8) of Nguyen et al. (2018), before anything is measured.

A model file states its parameters with relative standard deviations. Joints are known to 20 or 40 %, too badly for one
slope, so the distribution is propagated (GUM Supplement 1): each draw of the parameters is an axis, whose first elastic
natural frequency over places and preloads has its own k1…k4; their mean and covariance over the draws are the prior.
The nut follows :math:`P^{1/3}` in every draw, with the load rating of the model.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.models.extended import ExtendedModel, elastic_frequencies
from monitor_core.models.preload_share import HIGHEST_SHARE, usual_log_preload
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.preload import USUAL_SCATTER, CoefficientPrior, DriveLaw, ValidRange
from monitor_core.preload.calibration import feature_design
from monitor_core.preload.fit import BETWEEN_SESSIONS
from monitor_core.recording import ExcitationSource
from monitor_core.uncertainty import Estimate, VectorEstimate

#: Draws of the parameters, a power of two: points of Sobol, so that these few do.
_DRAWS: Final = 128
#: For the law of the position, which is wanted while a measurement is taken in.
_DRAWS_OF_LAW: Final = 64
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
    rating = _rating_of(description)
    drive = description.drive()
    low, high = travel or _travel(drive.stated)
    places, preloads = np.linspace(low, high, _PLACES), rating * np.array(_SHARES)
    settings = [DriveConditions(float(x), float(force)) for x in places for force in preloads]
    end = _motor_end(excitation_source)
    design = feature_design(np.repeat(places, preloads.size), np.tile(preloads, places.size))
    to_coefficients = np.linalg.pinv(design / (scale := np.linalg.norm(design, axis=0))) / scale[:, np.newaxis]

    drawn, misfit, mean_frequency = [], [], []
    for ratios in _drawn_ratios(description.uncertain, _draws(len(description.uncertain), _DRAWS)):
        frequency = _first_elastic(ExtendedModel(drive.stated, drive.physics(ratios)), settings, end)
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


def law_of_drive(
    description: AxisDescription, excitation_source: ExcitationSource = ExcitationSource.SENSOR
) -> DriveLaw:
    """Return what a drive model alone says of how 1/f² follows the position, of a nut that nobody measured.

    As :func:`prior_of_drive`, over all of the screw but a tenth at each end, each draw with a preload of its own.
    How badly a quadratic fits a draw joins the covariance, as scatter of the places that it is fitted to.
    """
    usual = usual_log_preload(_rating_of(description))
    drive, n = description.drive(), len(description.uncertain)
    places = np.linspace(*_travel(drive.stated), _PLACES)
    design = np.vander(places, 3, increasing=True)
    to_coefficients = np.linalg.pinv(design)
    drawn, end = _draws(n + 1, _DRAWS_OF_LAW), _motor_end(excitation_source)
    laws, misfit = [], []
    for ratios, quantile in zip(_drawn_ratios(description.uncertain, drawn[:, :n]), drawn[:, n].tolist(), strict=True):
        preload = math.exp(usual.value + math.sqrt(12.0) * (quantile - 0.5) * usual.standard_uncertainty)
        settings = [DriveConditions(float(x), preload) for x in places]
        model = ExtendedModel(drive.stated, drive.physics(ratios))
        level = _first_elastic(model, settings, end) ** -2.0
        laws.append(to_coefficients @ level)
        misfit.append(np.sum((level - design @ laws[-1]) ** 2) / (places.size - 3))
    covariance = np.cov(np.array(laws).T) + float(np.mean(misfit)) * to_coefficients @ to_coefficients.T
    return DriveLaw(tuple(np.mean(laws, axis=0).tolist()), tuple(covariance.ravel().tolist()))


def usual_preload_of(description: AxisDescription) -> Estimate:
    """Return ln(preload/N) of a nut that nobody measured: slightly to tightly preloaded, each as likely.

    ``OutsideValidityError`` where the model states no load rating, or no tolerance.
    """
    return usual_log_preload(_rating_of(description))


def _rating_of(description: AxisDescription) -> float:
    rating = description.parameters.get("dynamic_load_rating_n")
    if rating is None or not description.uncertain:
        missing = "dynamic_load_rating_n" if rating is None else "[uncertain]"
        raise OutsideValidityError(
            "a calibration of a drive model needs the load rating, by which the nut follows its preload, and how well "
            f"the parameters are known; expected {missing} in the model; got none"
        )
    return rating


def _travel(stated: object) -> tuple[float, float]:
    length = float(getattr(stated, "screw_length"))  # noqa: B009  # each family has its own record
    return _MARGIN * length, (1.0 - _MARGIN) * length


def _motor_end(excitation_source: ExcitationSource) -> MotorEnd:
    return MotorEnd.PRESCRIBED if excitation_source is ExcitationSource.SENSOR else MotorEnd.FREE


def _first_elastic(model: ExtendedModel, settings: Sequence[DriveConditions], end: MotorEnd) -> FloatArray:
    """Return the first elastic frequency in each setting [Hz]."""
    elastic = elastic_frequencies(model, list(settings), end)
    if not all(each.size for each in elastic):
        raise OutsideValidityError("a drive of these tolerances must have an elastic mode everywhere; got none")
    return np.array([each[0] for each in elastic])


def _draws(dimensions: int, n: int) -> FloatArray:
    points: FloatArray = scipy.stats.qmc.Sobol(dimensions, rng=1).random(n)  # scrambled: no point at 0
    return points


def _drawn_ratios(uncertain: Mapping[str, float], points: FloatArray) -> list[dict[str, float]]:
    """Return ln(drawn/stated) of each parameter: lognormal, so that a stiffness stays one."""
    normal: FloatArray = scipy.special.ndtri(points)
    spread = np.sqrt(np.log1p(np.square(list(uncertain.values()))))
    return [dict(zip(uncertain, row.tolist(), strict=True)) for row in normal * spread]
