"""How well a step can be known at all, where season and dependence from day to day are allowed for.

``python -m benchmarks.step_information``: no chart, no simulation. The step is estimated by generalised least squares
from a session a day, together with an open level and a season of a year, whose two coefficients have a prior as in
:mod:`monitor_core.trend.belief`; scatter and dependence are known for certain, as is the day of the step. Printed is
the step in its own standard uncertainties: no chart has more to go by, unless it leaves the season out of account.
"""

import math

import numpy as np

from monitor_core.trend.belief import YEAR, Prior, Structure

DAYS_A_YEAR = YEAR.days + YEAR.seconds / 86400.0
LEARNT = (20, 100, 365)
SINCE = (5, 10, 20, 40)
STRUCTURES = {"independent": Structure(0.0, 0.0, 1.0), "half of it AR(1) 0.6": Structure(0.6, 0.5, 1.0)}
SEASONS = {"no season": 0.0, "season unknown": Prior().deviations[0]}


def step_in_uncertainties(learnt: int, since: int, structure: Structure, season: float) -> float:
    r"""Return a step of one standard deviation of a session over its standard uncertainty.

    .. math:: u^{-2}(d) = 1 / \left[(X^\mathsf{T} C^{-1} X + P)^{-1}\right]_{dd}

    with the covariance C of the sessions and the precision P of the prior: 0 for level and step.
    """
    day = np.arange(learnt + since)
    angle = 2.0 * np.pi * day / DAYS_A_YEAR
    columns, precision = [np.ones(len(day)), day >= learnt], [0.0, 0.0]
    if season > 0.0:
        columns += [np.cos(angle) - 1.0, np.sin(angle)]
        precision += [season**-2] * 2
    design = np.column_stack(columns)
    apart = np.abs(day[:, None] - day)
    covariance = structure.share * structure.correlation**apart + (1.0 - structure.share) * np.eye(len(day))
    information = design.T @ np.linalg.solve(covariance, design) + np.diag(precision)
    return 1.0 / math.sqrt(float(np.linalg.inv(information)[1, 1]))


def main() -> None:
    """Print the table."""
    print("sessions since a step of 1 standard deviation: " + "".join(f"{since:6d}" for since in SINCE))
    for structure_name, structure in STRUCTURES.items():
        for season_name, season in SEASONS.items():
            for learnt in LEARNT:
                found = [step_in_uncertainties(learnt, since, structure, season) for since in SINCE]
                print(f"{structure_name:21s}{season_name:16s}{learnt:4d} days  " + "".join(f"{z:6.2f}" for z in found))


if __name__ == "__main__":
    main()
