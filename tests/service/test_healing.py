"""A lost or damaged waveform is written again when its window is sent again, and the answer says so."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.service.conftest import assert_problem, running_service, simulated_measurement
from tests.service.test_ingest import stored_frames


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


@pytest.mark.parametrize(
    ("harm", "restarted"),
    [
        (flip, True),
        (cut, False),
        (Path.unlink, False),
        *(pytest.param(*case, marks=pytest.mark.release) for case in ((flip, False), (cut, True), (Path.unlink, True))),
    ],
)
def test_window_sent_again_heals_its_waveform(tmp_path: Path, harm: Callable[[Path], None], restarted: bool) -> None:
    rng = np.random.default_rng(13)
    windows = simulated_measurement(rng, "m", set_preload=300.0)
    with running_service(tmp_path) as api:
        api.register("axis")
        api.accept("axis", windows)
        trend = api.trend("axis")
        ((file, _),) = stored_frames(tmp_path)
        if not restarted:
            harm(file)
            answer = api.accept("axis", windows)
    if restarted:
        harm(file)
        with running_service(tmp_path) as api:
            assert_problem(
                api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}}), 500, "waveform-damaged"
            )
            answer = api.accept("axis", windows)
    assert (answer["accepted"], answer["already_there"]) == (0, 15)
    healed = [item for item in answer["windows"] if item["reason"] == "waveform-restored"]
    assert len(healed) == (1 if harm is flip else 15)  # a bit spoils the window that it is of
    assert "written again" in healed[0]["detail"]
    with running_service(tmp_path) as api:
        assert api.trend("axis") == trend  # what was judged stays
        # the waveforms can be read: what is wrong with the calibration is that one position is too few
        assert_problem(api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}}), 422, "not-identifiable")
        again = api.accept("axis", windows)
        assert {item["reason"] for item in again["windows"]} == {None}


def test_measurement_goes_on_with_what_was_healed(tmp_path: Path) -> None:
    *windows, last = simulated_measurement(np.random.default_rng(13), "m")
    with running_service(tmp_path) as api:
        api.register("axis")
        api.accept("axis", windows)
    ((file, _),) = stored_frames(tmp_path)
    cut(file)
    with running_service(tmp_path) as api:
        answer = api.accept("axis", [*windows, last])
        assert [item["reason"] for item in answer["windows"]] == ["waveform-restored"] * 14 + [None]
        (outcome,) = answer["measurements"]
        assert not outcome["refused"]


def test_what_is_whole_is_not_written_again_and_another_window_heals_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    windows, others = (simulated_measurement(rng, "m") for _ in range(2))
    with running_service(tmp_path) as api:
        api.register("axis")
        api.accept("axis", windows)
        ((file, offset),) = stored_frames(tmp_path)
        content = file.read_bytes()
        assert api.accept("axis", windows)["windows"][0]["reason"] is None
        assert (stored_frames(tmp_path), file.read_bytes()) == ([(file, offset)], content)
        flip(file)
        harmed = file.read_bytes()
        assert_problem(api.post("axis", others), 409, "conflict")
        assert file.read_bytes() == harmed
