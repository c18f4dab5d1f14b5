"""What goes out is bounded and verified: by local servers that show foreign certificates, drip, or never end."""

import asyncio
import re
import socket
import ssl
import threading
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import click
import pytest
from paho.mqtt.client import MQTTMessage
from pydantic import BaseModel

import preload_client
from preload_client import AsyncClient, Client, UnreachableError, exchange as exchanging
from service.api.http import limits
from service.cli.remote import client as remote
from service.clock import now
from service.errors import DataFolderError
from service.gateways import mqtt_windows, opcua_reading
from service.gateways.mqtt_windows import MqttSettings, ServiceAwayError, WindowsGateway
from service.gateways.opcua_reading import read_service
from service.operations.notices import mail as mailing, mqtt, webhook as posting
from service.operations.notices.mail import MailSender
from service.operations.notices.mqtt import MqttSender
from service.operations.notices.receivers import Broker, Mail, Webhook, read_receivers
from service.operations.notices.senders import MOST_BYTES, NotTakenError, Sender
from service.operations.notices.webhook import WebhookSender
from service.store import notices, waveform_objects
from service.store.tables import NoticeRow
from tests.service.servers import WITHOUT_END, MailServer, foreign_certificate, talking, until_it_ends
from tests.service.test_access import served
from tests.service.test_notices import wait_until
from tests.service.test_python_client import at_once, in_a_loop

