r"""How near the frequency of a mode comes to the Cramér–Rao bound: twelve cells of damping and noise.

``python -m benchmarks.cramer_rao [trials [seed]]``: windows of moves, simulated in continuous time, white noise on the
response. Printed is the root mean square of the errors of the frequency, each over the bound of its record,
which :func:`tests.modal.test_refine.cramer_rao_bound` computes without the product, and how often the stated 95 %
interval covers.
"""

import math
import sys

import numpy as np
import scipy.stats

from monitor_core.modal import fit_modes
from tests.modal.simulated_axis import FREQUENCY, clean_spectra, with_noise
from tests.modal.test_refine import DAMPINGS, SNRS_DB, cramer_rao_bound, half_width, peak_bin

#: Trials that share a record of moves, each with its own noise: the bound is that of the record.
_OF_A_RECORD = 10


def cell(damping: float, snr: int, trials: int, seed: int) -> tuple[float, float]:
    """Return root mean square error over the bound, and how often the interval covers."""
    rng = np.random.default_rng([2034, seed, round(1e4 * damping), snr])
    ratios, covered, bound = np.empty(trials), 0, math.nan
    for trial in range(trials):
        if trial % _OF_A_RECORD == 0:
            clean = clean_spectra(rng, [(FREQUENCY, damping, 1.0)])
            bound = cramer_rao_bound(clean, damping)
        noisy, deviation = with_noise(rng, clean, snr, half_width(damping))
        estimate = fit_modes(noisy, frequency=peak_bin(noisy), damping_ratio=0.02).modes[0].frequency
        error = estimate.value - FREQUENCY
        ratios[trial] = error / (bound * deviation)
        reach = scipy.stats.t.ppf(0.975, estimate.degrees_of_freedom) * estimate.standard_uncertainty
        covered += abs(error) < reach
    return float(np.sqrt(np.mean(ratios**2))), covered / trials


def main(arguments: list[str]) -> None:
    """Print the table."""
    trials, seed = (int(a) for a in (arguments + ["2000", "500"][len(arguments) :])[:2])
    print(f"{trials} trials a cell, seed {seed}; a ratio is known to ± {1.96 / math.sqrt(2.0 * trials):.1%}")
    print("damping  SNR [dB]  error over the bound  covered")
    ratios = []
    for damping in DAMPINGS:
        for snr in SNRS_DB:
            ratio, covered = cell(damping, snr, trials, seed)
            ratios.append(ratio)
            print(f"{damping:7.0%} {snr:9d} {ratio:21.3f} {covered:8.1%}", flush=True)
    print(f"all cells: {math.sqrt(np.mean(np.square(ratios))):.3f}")


if __name__ == "__main__":
    main(sys.argv[1:])
