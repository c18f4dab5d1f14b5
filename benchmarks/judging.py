"""What a judged measurement costs: with a calibration, without one, and against another tree of the product.

``python -m benchmarks.judging [OTHER_TREE]``: ten healthy measurements of each of three machines are judged in turn by
each tree, and in each with and without a calibration. Printed are medians of paired ratios: what else the computer does
takes from both alike. A tree is a folder with the product in it, as ``git worktree add`` makes it.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monitor_core.recording import Window
from tests.plant.measurements import Acquisition
from tests.plant.shop import CASES, HEAVY, MEDIUM, Machine, calibration_session, case_session
from tests.plant.simulation import Plant

ROUNDS = 7
SEED = 700
#: The machine of the recorded sessions, which a second mode is sought on most often.
RECORDED = Machine("recorded", Plant(), Acquisition(), (100.0, 200.0, 300.0, 400.0), 300.0, (8.0, 12.0), 0.5)


def simulated() -> dict[str, NDArray[np.generic]]:
    """Simulate a calibration and ten healthy measurements of each machine, as plain arrays that any tree can read."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for machine in (RECORDED, MEDIUM, HEAVY):
        rng = np.random.default_rng([SEED, 1])
        days = [case_session(machine, CASES["healthy"], rng, day=day).session.windows for day in range(2)]
        healthy = [replace(w, measurement=f"{day}{w.measurement}") for day, windows in enumerate(days) for w in windows]
        arrays |= _arrays(f"{machine.name}/healthy", healthy)
        arrays |= _arrays(f"{machine.name}/calibration", calibration_session(machine, rng).windows)
    return arrays


def _arrays(key: str, windows: Sequence[Window]) -> dict[str, NDArray[np.generic]]:
    stated = [w.conditions for w in windows]
    conditions = [
        [c.position, c.payload_mass or 0.0, c.temperature or 0.0, np.nan if c.preload is None else c.preload]
        for c in stated
    ]
    return {
        f"{key}/excitation": np.array([w.excitation for w in windows]),
        f"{key}/response": np.array([w.response for w in windows]),
        f"{key}/trace": np.array([w.position_trace for w in windows]),
        f"{key}/conditions": np.array(conditions),
        f"{key}/measurement": np.array([w.measurement for w in windows]),
        f"{key}/rate": np.array(windows[0].sample_rate),
    }


class Tree:
    """A process that judges with the product of one tree."""

    def __init__(self, root: Path, data: Path) -> None:
        """Start the process of a tree on the measurements of a file."""
        environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        worker = Path(__file__).with_name("judging_worker.py")
        self.process = subprocess.Popen(
            [sys.executable, str(worker), str(data)],
            cwd=root,
            env=environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._line()

    def judge(self) -> NDArray[np.float64]:
        """Judge every measurement once; return the times, shape (n_measurements, 2): calibrated, and not [ms]."""
        if self.process.stdin is None:
            raise AssertionError("the process was started with a pipe")
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return np.array([float(t) for t in self._line().split()]).reshape(-1, 2)

    def _line(self) -> str:
        if self.process.stdout is None:
            raise AssertionError("the process was started with a pipe")
        return self.process.stdout.readline()

    def end(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()


def main(arguments: list[str]) -> None:
    """Print what a judged measurement costs."""
    roots = [Path(__file__).resolve().parents[1], *(Path(argument).resolve() for argument in arguments)]
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "measurements.npz"
        np.savez(data, **simulated())  # type: ignore[arg-type]  # none of the names is an argument of savez
        trees = [Tree(root, data) for root in roots]
        rounds = [[tree.judge() for tree in trees] for _ in range(ROUNDS + 1)][1:]  # the first warms up
        for tree in trees:
            tree.end()
    times = np.median(np.array(rounds), axis=0)  # shape (n_trees, n_measurements, 2) [ms]
    for name, (calibrated, without) in zip(("this tree", "other tree"), times.transpose(0, 2, 1), strict=False):
        ratio = without / calibrated
        print(
            f"{name}: calibrated {np.median(calibrated):.2f} ms (mean {calibrated.mean():.2f}), without a calibration "
            f"{np.median(without):.2f} ms (mean {without.mean():.2f}); without over calibrated: median of pairs "
            f"{np.median(ratio):.2f}, of the means {without.mean() / calibrated.mean():.2f}, worst {ratio.max():.1f}"
        )
    if len(trees) > 1:
        for kind, (this, other) in zip(("calibrated", "without"), times.transpose(2, 0, 1), strict=True):
            print(f"{kind}, this over other: median of pairs {np.median(this / other):.2f}, of the means "
                  f"{this.mean() / other.mean():.2f}, worst {(this / other).max():.1f}")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
