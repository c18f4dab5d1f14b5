"""What other settings would change is said before they are sent, and who sends them second is told."""

import re
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.operations.monitoring import trend
from tests.browser.states import CONFIGURATION, TOO_HIGH, measure, measurement
from tests.service.conftest import START, Api, assert_problem, running_service

AXIS = "axis"


@pytest.fixture(scope="module")
def learnt(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """Serve an axis whose baseline is learnt."""
    with running_service(Path(tmp_path_factory.mktemp("consequences")) / "var") as api:
        api.register(AXIS, **CONFIGURATION)
        api.calibrate(AXIS)
        for day, preload in enumerate(300.0 + 15.0 * np.random.default_rng(2).standard_normal(10)):
            measure(api, AXIS, range(day, day + 1), preload)
        yield api


def outlook(api: Api, name: str = AXIS, **settings: Any) -> dict[str, Any]:
    configuration = api.axis(AXIS)["configuration"] | settings
    answer = api.http.put(
        f"/v1/axes/{AXIS}", params={"dry_run": True}, json={"name": name, "configuration": configuration}
    )
    assert answer.status_code == 200, answer.text
    return answer.json()


def sentences(api: Api, **settings: Any) -> list[tuple[str, str]]:
    return [(item["kind"], item["sentence"]) for item in outlook(api, **settings)["consequences"]]


def test_what_would_change_is_listed_and_nothing_is_stored(learnt: Api) -> None:
    before = learnt.axis(AXIS)
    found = outlook(learnt, "other", machine="Mill 3")
    assert [(item["setting"], item["before"], item["after"]) for item in found["changes"]] == [
        ("name", AXIS, "other"), ("machine", None, "Mill 3")
    ]  # fmt: skip
    assert outlook(learnt)["changes"] == outlook(learnt)["consequences"] == []
    assert learnt.axis(AXIS) == before


def test_fewer_false_alarms_cost_delay(learnt: Api) -> None:
    def days(rate: float) -> float:
        kind, sentence = sentences(learnt, false_alarms_per_year=rate)[0]
        assert kind == "computed"
        assert sentence.startswith(f"{rate:g} false alarms a year are expected, until now 1. A sudden loss of 20 N")
        return float(sentence.split("after ")[1].split(" days")[0])

    assert days(0.01) > days(4.0) >= 1.0


def test_before_the_baseline_is_learnt_no_delay_is_claimed(api: Api) -> None:
    api.register(AXIS, **CONFIGURATION)
    assert "is known as soon as the baseline is learnt" in sentences(api, false_alarms_per_year=0.1)[0][1]


def test_silences_are_counted_in_what_was_measured(learnt: Api) -> None:
    kind, sentence = sentences(learnt, silent_after_hours=23.5)[0]
    assert kind == "counted"
    found = re.search(
        r"In the last (\d+) sessions that happened (\d+) times, with the setting until now 0 times", sentence
    )
    assert found is not None
    assert int(found[1]) == int(found[2]) + 1 >= 8  # a day apart; the last one is not over yet
    assert "happened 0 times" in sentences(learnt, silent_after_hours=72.5)[0][1]


def test_a_band_that_misses_the_mode_says_so(learnt: Api) -> None:
    assert "10 of the last 10 frequencies lie outside 100 to 150.5 Hz" in sentences(
        learnt, search_band_hz=[100.0, 150.5]
    )[0][1]  # fmt: skip
    assert "0 of the last 10" in sentences(learnt, search_band_hz=[150.0, 220.0])[0][1]


def test_windows_machine_and_commissioned_preload(learnt: Api) -> None:
    assert "becomes 0.5 times as wide" in sentences(learnt, windows_per_measurement=16)[0][1]
    assert "at the machine Mill 3, with 0 others" in sentences(learnt, machine="Mill 3")[0][1]
    stated = {"commissioned_preload_n": 400.0, "commissioned_at": START.isoformat()}
    left = learnt.axis(AXIS)["last_measurement"]["preload_n"] / 400.0
    assert f"{100 * left:.0f} % of 400 N are left" in sentences(learnt, **stated)[0][1]


def test_who_saves_second_is_told(api: Api) -> None:
    api.register(AXIS, **CONFIGURATION)
    read = api.http.get(f"/v1/axes/{AXIS}")
    body = {"name": "first", "configuration": read.json()["configuration"]}
    guard = {"if-match": read.headers["etag"]}
    saved = api.http.put(f"/v1/axes/{AXIS}", json=body, headers=guard)
    assert saved.status_code == 200
    refused = api.http.put(f"/v1/axes/{AXIS}", json=body | {"name": "second"}, headers=guard)
    assert_problem(refused, 412, "precondition-failed")
    assert api.axis(AXIS)["name"] == "first"
    assert api.http.put(f"/v1/axes/{AXIS}", json=body, headers={"if-match": saved.headers["etag"]}).status_code == 200


def test_a_measurement_does_not_change_the_tag(api: Api) -> None:
    api.register(AXIS, **CONFIGURATION)
    tag = api.http.get(f"/v1/axes/{AXIS}").headers["etag"]
    measure(api, AXIS, range(1))
    assert api.http.get(f"/v1/axes/{AXIS}").headers["etag"] == tag


def test_a_history_is_not_replaced_over_another_calibration(learnt: Api) -> None:
    body = {"calibration": 1, "dry_run": True}
    path = f"/v1/axes/{AXIS}/rejudgements"
    assert_problem(learnt.http.post(path, json=body, headers={"if-match": '"7"'}), 412, "precondition-failed")
    assert learnt.http.post(path, json=body, headers={"if-match": '"1"'}).status_code == 202


def test_refused_ones_are_found_page_by_page(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    api.register(AXIS, **CONFIGURATION)
    for day in range(3):  # one window alone is refused
        api.accept(AXIS, measurement(AXIS, day)[:1], complete=True)
    api.calibrate(AXIS)
    measure(api, AXIS, range(3, 9), TOO_HIGH)
    monkeypatch.setattr(trend, "LOOKED_AT", 4)
    found, cursor, n_pages = [], None, 0
    while n_pages == 0 or cursor is not None:
        more = {} if cursor is None else {"cursor": cursor}
        query = {"only": "refused", "order": "newest-first", "limit": 2} | more
        answer = api.http.get(f"/v1/axes/{AXIS}/trend", params=query).json()
        found += [point["at"] for point in answer["points"]]
        cursor, n_pages = answer["next_cursor"], n_pages + 1
    assert found == [f"{START + timedelta(days=day):%Y-%m-%dT%H:%M:%SZ}" for day in (2, 1, 0)]
    table = api.http.get(f"/v1/axes/{AXIS}/trend", params={"only": "refused", "format": "csv"}).text
    assert len(table.splitlines()) == 1 + 3
    assert api.trend(AXIS, only="in-doubt") == [point for point in api.trend(AXIS) if point["doubt"]]


def test_the_system_says_how_it_stands(api: Api) -> None:
    empty = api.http.get("/v1/system").json()
    assert (empty["axes"], empty["lag"]["last_received_at"], empty["refused_windows"]) == (0, None, {})
    api.register(AXIS, **CONFIGURATION)
    api.register("other", **CONFIGURATION | {"sample_rate_hz": 2000.0})
    api.calibrate(AXIS)
    measure(api, AXIS, range(2))
    measure(api, "other", range(1))
    api.http.post("/v1/axes/other/archive").raise_for_status()
    found = api.http.get("/v1/system").json()
    assert (found["axes"], found["archived_axes"]) == (2, 1)
    assert found["refused_windows"] == {"sample-rate-mismatch": 4}
    assert found["lag"]["waiting_requests"] == 0
    assert found["lag"]["mean_judging_s"] > 0.0
    assert found["versions"]["database"] == "sqlite"
