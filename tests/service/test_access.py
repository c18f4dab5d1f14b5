"""Who may do what: every route with every scope left out, keys that are no longer good, guessing, and the log."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from starlette.routing import Route

from service.api.access import COOKIE, OPEN, scopes_of
from service.app import create_app
from service.cli.remote import server
from service.clock import now
from service.errors import ConflictError, InvalidRequestError
from service.jobs import JobHandle
from service.operations.access import access
from service.operations.access.passwords import hashed_password, is_password
from service.operations.access.people import People
from service.operations.access.scopes import EVERYTHING, ROLES, Scope
from service.settings import Settings
from service.store.tables import KeyRow
from tests.conftest import canary
from tests.service.conftest import CONFIGURATION, client_of

PASSWORD = "correct horse battery"  # noqa: S105 - of nobody


class Closed:
    """A service with an administrator, an axis, and what a test may change of its keys and users."""

    def __init__(self, app: FastAPI, http: httpx.Client) -> None:
        self.http = http
        self.access: access.Access = app.state.services.access
        self.database = app.state.services.database
        self.people = People(self.database, "test")

    def browser(self) -> httpx.Client:
        """Return another client, with cookies of its own."""
        return client_of(self.http.base_url)

    def key(self, *scopes: Scope, axes: tuple[str, ...] | None = None, lasts: timedelta | None = None) -> str:
        """Return the header of a new key."""
        _, key = self.people.add_key("test", scopes, axes, lasts)
        self.access.forget()
        return f"Bearer {key}"

    def status(self, method: str, path: str, key: str | None) -> int:
        headers = {} if key is None else {"authorization": key}
        content = None if method in ("GET", "DELETE") else b""
        return self.http.request(method, path, headers=headers, content=content).status_code


@contextmanager
def served(data_dir: Path, **settings: Any) -> Iterator[tuple[FastAPI, httpx.Client]]:
    """Run a service on loopback, and show what is inside."""
    made = Settings(data_dir=data_dir, port=0, **settings)
    app = create_app(made)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(server, "create_app", lambda _settings: app)
        with (
            server.embedded_service(made) as url,
            client_of(url) as http,
        ):
            yield app, http


def _nothing(_: JobHandle) -> None:
    """Be done with a job at once."""


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Closed]:
    with served(tmp_path_factory.mktemp("closed")) as (app, http):
        for axis in ("press", "mill"):
            http.put(f"/v1/axes/{axis}", json={"name": axis, "configuration": CONFIGURATION}).raise_for_status()
        service = Closed(app, http)
        runner = app.state.services.jobs
        runner.work = dict.fromkeys(runner.work, _nothing)  # who may is asked, not what becomes of it
        service.people.add_user("anna", "administrator", PASSWORD)
        service.access.forget()
        yield service


def routes() -> list[Route]:
    """Return every route of the service that somebody has to be known for."""
    return [route for route in create_app(Settings()).routes if isinstance(route, Route) and route.path not in OPEN]


#: Method and template of each, and what is needed for those that state it.
ROUTES = sorted((method, route.path) for route in routes() for method in route.methods or () if method != "HEAD")
NEEDED = scopes_of(routes()) | {("GET", "/openapi.json"): Scope.TRENDS_READ}
#: What only administrators may do, written out: a new route is not among them by being forgotten.
OF_ADMINISTRATORS = {("GET", "/v1/audit"), ("DELETE", "/v1/axes/{axis}/recordings/{recording}")}


def path_of(template: str) -> str:
    for name, value in {"axis": "press", "alarm": "1", "job": "none"}.items():
        template = template.replace(f"{{{name}}}", value)
    return template.replace("{calibration}", "1").replace("{recording}", "1").replace("{measurement}", "1").replace(
        "{window}", "1"
    )  # fmt: skip


def test_every_route_states_what_it_needs_and_nothing_else_does() -> None:
    documented = {
        (method.upper(), path) for path, item in create_app(Settings()).openapi()["paths"].items() for method in item
    }
    assert documented <= {*ROUTES, *((method, path) for path in OPEN for method in ("GET", "POST"))}
    assert set(ROUTES) - OF_ADMINISTRATORS == set(NEEDED)


def test_each_route_is_denied_without_its_scope_and_to_nobody(closed: Closed, subtests: pytest.Subtests) -> None:
    for method, template in ROUTES:
        with subtests.test(method=method, template=template):
            needed, path = NEEDED.get((method, template), Scope.ADMIN), path_of(template)
            assert closed.status(method, path, None) == 401
            assert closed.status(method, path, "Bearer preload_of_nobody") == 401
            closed.access.wrong_keys.right("127.0.0.1", None)
            assert closed.status(method, path, closed.key(*(EVERYTHING - {needed}))) == 403
            assert closed.status(method, path, closed.key(needed)) not in (401, 403)


def test_the_key_of_another_axis_is_denied(closed: Closed, subtests: pytest.Subtests) -> None:
    for method, template in [route for route in ROUTES if "{axis}" in route[1]]:
        with subtests.test(method=method, template=template):
            assert closed.status(method, path_of(template), closed.key(*EVERYTHING, axes=("mill",))) == 403
            assert closed.status(method, path_of(template), closed.key(*EVERYTHING, axes=("press",))) not in (401, 403)


def test_a_key_of_some_axes_does_not_see_all_of_them(closed: Closed) -> None:
    answer = closed.http.get("/v1/axes", headers={"authorization": closed.key(*EVERYTHING, axes=("mill",))})
    assert answer.status_code == 403
    assert "is for mill only; this is of no axis or of all of them" in answer.json()["detail"]


def test_keys_end_when_they_expire_or_are_revoked(closed: Closed) -> None:
    number, key = closed.people.add_key("old", {Scope.TRENDS_READ}, None, timedelta(days=1))
    closed.access.forget()
    assert closed.status("GET", "/v1/axes", f"Bearer {key}") == 200
    with closed.database.write() as session:
        session.get(KeyRow, number).expires_at = now() - timedelta(seconds=1)
    closed.access.forget()
    assert closed.status("GET", "/v1/axes", f"Bearer {key}") == 401
    with closed.database.write() as session:
        session.get(KeyRow, number).expires_at = None
    closed.access.forget()
    assert closed.status("GET", "/v1/axes", f"Bearer {key}") == 200
    closed.people.revoke_key(number)
    closed.access.forget()
    assert closed.status("GET", "/v1/axes", f"Bearer {key}") == 401


def test_what_another_process_revokes_holds_here_within_two_seconds(
    closed: Closed, monkeypatch: pytest.MonkeyPatch
) -> None:
    number, key = closed.people.add_key("told", {Scope.TRENDS_READ}, None, None)
    closed.access.forget()
    assert closed.status("GET", "/v1/axes", f"Bearer {key}") == 200
    closed.people.revoke_key(number)
    later = access.time.monotonic() + access.FRESH_S
    monkeypatch.setattr(access.time, "monotonic", lambda: later)
    assert closed.status("GET", "/v1/axes", f"Bearer {key}") == 401


@pytest.mark.parametrize("role", canary(sorted(ROLES, key=lambda role: len(ROLES[role]))))
def test_people_may_do_what_their_role_says(closed: Closed, role: str) -> None:
    closed.people.add_user(f"a {role}", role, PASSWORD)
    with closed.browser() as http:
        answer = http.post("/login", data={"name": f"a {role}", "password": PASSWORD, "next": "/"})
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
        assert "HttpOnly" in answer.headers["set-cookie"]
        assert "SameSite=strict" in answer.headers["set-cookie"]
        for method, template in ROUTES:
            allowed = NEEDED.get((method, template), Scope.ADMIN) in ROLES[role]
            status = http.request(method, path_of(template), content=None if method == "GET" else b"").status_code
            assert (status != 403) is allowed, (method, template)
        assert http.post("/logout").status_code == 303
        assert http.get("/v1/axes").status_code == 401


def test_who_may_see_the_page_of_the_api_gets_what_it_is_drawn_with(closed: Closed) -> None:
    key = closed.key(Scope.TRENDS_READ)
    page = closed.http.get("/docs", headers={"authorization": key}).text
    assets = re.findall(r'(?:src|href)="(/[^"]+)"', page)
    assert len(assets) == 4
    assert [closed.status("GET", asset, key) for asset in assets] == [200] * 4


def test_who_is_not_logged_in_is_led_to_the_login_and_back(closed: Closed) -> None:
    answer = closed.http.get("/axes/press", headers={"accept": "text/html"})
    assert (answer.status_code, answer.headers["location"]) == (303, "/login?next=/axes/press")
    page = closed.http.get("/login?next=/axes/press").text
    assert 'name="next" value="/axes/press"' in page
    for elsewhere in ("https://elsewhere.example/", "//elsewhere.example", "/\\elsewhere.example", "javascript:x"):
        assert 'name="next" value="/"' in closed.http.get("/login", params={"next": elsewhere}).text


def test_every_change_is_in_the_log_with_who_and_what_became_of_it(closed: Closed) -> None:
    key = closed.key(*EVERYTHING)
    read = {"authorization": closed.key(Scope.ADMIN)}
    for method, template in ROUTES:
        if method == "GET" or template.endswith("/windows"):
            continue
        newest = closed.http.get("/v1/audit?limit=1", headers=read).json()["entries"][0]["id"]
        status = closed.status(method, path_of(template), key)
        entries = closed.http.get("/v1/audit", headers=read).json()["entries"]
        (entry,) = [entry for entry in entries if entry["id"] > newest]
        assert entry["action"] == f"{method} {template}"
        assert entry["target"] == path_of(template)
        assert entry["axis"] == ("press" if "{axis}" in template else None)
        assert entry["status"] == status
        assert entry["who"].startswith("key ")
        assert entry["request_id"]


def test_a_change_that_the_service_did_not_survive_is_in_the_log_without_an_answer(closed: Closed) -> None:
    """The entry stands before anything is tried: `kill -9` between the two leaves it so."""
    caller = closed.access.caller(key=closed.key(Scope.ADMIN).removeprefix("Bearer "), cookie=None, address="here")
    entry = closed.access.begin_entry(caller, "PUT /v1/axes/{axis}", "/v1/axes/press", "press", "r1")
    (row,) = [row for row in closed.access.log("press", None, 10) if row.id == entry]
    assert row.status is None


def test_the_log_is_read_in_pages(closed: Closed) -> None:
    headers = {"authorization": closed.key(Scope.ADMIN)}
    whole = closed.http.get("/v1/audit?limit=1000", headers=headers).json()["entries"]
    first = closed.http.get("/v1/audit?limit=2", headers=headers).json()
    second = closed.http.get(f"/v1/audit?limit=2&cursor={first['next_cursor']}", headers=headers).json()
    assert first["entries"] + second["entries"] == whole[:4]


def test_no_secret_is_in_a_log_or_in_the_database(closed: Closed, caplog: pytest.LogCaptureFixture) -> None:
    key = closed.key(Scope.TRENDS_READ)
    with caplog.at_level(logging.DEBUG):
        closed.status("GET", "/v1/axes", key)
        with closed.browser() as http:
            http.post("/login", data={"name": "anna", "password": PASSWORD})
            cookie = http.cookies[COOKIE]
    logged = [record.getMessage() for record in caplog.records if record.name.startswith(("service", "uvicorn"))]
    assert logged
    written = b"".join(path.read_bytes() for path in closed.database.file.path.parent.glob("preload.db*"))
    for secret in (key.removeprefix("Bearer "), PASSWORD, cookie):
        assert not [line for line in logged if secret in line]
        assert secret.encode() not in written


def test_on_loopback_without_an_administrator_it_is_open_and_says_so(tmp_path: Path) -> None:
    with served(tmp_path) as (app, http):
        assert http.put("/v1/axes/press", json={"name": "press"}).status_code == 201
        for page in ("/", "/axes/press"):
            assert "whoever uses this machine may change everything" in http.get(page).text
        (entry,) = http.get("/v1/audit").json()["entries"]
        assert entry["who"] == "anyone on this machine"
        People(app.state.services.database, "test").add_user("anna", "administrator", PASSWORD)
        app.state.services.access.forget()
        assert http.get("/v1/axes").status_code == 401


def test_beyond_loopback_it_is_closed_from_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for host, on_loopback in {
        "127.0.0.1": True,
        "localhost": True,
        "::1": True,
        "10.0.0.7": False,
        "::": False,
    }.items():
        assert Settings(host=host).is_on_loopback() is on_loopback
    monkeypatch.setattr(Settings, "is_on_loopback", lambda _settings: False)
    with served(tmp_path) as (_, http):
        assert http.get("/v1/axes").status_code == 401
        assert http.get("/healthz").status_code == 200
        assert http.get("/readyz").status_code == 200
        assert "preload user add" in http.get("/login").text


def test_the_last_administrator_stays(closed: Closed) -> None:
    for user in closed.people.users():
        if user.name != "anna":
            closed.people.disable_user(user.name)
    with pytest.raises(ConflictError, match="the last administrator"):
        closed.people.disable_user("anna")
    with pytest.raises(ConflictError, match="the last administrator"):
        closed.people.set_role("anna", "viewer")


def test_a_user_who_is_disabled_or_has_another_password_is_logged_out(closed: Closed) -> None:
    for n, change in enumerate((closed.people.disable_user, lambda name: closed.people.set_password(name, "x" * 12))):
        closed.people.add_user(f"carl {n}", "viewer", PASSWORD)
        with closed.browser() as http:
            assert http.post("/login", data={"name": f"carl {n}", "password": PASSWORD}).status_code == 303
            assert http.get("/v1/axes").status_code == 200
            change(f"carl {n}")
            closed.access.forget()
            assert http.get("/v1/axes").status_code == 401
            assert http.post("/login", data={"name": f"carl {n}", "password": PASSWORD}).status_code == 401
        closed.access.wrong_logins.right("127.0.0.1", f"carl {n}")


def test_passwords_are_long_and_stored_as_hashes(closed: Closed) -> None:
    with pytest.raises(InvalidRequestError, match="10 to 200 characters; got 5"):
        closed.people.add_user("short", "viewer", "short")
    stored = hashed_password(PASSWORD)
    assert is_password(PASSWORD, stored)
    assert not is_password(PASSWORD + " ", stored)
    assert stored != hashed_password(PASSWORD)
