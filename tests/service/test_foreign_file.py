"""What a library does to its process while it reads a file is one sentence, and ends nothing else."""

import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings.session_hdf5 import open_session, write_session
from service.operations import foreign_file, own_process
from service.operations.foreign_file import foreign_session, read_foreign, reading
from service.operations.own_process import Bounds, OwnProcess, Progress, Report, Reporting
from tests.conftest import PROJECT_ROOT
from tests.service import stand_in_readers as stand_ins
from tests.service.stand_in_readers import MIB

#: A test that waits waits so long at most [s].
LONGEST = 60.0


@pytest.fixture
def no_process_is_left() -> Iterator[None]:
    """Expect that each process that the test starts has ended; others of this one may be older."""
    older = set(multiprocessing.active_children())
    yield
    assert set(multiprocessing.active_children()) <= older


@pytest.fixture(params=["forked", "from the fork server"])
def either_way(request: pytest.FixtureRequest) -> Iterator[None]:
    """Read as a command does, and as a service does, which has threads."""
    if request.param == "forked":
        if threading.active_count() > 1:
            pytest.skip("another test has left a thread")
        yield
        return
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    yield
    done.set()
    thread.join()


ENDS: dict[str, tuple[Callable[..., Any], str]] = {
    "aborts": (stand_ins.aborts, "by signal SIGABRT: it is damaged, or too large for this machine"),
    "is killed": (stand_ins.is_killed, "by signal SIGKILL: it is damaged, or too large for this machine"),
    "exits": (stand_ins.exits, "with exit code 3: it is damaged, or too large for this machine"),
    "takes all memory": (stand_ins.takes_all_memory, "read in 256 MiB of memory; this one takes more"),
}


@pytest.mark.usefixtures("either_way", "no_process_is_left")
@pytest.mark.parametrize("end", ENDS)
def test_an_end_of_the_reader_is_one_sentence(monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    monkeypatch.setattr(foreign_file, "BOUNDS", Bounds(256 * MIB, 900.0))
    reader, words = ENDS[end]
    with pytest.raises(RecordingFormatError) as refusal:
        read_foreign(reader, "p.npz")
    sentence = str(refusal.value)
    assert sentence.startswith("p.npz: expected a recording that")
    assert words in sentence
    assert "\n" not in sentence


@pytest.mark.usefixtures("either_way", "no_process_is_left")
def test_a_reader_without_progress_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign_file, "BOUNDS", Bounds(256 * MIB, 0.6))
    with pytest.raises(RecordingFormatError, match=r"p\.npz: expected a recording that is read within 0\.01 minutes"):
        read_foreign(stand_ins.never_ends, "p.npz")


def steps(report: Report) -> str:
    for number in range(8):
        report(Progress(number))
    return "read"


def test_a_reader_that_goes_on_may_take_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    receive, hours = OwnProcess._receive, 0.0

    def later(process: OwnProcess) -> object:
        nonlocal hours
        hours += 0.2  # the bound is a quarter of an hour, and there are eight steps
        return receive(process)

    monkeypatch.setattr(own_process, "monotonic", lambda: 3600.0 * hours)
    monkeypatch.setattr(OwnProcess, "_receive", later)
    with reading(Reporting(steps), "p.npz") as process:
        assert process.answer() == "read"


@pytest.mark.usefixtures("either_way", "no_process_is_left")
def test_errors_keep_their_class_and_text() -> None:
    with pytest.raises(RecordingFormatError) as refusal:
        read_foreign(stand_ins.refuses, "a.mat")
    assert str(refusal.value) == "a.mat: expected numbers; got none"
    # its class takes something else: by name and text, or as it is where a library has taught pickle to send it
    with pytest.raises(Exception, match=r"a\.mat is odd: 7"):
        read_foreign(stand_ins.is_odd, "a.mat")
    with pytest.raises(MissingReaderError, match=r"a\.mat: expected the library that reads it; it cannot be loaded"):
        read_foreign(stand_ins.lacks_its_library, "a.mat")


@pytest.mark.usefixtures("either_way", "no_process_is_left")
def test_arrays_arrive_as_they_are() -> None:
    fixed, free = read_foreign(stand_ins.gives_arrays, "a.mat")
    np.testing.assert_array_equal(fixed, np.arange(5.0))
    assert not fixed.flags.writeable
    assert free.dtype == np.float32
    assert read_foreign(stand_ins.gives_its_process, "a.mat") != os.getpid()


@pytest.fixture
def session_file(tmp_path: Path) -> Path:
    start = datetime(2025, 3, 1, tzinfo=UTC)
    windows = tuple(
        Window(np.arange(32.0), np.ones(32), 1e3, start + timedelta(seconds=i), Conditions(0.1 * i), f"m{i // 2}")
        for i in range(6)
    )
    write_session(tmp_path / "a.session.h5", Session("x", windows))
    return tmp_path / "a.session.h5"