PASSWORD = "of-the-mail"  # noqa: S105 - of nobody
SOURCE = "http://preload.plant"


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ssl.SSLContext]:
    """Return a certificate that no system knows, and what a server shows it by."""
    folder = tmp_path_factory.mktemp("foreign")
    return folder / "cert.pem", foreign_certificate(folder)


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an exchange last half a second."""
    for module in (posting, mailing, mqtt):
        monkeypatch.setattr(module, "TIMEOUT_S", 0.5)


def send(sender: Sender) -> None:
    sender.send(NoticeRow(id=1, at=now(), kind="org.test.raised", subject="axes/a", content={"axis": "a"}))


def webhook(port: int, scheme: str = "http", **more: Any) -> WebhookSender:
    return WebhookSender(Webhook(name="desk", url=f"{scheme}://127.0.0.1:{port}/hook", **more), SOURCE)


def mail(port: int, **more: Any) -> MailSender:
    people = {"from": "preload@plant.example", "to": ["planner@plant.example"]}
    return MailSender(Mail(name="planner", host="127.0.0.1", port=port, **people, **more), SOURCE)


def broker(port: int, **more: Any) -> MqttSender:
    return MqttSender(Broker(name="plant", host="127.0.0.1", port=port, **more), SOURCE)


# --- verified ---------------------------------------------------------------------------------------------------------


def test_a_mail_server_gets_the_password_only_where_it_shows_a_certificate_that_is_believed(
    tmp_path: Path, foreign: tuple[Path, ssl.SSLContext]
) -> None:
    ca_file, tls = foreign
    password = tmp_path / "password"
    password.write_text(PASSWORD + "\n", encoding="utf-8")
    server = MailServer(tls)
    login: dict[str, Any] = {"start_tls": True, "username": "preload", "password_file": password}
    with server.listening() as port:
        with pytest.raises(NotTakenError, match="certificate verify failed"):
            send(mail(port, **login))
        assert (server.passwords, server.mails) == ([], [])
        send(mail(port, **login, ca_file=ca_file))
    assert server.passwords == [PASSWORD.encode()]
    assert len(server.mails) == 1


@pytest.mark.parametrize("status", [200, 302])
def test_a_webhook_is_verified_and_leads_nowhere_else(foreign: tuple[Path, ssl.SSLContext], status: int) -> None:
    ca_file, tls = foreign
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["content-length"]))
            asked.append(self.path)
            self.send_response(status)
            self.send_header("location", "/elsewhere")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with talking(lambda connection: void(Handler(connection, ("", 0), None)), tls) as port:  # type: ignore[arg-type]
        with pytest.raises(NotTakenError, match="certificate verify failed"):
            send(webhook(port, "https"))
        assert asked == []
        if status == 200:
            send(webhook(port, "https", ca_file=ca_file))
        else:
            with pytest.raises(NotTakenError, match="answered with 302"):
                send(webhook(port, "https", ca_file=ca_file))
    assert asked == ["/hook"]


def void(_: object) -> None:
    """Take it, and return nothing."""


def test_a_broker_is_verified_before_it_is_told_anything(foreign: tuple[Path, ssl.SSLContext]) -> None:
    heard: list[bytes] = []
    hear = talking(lambda connection: heard.append(connection.recv(1)), foreign[1])
    with hear as port, pytest.raises(NotTakenError, match="certificate verify failed"):
        send(broker(port, tls=True))
    assert heard == []


def test_a_key_goes_only_to_a_service_that_is_believed(
    foreign: tuple[Path, ssl.SSLContext], monkeypatch: pytest.MonkeyPatch
) -> None:
    ca_file, tls = foreign
    heard: list[bytes] = []

    def talk(to: socket.socket) -> None:
        heard.append(to.recv(2**16))
        to.sendall(b'HTTP/1.1 200 OK\r\ncontent-length: 11\r\n\r\n{"axes":[]}')

    class Axes(BaseModel):
        axes: list[str]

    monkeypatch.setenv("PRELOAD_KEY", PASSWORD)
    with talking(talk, tls) as port:
        with (
            remote.Client(f"https://127.0.0.1:{port}") as client,
            pytest.raises(click.ClickException, match="certificate verify failed"),
        ):
            client.get("/v1/axes", Axes)
        assert heard == []
        monkeypatch.setenv("PRELOAD_CA_FILE", str(ca_file))
        with remote.Client(f"https://127.0.0.1:{port}") as client:
            assert client.get("/v1/axes", Axes).axes == []
    assert PASSWORD.encode() in heard[0]


REFUSED = [
    ("mail", "start_tls = false", "the password would go to mail.plant.example without TLS; set start_tls = true"),
    ("mail", "ca_file = 'ca.pem'", "ca_file is for TLS, which is off; switch it on: start_tls = true"),
    ("mail", "start_tls = true\nca_file = 'ca.pem'", "the certificates in ca.pem cannot be read"),
    ("mqtt", "", "the password would go to mail.plant.example without TLS; set tls = true"),
    ("mqtt", "tls = true\nca_file = 'ca.pem'", "the certificates in ca.pem cannot be read"),
]


@pytest.mark.parametrize(("kind", "line", "says"), REFUSED)
def test_what_would_give_a_password_away_is_refused_in_a_sentence(
    tmp_path: Path, kind: str, line: str, says: str
) -> None:
    (tmp_path / "password").write_text(PASSWORD, encoding="utf-8")
    people = "from = 'a@b'\nto = ['a@b']\n" if kind == "mail" else ""
    text = (
        f"[[{kind}]]\nname = 'plant'\nhost = 'mail.plant.example'\nusername = 'preload'\n"
        f"password_file = '{tmp_path / 'password'}'\n{people}"
    )
    path = tmp_path / "receivers.toml"
    path.write_text(f"{text}{line}\n", encoding="utf-8")
    with pytest.raises(DataFolderError) as refused:
        read_receivers(path)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)
    assert PASSWORD not in str(refused.value)
    path.write_text(f"{text}password_in_clear = true\n", encoding="utf-8")
    read_receivers(path)


def test_the_gateway_and_a_webhook_keep_their_passwords_too() -> None:
    with pytest.raises(ValueError, match="the password would go to broker without TLS"):
        MqttSettings(host="broker", username="preload", password_file=Path("file"))
    with pytest.raises(ValueError, match=r"the password in it would go to desk\.example without TLS; use https"):
        Webhook(name="desk", url="http://me:secret@desk.example/hook")


# --- bounded ----------------------------------------------------------------------------------------------------------


def greeted(connection: socket.socket, answer: bytes) -> socket.socket:
    """Read what the other side says first, and answer it."""
    connection.recv(2**16)
    connection.sendall(answer)
    return connection


#: What each kind of receiver is told by a server that has begun to answer well.
KINDS: list[tuple[str, Callable[[int], Sender], Callable[[socket.socket], socket.socket], bytes]] = [
    ("webhook", webhook, lambda to: greeted(to, b"HTTP/1.1 200 OK\r\n"), b"x: " + 1021 * b"y" + b"\r\n"),
    ("mail", mail, lambda to: to, b"220-" + 994 * b"y" + b"\r\n"),
]


@pytest.mark.parametrize(("sender", "begun", "part"), [kind[1:] for kind in KINDS], ids=[kind[0] for kind in KINDS])
def test_an_answer_ends_by_its_bytes_and_by_the_total_time(
    sender: Callable[[int], Sender], begun: Callable[[socket.socket], socket.socket], part: bytes
) -> None:
    sent: list[int] = []
    flood = talking(lambda to: sent.append(until_it_ends(begun(to), part)))
    with flood as port, pytest.raises(NotTakenError, match=f"longer than {MOST_BYTES} bytes"):
        send(sender(port))
    drip = talking(lambda to: sent.append(until_it_ends(begun(to), part[4:5], 0.02)))
    with drip as port, pytest.raises(NotTakenError, match=r"did not end within 0\.5 s"):
        send(sender(port))
    assert all(n_bytes < WITHOUT_END for n_bytes in sent)


def test_the_content_of_an_answer_is_not_read() -> None:
    sent: list[int] = []
    head = b"HTTP/1.1 200 OK\r\ncontent-type: text/plain\r\n\r\n"
    with talking(lambda to: sent.append(until_it_ends(greeted(to, head), 2**16 * b"y"))) as port:
        send(webhook(port))
    assert sent[0] < WITHOUT_END


def test_a_broker_is_waited_for_and_listened_to_within_bounds() -> None:
    silent = talking(lambda to: void(to.recv(2**16) + to.recv(2**16)))
    with silent as port, pytest.raises(NotTakenError, match=r"did not acknowledge within 0\.5 s"):
        send(broker(port))
    accepted = b"\x20\x03\x00\x00\x00"
    announced = b"\x30\xff\xff\xff\x7f"  # a message of 256 MiB, of which nothing follows
    long = talking(lambda to: void(greeted(greeted(to, accepted), announced).recv(1)))
    with long as port, pytest.raises(NotTakenError, match=f"a packet that is longer than {MOST_BYTES} bytes"):
        send(broker(port))


def test_a_receiver_that_drips_is_shown_as_failing(tmp_path: Path) -> None:
    begun, part = KINDS[0][2], KINDS[0][3]
    with talking(lambda to: void(until_it_ends(begun(to), part[4:5], 0.02))) as port:
        path = tmp_path / "receivers.toml"
        path.write_text(f"[[webhook]]\nname = 'desk'\nurl = 'http://127.0.0.1:{port}/hook'\n", encoding="utf-8")
        with served(tmp_path / "var", receivers_file=path) as (app, http):
            with app.state.services.database.write() as session:
                notices.add_notice(session, now(), "org.test.raised", "axes/a", {"axis": "a"})

            def desk() -> dict[str, Any]:
                return dict(http.get("/v1/receivers").json()["receivers"][0])

            wait_until(lambda: desk()["failing_since"] is not None)
            assert "did not end within 0.5 s" in desk()["last_error"]
            measured = http.get("/metrics").text
            page = http.get("/system", headers={"accept": "text/html"}).text
    assert 'preload_receiver_failing{receiver="desk"} 1.0' in measured
    assert 'preload_receiver_waiting{receiver="desk"} 1.0' in measured
    assert re.search(r"desk</th>\s*<td[^>]*><strong class=\"bad\">", page)


# --- to the own service, and to a store -------------------------------------------------------------------------------

DRIPPING_BODY = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\n\r\n"


def dripping() -> Any:
    """Return a server of HTTP that begins well and goes on byte by byte."""
    return talking(lambda to: void(until_it_ends(greeted(to, DRIPPING_BODY), b" ", 0.02)))


def flooding() -> Any:
    """Return a server of HTTP that begins well and does not end."""
    return talking(lambda to: void(until_it_ends(greeted(to, DRIPPING_BODY), 2**16 * b" ")))


def test_a_client_waits_and_reads_within_bounds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(preload_client.routes, "_MOST_BYTES", 2**16)
    monkeypatch.setattr(preload_client.routes, "_TRANSFER_S", 0.5)

    def axes(client: Client) -> object:
        return client.axes()

    def table(client: Client) -> object:
        return client.table("/v1/alarms", tmp_path / "alarms.json")

    for asked in (at_once, in_a_loop):
        with dripping() as port:
            for ask in (axes, table):
                with pytest.raises(UnreachableError, match=r"did not end within 0\.5 s"):
                    asked(f"http://127.0.0.1:{port}", ask, timeout_s=0.5, retries=0)
        with flooding() as port, pytest.raises(UnreachableError, match="longer than 65536 bytes"):
            asked(f"http://127.0.0.1:{port}", axes, retries=0)


def test_the_gateways_wait_and_read_within_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_windows, "TIMEOUT_S", 0.5)
    monkeypatch.setattr(mqtt_windows, "MOST_OF_ANSWER", 2**16)
    monkeypatch.setattr(opcua_reading, "READ_WITHIN_S", 0.5)
    monkeypatch.setattr(preload_client.routes, "_MOST_BYTES", 2**16)

    def post(port: int) -> None:
        gateway = WindowsGateway(MqttSettings(), f"http://127.0.0.1:{port}", None)
        gateway._post("axis", MQTTMessage(topic=b"preload/axes/axis/windows"))

    async def read(port: int) -> None:
        async with AsyncClient(f"http://127.0.0.1:{port}", retries=0) as service:
            await read_service(service)

    with dripping() as port:
        with pytest.raises(ServiceAwayError, match=r"did not end within 0\.5 s"):
            post(port)
        with pytest.raises(opcua_reading.ServiceAwayError, match=r"has not answered within 0\.5 s"):
            asyncio.run(read(port))
    with flooding() as port:
        with pytest.raises(ServiceAwayError, match="longer than 65536 bytes"):
            post(port)
        with pytest.raises(opcua_reading.ServiceAwayError, match="longer than 65536 bytes"):
            asyncio.run(read(port))


def test_a_body_on_a_slow_line_has_the_time_that_the_service_gives_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Total times are longer than the service waits for a body without progress, and grow with what is sent."""
    assert exchanging.SLOWEST_BYTES_PER_S == limits.SLOWEST_BYTES_PER_S
    assert mqtt_windows.TIMEOUT_S > limits.BODY_TIME_S
    body, pause = {"samples": 2**21 * "x"}, threading.Event()

    def talk(to: socket.socket) -> None:
        pause.wait(0.6)  # longer than the client waits for anything but this
        n_bytes = 0
        with suppress(OSError):
            while n_bytes < 2**21 and (part := to.recv(2**18)):
                n_bytes += len(part)
            to.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n{}")

    with talking(talk) as port, Client(f"http://127.0.0.1:{port}", timeout_s=0.2, retries=0) as client:
        assert client.request("POST", "/v1/axes/axis/windows", json=body) == {}
        monkeypatch.setattr(exchanging, "SLOWEST_BYTES_PER_S", 2**25)  # the same pause is a line that stands still
        with pytest.raises(UnreachableError, match=r"did not end within 0\.[23] s"):
            client.request("POST", "/v1/axes/axis/windows", json=body)


@pytest.mark.release
def test_a_store_is_waited_for_within_a_total_time(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("s3fs")
    monkeypatch.setattr(waveform_objects, "TOTAL_S", 0.2)
    with talking(lambda to: void(until_it_ends(greeted(to, b"HTTP/1.1 200 OK\r\n"), b"x", 0.02))) as port:
        for name, value in {"ENDPOINT_URL": f"http://127.0.0.1:{port}", "ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b",
                            "DEFAULT_REGION": "us-east-1"}.items():  # fmt: skip
            monkeypatch.setenv(f"AWS_{name}", value)
        with pytest.raises(OSError, match=r"(?i)timeout"):
            waveform_objects.ObjectFiles("s3://waveforms").read("raw/frame", 0)
