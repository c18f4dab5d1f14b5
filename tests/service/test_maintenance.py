"""What was done to an axis: a new nut begins its charts anew, whenever it is entered and in whatever order."""

import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from service.operations.monitoring.intake import charts
from service.operations.monitoring.maintenance import MaintenanceIn, enter as enter_work
from service.store.database import Database
from tests.service.conftest import START, Api, assert_problem, running_service, simulated_measurement

DAYS = 40
LOSS = 20
CONFIGURATION = {"windows_per_measurement": 3, "baseline_size": 5, "baseline_days": 4}


def measure(api: Api, days: Sequence[int], *, seed: int = 3) -> None:
    """Measure once a day; the axis loses a fifth of its preload on the day :data:`LOSS`."""
    for day in days:
        windows = simulated_measurement(
            np.random.default_rng([seed, day]), f"d{day:02d}", preload=300.0 if day < LOSS else 240.0,
            started_at=START + timedelta(days=day), n_windows=3,
        )  # fmt: skip
        api.accept("axis", windows)


def prepared(api: Api) -> None:
    api.register("axis", **CONFIGURATION)
    api.calibrate("axis")


def entry(day: float, kind: str = "nut-replaced", **more: Any) -> dict[str, Any]:
    return {"at": (START + timedelta(days=day)).isoformat(), "who": "Anna", "kind": kind} | more


def enter(api: Api, day: float, kind: str = "nut-replaced", **more: Any) -> dict[str, Any]:
    answer = api.http.post("/v1/axes/axis/maintenance", json=entry(day, kind, **more))
    assert answer.status_code == 201, answer.text
    return answer.json()


def moment(text: str) -> datetime:
    return datetime.fromisoformat(text)


def said(folder: Path) -> dict[str, list]:
    """Return what is stored of the charts, but for what says who came first."""
    with closing(sqlite3.connect(folder / "preload.db")) as database:
        wanted = {
            "points": "SELECT * FROM trend_points ORDER BY at",
            "sessions": "SELECT * FROM sessions ORDER BY started_at",
            "epochs": "SELECT * FROM chart_epochs ORDER BY begins_at",
            "alarms": "SELECT measurement_id, epoch, measured_at, status, evidence FROM alarms "
            "WHERE status <> 'withdrawn' ORDER BY measured_at",
            "axis": "SELECT monitor_state, epoch, epoch_from, epoch_begins_at, last_charted_at, state, state_since, "
            "last_measurement_id, last_measured_at, uncharted FROM axes",
        }
        return {name: database.execute(query).fetchall() for name, query in wanted.items()}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a service that has measured all days, and is closed."""
    folder = tmp_path_factory.mktemp("measured") / "var"
    with running_service(folder) as api:
        prepared(api)
        measure(api, range(DAYS))
        assert [alarm["status"] for alarm in api.http.get("/v1/alarms").json()["alarms"]] == ["active"]
    return folder


def entered(measured: Path, folder: Path, entries: Sequence[dict[str, Any]]) -> dict[str, list]:
    """Return what is stored after these entries, each one that corrects named by its place in the sequence."""
    folder.mkdir(parents=True)
    shutil.copy(measured / "preload.db", folder / "preload.db")
    database = Database(f"sqlite:///{folder / 'preload.db'}")
    numbers: dict[str, int] = {}
    for item in entries:
        corrects = numbers.get(item["corrects"]) if "corrects" in item else None
        row, _ = enter_work(database, "axis", MaintenanceIn.model_validate(item | {"corrects": corrects}))
        numbers[item["note"]] = row.id
    database.close()
    return said(folder)


def in_some_order(draw: st.DrawFn, entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return entries in any order in which none corrects what is not entered yet."""
    left, ordered = list(entries), []
    while left:
        known = {item["note"] for item in ordered}
        possible = [item for item in left if item.get("corrects") in {None, *known}]
        ordered.append(draw(st.sampled_from(possible)))
        left.remove(ordered[-1])
    return ordered


