"""BLAS of one thread, whether it was loaded before it is limited or after."""

import subprocess
import sys

import pytest

BEFORE, LIMIT = "import numpy, scipy.linalg", "from service.blas import use_one_thread; use_one_thread()"


@pytest.mark.parametrize("order", [(BEFORE, LIMIT), (LIMIT, BEFORE)], ids=["before", "after"])
def test_every_library_has_one_thread(order: tuple[str, str]) -> None:
    asked = "from threadpoolctl import threadpool_info; print([pool['num_threads'] for pool in threadpool_info()])"
    answer = subprocess.run([sys.executable, "-c", "; ".join([*order, asked])], capture_output=True, check=True)
    assert set(answer.stdout.decode().strip().strip("[]").split(", ")) == {"1"}
