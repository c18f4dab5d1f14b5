"""Which change explains that an axis moved: preload, payload, bearing, position, sensor, temperature, or nothing.

``python -m benchmarks.running_axis [machines [first]] [few]`` draws machines about one description, measures each on
the finite-element plant in time, with friction and working motion, and asks for the cause after each of seven things.
Two more that no hypothesis has, a bracket and friction, are to be called unknown. With ``few`` there are five positions
instead of seven, measured on two days for the reference and once again instead of three times each.

Machines from number 200 on are scored: nothing was set on them. Those below are for development.
"""

import math
import sys
from collections import Counter
from collections.abc import Sequence

import numpy as np

from monitor_core.discrepancy.explanation import Outcome
from service.documents.change import attribution_sentence
from tests.hidden_effects.running.sessions import HAPPENINGS, OUTSIDE, POSITIONS, PRELOAD, Happened
from tests.hidden_effects.running.trials import Trial, trials

_FIRST_SCORED = 200
_FEW = (0.15, 0.30, 0.45, 0.60, 0.75)


def true_size(truth: str, happened: Happened) -> float:
    """Return the size of a change as the product states it."""
    return {
        "preload": (happened.preload_share - 1.0) * PRELOAD,
        "payload": happened.payload,
        "bearing": math.log(happened.bearing_share),
        "position": happened.offset,
        "sensor": happened.delay,
        "temperature": happened.warming,
    }[truth]


def report(found: Sequence[Trial]) -> None:
    """Print what was said of each truth, how sure, and how well its size is known."""
    print("truth        right  confidence: mean, least   gap before → after  size: error, rms, in 95 %   seconds  said")
    for truth in dict.fromkeys(trial.truth for trial in found):
        of_truth = [trial for trial in found if trial.truth == truth]
        answers = [trial.explanation for trial in of_truth]
        said = Counter(_said(trial) for trial in of_truth)
        confidence = [answer.confidence for answer in answers]
        before, after = np.median([(answer.gap_before, answer.gap_after) for answer in answers], axis=0)
        print(
            f"{truth:12s} {sum(trial.right for trial in of_truth):2d}/{len(of_truth):2d}  "
            f"{np.mean(confidence):16.3f}, {min(confidence):.3f}   {before:6.2f} → {after:4.2f}       "
            f"{size_errors(truth, of_truth):26s} {np.median([trial.seconds for trial in of_truth]):8.1f}  "
            + ", ".join(f"{count} {words}" for words, count in said.items())
        )
    values = np.median([trial.n_values for trial in found])
    print(f"{values:.0f} values compared (median), so many degrees of freedom less one for the size of the change")
    calibration(found)


def calibration(found: Sequence[Trial]) -> None:
    """Print how often answers of some confidence have the right cause."""
    confidence = np.array([trial.explanation.confidence for trial in found])
    right = np.array([trial.explanation.cause == _expected(trial.truth) for trial in found])
    for low, high in ((0.0, 0.9), (0.9, 0.99), (0.99, 1.001)):
        chosen = (confidence >= low) & (confidence < high)
        if np.any(chosen):
            print(
                f"confidence {low:.2f} to {min(high, 1.0):.2f}: {np.count_nonzero(chosen)} answers, "
                f"mean {np.mean(confidence[chosen]):.3f}, right {np.mean(right[chosen]):.3f}"
            )


def size_errors(truth: str, found: Sequence[Trial]) -> str:
    """Return mean and rms of the relative error of the size, and how often its interval covers the truth."""
    first = [(trial, trial.explanation.changes[0].size) for trial in found if trial.right and truth not in OUTSIDE]
    sizes = [(true_size(truth, trial.happened), size) for trial, size in first if size is not None]
    if not sizes:
        return ""
    errors = np.array([size.value / true - 1.0 for true, size in sizes])
    covered = sum(abs(size.value - true) <= 1.959964 * size.standard_uncertainty for true, size in sizes)
    rms = math.sqrt(float(np.mean(errors**2)))
    return f"{100.0 * np.mean(errors):+5.1f} %, {100.0 * rms:4.1f} %, {covered}/{len(sizes)}"


def _expected(truth: str) -> str:
    return "unknown" if truth in OUTSIDE else truth


def _said(trial: Trial) -> str:
    answer = trial.explanation
    return f"one of several, first {answer.cause}" if answer.outcome is Outcome.EQUIVALENT else str(answer.cause)


def main(n_machines: int = 20, first: int = _FIRST_SCORED, *, few: bool = False) -> None:
    positions, days = (_FEW, (2, 1)) if few else (POSITIONS, (3, 3))
    found = []
    for number in range(first, first + n_machines):
        for trial in trials(number, HAPPENINGS | OUTSIDE, positions=positions, days=days):
            found.append(trial)
            if not trial.right:
                answer = trial.explanation
                print(f"machine {number}, {trial.truth}: {answer.outcome}: {attribution_sentence(answer)}", flush=True)
    report(found)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:] if word.isdigit()), few="few" in sys.argv)
