"""Small frames are written by a process of its own: what its disk says, what becomes of it, and what then."""

import errno
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import zstandard

from service.errors import StorageError
from service.store import waveforms
from service.store.frame_writer import PLACES, FrameWriter
from service.store.waveform_files import FolderFiles
from service.store.waveforms import WaveformPlace, WaveformStore
from service.store.window_format import content_sha256
from tests.service.test_waveforms import NOW, window, written


def writing_processes(service: int) -> list[int]:
    """Return the numbers of the processes that write frames for a service, given the number of its own."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            command, stat = (entry / "cmdline").read_bytes(), (entry / "stat").read_text()
        except (FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
            continue
        if b"service.store.frame_process" in command and int(stat.rpartition(")")[2].split()[1]) == service:
            found.append(int(entry.name))
    return found


def is_running(process: int) -> bool:
    try:
        return "(zombie)" not in Path(f"/proc/{process}/status").read_text()
    except FileNotFoundError:
        return False


def await_end(process: int) -> None:
    for _ in range(500):
        if not is_running(process):
            return
        time.sleep(0.02)
    raise AssertionError(f"process {process} is still running")


@pytest.fixture
def store(tmp_path: Path) -> Iterator[WaveformStore]:
    store = WaveformStore(FolderFiles(tmp_path, FrameWriter()))
    yield store
    store.close()
    assert writing_processes(os.getpid()) == []


def content_of(folder: Path) -> bytes:
    (file,) = folder.rglob("*.zst")
    return file.read_bytes()


def test_process_starts_with_the_first_frame_and_writes_what_this_one_would(
    store: WaveformStore, tmp_path: Path
) -> None:
    assert writing_processes(os.getpid()) == []
    ours = WaveformStore(tmp_path / "ours")
    for seed in range(3):
        written(store, window(seed))
        written(ours, window(seed))
    assert len(writing_processes(os.getpid())) == 1
    assert content_of(tmp_path / "raw") == content_of(tmp_path / "ours")


def test_frames_of_many_axes_are_under_way_at_once_and_waited_for_in_any_order(
    store: WaveformStore, tmp_path: Path
) -> None:
    """More than there are places: the rest is written here."""
    n_axes = PLACES + 3
    with ExitStack() as open_frames:
        frames = [
            open_frames.enter_context(store.begin_write(f"axis-{i}", [window(i)], NOW)) for i in reversed(range(n_axes))
        ]
        places = [place for frame in frames for place in frame.sync()]
        for frame in frames:
            frame.keep()
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == [
        f"m{i}" for i in reversed(range(n_axes))
    ]
    written(store, window(0))  # and the places are free again


def test_what_the_disk_refuses_there_is_said_here(store: WaveformStore, tmp_path: Path) -> None:
    first = written(store, window(0))
    (process,) = writing_processes(os.getpid())
    size = len(content_of(tmp_path))
    unlimited = resource.prlimit(process, resource.RLIMIT_FSIZE, (size + 100, resource.RLIM_INFINITY))
    with store.begin_write("axis", [window(1)], NOW) as writing:
        for _ in range(2):  # whoever asks twice is told twice
            with pytest.raises(StorageError, match="File too large"):
                writing.sync()
    assert len(content_of(tmp_path)) == size  # what was written of it is gone
    resource.prlimit(process, resource.RLIMIT_FSIZE, unlimited)
    second = written(store, window(2))
    assert second.path != first.path  # as of every file that failed
    assert [item.measurement for item in WaveformStore(tmp_path).read([first, second])] == ["m0", "m2"]


def test_frame_that_nobody_waits_for_is_taken_back_whole(store: WaveformStore, tmp_path: Path) -> None:
    """Its windows turn out to contradict stored ones, say: what is still being written must not come afterwards."""
    written(store, window(0))
    size = len(content_of(tmp_path))
    for seed in range(20):
        with store.begin_write("axis", [window(seed, 60_000)], NOW):
            pass
        assert len(content_of(tmp_path)) == size


def test_frame_lies_where_its_row_says_whatever_became_of_the_one_before(
    store: WaveformStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one before is refused while it is still being written."""
    first = written(store, window(0))
    (process,) = writing_processes(os.getpid())

    def fail(_: object) -> None:
        raise MemoryError

    os.kill(process, signal.SIGSTOP)
    threading.Timer(0.2, os.kill, (process, signal.SIGCONT)).start()
    with monkeypatch.context() as broken:
        broken.setattr(waveforms, "content_sha256", fail)
        with pytest.raises(MemoryError):
            store.begin_write("axis", [window(1)], NOW)
    second = written(store, window(2))
    assert second.path == first.path
    assert [item.measurement for item in WaveformStore(tmp_path).read([first, second])] == ["m0", "m2"]
    descriptors = len(os.listdir("/proc/self/fd"))
    written(store, window(3))
    assert len(os.listdir("/proc/self/fd")) == descriptors


