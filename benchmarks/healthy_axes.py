"""How often nothing is found in healthy axes: more of them than the blind benchmark has, drawn by seeds of their own.

``python -m benchmarks.healthy_axes --out FOLDER [--draws 2] [--workers 1]`` draws the healthy axes of as many blind
benchmarks (``benchmarks.hidden_effects``), by lot, answers each from its files alone, and prints how many answers were
*none*, with an exact 95 % confidence interval (Clopper and Pearson), and what the others were.
"""

import argparse
import secrets
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from scipy.stats import binomtest

from benchmarks.blind_cases import composition
from benchmarks.hidden_effects import answer, draw, make_folders
from monitor_core.fitting.residuals.model_form import ModelFormError
from service.blas_threads import compute_in_one_thread


def main() -> None:
    """Draw, answer, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    n_none = n_all = 0
    with ProcessPoolExecutor(options.workers, initializer=compute_in_one_thread) as pool:
        for _ in range(options.draws):
            seed, form = secrets.randbelow(10**9), ModelFormError()
            folder = options.out / str(seed)
            make_folders(folder)
            jobs = [job for job in composition(seed) if job.healthy]
            n = len(jobs)
            list(pool.map(draw, jobs, [folder] * n, [seed] * n, [form] * n))
            answers = list(pool.map(answer, [job.name for job in jobs], [folder] * n, [form] * n))
            others = [(job, found) for job, found in zip(jobs, answers, strict=True) if found["outcome"] != "none"]
            n_none, n_all = n_none + n - len(others), n_all + n
            print(f"seed {seed}: none in {n - len(others)} of {n}", flush=True)
            for job, found in others:
                named = ", ".join(effect["key"] for effect in found["effects"]) or "nothing"
                print(f"  {job.name}: {job.machine}, {job.design}, {job.scatter}, {job.disturbance}: "
                      f"{found['outcome']}, {named} named")  # fmt: skip
    low, high = binomtest(n_none, n_all).proportion_ci(0.95)
    print(f"none in {n_none} of {n_all}: {100 * n_none / n_all:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)")


if __name__ == "__main__":
    main()
