"""Whether stated intervals hold for a year: a healthy axis in a shop, judged against its calibration, month by month.

``python -m benchmarks.shop_year [days [first seed [machine [every]]]]``: friction that wanders by 15 % and rises by a
quarter between lubrications, seasons and weather with a structure that lags behind the air, eight windows at five
places every day, or every so many days. What is measured is found once and judged four times: with temperature and
payload stated, without one of them, without both. How much of the mean squared error is common to a month tells what
can be asked of a single month at all: :mod:`benchmarks.month_information`.
"""

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.honest_intervals import SETTINGS, Judged
from monitor_core.axis_state import AxisState, advance, scatter_with_history
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import witnesses_of
from monitor_core.preload import (
    Calibration,
    PreloadEstimate,
    estimate_preload,
    excess_variance_of,
    friction_amplification,
    widened,
)
from monitor_core.recording import Conditions, DoubtReason, Rejection
from monitor_core.session import SessionMeasurement, calibrate_judged, judge_session, with_session_doubts
from monitor_core.trend import DetectorSettings, LossDirection, design_detector
from tests.plant.chain import Condition
from tests.plant.shop import MACHINES, Machine, calibration_session, shop_year


@dataclass(frozen=True, slots=True)
class RecordedYear:
    """A year as it was measured, which can be judged by any rule."""

    calibration: list[SessionMeasurement]
    sessions: list[list[SessionMeasurement]]  # as the program judged them when they were recorded
    preload: list[float]  # that is true, of each session [N]
    conditions: list[tuple[Condition, ...]]  # that were true


def record_year(machine: Machine, days: int, seed: int, every: int = 1) -> RecordedYear:
    """Simulate a year and measure its modes."""
    judged = list(judge_session(calibration_session(machine, np.random.default_rng([2026, seed])), SETTINGS))
    calibration = calibrate_judged(judged, SETTINGS)
    sessions, preload, conditions = [], [], []
    for recorded in shop_year(machine, np.random.default_rng([2027, seed]), days, measured=range(0, days, every)):
        sessions.append(list(judge_session(recorded.session, SETTINGS, calibration)))
        preload.append(recorded.preload[0])
        conditions.append(recorded.conditions)
    return RecordedYear(judged, sessions, preload, conditions)


DESIGN = design_detector(DetectorSettings(measurements_per_year=5 * 365.0, loss=LossDirection.RISE))

#: What is stated of the conditions.
ROWS: dict[str, Callable[[Conditions], Conditions]] = {
    "stated": lambda stated: stated,
    "without thermometer": lambda stated: replace(stated, temperature=None),
    "without payload": lambda stated: replace(stated, payload_mass=None),
    "without both": lambda stated: replace(stated, temperature=None, payload_mass=None),
}


def judge_year(
    recorded: RecordedYear, stated: Callable[[Conditions], Conditions], *, history: bool = True
) -> list[list[Judged]]:
    """Judge every day of a year, with so much of its conditions stated and with what the axis has shown before."""
    calibration, state, judged = calibrate_judged(recorded.calibration, SETTINGS), AxisState(), []
    for session, truth in zip(recorded.sessions, recorded.preload, strict=True):
        measured = with_session_doubts([_judged(item, calibration, stated) for item in session], calibration)
        answers = []
        for item in measured:
            answer, modal = item.outcome.preload, item.outcome.modal
            if history and isinstance(answer, PreloadEstimate) and isinstance(modal, ModalMeasurement):
                before = state
                state = advance(before, item.outcome, modal.started_at, calibration=calibration, design=DESIGN)
                of_friction = friction_amplification(answer.feature.value, item.conditions, calibration)
                scatter = scatter_with_history(
                    before,
                    modal.started_at,
                    item.conditions,
                    answer.feature_scatter,
                    calibration,
                    amplification=1.0 if modal.friction_torque is None else of_friction,
                )
                if scatter is not None:
                    excess = excess_variance_of(scatter, answer.feature_scatter)
                    interval = widened(answer.interval, answer.preload, answer.feature.value, excess)
                    answer = replace(answer, interval=interval)
            answers.append(Judged(truth, answer))
        judged.append(answers)
    return judged


def _judged(
    item: SessionMeasurement, calibration: Calibration, stated: Callable[[Conditions], Conditions]
) -> SessionMeasurement:
    """Estimate once more from the mode that was measured; a second mode that was found is still said."""
    modal, before = item.outcome.modal, item.outcome.preload
    if isinstance(modal, Rejection):
        return item
    conditions = stated(item.conditions)
    modal = replace(modal, conditions=conditions)
    preload = estimate_preload(modal.mode.frequency, conditions, calibration, witnesses=witnesses_of(modal))
    if isinstance(preload, PreloadEstimate) and isinstance(before, PreloadEstimate):
        preload = preload.with_doubts([doubt for doubt in before.doubts if doubt.reason is DoubtReason.SECOND_MODE])
    return replace(item, conditions=conditions, outcome=replace(item.outcome, modal=modal, preload=preload))


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


def report(title: str, judged: list[list[Judged]]) -> None:
    """Print coverage, half-width and scatter of the year and of each month."""
    print(f"{title}: {len(judged)} days of {len(judged[0])} measurements")
    print("month  covered  error: mean, sd   ± half   demanded   silent  and outside  refused or doubted")
    per_month = max(1, round(len(judged) / 12))
    months = [judged[i : i + per_month] for i in range(0, len(judged), per_month)]
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
            f"{1.96 * error.std():9.2%}  {np.mean([j.silent for j in measured]):7.3f} "
            f"{np.mean([j.silent and j.outside for j in measured]):12.3f}  {dict(reasons)}",
            flush=True,
        )
    print(f"common to a month: {common_to_a_month(months):.0%} of the mean squared error", flush=True)


def main(arguments: list[str]) -> None:
    """Print the tables of each machine."""
    days, seed = (int(a) for a in (arguments + ["365", "500"][len(arguments) :])[:2])
    every = int(arguments[3]) if len(arguments) > 3 else 1
    for name in arguments[2:3] or MACHINES:
        recorded = record_year(MACHINES[name], days, seed, every)
        for row, stated in ROWS.items():
            report(f"{name} machine, seed {seed}, {row}", judge_year(recorded, stated))


if __name__ == "__main__":
    main(sys.argv[1:])
