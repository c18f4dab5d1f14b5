"""Stored documents that are damaged or of another version: their axis says so, and the others go on."""

import itertools
import json
import sqlite3
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from service.json_types import JsonObject
from service.store.packed_documents import unpacked
from tests.conftest import canary
from tests.service.conftest import START, Api, assert_problem, running_service, simulated_measurement

HARMS = ("cut off", "a list", "blank", "newer", "another member", "a member less")
COLUMNS = {"configuration": "configuration", "monitor_state": "state of the charts", "detector_design": "limits"}


def stored(folder: Path, column: str) -> str:
    with closing(sqlite3.connect(folder / "preload.db")) as connection:
        ((text,),) = connection.execute(f"SELECT {column} FROM axes WHERE id = 'broken'").fetchall()  # noqa: S608
    return text


def store(folder: Path, column: str, text: str) -> None:
    with closing(sqlite3.connect(folder / "preload.db")) as connection:
        connection.execute(f"UPDATE axes SET {column} = ? WHERE id = 'broken'", (text,))  # noqa: S608
        connection.commit()


def damaged(text: str, how: str) -> str:
    document: JsonObject = json.loads(text)
    match how:
        case "cut off":
            return text[: len(text) // 2]
        case "a list":
            return "[]"
        case "blank":
            return "{}"
        case "newer":
            return json.dumps(document | {"version": 99})
        case "another member":
            return json.dumps(document | {"cost": 1.0})
        case "a member less":
            return json.dumps(dict(list(document.items())[:-1]))
    raise ValueError(how)


def measured(api: Api, axis: str, hour: int) -> list:
    windows = simulated_measurement(np.random.default_rng(hour), f"m{hour}", started_at=START + timedelta(hours=hour))
    return [axis, windows]


@pytest.mark.parametrize(
    "harms",
    [
        pytest.param(tuple(zip(HARMS, 2 * tuple(COLUMNS), strict=True)), id="each"),
        pytest.param(tuple(itertools.product(HARMS, COLUMNS)), id="all", marks=pytest.mark.release),
    ],
)
def test_axis_with_a_damaged_document_is_refused_and_others_go_on(
    api: Api, harms: tuple[tuple[str, str], ...], subtests: pytest.Subtests
) -> None:
    for axis in ("broken", "well"):
        api.register(axis)
        api.calibrate(axis)
        api.accept(*measured(api, axis, 0))
    for how, column in harms:
        with subtests.test(how=how, column=column):
            hour = 1 + list(COLUMNS).index(column) * len(HARMS) + HARMS.index(how)
            whole = stored(api.data_dir, column)
            store(api.data_dir, column, damaged(whole, how))
            try:
                refused = api.post(*measured(api, "broken", hour))
                detail = assert_problem(refused, 500, "document-damaged")["detail"]
                assert COLUMNS[column] in detail
                assert "cannot be read" in detail
                if how == "newer":
                    assert f"expected version {json.loads(whole)['version']}; got 99" in detail
                listed = api.http.get("/v1/axes").json()
                assert [axis["id"] for axis in listed["axes"] if axis["id"] == "well"] == ["well"]
                if column != "detector_design":  # only a measurement that is judged asks for the limits
                    assert [(axis["id"], axis["detail"]) for axis in listed["damaged"]] == [("broken", detail)]
                    assert_problem(api.http.get("/v1/axes/broken"), 500, "document-damaged")
                    assert "not monitored" in api.http.get("/").text
                accepted = api.accept(*measured(api, "well", hour))
                assert (accepted["accepted"], len(accepted["measurements"])) == (15, 1)
                assert stored(api.data_dir, column) == damaged(whole, how)  # evidence: nothing was written over it
            finally:
                store(api.data_dir, column, whole)
            assert (
                api.accept(*measured(api, "broken", hour))["accepted"] == 15
            )  # nothing of the refused request was stored


@pytest.mark.parametrize(("table", "column"), [("axes", "monitor_state"), ("calibrations", "document")])
def test_the_fleet_is_shown_whatever_is_damaged_of_an_axis_with_an_alarm(api: Api, table: str, column: str) -> None:
    api.register("broken")
    api.calibrate("broken")
    api.accept(*measured(api, "broken", 0))
    evidence = {
        "at": str(START), "onset": str(START), "preload_n": 250.0, "interval": [240.0, 260.0], "preload_loss_n": 50.0,
        "baseline_preload_n": 300.0,
    }  # fmt: skip
    explanation = {"examined": False, "reason": "no-drive-model", "sentence": "none", "recent": None}
    with closing(sqlite3.connect(api.data_dir / "preload.db")) as connection:
        connection.execute(
            "INSERT INTO alarms (axis_id, measurement_id, kind, raised_at, status, epoch, measured_at, evidence, "
            "explanation) SELECT axis_id, id, 'preload-loss', started_at, 'active', 1, started_at, ?, ? "
            "FROM measurements",
            (json.dumps(evidence), json.dumps(explanation)),
        )
        connection.execute(f"UPDATE {table} SET {column} = '{{}}'")  # noqa: S608
        connection.commit()
    for path in ("/", "/wall"):
        assert api.http.get(path).status_code == 200, path
    assert_problem(api.http.get("/v1/axes/broken/history"), 500, "document-damaged")


def test_configuration_and_limits_are_healed_by_sending_them_again(api: Api) -> None:
    api.register("broken")
    for column in ("configuration", "detector_design"):
        whole = stored(api.data_dir, column)
        store(api.data_dir, column, "{}")
        api.register("broken")
        assert stored(api.data_dir, column) == whole


def test_a_member_of_a_measurement_that_cannot_be_read_is_missing_and_the_rest_is_read(api: Api) -> None:
    api.register("axis")
    api.calibrate("axis")
    api.accept(*measured(api, "axis", 0))
    whole = api.axis("axis")["last_measurement"]
    broken = {"coherence": "high", "variance_shares": [1], "doubts": [{"reason": 3}], "of_a_later_program": {"a": 1}}
    with closing(sqlite3.connect(api.data_dir / "preload.db")) as connection:
        ((content,),) = connection.execute("SELECT outcome FROM measurement_documents").fetchall()
        document = json.dumps(unpacked(content) | broken)  # as older programs wrote it
        connection.execute("UPDATE measurement_documents SET outcome = ?", (document,))
        connection.commit()
    missing = {"coherence": None, "variance_shares": {}, "doubts": [], "of_a_later_program": {"a": 1}}
    assert api.axis("axis")["last_measurement"] == whole | missing
    number = whole["measurement_id"]
    for page in ("/", "/axes/axis", f"/axes/axis/measurements/{number}", "/metrics"):
        assert api.http.get(page).status_code == 200, page
    assert api.http.get(f"/v1/axes/axis/measurements/{number}").json()["outcome"] == whole | missing


def test_configuration_of_before_versions_were_stated_is_read(tmp_path: Path) -> None:
    with running_service(tmp_path) as api:
        api.register("broken")
        before = api.axis("broken")
    document = json.loads(stored(tmp_path, "configuration"))
    assert document.pop("version") == 1
    del document["baseline_days"], document["axis_type"]  # that nobody was asked for then
    store(tmp_path, "configuration", json.dumps(document))
    with running_service(tmp_path) as api:
        expected = before["configuration"] | {"baseline_days": 14.0}
        assert api.axis("broken") == before | {"configuration": expected}
        api.accept(*measured(api, "broken", 1))


@pytest.mark.parametrize("version", canary(["x", None]))
def test_a_damaged_version_keeps_no_service_from_starting(tmp_path: Path, version: object) -> None:
    with running_service(tmp_path) as api:
        for axis in ("broken", "well"):
            api.register(axis)
            api.calibrate(axis)
        api.accept(*measured(api, "broken", 0))
    damaged_state = json.dumps(json.loads(stored(tmp_path, "monitor_state")) | {"version": version})
    store(tmp_path, "monitor_state", damaged_state)
    with running_service(tmp_path) as api:
        listed = api.http.get("/v1/axes").json()
        assert [axis["id"] for axis in listed["axes"]] == ["well"]
        assert [axis["id"] for axis in listed["damaged"]] == ["broken"]
        assert api.accept(*measured(api, "well", 1))["accepted"] == 15
    assert stored(tmp_path, "monitor_state") == damaged_state


@pytest.mark.release
def test_charts_of_an_older_version_are_folded_again_from_what_was_measured(tmp_path: Path) -> None:
    def said(api: Api) -> dict[str, object]:
        alarms = api.http.get("/v1/alarms", params={"axis": "broken"}).json()["alarms"]
        return {"axis": api.axis("broken"), "trend": api.trend("broken"), "alarms": alarms}

    rng = np.random.default_rng(4)
    with running_service(tmp_path) as api:
        api.register("broken", baseline_size=5)
        api.calibrate("broken")
        for day, preload in enumerate([300.0] * 6 + [200.0] * 3):
            at = START + timedelta(days=day)
            api.accept("broken", simulated_measurement(rng, f"m{day}", preload=preload, started_at=at))
        before = said(api)
        assert before["axis"]["state"] == "alarm"
    state = stored(tmp_path, "monitor_state")
    store(tmp_path, "monitor_state", json.dumps({"detector": {"status": "alarm"}}))  # as version 1 had it, or nearly
    store(tmp_path, "detector_design", json.dumps({"cusum_limit": 7.0}))
    with closing(sqlite3.connect(tmp_path / "preload.db")) as connection:
        connection.execute("UPDATE chart_epochs SET state = ?", (json.dumps({"version": 1}),))
        connection.commit()
    with running_service(tmp_path) as api:
        assert said(api) == before
    with closing(sqlite3.connect(tmp_path / "preload.db")) as connection:
        states = [json.loads(text) for (text,) in connection.execute("SELECT state FROM chart_epochs")]
    assert {document["version"] for document in states} == {json.loads(state)["version"]}
    assert json.loads(stored(tmp_path, "monitor_state"))["detector"] == json.loads(state)["detector"]
