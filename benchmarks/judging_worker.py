"""Judges the measurements of ``benchmarks.judging`` with the product that it is started in, of this commit or another.

It takes from the product what every commit has, and from this tree nothing.
"""

import sys
import time
from datetime import UTC, datetime, timedelta

import numpy as np

from monitor_core.pipeline import AxisSettings, judge_measurement
from monitor_core.recording import Conditions, ExcitationSource, Session, Window
from monitor_core.session import calibrate_session

#: The axis of the recorded sessions lies at 175 to 197 Hz, those of the shop at 182 to 218 Hz.
SETTINGS = AxisSettings(search_band=(120.0, 260.0))
START = datetime(2026, 1, 5, 6, 0, tzinfo=UTC)
KINDS = ("calibration", "healthy")


def session(arrays: "np.lib.npyio.NpzFile", key: str) -> Session:
    """Make a session of plain arrays."""
    excitation, response, trace, conditions, names, rate = (
        arrays[f"{key}/{part}"] for part in ("excitation", "response", "trace", "conditions", "measurement", "rate")
    )
    return Session(
        key,
        tuple(
            Window(
                excitation=excitation[i],
                response=response[i],
                sample_rate=float(rate),
                started_at=START + timedelta(seconds=2.0 * i),
                conditions=Conditions(
                    position=position,
                    payload_mass=payload,
                    temperature=temperature,
                    preload=None if np.isnan(preload) else preload,
                ),
                measurement=str(names[i]),
                excitation_source=ExcitationSource.SENSOR,
                position_span=float(np.ptp(trace[i])),
                position_trace=trace[i],
            )
            for i, (position, payload, temperature, preload) in enumerate(conditions.tolist())
        ),
    )


def main(path: str) -> None:
    """Judge the healthy measurements once for each line of the input; print the times of all [ms]."""
    with np.load(path) as arrays:
        machines = sorted({name.split("/")[0] for name in arrays.files})
        calibration, healthy = ({name: session(arrays, f"{name}/{kind}") for name in machines} for kind in KINDS)
    calibrations = {name: calibrate_session(calibration[name], SETTINGS) for name in machines}
    measurements = [
        (calibrations[name], healthy[name].windows_of(measurement))
        for name in machines
        for measurement in healthy[name].measurements
    ]
    print("ready", flush=True)
    for _ in sys.stdin:
        times = []
        for calibrated, windows in measurements:
            for calibration_in_force in (calibrated, None):
                begin = time.perf_counter()
                judge_measurement(windows, SETTINGS, calibration_in_force)
                times.append(1e3 * (time.perf_counter() - begin))
        print(" ".join(f"{t:.4f}" for t in times), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
