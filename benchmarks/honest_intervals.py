"""How often a preload is wrong and does not say so, case by case, on two machines the product does not know.

``python -m benchmarks.honest_intervals [days [first seed [machine [cases …]]]]``: a calibration session, then so many
days of five measurements in each case. *Silent* is a measurement with neither doubt nor refusal; what counts is *silent
and outside its interval*. Seeds from 500 on are scored: no threshold was set on them.

``python -m benchmarks.honest_intervals DAYS SEED MACHINE healthy [n]``: six regimes of a healthy axis within what its
calibration has seen, n calibrations from the seed on with so many days each. Who is not silent is doubted for nothing.
"""

import sys
from dataclasses import dataclass

import numpy as np

from monitor_core.pipeline import AxisSettings
from monitor_core.preload import Calibration, PreloadEstimate
from monitor_core.recording import Rejection
from monitor_core.session import calibrate_session, judge_session, with_session_doubts
from tests.plant.shop import (
    CASES,
    MACHINES,
    REGIMES,
    Case,
    Machine,
    Truth,
    calibration_session,
    case_session,
    regime_calibration,
    regime_sessions,
)

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


HEAD = f"{'case':56s}{'bias':>7s} {'± half':>7s}  outside silent  wrong  said"


def judge_case(machine: Machine, case: Case, calibration: Calibration, *, days: int, seed: int) -> list[Judged]:
    """Judge every measurement of some days of a case."""
    judged: list[Judged] = []
    for day in range(days):
        rng = np.random.default_rng([2026, seed, list(CASES).index(case.key), day])
        judged += judge_day(case_session(machine, case, rng, day=day), calibration)
    return judged


def judge_regimes(machine: Machine, *, days: int, seed: int) -> dict[str, list[Judged]]:
    """Calibrate, and judge every measurement of some healthy days of each regime within what that has seen."""
    calibrations: dict[bool, Calibration] = {}
    judged: dict[str, list[Judged]] = {}
    for number, regime in enumerate(REGIMES):
        of_speeds = regime == "speed"
        if of_speeds not in calibrations:
            session = regime_calibration(machine, regime, np.random.default_rng([2026, seed, of_speeds]))
            calibrations[of_speeds] = calibrate_session(session, SETTINGS)
        recorded = regime_sessions(machine, regime, np.random.default_rng([2028, seed, number]), days)
        judged[regime] = [each for day in recorded for each in judge_day(day, calibrations[of_speeds])]
    return judged


def judge_day(recorded: Truth, calibration: Calibration) -> list[Judged]:
    """Judge the measurements of a session, each by itself and all together."""
    measured = with_session_doubts(list(judge_session(recorded.session, SETTINGS, calibration)), calibration)
    outcomes = [item.outcome.preload for item in measured]
    return [Judged(truth, answer) for truth, answer in zip(recorded.preload, outcomes, strict=True)]


def row_of(key: str, title: str, judged: list[Judged]) -> str:
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
        f"{key:12s}{title:44s}{numbers}  {sum(j.outside for j in judged) / len(judged):6.0%} "
        f"{sum(j.silent for j in judged) / len(judged):6.0%} {wrong:6.1%}  {said}"
    )


def main(arguments: list[str]) -> None:
    """Print the table."""
    days, seed = (int(a) for a in (arguments + ["8", "500"][len(arguments) :])[:2])
    machines = arguments[2:3] or list(MACHINES)
    if arguments[3:4] == ["healthy"]:
        n = int((arguments[4:] or ["1"])[0])
        print(f"{machines[0]} machine, {5 * n * days} measurements a regime, seeds {seed} to {seed + n - 1}\n{HEAD}")
        found = [judge_regimes(MACHINES[machines[0]], days=days, seed=seed + i) for i in range(n)]
        for regime, title in REGIMES.items():
            print(row_of(regime, title, [each for of_seed in found for each in of_seed[regime]]), flush=True)
        return
    for name in machines:
        machine = MACHINES[name]
        calibration = calibrate_session(calibration_session(machine, np.random.default_rng([2026, seed])), SETTINGS)
        print(f"{name} machine, {5 * days} measurements a case, seed {seed}")
        print(HEAD)
        for key in arguments[3:] or CASES:
            judged = judge_case(machine, CASES[key], calibration, days=days, seed=seed)
            print(row_of(key, CASES[key].title, judged), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
