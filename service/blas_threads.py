"""Compute in one thread: the matrices are small, and several BLAS threads only wait for each other, spinning."""

import os
import sys

from threadpoolctl import threadpool_limits

#: What the libraries below numpy and scipy read when they are loaded. They come one by one (scipy has a BLAS of its
#: own), so that a limit on those that are loaded already does not hold for the next.
VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")


def compute_in_one_thread() -> None:
    """Limit the mathematics of this process to one thread, and that of processes it starts from now on.

    What the environment said before gives way: the figures of the documentation are those of one thread.
    """
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    if "numpy" in sys.modules:  # it was loaded before somebody asked
        threadpool_limits(limits=1)
