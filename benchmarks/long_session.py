"""Open and judge a session of two hours: opening, ``preload frf`` over the judging alone, and peak memory.

    python -m benchmarks.long_session [--windows 7200] [--sample-rate-hz 2000]

The session has windows of a second, 15 a measurement. It is judged by ``preload frf`` in a process of its own, and
from memory; as ``write_session`` writes it, and without its index, as others write theirs.
"""

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np

from monitor_core.pipeline import AxisSettings
from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings import open_session, write_session
from monitor_core.recordings.session_index import NAME
from monitor_core.session import judge_session
from service.blas_threads import compute_in_one_thread

PER_MEASUREMENT = 15
MODE_HZ, DAMPING = 180.0, 0.02
#: The peak of this program alone: what the operating system counts (``ru_maxrss``) begins with the one that started it.
_PEAK = """
import sys
sys.argv[0] = "preload"
from service.cli.main import main
try:
    main()
finally:
    with open("/proc/self/status") as status:
        print(*(line.split()[1] for line in status if line.startswith("VmHWM")), file=sys.stderr)
"""


def channels(n_windows: int, sample_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return torque and acceleration of windows of a second: one mode, in closed form over the whole record."""
    rng = np.random.default_rng(1)
    n_samples = int(sample_rate)
    torque = 0.3 * rng.standard_normal(n_windows * n_samples)
    f = np.fft.rfftfreq(torque.size, 1.0 / sample_rate)
    response = -(f**2) / (MODE_HZ**2 - f**2 + 2j * DAMPING * MODE_HZ * f)
    acceleration = np.fft.irfft(response * np.fft.rfft(torque), torque.size)
    acceleration += 0.05 * acceleration.std() * rng.standard_normal(torque.size)
    shape = (n_windows, n_samples)
    return torque.astype(np.float32).reshape(shape), acceleration.astype(np.float32).reshape(shape)


def session(n_windows: int, sample_rate: float) -> Session:
    """Return a session of windows of a second; the same ten measurements again and again."""
    torque, acceleration = channels(10 * PER_MEASUREMENT, sample_rate)
    start = datetime(2025, 3, 1, 6, tzinfo=UTC)
    windows = tuple(
        Window(
            torque[number % len(torque)],
            acceleration[number % len(torque)],
            sample_rate,
            start + timedelta(seconds=number),
            Conditions(0.2 + 0.05 * (number // PER_MEASUREMENT % 10)),
            f"m{number // PER_MEASUREMENT:05d}",
        )
        for number in range(n_windows)
    )
    return Session("long", windows)


def seconds_of(work: Callable[[], object]) -> tuple[float, float]:
    """Return wall clock and processor time of some work [s]."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - processor


def open_and_close(path: Path) -> None:
    """Open a session and close it again."""
    with open_session(path):
        pass


def frf_peak(path: Path) -> tuple[float, float, float]:
    """Run ``preload frf`` in a process of its own; return its time, processor time [s] and peak memory [MiB]."""
    started, processor = time.perf_counter(), processor_of_children()
    ran = subprocess.run(
        [sys.executable, "-c", _PEAK, "frf", str(path), "--json"], check=False, capture_output=True, text=True
    )
    seconds, processor = time.perf_counter() - started, processor_of_children() - processor
    return seconds, processor, int(ran.stderr.split()[-1]) / 1024.0


def processor_of_children() -> float:
    """Return the processor time of processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def start_seconds() -> tuple[float, float]:
    """Return time and processor time of a ``preload frf`` that has nothing to do [s]."""
    started, processor = time.perf_counter(), processor_of_children()
    subprocess.run([sys.executable, "-c", _PEAK, "frf", "--help"], check=False, capture_output=True)
    return time.perf_counter() - started, processor_of_children() - processor


def measure(path: Path, judging: tuple[float, float]) -> None:
    """Print opening time, time of ``preload frf`` over that of judging alone, and its peak memory."""
    print(f"{path.name}: {path.stat().st_size / 1e6:.0f} MB")
    wall, processor = min(seconds_of(lambda: open_and_close(path)) for _ in range(5))
    print(f"  opening: {wall:.2f} s, of processor {processor:.2f} s")
    frf, of_processor, peak = frf_peak(path)
    print(
        f"  preload frf: {frf:.1f} s, of processor {of_processor:.1f} s; {frf / judging[0]:.2f} and "
        f"{of_processor / judging[1]:.2f} times the judging; peak {peak:.0f} MiB"
    )


def main() -> None:
    """Measure a session with its index and without."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--windows", type=int, default=7200)
    parser.add_argument("--sample-rate-hz", type=float, default=2000.0)
    stated = parser.parse_args()
    compute_in_one_thread()
    with tempfile.TemporaryDirectory() as folder:
        recorded = session(stated.windows, stated.sample_rate_hz)
        path = Path(folder) / "indexed.session.h5"
        write_session(path, recorded)
        without = Path(folder) / "plain.session.h5"
        shutil.copyfile(path, without)
        with h5py.File(without, "r+") as file:
            file.pop(NAME, None)
        judging = seconds_of(lambda: list(judge_session(recorded, AxisSettings())))
        print(f"judging {stated.windows} windows from memory: {judging[0]:.1f} s, of processor {judging[1]:.1f} s")
        wall, processor = start_seconds()
        print(f"preload frf --help: {wall:.1f} s, of processor {processor:.1f} s")
        measure(path, judging)
        measure(without, judging)


if __name__ == "__main__":
    main()
