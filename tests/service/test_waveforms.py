"""Waveform files: what is remembered, what is read back, what is removed."""

import errno
import mmap
import os
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zstandard

from monitor_core.recording import Conditions, ResponseQuantity, Window
from service.errors import StorageError, WaveformDamagedError
from service.store import waveform_files, waveforms
from service.store.frame_writer import FrameWriter
from service.store.waveform_files import FolderFiles
from service.store.waveforms import WaveformPlace, WaveformStore
from service.store.window_format import content_sha256, pack_windows, unpack_windows
from tests.service.conftest import START
from tests.service.test_failures import failing_once

NOW = datetime(2026, 3, 2, tzinfo=UTC)


def window(seed: int, n_samples: int = 1000) -> Window:
    excitation, response = np.random.default_rng(seed).normal(size=(2, n_samples)).astype(np.float32)
    return Window(excitation, response, 1024.0, START, Conditions(0.5), f"m{seed}")


@pytest.fixture(params=[False, True], ids=["written here", "written by a process"])
def store(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[WaveformStore]:
    store = WaveformStore(FolderFiles(tmp_path, FrameWriter() if request.param else None))
    yield store
    store.close()


@pytest.mark.parametrize("n_samples", [1000, 200_000])  # small enough for one step, and handed over to a thread
def test_what_was_written_is_read_back(store: WaveformStore, tmp_path: Path, n_samples: int) -> None:
    posted = [window(1, n_samples), window(2, n_samples)]
    with store.begin_write("axis", posted, NOW) as writing:
        places = writing.sync()
        writing.keep()
    assert [place.content_sha256 for place in places] == [content_sha256(item) for item in posted]
    remembered, fresh = store.read(places), WaveformStore(tmp_path).read(places)
    for i, item in enumerate(posted):
        assert remembered[i] is item
        assert content_sha256(fresh[i]) == content_sha256(item)


def test_what_windows_say_of_their_response_is_kept_and_older_ones_keep_their_hash() -> None:
    ramp = np.arange(4, dtype=np.float32)
    plain = Window(ramp, 4 - ramp, 1024.0, START, Conditions(0.5, 0.0, 21.5), "early")
    of_scale = replace(plain, response_quantity=ResponseQuantity.DISPLACEMENT, response_resolution=1e-7)
    # what was made of the first before these were stated; another hash would make another window of each stored one
    assert content_sha256(plain) == "9422cdd62e7153c96debc3b81a14b87e74895fa720cd69cee984e2cdbca17eb2"
    assert content_sha256(of_scale) != content_sha256(plain)
    (read,) = unpack_windows(b"".join(bytes(part) for part in pack_windows([of_scale])))
    assert (read.response_quantity, read.response_resolution) == (ResponseQuantity.DISPLACEMENT, 1e-7)
    assert content_sha256(read) == content_sha256(of_scale)


def written(store: WaveformStore, item: Window, at: datetime = NOW) -> WaveformPlace:
    with store.begin_write("axis", [item], at) as writing:
        (place,) = writing.sync()
        writing.keep()
    return place


def test_file_grows_request_by_request_and_is_plain_zstd_around_messagepack(
    store: WaveformStore, tmp_path: Path
) -> None:
    posted = [window(seed) for seed in range(3)]
    places = [written(store, item) for item in posted]
    assert [place.path for place in places] == [places[0].path] * 3
    fresh = WaveformStore(tmp_path).read(places[::-1])
    assert [content_sha256(item) for item in fresh] == [content_sha256(item) for item in posted[::-1]]
    with (tmp_path / places[0].path).open("rb") as file:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        frames = list(msgpack.Unpacker(reader))
    assert [item["measurement"] for frame in frames for item in frame] == ["m0", "m1", "m2"]


def bytes_from_disk() -> int:
    """Return how many bytes this process had the system read from a disk."""
    counts = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(counts["read_bytes"])


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="only Linux counts what a process reads")
def test_next_frame_reads_nothing_back(tmp_path: Path) -> None:
    """A frame begins in the page that the one before ended in: forgotten, it would be read from the disk first."""
    store = WaveformStore(tmp_path)
    written(store, window(0))
    before = bytes_from_disk()
    for seed in range(1, 6):
        written(store, window(seed))
    assert bytes_from_disk() - before < 5 * mmap.PAGESIZE  # a page for each; the process may read one of its own


@pytest.mark.parametrize("n_samples", [1000, 200_000])
@pytest.mark.parametrize("n_before", [0, 2])
def test_what_is_not_kept_is_taken_back(store: WaveformStore, tmp_path: Path, n_samples: int, n_before: int) -> None:
    before = [written(store, window(seed)) for seed in range(n_before)]
    size = sum(file.stat().st_size for file in tmp_path.rglob("*.zst"))
    with store.begin_write("axis", [window(10, n_samples)], NOW) as writing:
        (place,) = writing.sync()
        assert (tmp_path / place.path).stat().st_size > size
    assert sum(file.stat().st_size for file in tmp_path.rglob("*.zst")) == size
    with pytest.raises(WaveformDamagedError):
        store.read([place])
    places = [*before, written(store, window(11))]
    assert [item.measurement for item in WaveformStore(tmp_path).read(places)] == [f"m{i}" for i in range(n_before)] + [
        "m11"
    ]


def test_another_file_is_begun(store: WaveformStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = written(store, window(0))
    next_day = written(store, window(1), NOW + timedelta(days=1))
    assert (first.path.split("/")[:4], next_day.path.split("/")[:4]) == (
        ["raw", "2026", "03", "02"],
        ["raw", "2026", "03", "03"],
    )
    monkeypatch.setattr(waveform_files, "LARGEST_FILE_BYTES", 1)
    beside = written(store, window(2), NOW + timedelta(days=1))
    assert beside.path not in (first.path, next_day.path)
    monkeypatch.undo()
    (tmp_path / beside.path).unlink()  # somebody put it away
    after = written(store, window(3), NOW + timedelta(days=1))
    assert (after.path != beside.path, after.offset) == (True, 0)
    (tmp_path / after.path).rename(tmp_path / "kept")
    (tmp_path / after.path).mkdir()  # it is there, and cannot be opened
    last = written(store, window(4), NOW + timedelta(days=1))
    assert (last.path != after.path, last.offset) == (True, 0)
    assert len(WaveformStore(tmp_path).read([first, next_day, last])) == 3


def test_file_that_failed_takes_nothing_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = WaveformStore(tmp_path)
    first = written(store, window(0))
    with monkeypatch.context() as broken, store.begin_write("axis", [window(1)], NOW) as writing:
        broken.setattr(os, "fsync", failing_once(os.fsync, OSError(errno.EIO, os.strerror(errno.EIO))))
        with pytest.raises(StorageError, match="Input/output error"):
            writing.sync()
    second = written(store, window(2))
    assert second.path != first.path
    assert [item.measurement for item in WaveformStore(tmp_path).read([first, second])] == ["m0", "m2"]


def test_memory_of_windows_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = window(0)
    monkeypatch.setattr(waveforms, "REMEMBERED_BYTES", 3 * (sample.excitation.nbytes + sample.response.nbytes))
    store, posted = WaveformStore(tmp_path), [window(seed) for seed in range(5)]
    places = [written(store, item) for item in posted]
    remembered = [store.read([place])[0] is item for place, item in zip(places, posted, strict=True)]
    assert remembered == [False, False, True, True, True]
