"""Waveform files: what is remembered, what is read back, what is removed."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from monitor_core.recording import Conditions, Window
from service.store import waveforms
from service.store.waveforms import WaveformStore, content_sha256
from tests.service.conftest import START

NOW = datetime(2026, 3, 2, tzinfo=UTC)


def window(seed: int, n_samples: int = 1000) -> Window:
    excitation, response = np.random.default_rng(seed).normal(size=(2, n_samples)).astype(np.float32)
    return Window(excitation, response, 1024.0, START, Conditions(0.5), f"m{seed}")


@pytest.mark.parametrize("n_samples", [1000, 200_000])  # packed at once, and handed over to a thread
def test_what_was_written_is_read_back(tmp_path: Path, n_samples: int) -> None:
    posted = [window(1, n_samples), window(2, n_samples)]
    store = WaveformStore(tmp_path)
    with store.begin_write("axis", posted, NOW) as writing:
        places = writing.sync()
        writing.keep()
    assert [place.content_sha256 for place in places] == [content_sha256(item) for item in posted]
    remembered, fresh = store.read(places), WaveformStore(tmp_path).read(places)
    for i, item in enumerate(posted):
        assert remembered[i] is item
        assert content_sha256(fresh[i]) == content_sha256(item)


@pytest.mark.parametrize("n_samples", [1000, 200_000])
def test_a_file_that_is_not_kept_is_removed(tmp_path: Path, n_samples: int) -> None:
    with WaveformStore(tmp_path).begin_write("axis", [window(1, n_samples)], NOW) as writing:
        path = tmp_path / writing.sync()[0].path
        assert path.is_file()
    assert not path.exists()


def test_memory_of_windows_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = window(0)
    monkeypatch.setattr(waveforms, "REMEMBERED_BYTES", 3 * (one.excitation.nbytes + one.response.nbytes))
    store, posted, places = WaveformStore(tmp_path), [window(seed) for seed in range(5)], []
    for item in posted:
        with store.begin_write("axis", [item], NOW) as writing:
            places += writing.sync()
            writing.keep()
    remembered = [store.read([place])[0] is item for place, item in zip(places, posted, strict=True)]
    assert remembered == [False, False, True, True, True]
