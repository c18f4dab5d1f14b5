"""Take the measurements of one day as one: what charts and baseline are fed with.

Measurements of a day share its friction, its temperature and its mounting, so that five of them tell hardly more than
one. The session is the unit: its mean, what its measurements scatter by among themselves, and how many they are.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError

#: What is measured within so long after the first measurement of a session belongs to it. Less than a day, so that an
#: axis that is measured every morning, if not to the minute, has a session a day.
SESSION = timedelta(hours=20)
#: So much of an error that payload, temperature and position leave is no evidence [standard uncertainties].
DEAD_ZONE = 1.96


@dataclass(frozen=True, slots=True)
class Observation:
    """One accepted measurement of a trended quantity, whatever its unit.

    ``standard_uncertainty`` is the random part of its uncertainty, new in every measurement. ``systematic_uncertainty``
    is what the corrections for payload, temperature and position do not know of its difference from the baseline; 0
    under the conditions of the baseline. It is common to many later measurements, so it does not average out, and a
    change that it could explain is no evidence.

    Temperature and friction torque are covariates: what the quantity follows of them is learnt. Those that were not
    measured are None. A measurement in doubt moves the charts, and its session teaches nothing. ``lubricated``: since
    the measurement before it, as somebody said.
    """

    at: datetime
    value: float
    standard_uncertainty: float = 0.0
    systematic_uncertainty: float = 0.0
    temperature: float | None = None  # of the structure [°C]
    friction_torque: float | None = None  # of the running axis [N·m]
    in_doubt: bool = False
    lubricated: bool = False

    def __post_init__(self) -> None:
        if self.at.tzinfo is None:
            raise OutsideValidityError(f"at must carry a time zone; got {self.at.isoformat()}")
        for name in ("value", "temperature", "friction_torque"):
            stated = getattr(self, name)
            if stated is not None and not math.isfinite(stated):
                raise OutsideValidityError(f"{name} must be finite; got {stated}")
        for name in ("standard_uncertainty", "systematic_uncertainty"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise OutsideValidityError(f"{name} must be finite and not negative; got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Session:
    """The measurements of one session, summed up."""

    started_at: datetime
    last_at: datetime
    count: int
    value: float  # mean
    squares: float = 0.0  # sum of the squared deviations from the mean
    own_variance: float = 0.0  # of the mean, as the measurements state it
    systematic_uncertainty: float = 0.0  # the mean of them: common to all
    temperature: float | None = None  # mean of those that were stated
    friction_torque: float | None = None
    n_temperatures: int = 0
    n_friction_torques: int = 0
    in_doubt: bool = False  # one of its measurements is
    lubricated: bool = False  # before one of them

    def takes(self, at: datetime) -> bool:
        """Tell whether a measurement made at this moment, later than all, is of this session."""
        return at - self.started_at < SESSION

    def evident(self, difference: FloatArray | float) -> FloatArray:
        """Return what is left of differences once payload, temperature and position have explained what they can."""
        zone = DEAD_ZONE * self.systematic_uncertainty
        return np.asarray(difference - np.minimum(np.maximum(difference, -zone), zone))

    def with_observation(self, new: Observation) -> "Session":
        """Return the session with one more measurement (recursive mean and sum of squares after Welford)."""
        n = self.count + 1
        deviation = new.value - self.value
        mean = self.value + deviation / n
        temperature, n_temperatures = _mean(self.temperature, self.n_temperatures, new.temperature)
        friction_torque, n_friction_torques = _mean(self.friction_torque, self.n_friction_torques, new.friction_torque)
        return Session(
            self.started_at,
            new.at,
            n,
            mean,
            self.squares + deviation * (new.value - mean),
            (self.own_variance * self.count**2 + new.standard_uncertainty**2) / n**2,
            self.systematic_uncertainty + (new.systematic_uncertainty - self.systematic_uncertainty) / n,
            temperature,
            friction_torque,
            n_temperatures,
            n_friction_torques,
            self.in_doubt or new.in_doubt,
            self.lubricated or new.lubricated,
        )


def first_of(new: Observation) -> Session:
    """Begin a session with its first measurement."""
    return Session(new.at, new.at, 0, new.value).with_observation(new)


def sessions_of(observations: Sequence[Observation]) -> list[Session]:
    """Sum up measurements, in the order of their time, session by session."""
    sessions: list[Session] = []
    for observation in observations:
        if sessions and sessions[-1].takes(observation.at):
            sessions[-1] = sessions[-1].with_observation(observation)
        else:
            sessions.append(first_of(observation))
    return sessions


def _mean(mean: float | None, count: int, new: float | None) -> tuple[float | None, int]:
    if new is None:
        return mean, count
    return (new if mean is None else mean + (new - mean) / (count + 1)), count + 1