@pytest.mark.usefixtures("either_way", "no_process_is_left")
def test_a_session_gives_its_windows_in_any_order(session_file: Path) -> None:
    with open_session(session_file) as here, foreign_session(session_file) as elsewhere:
        assert elsewhere.measurements == here.measurements
        for name in (*reversed(here.measurements), "m0"):
            for window, expected in zip(elsewhere.windows_of(name), here.windows_of(name), strict=True):
                np.testing.assert_array_equal(window.excitation, expected.excitation)
                assert not window.excitation.flags.writeable
                assert (window.started_at, window.conditions) == (expected.started_at, expected.conditions)


def test_a_window_that_is_refused_is_refused_by_the_same_sentence(session_file: Path) -> None:
    with h5py.File(session_file, "r+") as file:
        file["windows/000003"].attrs["response_unit"] = "g"
    with foreign_session(session_file) as session:
        assert len(session.windows_of(session.measurements[0])) == 1
        with pytest.raises(RecordingFormatError, match=r"/windows/000003, response_unit: expected 'm/s2'; got 'g'"):
            list(map(session.windows_of, session.measurements))


# The command line


def command(*words: str, **settings: Any) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, *words],
        cwd=PROJECT_ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **settings,
    )


def with_stand_in(reader: Callable[..., Any], file: Path, **settings: Any) -> "subprocess.Popen[str]":
    return command("-m", "tests.service.stand_in_readers", reader.__name__, "check", str(file), **settings)


def refused(process: "subprocess.Popen[str]") -> str:
    """Bad input: exit 2, one line on standard error, nothing on standard output."""
    out, err = process.communicate(timeout=LONGEST)
    assert (process.returncode, out) == (2, ""), err
    assert err.startswith("preload: ")
    assert err.count("\n") == 1, err
    return err


def test_a_command_survives_its_reader(session_file: Path) -> None:
    assert "by signal SIGABRT: it is damaged, or too large" in refused(with_stand_in(stand_ins.aborts, session_file))


def test_a_limit_of_the_shell_is_named(session_file: Path) -> None:
    limits = partial(resource.setrlimit, resource.RLIMIT_DATA, (1000 * MIB, 1000 * MIB))
    process = with_stand_in(stand_ins.takes_all_memory, session_file, preexec_fn=limits)
    assert "is read in 1000 MiB of memory; this one takes more" in refused(process)


def wait_until(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + LONGEST
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.05)


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def reading_for_ever(session_file: Path, tmp_path: Path) -> tuple["subprocess.Popen[str]", int]:
    """Return a command that reads, and the number of the process that does."""
    place = tmp_path / "process"
    process = with_stand_in(
        stand_ins.says_where_it_is_and_never_ends, session_file,
        start_new_session=True, env=os.environ | {"STAND_IN_PROCESS": str(place)},
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # a shell may have it ignored
    )  # fmt: skip
    wait_until(lambda: place.exists() and bool(place.read_text()))
    return process, int(place.read_text())


@pytest.mark.parametrize(
    "send",
    [pytest.param(os.kill, id="the command", marks=pytest.mark.release), pytest.param(os.killpg, id="the terminal")],
)
def test_ctrl_c_ends_the_command_and_its_reader(
    reading_for_ever: tuple["subprocess.Popen[str]", int], send: Callable[[int, int], None]
) -> None:
    process, reader = reading_for_ever
    send(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=LONGEST)
    assert (process.returncode, err.strip()) == (1, "stopped")
    wait_until(lambda: not is_running(reader))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with the one that it comes from")
def test_a_command_that_is_killed_takes_its_reader_along(
    reading_for_ever: tuple["subprocess.Popen[str]", int],
) -> None:
    process, reader = reading_for_ever
    process.kill()
    process.communicate(timeout=LONGEST)
    wait_until(lambda: not is_running(reader))


WITHOUT_GUARD = """
import sys, threading
from service.cli.main import main

threading.Thread(target=threading.Event().wait, daemon=True).start()
sys.argv = ["preload", "check", {file!r}]
main()
"""


def test_a_program_that_keeps_the_process_from_beginning_is_told_so(session_file: Path, tmp_path: Path) -> None:
    """Its threads keep the process from being forked, and whatever is not guarded in it would run once more."""
    script = tmp_path / "script.py"
    script.write_text(WITHOUT_GUARD.format(file=str(session_file)))
    process = command(str(script), env=os.environ | {"PYTHONPATH": str(PROJECT_ROOT)})
    _, err = process.communicate(timeout=LONGEST)
    (sentence,) = (line for line in err.splitlines() if line.startswith("preload: "))
    assert "ended before it began, with exit code 1" in sentence
    assert "if __name__ == '__main__':" in sentence
    assert "damaged" not in sentence
