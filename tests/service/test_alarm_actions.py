"""Alarms are commented, shelved and cleared; two people at once; what rests is not told, and is back by itself."""

import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import pytest

from service.clock import now, text_of
from service.operations.monitoring import alarm_changes, alarms, changes as marks
from service.operations.monitoring.alarms import bring_back_ended
from service.store.database import Database
from service.store.tables import AlarmRow, NoticeRow
from tests.browser.states import CONFIGURATION, WORN, measure
from tests.service.brokers import wait_until
from tests.service.conftest import Api, assert_problem, running_service


@pytest.fixture(scope="module")
def worn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wear an axis until it alarms; nobody writes into its folder."""
    folder = tmp_path_factory.mktemp("worn")
    with running_service(folder) as api:
        api.register("axis", **CONFIGURATION)
        api.calibrate("axis")
        measure(api, "axis", range(9))
        measure(api, "axis", range(9, 13), WORN)
    return folder


@pytest.fixture
def alarmed(worn: Path, tmp_path: Path) -> Iterator[tuple[Api, int]]:
    """Serve a copy of the worn axis, and give the number of its alarm."""
    shutil.copytree(worn, tmp_path / "var")
    with running_service(tmp_path / "var") as api:
        (alarm,) = api.http.get("/v1/alarms").json()["alarms"]
        yield api, alarm["id"]


def post(api: Api, alarm: int, verb: str, **body: object) -> dict:
    answer = api.http.post(f"/v1/alarms/{alarm}/{verb}", json={"comment": "said"} | body)
    assert answer.status_code == 200, answer.text
    return answer.json()


def events_of(api: Api, alarm: int) -> list[dict]:
    return api.http.get(f"/v1/alarms/{alarm}").json()["events"]


def kinds_told(api: Api) -> list[str]:
    database = Database(f"sqlite:///{api.data_dir}/preload.db")
    with database.read() as session:
        found = [row.kind.removeprefix("org.preload-monitor.alarm.") for row in session.query(NoticeRow)]
    database.close()
    return found


def test_a_comment_is_an_event_and_changes_nothing(alarmed: tuple[Api, int]) -> None:
    api, alarm = alarmed
    told = post(api, alarm, "comment", comment="heard a knock")
    assert told["status"] == "active"
    last = told["events"][-1]
    assert (last["kind"], last["reason"], last["who"]) == ("comment", "heard a knock", "anyone on this machine")


def test_shelved_it_rests_until_then_and_is_back_by_itself(
    alarmed: tuple[Api, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    api, alarm = alarmed
    until = now() + timedelta(days=2)
    mark = api.http.get("/v1/changes", params={"since": ""}).json()
    told = post(api, alarm, "shelve", until=text_of(until))
    assert told["status"] == "active"
    assert told["shelved_until"] == text_of(until)
    assert told["events"][-1]["kind"] == "shelved"
    for module in (alarm_changes, alarms, marks):
        monkeypatch.setattr(module, "now", lambda: until + timedelta(seconds=1))
    assert api.http.get(f"/v1/alarms/{alarm}").json()["shelved_until"] is None
    assert api.http.get("/v1/changes", params={"since": ""}).json() != mark


def test_the_end_of_a_shelf_is_an_event_that_receivers_hear_of_once(alarmed: tuple[Api, int]) -> None:
    api, alarm = alarmed
    post(api, alarm, "acknowledge")
    post(api, alarm, "shelve", until=text_of(now() + timedelta(seconds=0.5)))
    post(api, alarm, "comment")
    assert kinds_told(api)[-1] == "shelved"
    wait_until(lambda: events_of(api, alarm)[-1]["kind"] == "back", what="the alarm to be back")
    last = events_of(api, alarm)[-1]
    assert (last["who"], last["new_status"]) == (None, "acknowledged")
    assert api.http.get(f"/v1/alarms/{alarm}").json()["shelved_until"] is None
    assert kinds_told(api) == ["raised", "acknowledged", "shelved", "back"]


def test_of_two_services_one_brings_an_alarm_back(alarmed: tuple[Api, int]) -> None:
    api, alarm = alarmed
    database = Database(f"sqlite:///{api.data_dir}/preload.db")
    with database.write() as session:
        session.get_one(AlarmRow, alarm).shelved_until = now()
    with ThreadPoolExecutor(4) as pool:  # and the service's own
        pool.map(lambda _: bring_back_ended(database), range(8))
    database.close()
    assert [event["kind"] for event in events_of(api, alarm)].count("back") == 1


def test_an_alarm_that_rests_is_told_of_when_it_ends_and_not_before(alarmed: tuple[Api, int]) -> None:
    api, alarm = alarmed
    post(api, alarm, "shelve", until=text_of(now() + timedelta(days=2)))
    post(api, alarm, "comment")
    post(api, alarm, "acknowledge")
    post(api, alarm, "clear")
    assert kinds_told(api) == ["raised", "shelved", "cleared"]


@pytest.mark.parametrize("days", [-1.0, 93.0])
def test_a_shelf_ends_within_three_months(alarmed: tuple[Api, int], days: float) -> None:
    api, alarm = alarmed
    body = {"comment": "x", "until": text_of(now() + timedelta(days=days))}
    assert_problem(api.http.post(f"/v1/alarms/{alarm}/shelve", json=body), 422, "invalid-request")


def test_a_cleared_alarm_is_not_shelved(alarmed: tuple[Api, int]) -> None:
    api, alarm = alarmed
    post(api, alarm, "clear")
    body = {"comment": "x", "until": text_of(now() + timedelta(days=1))}
    assert_problem(api.http.post(f"/v1/alarms/{alarm}/shelve", json=body), 409, "conflict")


@pytest.mark.parametrize("verb", ["acknowledge", "shelve", "clear"])
def test_the_second_of_two_people_is_told_what_the_first_did(alarmed: tuple[Api, int], verb: str) -> None:
    api, alarm = alarmed
    seen = api.http.get(f"/v1/alarms/{alarm}").json()["events"][-1]["id"]
    post(api, alarm, "shelve", until=text_of(now() + timedelta(days=1)), comment="spare part on its way")
    body = {"comment": "x", "seen_event": seen, "until": text_of(now() + timedelta(days=1))}
    body = body if verb == "shelve" else {name: body[name] for name in ("comment", "seen_event")}
    problem = assert_problem(api.http.post(f"/v1/alarms/{alarm}/{verb}", json=body), 409, "conflict")
    assert "anyone on this machine, shelved" in problem["detail"]
    assert "spare part on its way" in problem["detail"]


def test_what_the_service_or_a_comment_added_is_no_conflict(alarmed: tuple[Api, int]) -> None:
    api, alarm = alarmed
    post(api, alarm, "comment")
    post(api, alarm, "acknowledge", seen_event=0)
    assert api.http.get(f"/v1/alarms/{alarm}").json()["status"] == "acknowledged"
