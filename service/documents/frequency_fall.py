"""Say what a frequency without a calibration tells of the preload: by how much it fell, and what that may be of it."""

import math
from dataclasses import dataclass
from datetime import datetime

from monitor_core.preload import UNSTATED_SHARE, preload_lost_interval
from monitor_core.uncertainty import Estimate, Interval, IntervalKind
from service.documents.said import N_, PlusMinus, Said, Value, in_english

#: Half of the width of a 95 % interval in standard uncertainties.
REACH = 1.96


@dataclass(frozen=True, slots=True)
class FrequencyFall:
    """A natural frequency below that of the healthy baseline at the same place, in percent of it; negative: above."""

    percent: float
    half_percent: float  # of its 95 % interval
    lost_percent: tuple[float, float]  # of the preload, if it is preload
    share_by_model: bool  # whether a drive model says how much of the compliance depends on the preload

    @property
    def is_evident(self) -> bool:
        """Whether it is more than chance."""
        return self.percent > self.half_percent

    @property
    def interval_95_percent(self) -> tuple[float, float]:
        """Both ends of the interval."""
        return self.percent - self.half_percent, self.percent + self.half_percent


def fall_of(rise: float, standard_uncertainty: float, share: Interval | None) -> FrequencyFall:
    """Return the fall of a frequency whose 1/f² has risen by a share of itself [-].

    ``share`` is that of 1/f² which depends on the preload, by the drive model of the axis; None without one.
    """
    fall = 1.0 - (1.0 + rise) ** -0.5
    half = REACH * standard_uncertainty
    risen = Interval(rise - half, rise + half, IntervalKind.COVERAGE)
    lost = preload_lost_interval(risen, share or UNSTATED_SHARE)
    return FrequencyFall(
        100.0 * fall,
        100.0 * 0.5 * half * (1.0 + rise) ** -1.5,
        (100.0 * lost.lower, 100.0 * lost.upper),
        share is not None,
    )


def fall_between(frequency: Estimate, expected: Estimate, share: Interval | None) -> FrequencyFall:
    """Return the fall of a frequency below that which a healthy axis shows there [Hz]."""
    rise = (expected.value / frequency.value) ** 2 - 1.0
    relative = math.hypot(frequency.standard_uncertainty, expected.standard_uncertainty) / expected.value
    return fall_of(rise, 2.0 * relative * (1.0 + rise) ** 1.5, share)


def fall_sentence(fall: FrequencyFall, since: datetime | None = None) -> Said:
    """Say how far a frequency has fallen, and how much of the preload that may be; never newtons."""
    least, most = (round(end) for end in fall.lost_percent)
    by = PlusMinus(fall.percent, fall.half_percent)
    values: dict[str, Value] = {"fall": by, "least": least, "most": most}
    text = N_("The natural frequency fell by %(fall)s %%; if that is preload, %(least)s to %(most)s %% of it is lost.")
    if since is None:
        return Said(text, values)
    text = N_(
        "Since %(day)s the natural frequency fell by %(fall)s %%; if that is preload, %(least)s to %(most)s %% of it "
        "is lost."
    )
    return Said(text, values | {"day": since})


def fall_in_english(fall: FrequencyFall) -> str:
    """Write the sentence as programs get it, with what the share rests on."""
    sentence = in_english(fall_sentence(fall)).removesuffix(".")
    known = "" if fall.share_by_model else " (no drive model says how much of the compliance depends on it)"
    return f"{sentence[0].lower()}{sentence[1:]}{known}"
