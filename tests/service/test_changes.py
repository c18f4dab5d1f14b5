"""The mark of what is stored: another one after every change, the same while there is none, and cheap to ask for."""

import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sqlalchemy import event

from service.operations.monitoring.changes import Changes
from service.store.database import Database
from tests.browser.states import CONFIGURATION, measure
from tests.service.conftest import Api


def mark(api: Api) -> str:
    return str(api.http.get("/v1/changes").json()["mark"])


def settled_mark(api: Api) -> str:
    """Return the mark once what the service does of its own at its start is stored."""
    end = time.monotonic() + 30.0
    last = mark(api)
    while time.monotonic() < end:
        time.sleep(0.5)
        if (now := mark(api)) == last:
            return now
        last = now
    raise AssertionError("the service goes on writing, and nobody asked for anything")


def test_a_mark_holds_until_something_changes(api: Api) -> None:
    before = settled_mark(api)
    for _ in range(3):
        assert api.http.get("/v1/changes", params={"since": before}).status_code == 304
        api.http.get("/v1/axes")
    api.register("axis", **CONFIGURATION)
    answer = api.http.get("/v1/changes", params={"since": before})
    assert answer.status_code == 200
    assert answer.json()["mark"] != before


def test_silence_changes_the_mark_without_a_write(api: Api) -> None:
    api.register("axis", **CONFIGURATION)
    api.calibrate("axis")
    measure(api, "axis", range(1))
    settled_mark(api)
    heard_at = datetime.fromisoformat(api.axis("axis")["last_measurement"]["started_at"])
    soon = datetime.now(UTC) + timedelta(seconds=3.0)
    api.register("axis", **CONFIGURATION | {"silent_after_hours": (soon - heard_at).total_seconds() / 3600.0})
    before = mark(api)
    assert mark(api) == before
    time.sleep(3.2)
    assert mark(api) != before
    assert api.axis("axis")["state"] == "unknown"


def test_another_run_of_the_service_has_other_marks(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path}/preload.db")
    database.migrate()
    assert Changes(database).mark() != Changes(database).mark()
    database.close()


def test_no_row_is_read_while_nothing_is_written(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path}/preload.db")
    database.migrate()
    changes, statements = Changes(database), list[str]()
    event.listen(database.engine, "before_cursor_execute", lambda *arguments: statements.append(arguments[2]))
    first = changes.mark()
    assert statements  # the silences, once
    statements.clear()
    begin = time.process_time()
    assert {changes.mark() for _ in range(1000)} == {first}
    assert (time.process_time() - begin) / 1000 < 0.0002
    assert not statements
    database.close()


def test_an_answer_without_a_change_takes_two_milliseconds(api: Api) -> None:
    since = settled_mark(api)
    begin = time.process_time()
    for _ in range(100):
        assert api.http.get("/v1/changes", params={"since": since}).status_code == 304
    assert (time.process_time() - begin) / 100 < 0.01  # of client and service together, in this one process
