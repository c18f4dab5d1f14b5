"""Keep BLAS to one thread: the matrices are small, and several threads only wait for each other."""

import os

from threadpoolctl import threadpool_limits

#: What the BLAS of NumPy and of SciPy, each its own, read when they are loaded.
_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_thread() -> None:
    """Limit the libraries that this process has loaded, and those that it or a child of it will load."""
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    threadpool_limits(limits=1)