def test_what_is_under_way_when_a_store_is_closed_is_finished(tmp_path: Path) -> None:
    store = WaveformStore(FolderFiles(tmp_path, FrameWriter()))
    before = written(store, window(0))
    (process,) = writing_processes(os.getpid())
    os.kill(process, signal.SIGSTOP)
    threading.Timer(0.2, os.kill, (process, signal.SIGCONT)).start()
    with store.begin_write("kept", [window(1)], NOW) as kept, store.begin_write("axis", [window(2)], NOW):
        store.close()
        places = [before, *kept.sync()]
        kept.keep()
    assert not is_running(process)
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == ["m0", "m1"]
    (file,) = (tmp_path / "raw").rglob("axis/*.zst")
    assert file.stat().st_size == zstd_size(tmp_path, before), "what was not kept is gone"
    places.append(written(store, window(3)))  # by the service: the process has ended
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == ["m0", "m1", "m3"]


def zstd_size(folder: Path, place: WaveformPlace) -> int:
    """Return where the frame that lies in a place ends."""
    content = (folder / place.path).read_bytes()[place.offset :]
    reader = zstandard.ZstdDecompressor().decompressobj()
    reader.decompress(content)
    return place.offset + len(content) - len(reader.unused_data)


def test_process_killed_at_any_moment_leaves_what_was_said_to_be_there(tmp_path: Path) -> None:
    rng, n_failed = np.random.default_rng(), 0
    for turn in range(12):
        store = WaveformStore(FolderFiles(tmp_path / str(turn), FrameWriter()))
        places = [written(store, window(0, 20_000))]
        (process,) = writing_processes(os.getpid())
        threading.Timer(rng.uniform(0.0, 0.01), os.kill, (process, signal.SIGKILL)).start()
        for seed in range(1, 12):
            try:
                places.append(written(store, window(seed, 20_000)))
            except StorageError:
                n_failed += 1
        await_end(process)
        found = WaveformStore(tmp_path / str(turn)).read(places)
        assert [content_sha256(item) for item in found] == [place.content_sha256 for place in places]
        store.close()
    assert n_failed <= 12, "each costs the one that was under way"


def test_process_that_is_killed_costs_one_request(
    store: WaveformStore, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first = written(store, window(0))
    (process,) = writing_processes(os.getpid())
    os.kill(process, signal.SIGSTOP)  # it has the next frame, and does nothing with it
    with store.begin_write("axis", [window(1)], NOW) as writing:
        os.kill(process, signal.SIGKILL)
        with pytest.raises(StorageError, match=r"the process that writes them has ended\); nothing of the request"):
            writing.sync()
    places = [first, *(written(store, window(seed)) for seed in (2, 3))]
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == ["m0", "m2", "m3"]
    assert caplog.text.count("the service does it now") == 1


def test_process_that_has_ended_is_found_out_before_anything_is_handed_over(
    store: WaveformStore, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    places = [written(store, window(0))]
    (process,) = writing_processes(os.getpid())
    os.kill(process, signal.SIGKILL)
    await_end(process)
    places += [written(store, window(seed)) for seed in (1, 2)]
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == ["m0", "m1", "m2"]
    assert caplog.text.count("the service does it now") == 1


def test_machine_that_starts_no_process_writes_here(
    store: WaveformStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr(subprocess, "Popen", refuse)
    places = [written(store, window(seed)) for seed in range(2)]
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == ["m0", "m1"]
    assert caplog.text.count("cannot be started") == 1


@pytest.mark.parametrize("signal_of_all", [signal.SIGTERM, signal.SIGINT])
def test_what_ends_a_service_gently_leaves_its_process_to_it(
    store: WaveformStore, tmp_path: Path, signal_of_all: int
) -> None:
    """A terminal interrupts all, and systemd terminates all: frames under way are still wanted, the first one, too."""
    with store.begin_write("axis", [window(0)], NOW) as writing:
        while not (processes := writing_processes(os.getpid())):  # which has its name once it is more than a copy
            time.sleep(0.001)
        (process,) = processes
        os.kill(process, signal_of_all)  # while it starts
        places = writing.sync()
        writing.keep()
    os.kill(process, signal_of_all)
    places.append(written(store, window(1)))
    assert writing_processes(os.getpid()) == [process]
    assert len(WaveformStore(tmp_path).read(places)) == 2


_SERVICE = """
import sys, time
from pathlib import Path
from service.store.frame_writer import FrameWriter
from service.store.waveform_files import FolderFiles
from service.store.waveforms import WaveformStore
from tests.service.test_waveforms import window, written
store = WaveformStore(FolderFiles(Path(sys.argv[1]), FrameWriter()))
written(store, window(0))
print("written", flush=True)
time.sleep(600)
"""


def test_process_does_not_outlive_a_service_that_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", _SERVICE, str(tmp_path)], stdout=subprocess.PIPE) as service:
        try:
            assert service.stdout is not None
            assert service.stdout.readline() == b"written\n"
            (process,) = writing_processes(service.pid)
        finally:
            service.kill()
    await_end(process)


@pytest.mark.release
def test_service_is_not_taken_from_the_folder_that_it_is_started_in(tmp_path: Path) -> None:
    """A user's own folder may be called ``service``."""
    (tmp_path / "service").mkdir()
    (tmp_path / "service" / "__init__.py").write_text("raise SystemExit('of somebody else')")
    code = _SERVICE.replace("time.sleep(600)", "") + "\nimport os; print(len(os.listdir('raw')))"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-P", "-c", code, str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "written\n1\n"
    assert "somebody else" not in done.stderr
