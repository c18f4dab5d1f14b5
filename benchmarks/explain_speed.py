"""How long ``preload explain`` takes on one core, case by case: processor time from the comparison to the answer.

``python -m benchmarks.explain_speed [--every 8]`` draws every eighth case of the blind benchmark's composition, with
seeds of its own, some 60 responses of 100 lines each, and prints the time of each, the median, what 95 % stay below,
the longest, and when the first sign of progress came.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.blind_cases import PLANTS, composition
from benchmarks.hidden_effects import learnt_form
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.models.families import build_model
from monitor_core.recordings.model_file import parse_model
from service.blas_threads import compute_in_one_thread
from tests.hidden_effects import cases, frf_file

FIRST_SEED = 100


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=8)
    compute_in_one_thread()
    taken, first = [], []
    with tempfile.TemporaryDirectory() as folder:
        form = learnt_form(Path(folder))
    for job in composition()[:: parser.parse_args().every]:
        case = cases.draw_case(
            job.kind, job.size, job.noise, FIRST_SEED + job.number, job.family, respond=PLANTS[job.plant]
        )
        file, observations = parse_model(case.baseline, job.name), frf_file.observations(case)
        folds = default_folds(observation.conditions for observation in observations)
        comparison = compare_responses(observations, held_out=folds, form=form)
        drive = DescribedDrive(
            build_model(file.family, file.parameters).parameters, dict(file.uncertain), dict(file.effects)
        )
        sizes = sizes_of_drive(drive.physics({}), observations)
        began, signs = time.process_time(), list[float]()
        answer = explain_comparison(
            comparison,
            drive,
            drive.candidates(sizes),
            sizes=sizes,
            progress=lambda _sentence: signs.append(time.process_time()),  # noqa: B023
        )
        taken.append(time.process_time() - began)
        first.append(signs[0] - began)
        print(
            f"{taken[-1]:6.1f} s  {len(observations)} responses  {job.kind}, {job.size}: {answer.outcome}", flush=True
        )
    print(
        f"{len(taken)} cases: median {statistics.median(taken):.1f} s, 95 % below {np.quantile(taken, 0.95):.1f} s, "
        f"longest {max(taken):.1f} s; first sign after {max(first):.2f} s at most"
    )


if __name__ == "__main__":
    main()
