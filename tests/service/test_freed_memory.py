"""The service keeps what a judged measurement frees: a window is not to be paid for in new pages."""

import ctypes
import subprocess
import sys

import pytest

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


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="another C library than glibc")
def test_freed_memory_is_taken_again_without_new_pages() -> None:
    """Without the setting nearly every page is new each time, which shows that the pattern asks for it."""
    assert new_pages(kept=False) > PAGES / 2
    assert new_pages(kept=True) < PAGES / 100
