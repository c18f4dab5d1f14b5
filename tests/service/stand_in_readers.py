"""Harmless stand-ins for readers whose library does something to its process: no file is needed for it."""

import faulthandler
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from monitor_core.errors import RecordingFormatError

MIB = 2**20


class OddError(Exception):
    """An error that cannot be made anew from its text."""

    def __init__(self, place: str, number: int) -> None:
        super().__init__(f"{place} is odd: {number}")


def aborts(*_: Any) -> Any:
    faulthandler.disable()  # of pytest
    os.abort()


def is_killed(*_: Any) -> Any:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def exits(*_: Any) -> Any:
    os._exit(3)


def never_ends(*_: Any) -> Any:
    while True:
        time.sleep(0.1)


def takes_all_memory(*_: Any) -> Any:
    np.ones(2**28)
    raise AssertionError


def lacks_its_library(*_: Any) -> Any:
    raise ImportError("libodd.so: failed to map segment from shared object")


def refuses(*_: Any) -> Any:
    raise RecordingFormatError("a.mat: expected numbers; got none")


def is_odd(*_: Any) -> Any:
    raise OddError("a.mat", 7)


def gives_arrays(*_: Any) -> Any:
    fixed = np.arange(5.0)
    fixed.setflags(write=False)
    return fixed, np.arange(3, dtype="f4")


def gives_its_process(*_: Any) -> Any:
    return os.getpid()


def says_where_it_is_and_never_ends(*_: Any) -> Any:
    Path(os.environ["STAND_IN_PROCESS"]).write_text(str(os.getpid()))
    never_ends()


def in_place_of(check_file: Callable[..., Any], *words: str) -> None:
    """Run ``preload`` with a stand-in for what looks at a file."""
    from service.cli import check
    from service.cli.main import main

    check.check_file = check_file  # type: ignore[attr-defined]
    sys.argv = ["preload", *words]
    main()


if __name__ == "__main__":
    in_place_of(globals()[sys.argv[1]], *sys.argv[2:])
