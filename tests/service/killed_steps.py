"""A process that is killed before or after one of its calls that reach disk or database."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any


def count(counted: Any, fatal: int) -> None:
    """Count a step of this process, and kill it at the fatal one."""
    counted.value += 1
    if counted.value == fatal:
        os.kill(os.getpid(), signal.SIGKILL)


class Steps:
    """Work on a data folder in a process of its own, which is given the step to die at and the counter of steps."""

    _forks = multiprocessing.get_context("forkserver")

    def __init__(self, work: Callable[[Path, int, Any], None], data_dir: Path) -> None:
        self._forks.set_forkserver_preload([work.__module__])
        self._work, self._data_dir = work, data_dir

    def until(self, step: int) -> tuple[bool, int]:
        """Kill it at a step; return whether it was still at work, and how many steps it did."""
        counted = self._forks.Value("i", 0)
        process = self._forks.Process(target=self._work, args=(self._data_dir, step, counted))
        process.start()
        process.join()
        assert process.exitcode in (0, -signal.SIGKILL)
        return process.exitcode != 0, counted.value
