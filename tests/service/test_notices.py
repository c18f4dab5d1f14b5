"""Receivers outside are told of alarms once and in order, whatever happens to them, to the service, or in between."""

import base64
import hashlib
import hmac
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from email import message_from_bytes, policy
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiosmtpd.controller import Controller

from service.clock import now
from service.errors import DataFolderError
from service.observability import Metrics
from service.operations.notices import dispatcher as dispatching
from service.operations.notices.dispatcher import GIVEN_UP_AFTER, Dispatcher
from service.operations.notices.receivers import read_receivers
from service.operations.notices.senders import NotTakenError
from service.operations.notices.webhook import WebhookSender, signature
from service.store import notices
from service.store.database import Database
from service.store.tables import AlarmEventRow, NoticeRow, ReceiverRow
from tests.service.conftest import START, Api, running_service, simulated_measurement

SECRET = "whsec_plJ3nmyCDGBKInavdOK15jsl"  # noqa: S105 - that of the specification's example


class Recipient:
    """Takes what is posted to it; answers with `status`."""

    def __init__(self) -> None:
        self.status = 200
        self.taken: list[tuple[dict[str, str], bytes]] = []
        self.n_refused = 0

    @contextmanager
    def listening(self) -> Iterator[str]:
        recipient = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["content-length"]))
                if recipient.status == 200:
                    recipient.taken.append(({name.lower(): value for name, value in self.headers.items()}, body))
                else:
                    recipient.n_refused += 1
                self.send_response(recipient.status)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                """Say nothing."""

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/hook"
        finally:
            server.shutdown()
            server.server_close()
            thread.join()

    def documents(self) -> list[dict[str, Any]]:
        return [json.loads(body) for _, body in self.taken]


def wait_until(holds: Callable[[], bool], *, seconds: float = 60.0) -> None:
    due = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < due, "it did not happen in time"
        time.sleep(0.02)


def receivers_file(folder: Path, *, url: str | None = None, mail_port: int | None = None) -> Path:
    text = ""
    if url is not None:
        (folder / "secret").write_text(SECRET + "\n")
        text += f'[[webhook]]\nname = "desk"\nurl = "{url}"\nsecret_file = "{folder / "secret"}"\n'
    if mail_port is not None:
        text += (
            f'[[mail]]\nname = "planner"\nhost = "127.0.0.1"\nport = {mail_port}\n'
            'from = "preload@plant.example"\nto = ["planner@plant.example", "shift@plant.example"]\n'
        )
    path = folder / "receivers.toml"
    path.write_text(text)
    return path


def losing_preload(api: Api) -> int:
    """Let an axis lose preload until an alarm stands, and return its number."""
    api.register("axis", windows_per_measurement=8, minimum_averages=8)
    api.calibrate("axis")
    rng = np.random.default_rng(4)
    for day in range(40):
        preload = 300.0 if day < 12 else 300.0 - 12.0 * (day - 12)
        windows = simulated_measurement(
            rng, f"day {day}", n_windows=8, preload=preload, started_at=START + timedelta(days=day)
        )
        api.accept("axis", windows, complete=True)
        alarms = api.http.get("/v1/alarms").json()["alarms"]
        if alarms:
            return int(alarms[0]["id"])
    raise AssertionError("no alarm was raised")


def test_signature_is_that_of_the_specification() -> None:
    """The example of Standard Webhooks."""
    body = b'{"event_type":"ping","data":{"success":true}}'
    signed = signature(SECRET, "msg_loFOjxBNrRLzqYUf", "1731705121", body)
    assert signed == "v1,rAvfW3dJ/X/qxhsaXPOyyCGmRKsaKWcsNccKXlIktD0="


