"""Say in sentences what other settings of an axis would change, each with the kind of its number."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from service.documents.said import N_, Said, Stated, Value


class Kind(StrEnum):
    """What a number rests on."""

    COMPUTED = "computed"  # from the limits of the charts, before anything is seen
    COUNTED = "counted"  # in what was measured of this axis
    ESTIMATED = "estimated"  # by a rule of thumb
    RULE = "rule"  # how the service goes about it


@dataclass(frozen=True, slots=True)
class Consequence:
    """What a setting changes."""

    setting: str
    kind: Kind
    said: Said


@dataclass(frozen=True, slots=True)
class Limit:
    """A rate of false alarms, and how long the loss that is spoken of stays unnoticed with it."""

    false_alarms_per_year: float
    delay_days: float | None  # on average; None as long as the baseline is not learnt


@dataclass(frozen=True, slots=True)
class Gaps:
    """How often the axis would have been silent, of so many sessions that are looked at."""

    hours: float
    n_gaps: int
    n_sessions: int


@dataclass(frozen=True, slots=True)
class InBand:
    """How many of the newest frequencies lie outside a search band."""

    low_hz: float
    high_hz: float
    n_outside: int
    n_looked_at: int
    calibrated: bool  # then the calibration says where the mode is looked for


def of_limit(before: Limit, after: Limit, loss_n: float) -> Consequence:
    """Say what another rate of false alarms costs in delay."""
    values: dict[str, Value] = {
        "rate": Stated(after.false_alarms_per_year), "was": Stated(before.false_alarms_per_year), "loss": round(loss_n),
    }  # fmt: skip
    if before.delay_days is None or after.delay_days is None:
        text = N_(
            "%(rate)s false alarms a year are expected, until now %(was)s. After how long a loss of %(loss)s N is "
            "alarmed is known as soon as the baseline is learnt."
        )
    else:
        values |= {"days": after.delay_days, "days_was": before.delay_days}
        text = N_(
            "%(rate)s false alarms a year are expected, until now %(was)s. A sudden loss of %(loss)s N is alarmed "
            "after %(days)s days on average, until now %(days_was)s."
        )
    return Consequence("false_alarms_per_year", Kind.COMPUTED, Said(text, values))


def of_limits_in_time() -> Consequence:
    """Say from when new limits hold."""
    text = N_("New limits hold from the next measurement on. What was judged stays, and so do alarms that stand.")
    return Consequence("false_alarms_per_year", Kind.RULE, Said(text))


def of_silence(before: Gaps, after: Gaps, *, silent_now: bool) -> Iterator[Consequence]:
    """Say how often the axis would have been unknown because nothing was heard of it."""
    values: dict[str, Value] = {
        "hours": Stated(after.hours), "n": after.n_gaps, "n_was": before.n_gaps, "sessions": after.n_sessions,
    }  # fmt: skip
    text = N_(
        "Without an accepted measurement for %(hours)s h the axis is unknown. In the last %(sessions)s sessions that "
        "happened %(n)s times, with the setting until now %(n_was)s times."
    )
    yield Consequence("silent_after_hours", Kind.COUNTED, Said(text, values))
    if silent_now:
        yield Consequence("silent_after_hours", Kind.COUNTED, Said("It would be unknown at once."))


def of_windows(before: int, after: int) -> Consequence:
    """Say what more or fewer windows of a measurement change."""
    text = N_(
        "Measurements that begin from now on are judged after %(after)s windows, until now %(before)s. What chance "
        "adds to their interval becomes %(ratio)s times as wide, and a measurement takes %(share)s times as long."
    )
    values: dict[str, Value] = {
        "after": after, "before": before, "ratio": (before / after) ** 0.5, "share": after / before,
    }  # fmt: skip
    return Consequence("windows_per_measurement", Kind.ESTIMATED, Said(text, values))


def of_band(in_band: InBand) -> Iterator[Consequence]:
    """Say how many of the newest measurements a search band would have missed."""
    if in_band.n_looked_at:
        text = N_(
            "%(n)s of the last %(looked)s frequencies lie outside %(low)s to %(high)s Hz: measurements like these are "
            "refused."
        )
        values: dict[str, Value] = {
            "n": in_band.n_outside, "looked": in_band.n_looked_at,
            "low": Stated(in_band.low_hz), "high": Stated(in_band.high_hz),
        }  # fmt: skip
        yield Consequence("search_band_hz", Kind.COUNTED, Said(text, values))
    if in_band.calibrated:
        text = N_("As long as a calibration is in force, it says where the mode is looked for, not this band.")
        yield Consequence("search_band_hz", Kind.RULE, Said(text))


def of_machine(machine: str | None, n_others: int) -> Consequence:
    """Say where the axis stands in the list of machines."""
    if machine is None:
        return Consequence("machine", Kind.RULE, Said("The axis is of no machine."))
    text = N_("The axis is listed at the machine %(machine)s, with %(n)s others.")
    return Consequence("machine", Kind.COUNTED, Said(text, {"machine": machine, "n": n_others}))


def of_commissioned(commissioned_n: float | None, left: float | None) -> Consequence:
    """Say what is left of the preload that the axis was put into service with."""
    if commissioned_n is None:
        text = N_("What is left of the commissioned preload is not said any more.")
        return Consequence("commissioned_preload_n", Kind.RULE, Said(text))
    if left is None:
        text = N_("What is left of %(preload)s N is said with the next accepted measurement.")
        return Consequence("commissioned_preload_n", Kind.RULE, Said(text, {"preload": round(commissioned_n)}))
    text = N_("By the last measurement %(left)s %% of %(preload)s N are left. No alarm rests on that.")
    values: dict[str, Value] = {"left": round(100.0 * left), "preload": round(commissioned_n)}
    return Consequence("commissioned_preload_n", Kind.COMPUTED, Said(text, values))
