"""Responses of a session: whose accelerometer is not placed, and the temperatures that its windows state."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor_core.measured_responses import SessionResponses
from monitor_core.recordings.session_hdf5 import read_session, write_session
from service.cli.inputs.data import Data, DataKind, axis_settings
from service.cli.inputs.model import responses_of_data
from tests.conftest import PROJECT_ROOT, canary


def responses(folder: Path, temperatures: Sequence[float | None]) -> SessionResponses:
    """Return the responses of measurements of the bundled calibration, tagged with these temperatures."""
    whole = read_session(PROJECT_ROOT / "replay_data" / "calibration.session.h5")
    names = list(dict.fromkeys(window.measurement for window in whole.windows))[: len(temperatures)]
    told = dict(zip(names, temperatures, strict=True))
    windows = tuple(
        replace(window, conditions=replace(window.conditions, temperature=told[window.measurement]))
        for window in whole.windows
        if window.measurement in told
    )
    path = folder / "tagged.session.h5"
    write_session(path, replace(whole, windows=windows))
    return responses_of_data(Data((path,), DataKind.SESSION, None), axis_settings(None))


@pytest.mark.parametrize(
    ("temperatures", "deviations", "sentence"),
    canary(
        [
            (
                (22.2, 21.8, 22.4, 38.1),
                (0.0, 0.0, 0.0, 16.0),
                "Temperatures are counted from 22.3 °C, their median, to",
            ),
            ((22.2, 21.8, 22.4, 22.0), (0.0, 0.0, 0.0, 0.0), None),
            ((22.0, None, 30.0, 38.0), (0.0, 0.0, 0.0, 0.0), "Temperatures are not compared: 1 of 4 state none."),
            ((None, None, None, None), (0.0, 0.0, 0.0, 0.0), None),
        ]
    ),
)
def test_temperatures_are_counted_from_their_median_to_the_kelvin(
    tmp_path: Path, temperatures: tuple[float | None, ...], deviations: tuple[float, ...], sentence: str | None
) -> None:
    found = responses(tmp_path, temperatures)
    assert tuple(observation.conditions.temperature_deviation for observation in found.observations) == deviations
    assert [said[: len(sentence or "")] for said in found.sentences] == ([] if sentence is None else [sentence])
    assert not any(observation.placed for observation in found.observations)


@pytest.mark.release
@pytest.mark.parametrize(("stated", "reaches"), [((140.0, 230.0), None), ((10.0, 230.0), 10.0)])
def test_band_of_the_mode_does_not_leave_out_lines(stated: tuple[float, float], reaches: float | None) -> None:
    """It may reach lower, where a mode lies below what is looked at by itself; never less far."""
    session = PROJECT_ROOT / "replay_data" / "calibration.session.h5"
    without, within = (
        responses_of_data(Data((session,), DataKind.SESSION, None), axis_settings(band)).observations
        for band in (None, stated)
    )
    assert [observation.conditions for observation in within] == [observation.conditions for observation in without]
    for with_band, bare in zip(within, without, strict=True):
        assert with_band.frequency[-1] == pytest.approx(bare.frequency[-1], abs=3.0)
        if reaches is None:
            assert np.array_equal(with_band.frequency, bare.frequency)
        else:
            assert reaches <= with_band.frequency[0] < bare.frequency[0]


def test_measurements_that_are_left_out_are_counted(tmp_path: Path) -> None:
    whole = read_session(PROJECT_ROOT / "replay_data" / "calibration.session.h5")
    first, second, third = whole.measurements[:3]
    windows = (*whole.windows_of(first), *whole.windows_of(second)[:1], *whole.windows_of(third)[:1])
    path = tmp_path / "short.session.h5"
    write_session(path, replace(whole, windows=windows))
    found = responses_of_data(Data((path,), DataKind.SESSION, None), axis_settings(None))
    assert len(found.observations) == 1
    assert found.sentences[0] == "2 of 3 measurements are left out: too-few-averages."
