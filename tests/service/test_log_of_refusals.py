"""The log of the service: an expected refusal is one line that says why, a fault of the program one traceback."""

import errno
import logging
import os
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from service.api.http import tables
from service.errors import BusyError, ConflictError, StorageError, tell_failure
from service.operations.access.access import Access
from service.operations.monitoring.axes import Axes
from service.operations.monitoring.changes import Changes
from tests.service.conftest import Api, running_service, simulated_measurement
from tests.service.test_failures import failing_once

FULL = StorageError("the database refused: disk full; send the request again")
BUG = RuntimeError("a bug")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with running_service(tmp_path_factory.mktemp("service"), max_body_mib=1) as api:
        api.register("axis")
        yield api


def failing(error: Exception) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


@pytest.fixture
def told(caplog: pytest.LogCaptureFixture) -> Callable[[int], list[logging.LogRecord]]:
    """Return what waits for so many lines of the log from WARNING up, and gives all there are."""
    caplog.set_level(logging.INFO)

    def lines(n: int) -> list[logging.LogRecord]:
        deadline = time.monotonic() + 20.0
        while len(loud := [record for record in caplog.records if record.levelno >= logging.WARNING]) < n:
            assert time.monotonic() < deadline, caplog.text
            time.sleep(0.01)
        return loud

    return lines


Told = Callable[[int], list[logging.LogRecord]]


def assert_one_line(lines: list[logging.LogRecord], message: str, reason: str) -> None:
    assert [line.levelname for line in lines] == ["WARNING"], [line.getMessage() for line in lines]
    assert lines[0].exc_info is None
    assert lines[0].getMessage() == message
    assert reason in getattr(lines[0], "members", {}).get("reason", "")


def test_a_full_disk(service: Api, told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", failing_once(os.fsync, error))
        answer = service.post("axis", simulated_measurement(np.random.default_rng(1), "m", n_windows=1))
    assert answer.status_code == 503
    assert_one_line(told(1), "POST /v1/axes/{axis}/windows 503", "No space left")


def test_a_conflict(service: Api, told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Axes, "register", failing(ConflictError("it is another one already")))
    assert service.http.put("/v1/axes/axis", json={"name": "axis"}).status_code == 409
    assert_one_line(told(1), "PUT /v1/axes/{axis} 409", "it is another one already")


def test_a_body_that_is_too_large(service: Api, told: Told) -> None:
    assert service.http.put("/v1/axes/axis", content=b"x" * (2**20 + 1)).status_code == 413
    assert_one_line(told(1), "PUT none 413", "a body may hold")


def test_a_database_that_fails_before_a_page_is_read(service: Api, told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Changes, "mark", failing(FULL))
    answer = service.http.get("/", headers={"accept": "text/html"})
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
    assert_one_line(told(1), "GET none 503", "disk full")


def test_an_answer_that_the_log_of_changes_does_not_take(
    service: Api, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was asked is done: the answer says so, and the entry stands without one."""
    with monkeypatch.context() as broken:
        broken.setattr(Access, "end_entry", failing(FULL))
        assert service.http.put("/v1/axes/axis", json={"name": "renamed"}).status_code == 200
    (line,) = told(1)
    assert (line.levelname, line.exc_info) == ("WARNING", None)
    assert "stays without its answer: the database refused: disk full" in line.getMessage()
    entry = service.http.get("/v1/audit?limit=1").json()["entries"][0]
    assert (entry["action"], entry["status"]) == ("PUT /v1/axes/{axis}", None)
    assert service.axis("axis")["name"] == "renamed"


def test_an_answer_that_is_broken_off(service: Api, told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    break_off(service, FULL, monkeypatch)
    assert_one_line(told(1), "GET /v1/audit 200", "disk full")


def break_off(service: Api, error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read a table whose second page fails."""
    real, pages = Access.log, []

    def log(self: Access, axis: str | None, before_id: int | None, _limit: int) -> object:
        pages.append(before_id)
        if len(pages) > 1:
            raise error
        return real(self, axis, before_id, 1)

    with monkeypatch.context() as broken:
        broken.setattr(Access, "log", log)
        broken.setattr(tables, "ROWS_OF_PAGE", 1)
        with pytest.raises(httpx.RemoteProtocolError):
            service.http.get("/v1/audit?format=csv")
    assert len(pages) == 2


@pytest.mark.parametrize("path", ["/v1/axes/axis/recordings", "/v1/axes/axis/windows"])
def test_a_client_that_leaves(service: Api, told: Told, path: str) -> None:
    with socket.create_connection((service.http.base_url.host, service.http.base_url.port)) as connection:
        connection.sendall(
            f"POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-length: 1000\r\n".encode()
            + b"content-type: multipart/form-data; boundary=x\r\n\r\n--x\r\n"
        )
        time.sleep(0.1)
    lines = told(1)
    assert [line.levelname for line in lines] == ["WARNING"]
    assert lines[0].exc_info is None
    assert lines[0].getMessage().endswith(" 499")


def test_a_fault_of_the_program_leaves_one_traceback(service: Api, told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(Axes, "register", failing(BUG))
        assert service.http.put("/v1/axes/axis", json={"name": "axis"}).status_code == 500
    lines = told(2)
    assert [(line.levelname, line.exc_info is not None) for line in lines] == [("ERROR", True), ("WARNING", False)]


def test_a_fault_in_the_middle_of_an_answer_leaves_one_traceback(
    service: Api, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    break_off(service, BUG, monkeypatch)
    time.sleep(0.1)  # the server of the framework would say it once more
    (line,) = told(1)
    assert (line.levelname, line.getMessage()) == ("ERROR", "request failed")
    assert line.exc_info is not None
    assert line.exc_info[1] is BUG


def test_what_fails_in_the_background_is_told_alike(caplog: pytest.LogCaptureFixture) -> None:
    wrapped = RuntimeError("of a library")
    wrapped.__cause__ = BusyError("ten jobs are waiting")
    for error in (BUG, FULL, wrapped):
        tell_failure(logging.getLogger("service"), "the job", error)
    assert [(record.levelname, record.getMessage(), bool(record.exc_info)) for record in caplog.records] == [
        ("ERROR", "the job", True),
        ("WARNING", f"the job: {FULL}", False),
        ("WARNING", "the job: ten jobs are waiting", False),
    ]


@pytest.mark.parametrize(
    ("asked", "sent", "told_as"),
    [
        (("GET", "/v1/axes"), {"headers": {"host": "elsewhere"}}, ("GET none 421", "got 'elsewhere'")),
        (
            ("PUT", "/v1/axes/axis"),
            {"headers": {"sec-fetch-site": "cross-site"}},
            ("PUT none 403", "a page may change"),
        ),
        (("GET", "/v1/" + 1000 * "x"), {}, ("GET none 404", "there is no resource /v1/x")),
        (("PUT", "/v1/axes/axis"), {"json": {}}, ("PUT /v1/axes/{axis} 422", "/name: missing")),
        (
            ("POST", "/login"),
            {"data": {"name": "a", "password": 2000 * "s"}},
            ("POST /login 422", "/password: string_too"),
        ),
    ],
)
def test_every_refusal_has_its_reason_there_and_nothing_secret(
    service: Api, told: Told, asked: tuple[str, str], sent: dict[str, Any], told_as: tuple[str, str]
) -> None:
    service.http.request(*asked, **sent)
    assert_one_line(told(1), *told_as)
    members = told(1)[0].__dict__["members"]
    assert "sss" not in members["reason"]
    assert len(members["reason"]) <= 500