@st.composite
def two_orders(draw: st.DrawFn) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Draw entries, some of which correct others, in two orders."""
    kinds = st.sampled_from(["nut-replaced", "screw-replaced", "lubricated", "nut-replaced"])
    days = st.sampled_from([0.0, 5.0, 7.5, LOSS, LOSS + 0.5, 26.0, DAYS - 1.0, DAYS + 2.5])
    entries = [entry(draw(days), draw(kinds), note=f"e{i}") for i in range(draw(st.integers(1, 4)))]
    if draw(st.booleans()):
        entries.append(entry(draw(days), draw(kinds), note="c", corrects="e0"))
    return in_some_order(draw, entries), in_some_order(draw, entries)


@pytest.mark.release
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(orders=two_orders())
def test_entries_in_any_order_say_the_same(
    measured: Path, tmp_path_factory: pytest.TempPathFactory, orders: tuple[list, list]
) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(charts, "CHECKPOINT_EVERY", 4)
        first, second = (entered(measured, tmp_path_factory.mktemp("orders") / "var", order) for order in orders)
    assert first == second


@pytest.mark.release
def test_it_makes_no_difference_whether_windows_or_entries_come_first(measured: Path, tmp_path: Path) -> None:
    entries = [
        entry(8.5, note="e0"),
        entry(10.5, "lubricated", note="e1"),
        entry(26.25, "screw-replaced", note="e2"),
        entry(35.5, "lubricated", note="e3"),
    ]
    after = entered(measured, tmp_path / "after", entries)
    with running_service(tmp_path / "meanwhile") as api:
        prepared(api)
        measure(api, range(9))
        enter(api, 8.5, note="e0")
        measure(api, [9, 10, 12])
        enter(api, 10.5, "lubricated", note="e1")
        enter(api, 26.25, "screw-replaced", note="e2")
        enter(api, 35.5, "lubricated", note="e3")
        measure(api, [11, *range(13, DAYS)])  # those until 26 belong before the screw, though they come after the entry
        trend, state = api.trend("axis"), api.axis("axis")
        baseline = api.http.get("/v1/axes/axis/history").json()["baseline"]
    assert moment(baseline["looks_lubricated_at"]) == START + timedelta(days=36)
    found = said(tmp_path / "meanwhile")
    assert found["axis"][0][0] == after["axis"][0][0]
    by_name = {row[3]: row[4:-9] for row in after["points"]}
    assert {row[3]: row[4:-9] for row in found["points"]} == by_name
    assert [row[3:] for row in found["sessions"]] == [row[3:] for row in after["sessions"]]
    assert state["state"] == "normal"
    assert {point["uncharted"] for point in trend} == {None}


def test_a_new_nut_where_the_preload_fell_takes_the_alarm_back(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        prepared(api)
        measure(api, range(DAYS))
        (alarm,) = api.http.get("/v1/alarms").json()["alarms"]
        assert api.axis("axis")["state"] == "alarm"
        enter(api, LOSS - 0.5, note="oversized balls", set_preload_n=240.0)
        assert api.axis("axis")["state"] == "normal"
        events = api.http.get(f"/v1/alarms/{alarm['id']}").json()["events"]
        assert (events[-1]["new_status"], events[-1]["reason"]) == (
            "withdrawn", "with what was done to the axis the charts raise none",
        )  # fmt: skip
        history = api.http.get("/v1/axes/axis/history").json()
        assert [(e["kind"], e["set_preload_n"]) for e in history["events"]] == [("nut-replaced", 240.0)]
        assert history["baseline"]["preload_n"] == pytest.approx(240.0, rel=0.05)  # calibrated to a few per cent


def test_a_lubrication_opens_the_level_hides_no_large_loss_and_is_taken_back(measured: Path, tmp_path: Path) -> None:
    shutil.copytree(measured, tmp_path / "var")
    before = said(tmp_path / "var")
    with running_service(tmp_path / "var") as api:
        wrong = enter(api, LOSS - 0.5, "lubricated")
        baseline = api.http.get("/v1/axes/axis/history").json()["baseline"]
        assert moment(baseline["looks_lubricated_at"]) == START + timedelta(days=LOSS)
        assert [alarm["status"] for alarm in api.http.get("/v1/alarms").json()["alarms"]] == ["active"]
        assert said(tmp_path / "var")["axis"] != before["axis"]
        enter(api, LOSS - 0.5, "other", note="not done", corrects=wrong["id"])
    after = said(tmp_path / "var")
    assert {**after, "alarms": None} == {**before, "alarms": None}


def test_a_correction_takes_an_entry_back(measured: Path, tmp_path: Path) -> None:
    shutil.copytree(measured, tmp_path / "var")
    before = said(tmp_path / "var")
    with running_service(tmp_path / "var") as api:
        wrong = enter(api, LOSS - 0.5, note="wrong axis")
        assert said(tmp_path / "var") != before
        enter(api, LOSS - 0.5, "other", note="not done", corrects=wrong["id"])
        log = api.http.get("/v1/axes/axis/maintenance").json()["entries"]
        assert [(row["kind"], row["corrects"]) for row in log] == [("nut-replaced", None), ("other", wrong["id"])]
        again = api.http.post("/v1/axes/axis/maintenance", json=entry(1.0, "other", note="again", corrects=wrong["id"]))
        assert_problem(again, 409, "conflict")
        other = api.http.post("/v1/axes/axis/maintenance", json=entry(1.0, "other", corrects=99))
        assert_problem(other, 404, "unknown-resource")
    after = said(tmp_path / "var")
    same_alarm = [row[:3] + row[4:] for row in before["alarms"]]
    assert [row[:3] + row[4:] for row in after["alarms"]] == same_alarm
    assert {**after, "alarms": None} == {**before, "alarms": None}


def test_the_same_entry_sent_again_is_one_and_the_future_is_refused(api: Api) -> None:
    prepared(api)
    body = entry(1.0, "lubricated")
    answers = [api.http.post("/v1/axes/axis/maintenance", json=body) for _ in range(2)]
    assert [answer.status_code for answer in answers] == [201, 200]
    assert answers[0].json() == answers[1].json()
    later = api.http.post("/v1/axes/axis/maintenance", json=body | {"at": "2190-01-01T00:00:00Z"})
    assert "what was done, until now" in assert_problem(later, 422, "invalid-request")["detail"]


def test_an_alarm_from_before_a_new_nut_is_closed_without_another_baseline(api: Api) -> None:
    prepared(api)
    measure(api, range(LOSS + 6))
    (alarm,) = api.http.get("/v1/alarms").json()["alarms"]
    enter(api, LOSS + 5.5)
    assert api.axis("axis")["state"] == "unknown"
    measure(api, range(LOSS + 6, LOSS + 12))
    assert api.axis("axis")["state"] == "normal"
    cleared = api.http.post(f"/v1/alarms/{alarm['id']}/clear", json={"comment": "that nut is gone"})
    assert cleared.json()["status"] == "cleared"
    assert api.axis("axis")["state"] == "normal"
