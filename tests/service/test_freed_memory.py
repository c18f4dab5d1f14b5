"""The service keeps what a judged measurement frees: a window is not to be paid for in new pages."""

import ctypes
import gc
import subprocess
import sys
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.recording import Window
from service.store import waveforms
from tests.service.conftest import START, running_service, simulated_measurement

#: Nine MiB in three arrays, as a measurement that is judged takes and frees them, twenty times.
PROGRAM = """
import resource
import numpy as np
from service.cli.serve import keep_freed_memory

def judge():
    return sum(array.size for array in [np.ones(3 * 2**17) for _ in range(3)])

if {kept}:
    keep_freed_memory()
judge()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    judge()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
PAGES = 20 * 9 * 2**20 // 4096


def new_pages(*, kept: bool) -> int:
    """Return how many pages the system had to give a process of its own."""
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(kept=kept)], check=True, capture_output=True, text=True, timeout=120
    )
    return int(ended.stdout)


@pytest.mark.release
@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="another C library than glibc")
def test_freed_memory_is_taken_again_without_new_pages() -> None:
    """Without the setting nearly every page is new each time, which shows that the pattern asks for it."""
    assert new_pages(kept=False) > PAGES / 2
    assert new_pages(kept=True) < PAGES / 100


def test_samples_of_a_request_are_freed_without_the_collector(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a circle of records each measurement stays until Python collects it: tens of MiB for long windows."""
    monkeypatch.setattr(waveforms, "REMEMBERED_BYTES", 0)
    with running_service(tmp_path) as api:
        rng = np.random.default_rng(1)
        api.register("axis", windows_per_measurement=4)
        gc.disable()
        try:
            for name, start in (("first-taken", START), ("taken-next", START + timedelta(days=1))):
                api.accept("axis", simulated_measurement(rng, name, n_windows=4, started_at=start), complete=True)
            # while the second was taken, the first was let go
            held = {item.measurement for item in gc.get_objects() if type(item) is Window}
        finally:
            gc.enable()
    assert "first-taken" not in held