def test_an_alarm_is_told_by_webhook_and_mail_within_two_seconds(tmp_path: Path) -> None:
    mails: list[bytes] = []

    class Mailbox:
        async def handle_DATA(self, _server: object, _session: object, envelope: Any) -> str:  # noqa: N802
            mails.append(envelope.content)
            return "250 taken"

    recipient = Recipient()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = Controller(Mailbox(), hostname="127.0.0.1", port=port)
    server.start()
    try:
        with recipient.listening() as url:
            path = receivers_file(tmp_path, url=url, mail_port=port)
            with running_service(tmp_path / "var", receivers_file=path, public_url="http://preload.plant") as api:
                alarm = losing_preload(api)
                wait_until(lambda: bool(recipient.taken) and bool(mails))
                api.http.post(f"/v1/alarms/{alarm}/acknowledge", json={"comment": "nut ordered"}).raise_for_status()
                wait_until(lambda: any(each["type"].endswith("acknowledged") for each in recipient.documents()))
                events = api.http.get(f"/v1/alarms/{alarm}").json()["events"]
    finally:
        server.stop()
    headers, body = recipient.taken[0]
    key = base64.b64decode(SECRET.removeprefix("whsec_"))
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    expected = base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"
    assert headers["content-type"].startswith("application/cloudevents+json")
    first = recipient.documents()[0]
    assert {"specversion", "id", "source", "type", "subject", "time", "datacontenttype", "data"} == set(first)
    assert (first["specversion"], first["type"]) == ("1.0", "org.preload-monitor.alarm.raised")
    assert (first["source"], first["subject"]) == ("http://preload.plant", "axes/axis")
    assert datetime.fromisoformat(first["time"]).tzinfo is not None
    assert first["data"]["axis"] == "axis"
    assert first["data"]["preload_n"] < 300.0
    assert "below the baseline" in first["data"]["sentence"]
    assert [each["data"]["reason"] for each in recipient.documents()] == [event["reason"] for event in events]
    mail = message_from_bytes(mails[0], policy=policy.default)
    assert mail["To"] == "planner@plant.example, shift@plant.example"
    assert mail["Subject"] == f"axis: alarm {alarm} raised"
    assert "below the baseline" in mail.get_content()
    assert "http://preload.plant/axes/axis" in mail.get_content()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(f"sqlite:///{tmp_path / 'preload.db'}")
    database.migrate()
    yield database
    database.close()


def tell(database: Database, *subjects: str) -> None:
    for subject in subjects:
        with database.write() as session:
            notices.add_notice(session, now(), "test", subject, {"axis": subject})


class Sender:
    """Remembers what it was given; fails while it is down."""

    name = "desk"

    def __init__(self) -> None:
        self.down: NotTakenError | None = None
        self.told: list[str] = []

    def send(self, notice: NoticeRow) -> None:
        if self.down is not None:
            raise self.down
        self.told.append(notice.subject)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[datetime]:
    """Return a list whose only entry is the time."""
    at = [now()]
    monkeypatch.setattr(dispatching, "now", lambda: at[0])
    return at


def make(database: Database, sender: Sender) -> Dispatcher:
    made = Dispatcher(database, [sender], Metrics())
    with database.write() as session:
        notices.receiver(session, sender.name, dispatching.now())
    return made


def test_what_came_while_a_receiver_was_down_is_told_once_and_in_order(
    database: Database, clock: list[datetime]
) -> None:
    sender = Sender()
    made = make(database, sender)
    sender.down = NotTakenError("no answer")
    tries = 0
    began = clock[0]
    for second in (*range(60), *range(60, 3600, 10)):  # an hour
        clock[0] = began + timedelta(seconds=second)
        if second % 600 == 0:
            tell(database, f"n{second}")
        before = _tries(database)
        made.tell_next(sender)
        tries += _tries(database) != before
    assert 12 < tries < 40  # 1, 2, 4 … 256, 300, 300 s apart
    assert sender.told == []
    sender.down = None
    clock[0] += timedelta(seconds=300)
    while made.tell_next(sender):
        pass
    assert sender.told == ["n0", "n600", "n1200", "n1800", "n2400", "n3000"]
    with database.read() as session:
        assert notices.dead_letters(session, "desk") == []


def _tries(database: Database) -> int:
    with database.read() as session:
        row = session.get(ReceiverRow, "desk")
        assert row is not None
        return row.n_tries


