"""Learn the baseline of a healthy axis, against which later measurements are judged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.trend.intervals import prediction_interval
from monitor_core.uncertainty import Interval

#: Critical value for the lag-1 autocorrelation, in units of 1/√m. So high (1 %) that baselines of independent
#: measurements are hardly ever widened: the stated false-alarm rate stays what it is.
_SIGNIFICANT = 2.33
#: A baseline whose measurements depend on each other more than this is a drift; its factor would have no bound.
_LARGEST_AUTOCORRELATION = 0.9


@dataclass(frozen=True, slots=True)
class Observation:
    """One accepted measurement of a trended quantity, whatever its unit.

    ``standard_uncertainty`` is the random part of its uncertainty, new in every measurement. ``systematic_uncertainty``
    is what the corrections for payload, temperature and position do not know of its difference from the baseline; 0
    under the conditions of the baseline. It is common to many later measurements, so it does not average out, and a
    change that it could explain is no evidence.
    """

    at: datetime
    value: float
    standard_uncertainty: float = 0.0
    systematic_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        if self.at.tzinfo is None:
            raise OutsideValidityError(f"at must carry a time zone; got {self.at.isoformat()}")
        if not math.isfinite(self.value):
            raise OutsideValidityError(f"value must be finite; got {self.value}")
        for name in ("standard_uncertainty", "systematic_uncertainty"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise OutsideValidityError(f"{name} must be finite and not negative; got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Baseline:
    """Mean and scatter of the first accepted measurements of an axis."""

    mean: float
    scatter: float  # standard deviation from one measurement to the next, same unit as the mean
    size: int
    degrees_of_freedom: int
    autocorrelation: float  # lag 1
    dependence: float  # widens the scatter when the autocorrelation is significant; 1 for independent measurements
    started_at: datetime
    ended_at: datetime

    def __post_init__(self) -> None:
        if not self.scatter > 0.0:
            raise OutsideValidityError(f"scatter must be positive; got {self.scatter}")

    def standardise(self, observation: Observation) -> float:
        r"""Return the residual of a later measurement in standard deviations, with its dead zone.

        .. math::

            z = \operatorname{sign}(r) \, \frac{\max(|r| - 1.96\,u_\mathrm{sys},\, 0)}
                {d\,\sqrt{\max(s, u)^2 + s^2/m}}

        with r the difference from the mean of m baseline measurements: the new measurement scatters, and so does
        the mean it is compared with. A measurement that says itself to be worse than the scatter is believed. The
        factor d is ``dependence``.
        """
        difference = observation.value - self.mean
        evidence = max(abs(difference) - 1.96 * observation.systematic_uncertainty, 0.0)
        random = max(self.scatter, observation.standard_uncertainty)
        scatter_of_difference = self.dependence * math.sqrt(random**2 + self.scatter**2 / self.size)
        return math.copysign(evidence / scatter_of_difference, difference)

    def prediction_interval(self, level: float = 0.95) -> Interval:
        r"""Predict where one more healthy measurement will lie, :math:`\bar x \pm t^* s \sqrt{1 + 1/m}`.

        For people to look at: alarms come from the charts, whose false-alarm rate is stated.
        """
        return prediction_interval(self.mean, self.scatter, self.size, level)


def learn_baseline(observations: Sequence[Observation]) -> Baseline | None:
    """Take mean and scatter of healthy measurements, in time order and any unit.

    ``None`` as long as the scatter is not known: fewer than two measurements, or all of one value without any stated
    uncertainty. The scatter is the standard deviation between measurements, but not less than the root mean square of
    the stated uncertainties. The stated ones alone would not do: on real records it is up to 24 times larger.
    """
    if len(observations) < 2:
        return None
    values = np.array([o.value for o in observations])
    stated = math.sqrt(sum(o.standard_uncertainty**2 for o in observations) / len(observations))
    # values all alike may differ from their mean by a rounding error, which is no scatter
    observed = float(values.std(ddof=1)) if np.ptp(values) > 0.0 else 0.0
    scatter = max(observed, stated)
    if scatter == 0.0:
        return None
    autocorrelation = _lag_one(values)
    return Baseline(
        mean=float(values.mean()),
        scatter=scatter,
        size=values.size,
        degrees_of_freedom=values.size - 1,
        autocorrelation=autocorrelation,
        dependence=_dependence(autocorrelation, values.size),
        started_at=observations[0].at,
        ended_at=observations[-1].at,
    )


def _lag_one(values: FloatArray) -> float:
    deviation = values - values.mean()
    power = float(deviation @ deviation)
    return float(deviation[:-1] @ deviation[1:]) / power if power > 0.0 else 0.0


def _dependence(autocorrelation: float, size: int) -> float:
    rho = min(autocorrelation + 1.0 / size, _LARGEST_AUTOCORRELATION)
    significant = rho > _SIGNIFICANT / math.sqrt(size)
    return math.sqrt((1.0 + rho) / (1.0 - rho)) if significant else 1.0
