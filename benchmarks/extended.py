"""Extended drive against Tian's model, line by line the same axis: 30 conditions of 100 lines each.

``python -m benchmarks.extended`` prints milliseconds per evaluation of all conditions and factors. The variants run in
turn, round after round, and the median round is reported, so a busy machine slows all of them alike.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.receptance import PARAMETERS
from monitor_core.models.extended import (
    AxisPhysics,
    ResponseCase,
    natural_frequencies,
    physics_of,
    prepare_lines,
    responses,
)
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.receptance import ReceptanceModel

FREQUENCY = np.linspace(10.0, 800.0, 100)
CONDITIONS = [DriveConditions(position=0.2 + 0.07 * n, excitation_level=5.0) for n in range(30)]
POINTS = {"excitation": ExcitationPoint.TORQUE_AT_SCREW, "response": ResponsePoint.ACCELERATION_AT_TABLE}
ROUNDS = 15
REPEATS = 20


def as_the_family_answers() -> np.ndarray:
    """Return all lines from Tian's model, condition after condition."""
    model = ReceptanceModel(PARAMETERS)
    return np.concatenate(
        [model.frequency_response(FREQUENCY, conditions, **POINTS).response for conditions in CONDITIONS]
    )


def with_friction(physics: AxisPhysics) -> AxisPhysics:
    """Return the axis with 50 N at its guides."""
    return replace(physics, added=replace(physics.added, guide_friction=50.0))


def measure() -> dict[str, float]:
    """Return the time of each variant in milliseconds: the median over rounds."""
    physics, rough = physics_of(PARAMETERS), with_friction(physics_of(PARAMETERS))
    cases = [ResponseCase(FREQUENCY, conditions, *POINTS.values(), MotorEnd.PRESCRIBED) for conditions in CONDITIONS]
    lines, ends = prepare_lines(cases), [MotorEnd.PRESCRIBED] * len(cases)
    difference = np.max(np.abs(responses(physics, lines) / as_the_family_answers() - 1.0))
    print(f"extended drive against Tian's model: largest relative difference {difference:.1e}")
    variants: dict[str, Callable[[], object]] = {
        "Tian's model, one by one": as_the_family_answers,
        "extended drive": lambda: responses(physics, lines),
        "extended drive with friction": lambda: responses(rough, lines),
        "its poles up to 400 Hz": lambda: natural_frequencies(physics, CONDITIONS, ends, 400.0),
    }
    elapsed: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(ROUNDS + 1):
        for name, variant in variants.items():
            start = time.perf_counter()
            for _ in range(REPEATS):
                variant()
            elapsed[name].append((time.perf_counter() - start) / REPEATS * 1e3)
    return {name: statistics.median(times[1:]) for name, times in elapsed.items()}


def main() -> None:
    """Print the table."""
    times = measure()
    for name, milliseconds in times.items():
        print(f"{name:30s} {milliseconds:8.3f} ms   {milliseconds / times['extended drive']:6.1f} x extended drive")


if __name__ == "__main__":
    main()