def test_what_is_never_taken_becomes_a_dead_letter_and_holds_nothing_up(
    database: Database, clock: list[datetime]
) -> None:
    sender = Sender()
    made = make(database, sender)
    sender.down = NotTakenError("answered with 404")
    tell(database, "lost", "kept")
    made.tell_next(sender)
    clock[0] += GIVEN_UP_AFTER
    made.tell_next(sender)
    sender.down = None
    clock[0] += timedelta(minutes=5)
    assert made.tell_next(sender)
    assert sender.told == ["kept"]
    with database.read() as session:
        (letter,) = notices.dead_letters(session, "desk")
        assert letter.error == "answered with 404"


def test_what_is_refused_for_good_is_not_tried_for_days(database: Database, clock: list[datetime]) -> None:
    sender = Sender()
    made = make(database, sender)
    sender.down = NotTakenError("answered with 400", for_good=True)
    tell(database, "bad")
    for _ in range(3):
        made.tell_next(sender)
        clock[0] += timedelta(seconds=10)
    with database.read() as session:
        assert len(notices.dead_letters(session, "desk")) == 1


def test_a_new_receiver_is_not_told_of_the_past(database: Database) -> None:
    tell(database, "old")
    sender = Sender()
    made = make(database, sender)
    tell(database, "new")
    while made.tell_next(sender):
        pass
    assert sender.told == ["new"]


def test_an_event_of_an_alarm_and_its_notice_are_stored_together_or_not_at_all(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        losing_preload(api)
    database = Database(f"sqlite:///{tmp_path / 'var' / 'preload.db'}")
    with database.read() as session:
        n_events = session.query(AlarmEventRow).count()
        assert n_events > 0
        assert session.query(NoticeRow).count() == n_events
    database.close()


def test_receivers_go_on_where_they_were_after_a_restart(tmp_path: Path) -> None:
    recipient = Recipient()
    recipient.status = 503
    with recipient.listening() as url:
        path = receivers_file(tmp_path, url=url)
        with running_service(tmp_path / "var", receivers_file=path) as api:
            losing_preload(api)
            wait_until(lambda: api.http.get("/v1/receivers").json()["receivers"][0]["last_error"] is not None)
            (desk,) = api.http.get("/v1/receivers").json()["receivers"]
            assert (desk["name"], desk["last_error"], desk["dead_letters"]) == ("desk", "answered with 503", [])
            assert desk["waiting"] >= 1
            assert desk["failing_since"] is not None
        recipient.status = 200
        with running_service(tmp_path / "var", receivers_file=path) as api:
            (alarm,) = api.http.get("/v1/alarms").json()["alarms"]
            wait_until(lambda: len(recipient.taken) >= len(alarm["events"]))
            numbers = [each["id"] for each in recipient.documents()]
            assert len(set(numbers)) == len(numbers)
            assert numbers == sorted(numbers, key=int)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[webhook]]\nname = 'a'\n", "webhook.0.url: Field required"),
        ("[[webhook]]\nname = 'a'\nurl = 'ftp://x'\n", "URL scheme should be 'http' or 'https'"),
        ("[[mail]]\nname = 'a'\nhost = 'h'\nfrom = 'a@b'\nto = []\n", "at least 1 item"),
        ("[[webhook]]\nname = 'a'\nurl = 'http://x'\n[[webhook]]\nname = 'a'\nurl = 'http://y'\n", "different names"),
        ("[[pigeon]]\nname = 'a'\n", "pigeon: Extra inputs are not permitted"),
        ("webhook = [", "cannot be read"),
        (
            "[[webhook]]\nname = 'a'\nurl = 'http://x'\nsecret_file = '/nowhere/secret'\n",
            "/nowhere/secret cannot be read",
        ),
    ],
)
def test_a_file_of_receivers_that_means_nothing_is_refused_in_a_sentence(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "receivers.toml"
    path.write_text(text)
    with pytest.raises(DataFolderError) as refused:
        read_receivers(path)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_no_answer_of_a_webhook_is_a_sentence(tmp_path: Path) -> None:
    path = receivers_file(tmp_path, url="http://127.0.0.1:9/hook")
    (webhook,) = read_receivers(path).webhook
    with pytest.raises(NotTakenError, match="no answer"):
        WebhookSender(webhook, "http://preload.plant").send(
            NoticeRow(id=1, at=now(), kind="test", subject="axes/axis", content={})
        )
