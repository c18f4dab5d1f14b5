"""Guessing passwords and keys: who guesses waits, nobody else does, and what was refused stands in the log."""

import asyncio
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from asyncua import Client, Server, ua
from sqlalchemy import event

from service.api.http import readers
from service.api.http.limits import LARGEST_LOGIN
from service.clock import now
from service.errors import ForbiddenError, StorageError
from service.gateways import opcua_login
from service.gateways.opcua_login import OneUser, Sessions
from service.operations.access import access, passwords, refusals
from service.operations.access.people import People
from service.operations.access.refusals import Refusals, Refused
from service.operations.access.scopes import EVERYTHING, Scope
from service.operations.access.throttle import (
    FORGOTTEN_AFTER_S,
    FREE_TRIES,
    FREE_TRIES_AT_A_NAME,
    LONGEST_WAIT_S,
    MOST_ADDRESSES,
    LoginThrottle,
)
from service.operations.monitoring.axes import Axes
from service.store.access import logged_in_since, newest_entry
from service.store.database import Database
from service.store.tables import AuditRow
from tests.conftest import free_port
from tests.service.conftest import CONFIGURATION
from tests.service.test_access import PASSWORD, Closed, served
from tests.service.test_cli_people import run

OWNER, ATTACKER = "198.51.100.1", "203.0.113.7"


@pytest.fixture
def behind_proxy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Closed]:
    """Run a service with the users anna and carl whose stated proxy says from which address each request comes."""
    monkeypatch.setattr(passwords, "_N", 2**4)  # a hash of 50 µs, where its cost is not what is tried
    monkeypatch.setattr(access, "time", SimpleNamespace(monotonic=lambda: 1e6))  # no wait ends while a test lasts
    with served(tmp_path, trusted_proxies="127.0.0.1") as (app, http):
        service = Closed(app, http)
        service.people.add_user("anna", "administrator", PASSWORD)
        service.people.add_user("carl", "viewer", PASSWORD)
        service.access.forget()
        yield service


def log_in(service: Closed, address: str, *, name: str = "anna", password: str = "wrong") -> httpx.Response:  # noqa: S107
    headers = {"x-forwarded-for": address}
    answer = service.http.post("/login", data={"name": name, "password": password}, headers=headers)
    service.http.cookies.clear()
    return answer


def key_of_administrator(service: Closed) -> dict[str, str]:
    return {"authorization": service.key(*EVERYTHING)}


def entries(service: Closed) -> list[dict[str, Any]]:
    answer = service.http.get("/v1/audit?limit=1000", headers=key_of_administrator(service))
    return list(answer.json()["entries"])


def refused_entries(service: Closed) -> list[dict[str, Any]]:
    return [entry for entry in entries(service) if entry["status"] in (401, 403, 429)]


def test_guesses_from_thirty_addresses_do_not_keep_the_owner_out(behind_proxy: Closed) -> None:
    guesses = [log_in(behind_proxy, f"203.0.113.{n // 2}").status_code for n in range(60)]
    assert guesses == [401] * 60
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303


def test_guesses_from_ever_new_networks_are_slowed_and_do_not_keep_the_owner_out(behind_proxy: Closed) -> None:
    """A customer of a provider has 65,536 networks of IPv6, each of as many addresses as there are."""
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303
    guesses = [log_in(behind_proxy, f"2001:db8:0:{n:x}::1").status_code for n in range(FREE_TRIES_AT_A_NAME + 20)]
    assert guesses == [401] * FREE_TRIES_AT_A_NAME + [429] * 20
    assert log_in(behind_proxy, "2001:db8::1", password=PASSWORD).status_code == 429
    assert log_in(behind_proxy, "2001:db8::1", name="carl", password=PASSWORD).status_code == 303
    behind_proxy.access.forget()
    assert log_in(behind_proxy, OWNER).status_code == 401  # where the owner logged in, slips cost what they did
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303


