"""Random orders, cuts and senders of the same windows: every one must say the same to the byte.

``python -m benchmarks.arrival_orders [--orders 200] [--first-seed 0]`` prints how many different answers there were.
"""

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from tests.service.arrivals import hashed, history, outcome_of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orders", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()
    answers: Counter[str] = Counter()
    started = time.monotonic()
    for seed in range(options.first_seed, options.first_seed + options.orders):
        windows, rng = history(seed // 20), np.random.default_rng(seed)  # twenty orders of each history
        n_senders = int(rng.integers(1, 9))
        arriving = [windows[i] for i in rng.permutation(len(windows))]
        with tempfile.TemporaryDirectory() as folder:
            answers[f"history {seed // 20}: {hashed(outcome_of(arriving, Path(folder), rng, n_senders))}"] += 1
    histories = len({answer.partition(":")[0] for answer in answers})
    print(f"{options.orders} orders of {histories} histories: {len(answers)} different answers")
    print(f"{(time.monotonic() - started) / options.orders:.1f} s an order")


if __name__ == "__main__":
    main()
