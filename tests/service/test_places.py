"""Places of one session that contradict each other are doubted as they are in ``preload estimate``."""

from dataclasses import replace
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from monitor_core.recording import Window
from tests.service.conftest import START, Api, simulated_measurement

DAY = timedelta(days=1)
#: Places of a session [mm], an hour apart.
PLACES = (300.0, 500.0, 700.0)


def session(day: int, *, tags: tuple[float, ...] = PLACES, first: int = 0) -> list[list[Window]]:
    """Return the measurements of a day, made at :data:`PLACES` and tagged as given."""
    rng = np.random.default_rng([3, day])
    made = [
        simulated_measurement(rng, f"d{day}-{i}", position_mm=place, started_at=START + day * DAY + timedelta(hours=i))
        for i, place in enumerate(PLACES)
    ]
    tagged = [
        [replace(w, conditions=replace(w.conditions, position=tag * 1e-3)) for w in windows]
        for tag, windows in zip(tags, made, strict=True)
    ]
    return tagged[first:]


def said(api: Api, axis: str) -> dict[str, tuple[str | None, list[dict[str, Any]]]]:
    """Return what is said against each measurement, in the trend and in words."""
    found = {}
    for point in api.trend(axis):
        outcome = api.http.get(f"/v1/axes/{axis}/measurements/{point['measurement_id']}").json()["outcome"]
        found[point["measurement"]] = (point["doubt"], outcome["doubts"])
    return found


def send(api: Api, axis: str, measurements: list[list[Window]]) -> None:
    for windows in measurements:
        api.accept(axis, windows, complete=True)


@pytest.fixture
def axis(api: Api) -> str:
    api.register("axis", windows_per_measurement=15)
    api.calibrate("axis")
    return "axis"


def test_places_that_contradict_each_other_put_every_measurement_of_their_day_in_doubt(api: Api, axis: str) -> None:
    send(api, axis, session(0) + session(1, tags=(275.0, 500.0, 700.0)) + session(2))
    found = said(api, axis)
    assert [name for name, (doubt, _) in found.items() if doubt == "places-disagree"] == ["d1-0", "d1-1", "d1-2"]
    sentences = {doubts[-1]["detail"] for name, (_, doubts) in found.items() if name.startswith("d1")}
    assert len(sentences) == 1
    assert "the places of one session give" in sentences.pop()
    assert all(doubts == [] for name, (_, doubts) in found.items() if not name.startswith("d1"))


def test_a_place_that_comes_late_is_compared_as_if_it_had_come_in_time(api: Api, axis: str) -> None:
    api.register("late", windows_per_measurement=15)
    api.calibrate("late")
    wrong, middle, last = session(0, tags=(275.0, 500.0, 700.0))
    send(api, axis, [wrong, middle, last, *session(1)])
    send(api, "late", [middle, last, *session(1)])
    assert all(doubt is None for doubt, _ in said(api, "late").values())
    send(api, "late", [wrong])
    assert said(api, "late") == said(api, axis)
    assert said(api, axis)["d0-0"][0] == "places-disagree"


def test_one_place_and_preloads_that_were_set_are_compared_with_nothing(api: Api, axis: str) -> None:
    rng = np.random.default_rng(4)
    set_so = [
        simulated_measurement(rng, f"set-{i}", preload=preload, position_mm=place, set_preload=preload,
                              started_at=START + timedelta(hours=i))
        for i, (preload, place) in enumerate([(300.0, 300.0), (200.0, 700.0)])
    ]  # fmt: skip
    one_place = [
        simulated_measurement(rng, f"m-{i}", preload=p, started_at=START + DAY + timedelta(hours=i))
        for i, p in enumerate([300.0, 200.0])
    ]
    send(api, axis, set_so + one_place)
    assert [doubt for doubt, _ in said(api, axis).values()] == [None] * 4