def test_whether_somebody_logged_in_before_is_found_by_an_index(behind_proxy: Closed) -> None:
    """It is asked at each guess at a crowded name, and the log grows with every change."""
    asked = []
    with behind_proxy.database.read() as session:
        event.listen(session.connection(), "before_cursor_execute", lambda *said: asked.append(said[2:4]))
        logged_in_since(session, "anna", OWNER, now())
        ((statement, values),) = asked
        plan = session.connection().exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", values).all()
    assert [step.detail.partition("USING ")[2] for step in plan] == ["INDEX ix_audit_log_logins (who=? AND target=?)"]


def test_an_unlock_opens_a_name_that_was_guessed_at_from_everywhere(
    behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access, "FRESH_S", 0.0)
    for n in range(FREE_TRIES_AT_A_NAME):
        log_in(behind_proxy, f"2001:db8:0:{n:x}::1")
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 429
    unlock(behind_proxy, "anna")
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303


def test_of_sixty_guesses_at_once_five_are_looked_at(behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    real, looked_at, everyone = access.is_password, [], threading.Barrier(60)

    def is_password(password: str, stored: str) -> bool:
        looked_at.append(password)
        return real(password, stored)

    def guess(n: int) -> int:
        everyone.wait()
        return log_in(behind_proxy, ATTACKER, name=("anna", "carl", "nobody")[n % 3], password=f"{n}").status_code

    monkeypatch.setattr(access, "is_password", is_password)
    with ThreadPoolExecutor(60) as threads:
        statuses = list(threads.map(guess, range(60)))
    assert len(looked_at) == FREE_TRIES
    refused = [status for status in statuses if status != 401]
    assert len(refused) == 60 - FREE_TRIES
    assert set(refused) <= {429, 503}  # too many tries, or so many at once that there is no place to wait


def test_guesses_from_everywhere_at_once_keep_no_other_request_waiting(
    behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each would take a thread of those that answer, and 16 MiB."""
    under_way, goes_on = threading.Semaphore(0), threading.Event()
    looked_at = []

    def is_password(password: str, _stored: str) -> bool:
        looked_at.append(password)
        under_way.release()
        goes_on.wait(60.0)
        return False

    monkeypatch.setattr(access, "is_password", is_password)
    monkeypatch.setattr(readers, "PATIENCE_S", 60.0)
    headers = {"authorization": behind_proxy.key(Scope.TRENDS_READ)}
    with ThreadPoolExecutor(60) as threads:
        guesses = [threads.submit(log_in, behind_proxy, f"203.0.113.{n}", password=f"{n}") for n in range(60)]
        for _ in range(readers.AT_WORK):
            assert under_way.acquire(timeout=60.0)
        assert behind_proxy.http.get("/v1/axes", headers=headers).status_code == 200
        assert len(looked_at) == readers.AT_WORK
        goes_on.set()
    assert {guess.result().status_code for guess in guesses} == {401}
    assert len(looked_at) == 60


def test_a_login_is_no_larger_than_its_form(behind_proxy: Closed) -> None:
    longest = {
        "name": "\N{BLACK SQUARE}" * 64,
        "password": "\U0001f600" * passwords.LONGEST_PASSWORD,
        "next": "/" * 400,
    }
    assert behind_proxy.http.post("/login", data=longest).status_code == 401
    assert behind_proxy.http.post("/login", data=longest | {"next": "/" * LARGEST_LOGIN}).status_code == 413


def test_an_own_success_does_not_clear_guesses_at_other_names(behind_proxy: Closed) -> None:
    statuses = []
    for _ in range(FREE_TRIES):
        statuses.append(log_in(behind_proxy, ATTACKER, name="anna").status_code)
        if len(statuses) < FREE_TRIES:
            assert log_in(behind_proxy, ATTACKER, name="carl", password=PASSWORD).status_code == 303
    assert statuses == [401] * FREE_TRIES
    answer = log_in(behind_proxy, ATTACKER, name="carl", password=PASSWORD)
    assert answer.status_code == 429
    assert int(answer.headers["retry-after"]) >= 1


def test_own_slips_are_forgotten_with_the_right_password(behind_proxy: Closed) -> None:
    for _ in range(3):
        for _ in range(FREE_TRIES - 1):
            assert log_in(behind_proxy, OWNER).status_code == 401
        assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303


def test_a_try_that_the_database_could_not_judge_is_no_wrong_one(
    behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> bool:
        raise StorageError("the disk is gone")

    with monkeypatch.context() as broken:
        broken.setattr(access.Access, "_is_right", fails)
        for _ in range(2 * FREE_TRIES):
            assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 503
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303


def test_a_command_unlocks(behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "FRESH_S", 0.0)
    for _ in range(FREE_TRIES + 3):
        log_in(behind_proxy, OWNER)
    answer = log_in(behind_proxy, OWNER, password=PASSWORD)
    assert answer.status_code == 429
    assert "preload user unlock" in answer.text
    unlock(behind_proxy, "carl")
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 429  # another one was unlocked
    unlock(behind_proxy, "anna")
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303
    unlocks = [(entry["action"], entry["target"]) for entry in entries(behind_proxy) if "unlock" in entry["action"]]
    assert unlocks == [("user unlock", "anna"), ("user unlock", "carl")]


def unlock(service: Closed, name: str) -> None:
    """Give the command, beside the running service."""
    done = run(service.database.file.path.parent, "user", "unlock", name)
    assert done.output == f"{name} may log in again\n"


def test_whoever_guessed_at_other_names_from_the_same_address_does_not_outlast_an_unlock(
    behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access, "FRESH_S", 0.0)
    for _ in range(FREE_TRIES):
        log_in(behind_proxy, OWNER, name="carl")
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 429
    behind_proxy.people.unlock_user("anna")
    assert log_in(behind_proxy, OWNER, password=PASSWORD).status_code == 303


def test_wrong_keys_are_slowed_and_the_right_one_is_not(behind_proxy: Closed) -> None:
    forwarded = {"x-forwarded-for": ATTACKER}
    statuses = [
        behind_proxy.http.get("/v1/axes", headers=forwarded | {"authorization": f"Bearer {n}"}).status_code
        for n in range(FREE_TRIES + 1)
    ]
    assert statuses == [401] * FREE_TRIES + [429]
    right = forwarded | {"authorization": behind_proxy.key(Scope.TRENDS_READ)}
    assert behind_proxy.http.get("/v1/axes", headers=right).status_code == 200


def test_passwords_of_opc_ua_go_through_the_same_counter(caplog: pytest.LogCaptureFixture) -> None:
    asyncio.run(guess_at_opcua(caplog))


async def guess_at_opcua(caplog: pytest.LogCaptureFixture) -> None:
    users = OneUser("control", PASSWORD)
    server, port, throttle = Server(iserver=Sessions(user_manager=users)), free_port(), users._throttle
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/preload")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    server.set_identity_tokens([ua.UserNameIdentityToken])
    real = asyncio.BaseEventLoop.create_connection

    async def is_let_in(address: str, password: str) -> bool:
        client = Client(f"opc.tcp://127.0.0.1:{port}/preload")
        client.set_user("control")
        client.set_password(password)
        with pytest.MonkeyPatch.context() as patched:
            connect = partialmethod(real, local_addr=(address, 0))
            patched.setattr(asyncio.BaseEventLoop, "create_connection", connect)
            try:
                async with client:
                    return True
            except ua.uaerrors.BadUserAccessDenied:
                return False

    async with server:
        assert [await is_let_in("127.0.0.1", str(n)) for n in range(FREE_TRIES)] == [False] * FREE_TRIES
        for _ in range(2):
            assert not await is_let_in("127.0.0.1", PASSWORD)  # it has to wait, also with the right one
        assert await is_let_in("127.0.0.2", PASSWORD)
        for n in range(FREE_TRIES_AT_A_NAME - FREE_TRIES):
            throttle.begin(f"203.0.113.{n}", "control", at_s=time.monotonic())
        assert not await is_let_in("127.0.0.3", PASSWORD)
        assert await is_let_in("127.0.0.2", PASSWORD)  # where the right one came from before
    told = [record.getMessage() for record in caplog.records if record.name == opcua_login.__name__]
    assert told[:-2] == ["OPC UA: a wrong name or password came from 127.0.0.1"] * FREE_TRIES
    assert told[-2].startswith("OPC UA: 127.0.0.1 has to wait")  # once
    assert told[-1].startswith("OPC UA: 127.0.0.3 has to wait")


# --- the counter -----------------------------------------------------------------------------------------------------


def test_each_wrong_try_doubles_the_wait() -> None:
    throttle, at_s, waits = LoginThrottle(), 0.0, []
    for _ in range(FREE_TRIES + 1100):  # 2 to the power of 1024 is no number any more
        wait_s = throttle.begin(OWNER, "anna", at_s=at_s)
        waits.append(wait_s)
        at_s += wait_s
        if wait_s:
            assert throttle.begin(OWNER, "anna", at_s=at_s) == 0.0
    assert waits[: FREE_TRIES + 1] == [0.0] * FREE_TRIES + [1.0]
    assert waits[FREE_TRIES : FREE_TRIES + 9] == [2.0**n for n in range(9)]
    assert max(waits) == LONGEST_WAIT_S
    assert throttle.begin("198.51.100.2", "anna", at_s=at_s) == 0.0
    assert throttle.begin(OWNER, "anna", at_s=at_s + FORGOTTEN_AFTER_S + 1.0) == 0.0


def test_a_name_forgives_as_one_address_does() -> None:
    """An hour of guesses from everywhere: the free ones, and one more each time that it forgives."""
    throttle, right = LoginThrottle(), 0
    for second in range(3600):
        hosts = (f"2001:db8:{second:x}:{n:x}::1" for n in range(2))
        right += sum(throttle.begin(host, "anna", at_s=float(second)) == 0.0 for host in hosts)
    assert right == FREE_TRIES_AT_A_NAME + 3600 // LONGEST_WAIT_S - 1
    for n in range(2 * FREE_TRIES_AT_A_NAME):  # of whoever knows the password nothing is left
        assert throttle.begin(f"192.0.2.{n}", "carl", at_s=0.0) == 0.0
        throttle.right(f"192.0.2.{n}", "carl")


def test_all_addresses_of_a_host_are_one() -> None:
    throttle = LoginThrottle()
    for n in range(FREE_TRIES):
        assert throttle.begin(f"2001:db8:0:1:{n}::{n}", "anna", at_s=0.0) == 0.0
    assert throttle.begin("2001:db8:0:1:ffff::1", "anna", at_s=0.0) == 1.0
    assert throttle.begin("2001:db8:0:2::1", "anna", at_s=0.0) == 0.0


def test_the_counter_takes_a_bounded_memory() -> None:
    """From ever new addresses, and from one with ever new tries: who guesses most is not the one that is forgotten."""
    throttle = LoginThrottle()
    for _ in range(FREE_TRIES):
        throttle.begin(ATTACKER, "anna", at_s=0.0)
    for n in range(2 * MOST_ADDRESSES):
        throttle.begin(f"10.{n >> 16}.{n >> 8 & 255}.{n & 255}", f"{n}", at_s=0.0)
        if n % (MOST_ADDRESSES // 2) == 0:
            assert throttle.begin(ATTACKER, "anna", at_s=0.0) == 1.0
    assert len(throttle._tries) == MOST_ADDRESSES


# --- the log ---------------------------------------------------------------------------------------------------------


def test_refused_attempts_stand_in_the_log_with_their_addresses(behind_proxy: Closed) -> None:
    headers = key_of_administrator(behind_proxy)
    behind_proxy.http.put("/v1/axes/press", json={"name": "press", "configuration": CONFIGURATION}, headers=headers)
    reader = {"authorization": behind_proxy.key(Scope.TRENDS_READ), "x-forwarded-for": OWNER}
    assert behind_proxy.http.put("/v1/axes/press", json={}, headers=reader).status_code == 403
    assert behind_proxy.http.get("/v1/audit", headers={"x-forwarded-for": ATTACKER}).status_code == 401
    foreign = {"origin": "http://elsewhere.example", "x-forwarded-for": "203.0.113.9"}
    assert behind_proxy.http.post("/v1/axes/press/windows", headers=foreign).status_code == 403
    for n in range(FREE_TRIES + 3):
        log_in(behind_proxy, ATTACKER, name="anna", password=f"secret {n}")
        behind_proxy.http.get("/v1/axes", headers={"authorization": f"Bearer {n}", "x-forwarded-for": "203.0.113.8"})
    log_in(behind_proxy, "203.0.113.10", name="the password itself")
    entries = {(entry["who"], entry["status"]): entry for entry in refused_entries(behind_proxy)}
    (key,) = [who for who, _ in entries if who.startswith("key ")]
    assert set(entries) == {
        (key, 403),
        (f"nobody from {ATTACKER}", 401),
        ("nobody from 203.0.113.9", 403),
        (f"user anna from {ATTACKER}", 401),
        (f"user anna from {ATTACKER}", 429),
        ("an unknown key from 203.0.113.8", 401),
        ("an unknown key from 203.0.113.8", 429),
        ("an unknown user from 203.0.113.10", 401),
    }
    assert key.endswith(f"(test) from {OWNER}")
    assert (entries[key, 403]["action"], entries[key, 403]["target"]) == ("PUT /v1/axes/{axis}", "/v1/axes/press")
    guessed = entries[f"user anna from {ATTACKER}", 401]
    assert guessed["action"] == "POST /login"
    assert guessed["target"].startswith(f"/login ({FREE_TRIES} times until 20")
    assert "(3 times until" in entries[f"user anna from {ATTACKER}", 429]["target"]


def test_a_login_stands_in_the_log_with_its_address(behind_proxy: Closed) -> None:
    log_in(behind_proxy, OWNER, password=PASSWORD)
    (entry,) = [entry for entry in entries(behind_proxy) if entry["action"] == "log in"]
    assert (entry["who"], entry["target"], entry["status"]) == ("user anna", f"/login from {OWNER}", 200)


def test_what_a_route_refuses_stands_in_the_log_once(behind_proxy: Closed, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: object, **__: object) -> None:
        raise ForbiddenError("not this one")

    monkeypatch.setattr(Axes, "register", refuses)
    answer = behind_proxy.http.put("/v1/axes/press", json={"name": "press"}, headers=key_of_administrator(behind_proxy))
    assert answer.status_code == 403
    (entry,) = [entry for entry in entries(behind_proxy) if entry["status"] == 403]
    assert entry["request_id"]


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(f"sqlite:///{tmp_path}/preload.db")
    database.migrate()
    yield database
    database.close()


def rows_of(database: Database) -> list[AuditRow]:
    with database.read() as session:
        return list(session.query(AuditRow).order_by(AuditRow.id))


def test_a_flood_of_refusals_takes_a_bounded_place_on_the_disk(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "MOST_ENTRIES", most := 50)
    monkeypatch.setattr(refusals, "MOST_KEPT", 2 * most)
    People(database, "test").add_user("anna", "administrator", PASSWORD)
    log, start = Refusals(database), refusals.now()
    for hour in range(5):
        monkeypatch.setattr(refusals, "now", lambda hour=hour: start + hour * timedelta(hours=1, seconds=1))
        for n in range(3 * most):
            address = f"10.{hour}.{n >> 8}.{n & 255}"
            for status in (401, 429):
                log.note(Refused("nobody", address, "GET /", "/" + "x" * 10_000, status))
        log.write()
        assert len(log._entries) <= most + 2
    rows = rows_of(database)
    assert len([row for row in rows if row.status in (401, 429)]) <= 2 * most
    assert [row.action for row in rows if row.status == 0] == ["user add administrator"]  # what was changed stays
    assert max(len(row.target) for row in rows) <= 400
    others = [row for row in rows if row.who == "others from further addresses"]
    assert {row.status for row in others} == {401, 429}
    assert sum(int(row.target.partition("(")[2].partition(" ")[0]) for row in others[-2:]) == 2 * 3 * most - most


def disk_is_full() -> None:
    raise StorageError("the database refused: disk full")


def test_what_the_database_does_not_take_is_written_later(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    log = Refusals(database)
    refused = Refused("nobody", ATTACKER, "GET /v1/axes", "/v1/axes", 401)
    log.note(refused)
    with monkeypatch.context() as broken:
        broken.setattr(database, "write", disk_is_full)
        log.write()
    assert rows_of(database) == []
    log.note(refused)
    log.write()
    log.write()
    (row,) = rows_of(database)
    assert "(2 times until" in row.target
    with database.read() as session:
        assert newest_entry(session) == row.id
