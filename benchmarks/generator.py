"""How much faster than real time a session is simulated: 300 windows in a batch, with friction, noise and all.

``python -m benchmarks.generator`` prints seconds and times real time for each family's axis: the time from the model to
the finished windows, modes included. One thread; the median of some rounds, in which every case runs in turn.
"""

import statistics
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from monitor_core.models.generator import SimulationSettings, condition_grid, simulate_session
from monitor_core.models.generator.scan import GuideFriction
from monitor_core.models.protocol import DriveConditions, DriveModel
from monitor_core.recordings.model_file import read_model_file
from service.blas_threads import compute_in_one_thread

MODELS = Path(__file__).resolve().parent.parent / "replay_data" / "models"
N_WINDOWS, PER_MEASUREMENT, ROUNDS = 300, 15, 3
SETTINGS = SimulationSettings(windows_per_measurement=PER_MEASUREMENT, friction=GuideFriction(5.0, 20.0))


def axis(path: Path) -> tuple[DriveModel, tuple[DriveConditions, ...]]:
    """Return the model of a file and twenty conditions along its screw."""
    values = dict(read_model_file(path).parameters)
    preload = 200.0 if "dynamic_load_rating_n" in values else None
    positions = np.linspace(0.1, 0.9, N_WINDOWS // PER_MEASUREMENT) * values["screw_length_m"]
    return read_model_file(path).build(), condition_grid(positions.tolist(), (preload,))


def simulate(model: DriveModel, conditions: tuple[DriveConditions, ...], settings: SimulationSettings) -> float:
    """Simulate a session and return how long it took, in seconds."""
    begin = time.perf_counter()
    session = simulate_session(
        model, conditions, settings,
        axis_id="axis", started_at=datetime(2025, 1, 1, tzinfo=UTC), rng=np.random.default_rng(0),
    )  # fmt: skip
    elapsed = time.perf_counter() - begin
    assert len(session.windows) == N_WINDOWS
    return elapsed


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return seconds for each case, the median over rounds."""
    cases = {}
    for path in sorted(MODELS.glob("*.toml")):
        model, conditions = axis(path)
        cases[f"{path.stem}, 20 conditions, 4096 Hz"] = (model, conditions, SETTINGS)
        cases[f"{path.stem}, 20 conditions, 8192 Hz"] = (model, conditions, replace(SETTINGS, sample_rate=8192.0))
        many_windows = replace(SETTINGS, windows_per_measurement=N_WINDOWS)
        cases[f"{path.stem}, 1 condition, 4096 Hz"] = (model, conditions[:1], many_windows)
    elapsed: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(rounds):
        for name, case in cases.items():
            elapsed[name].append(simulate(*case))
    return {name: statistics.median(times) for name, times in elapsed.items()}


def main() -> None:
    """Print the table."""
    simulated = N_WINDOWS * SETTINGS.window_duration
    compute_in_one_thread()
    for name, seconds in measure().items():
        print(f"{name:45s} {seconds:6.2f} s for {simulated:.0f} s   {simulated / seconds:6.0f} x real time")


if __name__ == "__main__":
    main()
