"""Which change explains that an axis moved: preload, payload, bearing, position, sensor, temperature, or nothing.

``python -m benchmarks.running_axis [machines] [few]`` draws machines about one description, measures each on the
finite-element plant in time, with friction and working motion, and asks for the cause after each of seven things. Two
more that no hypothesis has, a bracket and friction, are to be called unknown. With ``few`` there are five positions
instead of seven, measured on two days for the reference and once again instead of three times each.
"""

import math
import sys
from collections import Counter

import numpy as np

from tests.hidden_effects.running.sessions import HAPPENINGS, OUTSIDE, POSITIONS, PRELOAD, Happened
from tests.hidden_effects.running.trials import Trial, trials

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


def report(found: list[Trial]) -> None:
    truths = list(dict.fromkeys(one.truth for one in found))
    print(f"{'truth':12s} right  least confidence  gap before → after  size: mean error, in its 95 %   seconds   said")
    for truth in truths:
        of_truth = [one for one in found if one.truth == truth]
        said = Counter(f"{one.explanation.outcome} {one.explanation.cause}" for one in of_truth)
        before, after = (
            np.median([getattr(one.explanation, name) for one in of_truth]) for name in ("gap_before", "gap_after")
        )
        print(
            f"{truth:12s} {sum(one.right for one in of_truth):2d}/{len(of_truth):2d}  "
            f"{min(one.explanation.confidence for one in of_truth):16.3f}  {before:7.2f} → {after:4.2f}     "
            f"{size_errors(truth, of_truth):30s} {np.median([one.seconds for one in of_truth]):7.1f}   "
            + ", ".join(f"{count} {words}" for words, count in said.items())
        )


def size_errors(truth: str, found: list[Trial]) -> str:
    """Return the mean error of the size, relative, and how often its interval covers the truth."""
    first = [(one, one.explanation.changes[0].size) for one in found if one.right and truth not in OUTSIDE]
    sizes = [(true_size(truth, one.happened), size) for one, size in first if size is not None]
    if not sizes:
        return ""
    errors = [size.value / true - 1.0 for true, size in sizes]
    covered = sum(abs(size.value - true) <= 1.96 * size.standard_uncertainty for true, size in sizes)
    return f"{100.0 * np.mean(errors):+6.1f} %, {covered}/{len(sizes)}"


def main(n_machines: int = 4, *, few: bool = False) -> None:
    positions, days = (_FEW, (2, 1)) if few else (POSITIONS, (3, 3))
    found = []
    for seed in range(n_machines):
        for one in trials(seed, HAPPENINGS | OUTSIDE, positions=positions, days=days):
            found.append(one)
            if not one.right:
                print(f"machine {seed}, {one.truth}: {one.explanation.outcome}: {one.explanation.sentence}", flush=True)
    report(found)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:] if word.isdigit()), few="few" in sys.argv)
