"""Work in a process of its own whose process is ended by something else: it is begun anew, once."""

import os
import signal
import threading
from collections.abc import Iterator
from functools import partial
from multiprocessing.forkserver import _forkserver
from pathlib import Path

import pytest

from service.operations.own_process import EndedAgainError, Progress, Report, in_own_process


@pytest.fixture(autouse=True)
def beside_a_thread() -> Iterator[None]:
    """Let the processes come from where those of a service do."""
    ended = threading.Event()
    thread = threading.Thread(target=ended.wait)
    thread.start()
    yield
    ended.set()
    thread.join()


def is_killed_at_first(begun: Path, times: int, _: Report) -> int:
    """Return how often it was begun, unless it is killed."""
    n_begun = len(begun.read_text()) + 1 if begun.exists() else 1
    begun.write_text("." * n_begun)
    if n_begun <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return n_begun


def kills_where_it_comes_from(begun: Path, _: Report) -> str:
    """Return how it went where the process was ended that every other is forked from, and this one with it."""
    if not begun.exists():
        begun.touch()
        os.kill(os.getppid(), signal.SIGKILL)
        signal.pause()
    return "anew"


def test_work_whose_process_is_killed_is_begun_anew(tmp_path: Path) -> None:
    assert in_own_process(partial(is_killed_at_first, tmp_path / "begun", 1), lambda _: None, Progress(0)) == 2


def test_work_that_is_killed_again_says_so(tmp_path: Path) -> None:
    with pytest.raises(EndedAgainError, match="twice, the second time by signal SIGKILL: most often the system"):
        in_own_process(partial(is_killed_at_first, tmp_path / "begun", 2), lambda _: None, Progress(0))
    assert (tmp_path / "begun").read_text() == ".."


@pytest.mark.release  # the process that others are forked from is started anew
def test_work_goes_on_without_the_process_that_it_came_from(tmp_path: Path) -> None:
    assert in_own_process(partial(kills_where_it_comes_from, tmp_path / "begun"), lambda _: None, Progress(0)) == "anew"


@pytest.mark.release  # the process that others are forked from is started anew
def test_work_that_cannot_be_handed_over_is_begun_anew(tmp_path: Path) -> None:
    """The process that others are forked from is killed while nothing is at work: the pipe to it is broken."""
    in_own_process(partial(is_killed_at_first, tmp_path / "first", 0), lambda _: None, Progress(0))
    os.kill(_forkserver._forkserver_pid, signal.SIGKILL)
    assert in_own_process(partial(is_killed_at_first, tmp_path / "second", 0), lambda _: None, Progress(0)) == 1
