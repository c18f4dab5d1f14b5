"""Processor time of a window sent one by one, of the service and of the least service, as a share of the bare core's.

``python -m benchmarks.ingest_cost``: what :mod:`benchmarks.ingest` times by the clock, counted in processor time of the
process that serves and of those that it starts, so that it may be drawn while others use the machine. Waiting for the
disk is not in it, nor is the sender. A turn is several measurements in a row, by the bare core, by the least service
(``--judging``) and by ours, on an axis with a history.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.ingest import (
    CONFIGURATION,
    IN_A_ROW,
    LEAST_SERVICE,
    N_WINDOWS,
    OUR_SERVICE,
    WAYS,
    Service,
    axes_with_history,
    calibration,
    judge_bare,
    measurement,
    renamed,
    running,
)
from monitor_core.recording import Window
from service.blas_threads import compute_in_one_thread
from service.operations.monitoring.axis_configuration import AxisConfiguration

AXIS = "axis-0"


def core_cost(measurements: list[list[Window]]) -> float:
    """Return the processor time of the bare core [ms a window]."""
    configuration, in_force = AxisConfiguration.model_validate(CONFIGURATION), calibration()
    started = time.process_time()
    for windows in measurements:
        judge_bare(windows, configuration, in_force)
    return 1e3 * (time.process_time() - started) / (len(measurements) * N_WINDOWS)


def service_cost(service: Service, requests: list[bytes]) -> float:
    """Return the processor time of a service for requests of one window, system calls included [ms a window]."""
    connection, started = service.another(), service.processor_time_s()  # an idle one is closed after a while
    answers = [connection.send(request) for request in requests]
    spent = service.processor_time_s() - started
    assert all(json.loads(answer)["accepted"] == 1 for answer in answers)
    return 1e3 * spent / len(requests)


def costs(ours: Service, least: Service, turns: int) -> list[tuple[float, float, float]]:
    """Return processor times of the core, the least service and ours, turn by turn [ms a window]."""
    rng = np.random.default_rng(2)
    samples = [measurement(rng) for _ in range(3)]
    one_by_one = next(way for way in WAYS if way.windows_per_request == 1)
    drawn = []
    for turn in range(turns):
        numbers = range(turn * IN_A_ROW, (turn + 1) * IN_A_ROW)
        measurements = [renamed(samples[number % len(samples)], number) for number in numbers]
        requests = [request for windows in measurements for request in one_by_one.requests(AXIS, windows)]
        drawn.append((core_cost(measurements), service_cost(least, requests), service_cost(ours, requests)))
    return drawn[1:]  # the first warms up


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=41, help=f"turns of {IN_A_ROW} measurements by each")
    parser.add_argument("--history", type=int, default=10_000, help="measurements that the axis has before")
    options = parser.parse_args()
    compute_in_one_thread()  # as the service does
    with tempfile.TemporaryDirectory() as our_folder, tempfile.TemporaryDirectory() as least_folder:
        axes_with_history(Path(our_folder), options.history, [AXIS])
        with (
            running(Path(our_folder), *OUR_SERVICE) as ours,
            running(Path(least_folder), *LEAST_SERVICE, "--judging") as least,
        ):
            core, least_cost, our_cost = np.array(costs(ours, least, options.turns)).T
    print(f"one by one, processor time of a window, {core.size} turns of {IN_A_ROW * N_WINDOWS} windows")
    print(f"{'':16} ms a window   bare core / it: of all   median   quartiles     nine of ten")
    for name, spent in (("bare core", core), ("least service", least_cost), ("our service", our_cost)):
        tenth, low, middle, high = np.quantile(core / spent, [0.1, 0.25, 0.5, 0.75])
        print(
            f"{name:16} {np.mean(spent):11.3f}   {np.sum(core) / np.sum(spent):22.3f}   {middle:6.3f}   "
            f"{low:.3f}–{high:.3f}   ≥ {tenth:.3f}"
        )


if __name__ == "__main__":
    main()
