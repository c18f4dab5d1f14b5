r"""How often a year can be covered as a whole and in every month, by the best interval of constant half-width.

``python -m benchmarks.month_information``: no measurement, nothing of the product. The error of day d in month m is

.. math:: e_{md} = \sigma \left(\sqrt{s}\, a_m + \sqrt{1 - s}\, b_{md}\right), \qquad a, b \sim N(0, 1),

the share s of its variance lasting for a month: a mounting, a temperature, a lubrication. The shift of a month is not
known to who states the interval, or it would have been taken off; the variances are known for certain. So the interval
is of constant half-width h, the larger the more often it covers. Asked of a year of 12 months of 30 days: 92 to 98 % of
all days covered, at least 90 % of the days of every month.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from monitor_core.arrays import FloatArray

MONTHS, DAYS, YEARS = 12, 30, 4000
SEED = 2031
SHARES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9)
#: Of all days, what the interval covers in the long run.
COVERAGES = (0.95, 0.97, 0.98, 0.99, 0.999)
ASKED_OF_YEAR = (0.92, 0.98)
ASKED_OF_MONTH = 0.90


@dataclass(frozen=True, slots=True)
class Kept:
    """How often what is asked is kept, as shares of the years."""

    year: float
    every_month: float
    both: float


def errors(rng: np.random.Generator, share: float) -> FloatArray:
    """Draw the errors of many years in their own standard deviations, shape (years, months, days)."""
    of_month = rng.standard_normal((YEARS, MONTHS, 1))
    of_day = rng.standard_normal((YEARS, MONTHS, DAYS))
    return np.asarray(math.sqrt(share) * of_month + math.sqrt(1.0 - share) * of_day)


def kept(error: FloatArray, half_width: float) -> Kept:
    """Return how often a half-width keeps what is asked."""
    by_month = np.mean(np.abs(error) <= half_width, axis=2)
    by_year = by_month.mean(axis=1)
    year = (by_year >= ASKED_OF_YEAR[0]) & (by_year <= ASKED_OF_YEAR[1])
    every_month = by_month.min(axis=1) >= ASKED_OF_MONTH
    return Kept(float(year.mean()), float(every_month.mean()), float(np.mean(year & every_month)))


def half_width_of(coverage: float) -> float:
    """Return the half-width that covers so much of all days in the long run [standard deviations]."""
    return float(special.ndtri(0.5 * (1.0 + coverage)))


def main() -> None:
    """Print the table."""
    print(f"{YEARS} years of {MONTHS} months of {DAYS} days; shares of the years that keep what is asked")
    print("lasting a month  covers   h: 1.96 σ of all, of days   92–98 % of all  every month ≥ 90 %   both")
    rng = np.random.default_rng(SEED)
    for share in SHARES:
        drawn = errors(rng, share)
        for coverage in COVERAGES:
            h = half_width_of(coverage)
            of_all = h / half_width_of(0.95)
            found = kept(drawn, h)
            print(
                f"{share:14.0%} {coverage:8.1%} {of_all:17.2f} {of_all / math.sqrt(1.0 - share):8.2f} "
                f"{found.year:18.0%} {found.every_month:18.0%} {found.both:9.0%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
