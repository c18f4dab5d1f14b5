"""Whether stated intervals hold for a year: a healthy axis in a shop, judged against its calibration, month by month.

``python -m benchmarks.shop_year [days [first seed [machine]]]``: friction that wanders by 15 % and rises by a quarter
between lubrications, seasons and weather with a structure that lags behind the air, eight windows at five places every
day. Seeds from 500 on are scored. How much of the mean squared error is common to a month tells what can be asked of a
single month at all: :mod:`benchmarks.month_information`.
"""

import sys
from collections import Counter

import numpy as np

from benchmarks.honest_intervals import SETTINGS, Judged
from monitor_core.preload import PreloadEstimate
from monitor_core.session import calibrate_session, judge_session, with_session_doubts
from tests.plant.shop import MACHINES, Machine, calibration_session, shop_year


def judge_year(machine: Machine, days: int, seed: int) -> list[list[Judged]]:
    """Judge every day of a year."""
    calibration = calibrate_session(calibration_session(machine, np.random.default_rng([2026, seed])), SETTINGS)
    judged = []
    for recorded in shop_year(machine, np.random.default_rng([2027, seed]), days):
        measured = with_session_doubts(list(judge_session(recorded.session, SETTINGS, calibration)), calibration)
        answers = [item.outcome.preload for item in measured]
        judged.append([Judged(truth, answer) for truth, answer in zip(recorded.preload, answers, strict=True)])
    return judged


def common_to_a_month(months: list[list[list[Judged]]]) -> float:
    """Return which share of the mean squared error the measurements of a month have in common."""
    errors = [
        np.array(
            [j.answer.preload / j.truth - 1.0 for day in days for j in day if isinstance(j.answer, PreloadEstimate)]
        )
        for days in months
    ]
    within = sum(float(np.sum((error - error.mean()) ** 2)) for error in errors)
    return 1.0 - within / sum(float(np.sum(error**2)) for error in errors)


def report(machine: Machine, judged: list[list[Judged]]) -> None:
    """Print coverage, half-width and scatter of the year and of each month."""
    print(f"{machine.name} machine, {len(judged)} days of {len(judged[0])} measurements")
    print("month  covered  error: mean, sd   ± half   demanded   silent  refused or doubted")
    months = [judged[i : i + 30] for i in range(0, len(judged), 30)]
    for number, days in enumerate([*months, judged]):
        measured = [j for day in days for j in day]
        estimates = [(j.truth, j.answer) for j in measured if isinstance(j.answer, PreloadEstimate)]
        error = np.array([answer.preload / truth - 1.0 for truth, answer in estimates])
        half = np.array([0.5 * (a.interval.upper - a.interval.lower) / truth for truth, a in estimates])
        covered = np.mean([not j.outside for j in measured if isinstance(j.answer, PreloadEstimate)])
        reasons = Counter(
            str(reason)
            for j in measured
            for reason in (
                [doubt.reason for doubt in j.answer.doubts]
                if isinstance(j.answer, PreloadEstimate)
                else [j.answer.reason]
            )
        )
        name = "year" if number == len(months) else str(number + 1)
        print(
            f"{name:5s} {covered:8.3f}  {error.mean():+7.2%} {error.std():6.2%} {np.mean(half):8.2%} "
            f"{1.96 * error.std():9.2%}  {np.mean([j.silent for j in measured]):7.3f}  {dict(reasons)}",
            flush=True,
        )
    print(f"common to a month: {common_to_a_month(months):.0%} of the mean squared error", flush=True)


def main(arguments: list[str]) -> None:
    """Print the table of each machine."""
    days, seed = (int(a) for a in (arguments + ["365", "500"][len(arguments) :])[:2])
    for name in arguments[2:] or MACHINES:
        report(MACHINES[name], judge_year(MACHINES[name], days, seed))


if __name__ == "__main__":
    main(sys.argv[1:])
