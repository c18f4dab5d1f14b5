"""The transmission lines in rings beside the plain loop that shifts every section, on the same sections, in one run.

``python -m benchmarks.transmission_line`` prints steps per second and ratios. The variants run in turn, round after
round, and the median round counts, so a busy machine slows all of them alike. The plain loop is the one that the tests
judge the rings by: array shifts in numpy, junctions in Python.
"""

import statistics
import time
from collections.abc import Callable

import numpy as np

from monitor_core.models.published.transmission_line import LineGrid, common_step_grid, synchronised_grid
from monitor_core.models.published.transmission_line.kernel import (
    LineState,
    Outputs,
    advance,
    compiled_stepper,
    compiler_installed,
)
from tests.models.line_reference import (
    as_arrays,
    drive_on,
    empty_outputs,
    empty_rings,
    inputs_of,
    plain_loop,
    shaft,
)

ROUNDS = 9
COMPARED_STEPS = 3000  # over which all variants must give the same bits
PLAIN_STEPS, PYTHON_STEPS, COMPILED_STEPS = 400, 4000, 400_000  # in one round


def grids() -> dict[str, LineGrid]:
    """Return the paper's sections with its synchronisation, and about the same step common to both lines."""
    axis = shaft()
    return {"8 axial steps in one": synchronised_grid(axis, 1e-6), "common step": common_step_grid(axis, 421)}


def problem(grid, n_steps):
    """Return the drive, and a torque of noise on it."""
    drive, *places = drive_on(grid, shaft())
    torque = np.random.default_rng(0).standard_normal(n_steps)
    return drive, inputs_of(torque, *places)


def plain(drive, inputs):
    return plain_loop(drive, inputs)[0]


def rings_in_python(drive, inputs):
    outputs = empty_outputs(len(inputs.torque))
    advance(drive, LineState(), empty_rings(drive), inputs, outputs)
    return outputs


def rings_compiled(drive, inputs):
    outputs = Outputs(*np.zeros((len(Outputs._fields), len(inputs.torque))))
    compiled_stepper()(drive, LineState(), as_arrays(empty_rings(drive)), inputs, outputs)
    return outputs


def same_bits(grid) -> bool:
    """Tell whether all three variants give the same numbers to the last bit, the first call compiling."""
    drive, inputs = problem(grid, COMPARED_STEPS)
    reference = plain(drive, inputs)
    others = (rings_in_python(drive, inputs), rings_compiled(drive, as_arrays(inputs)))
    return all(np.array_equal(a, b) for other in others for a, b in zip(reference, other, strict=True))


def measure(grid) -> dict[str, float]:
    """Return the steps per second of each variant: the median over rounds."""
    variants: dict[str, tuple[Callable, int, Callable]] = {
        "plain loop, numpy": (plain, PLAIN_STEPS, lambda inputs: inputs),
        "rings, Python": (rings_in_python, PYTHON_STEPS, lambda inputs: inputs),
        "rings, compiled": (rings_compiled, COMPILED_STEPS, as_arrays),
    }
    problems = {}
    for name, (_, n_steps, prepare) in variants.items():
        drive, inputs = problem(grid, n_steps)
        problems[name] = drive, prepare(inputs)
    rates: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(ROUNDS):
        for name, (run, n_steps, _) in variants.items():
            start = time.perf_counter()
            run(*problems[name])
            rates[name].append(n_steps / (time.perf_counter() - start))
    return {name: statistics.median(values) for name, values in rates.items()}


def main() -> None:
    """Print the tables."""
    if not compiler_installed():
        print("transmission line: numba is not installed (extra `compiled`); nothing to compare")
        return
    for name, grid in grids().items():
        print(
            f"transmission line, {name}: {grid.torsional_sections} torsional and {grid.axial_sections} axial sections "
            f"at {grid.time_step * 1e6:.3f} µs"
        )
        print(f"same bits over {COMPARED_STEPS} steps: {'yes' if same_bits(grid) else 'NO'}")
        rates = measure(grid)
        slowest = rates["plain loop, numpy"]
        for variant, rate in rates.items():
            print(
                f"{variant:20s} {rate:12.3e} steps/s   factor {rate / slowest:7.1f}   "
                f"{rate * grid.time_step:7.3f} x real time"
            )


if __name__ == "__main__":
    main()
