"""How often a preload is wrong and does not say so, case by case, on two machines the product does not know.

``python -m benchmarks.honest_intervals [days [first seed [machine [cases …]]]]``: a calibration session, then so many
days of five measurements in each case. *Silent* is a measurement with neither doubt nor refusal; what counts is *silent
and outside its interval*. Seeds from 500 on are scored: no threshold was set on them.
"""

import sys
from dataclasses import dataclass

import numpy as np

from monitor_core.pipeline import AxisSettings
from monitor_core.preload import Calibration, PreloadEstimate
from monitor_core.recording import Rejection
from monitor_core.session import calibrate_session, judge_session, with_session_doubts
from tests.plant.shop import CASES, MACHINES, Case, Machine, calibration_session, case_session

SETTINGS = AxisSettings(search_band=(120.0, 260.0))


@dataclass(frozen=True, slots=True)
class Judged:
    """A measurement with what was true."""

    truth: float  # [N]
    answer: PreloadEstimate | Rejection

    @property
    def silent(self) -> bool:
        """Whether nothing is said against the number."""
        return isinstance(self.answer, PreloadEstimate) and not self.answer.doubts

    @property
    def outside(self) -> bool:
        """Whether the interval misses the truth."""
        answer = self.answer
        return isinstance(answer, PreloadEstimate) and not (
            answer.interval.lower <= self.truth <= answer.interval.upper
        )


def judge_case(machine: Machine, case: Case, calibration: Calibration, *, days: int, seed: int) -> list[Judged]:
    """Judge every measurement of some days of a case."""
    judged: list[Judged] = []
    for day in range(days):
        rng = np.random.default_rng([2026, seed, list(CASES).index(case.key), day])
        recorded = case_session(machine, case, rng, day=day)
        measured = with_session_doubts(list(judge_session(recorded.session, SETTINGS, calibration)), calibration)
        outcomes = [item.outcome.preload for item in measured]
        judged += [Judged(truth, answer) for truth, answer in zip(recorded.preload, outcomes, strict=True)]
    return judged


def row_of(case: Case, judged: list[Judged]) -> str:
    """Write a case as a row of the table."""
    estimates = [(j.truth, j.answer) for j in judged if isinstance(j.answer, PreloadEstimate)]
    bias = np.array([answer.preload / truth - 1.0 for truth, answer in estimates])
    half = np.array([0.5 * (a.interval.upper - a.interval.lower) / a.preload for _, a in estimates])
    reasons = [str(j.answer.reason) for j in judged if isinstance(j.answer, Rejection)]
    doubts = [str(doubt.reason) for _, answer in estimates for doubt in answer.doubts]
    said = ", ".join(f"{words} {(reasons + doubts).count(words)}" for words in dict.fromkeys(reasons + doubts))
    wrong = sum(j.silent and j.outside for j in judged) / len(judged)
    numbers = f"{np.median(bias):+7.1%} {np.median(half):7.1%}" if estimates else f"{'—':>7s} {'—':>7s}"
    return (
        f"{case.key:8s}{case.title:42s}{numbers}  {sum(j.outside for j in judged) / len(judged):6.0%} "
        f"{sum(j.silent for j in judged) / len(judged):6.0%} {wrong:6.1%}  {said}"
    )


def main(arguments: list[str]) -> None:
    """Print the table."""
    days, seed = (int(a) for a in (arguments + ["8", "500"][len(arguments) :])[:2])
    machines = arguments[2:3] or list(MACHINES)
    for name in machines:
        machine = MACHINES[name]
        calibration = calibrate_session(calibration_session(machine, np.random.default_rng([2026, seed])), SETTINGS)
        print(f"{name} machine, {5 * days} measurements a case, seed {seed}")
        print(f"{'case':50s}{'bias':>7s} {'± half':>7s}  outside silent  wrong  said")
        for key in arguments[3:] or CASES:
            judged = judge_case(machine, CASES[key], calibration, days=days, seed=seed)
            print(row_of(CASES[key], judged), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
