"""Raw waveforms in an S3-compatible store: a real server on the loopback, which can be emptied and stopped."""

import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from service.app import create_app
from service.errors import DataFolderError, StorageError, WaveformDamagedError
from service.settings import Settings
from service.store.waveform_objects import ObjectFiles
from service.store.waveforms import WaveformStore
from tests.service.conftest import START, assert_problem, running_service, simulated_measurement

server = pytest.importorskip("moto.server")
pytest.importorskip("s3fs")

BUCKET, URL = "waveforms", "s3://waveforms/plant/line 1"


@pytest.fixture
def store_url(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Run an empty store and make the bucket; return its address."""
    running = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    url = f"http://{host}:{port}"
    for name, value in (
        ("AWS_ENDPOINT_URL", url),
        ("AWS_ACCESS_KEY_ID", "test"),
        ("AWS_SECRET_ACCESS_KEY", "test"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    httpx.post(f"{url}/moto-api/reset", trust_env=False, timeout=60.0).raise_for_status()
    httpx.put(f"{url}/{BUCKET}", trust_env=False, timeout=60.0).raise_for_status()
    yield url
    running.stop()


@pytest.mark.usefixtures("store_url")
def test_what_is_stored_is_there_for_another_service_and_never_under_a_name_of_its() -> None:
    windows = simulated_measurement(np.random.default_rng(1), "m", n_windows=4)
    stores = [WaveformStore(ObjectFiles(URL)) for _ in range(2)]
    places = []
    for store, share in zip(stores, (windows[:2], windows[2:]), strict=True):
        with store.begin_write("axis", share, START) as frame:
            places += frame.sync()
            frame.keep()
    assert len({place.path for place in places}) == 2
    assert all(place.path.startswith("raw/2026/03/02/axis/") for place in places)
    fresh = WaveformStore(ObjectFiles(URL))
    for window, read in zip(windows, fresh.read(places), strict=True):
        np.testing.assert_array_equal(read.response, window.response)
    assert sorted(path for path, _ in fresh.files.sizes()) == sorted({place.path for place in places})
    assert fresh.files.size(places[0].path)
    fresh.files.delete(places[0].path)
    fresh.files.delete(places[0].path)  # gone already
    assert not fresh.files.size(places[0].path)
    with pytest.raises(WaveformDamagedError, match="cannot be read"):
        fresh.read(places[:1])


@pytest.mark.usefixtures("store_url")
def test_frame_that_no_row_names_is_removed() -> None:
    store = WaveformStore(ObjectFiles(URL))
    with store.begin_write("axis", simulated_measurement(np.random.default_rng(1), "m", n_windows=1), START) as frame:
        frame.sync()
        assert len(list(store.files.sizes())) == 1
    assert list(store.files.sizes()) == []


@pytest.mark.usefixtures("store_url")
def test_the_whole_way_and_what_is_lost_there_is_healed(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    windows = simulated_measurement(rng, "m", set_preload=300.0)
    with running_service(tmp_path / "folder") as api:
        api.register("axis")
        expected = api.accept("axis", windows)["measurements"]
    with running_service(tmp_path / "var", waveform_url=URL) as api:
        api.register("axis")
        assert api.accept("axis", windows)["measurements"] == expected
        assert not (tmp_path / "var/raw").exists()
        files = ObjectFiles(URL)
        for path, _ in files.sizes():
            files.delete(path)
        answer = api.accept("axis", windows)
        assert {item["reason"] for item in answer["windows"]} == {"waveform-restored"}
    with running_service(tmp_path / "var", waveform_url=URL) as api:  # it remembers nothing, and reads them
        assert_problem(api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}}), 422, "not-identifiable")
        assert {item["reason"] for item in api.accept("axis", windows)["windows"]} == {None}


def test_store_that_does_not_take_a_window_is_503_and_nothing_is_stored(
    tmp_path: Path, store_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    windows = simulated_measurement(np.random.default_rng(1), "m", n_windows=2)
    with running_service(tmp_path / "var", waveform_url=URL) as api:
        api.register("axis")
        httpx.delete(f"{store_url}/{BUCKET}", trust_env=False).raise_for_status()
        problem = assert_problem(api.post("axis", windows), 503, "storage-failed")
        assert "bucket" in problem["detail"]
        httpx.put(f"{store_url}/{BUCKET}", trust_env=False, timeout=60.0).raise_for_status()
        assert api.accept("axis", windows)["accepted"] == 2
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")  # nobody listens
    store = WaveformStore(ObjectFiles(URL))
    with (
        pytest.raises(StorageError, match="did not take the waveforms"),
        store.begin_write("axis", windows, START) as frame,
    ):
        frame.sync()


def test_missing_extra_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with (
        pytest.raises(DataFolderError, match=r"need s3fs; pip install s3fs"),
        running_service(tmp_path, waveform_url=URL),
    ):
        pass


def test_other_stores_are_refused() -> None:
    with pytest.raises(ValueError, match="waveform_url"):
        create_app(Settings(waveform_url="ftp://host/waveforms"))
