"""An alarm of a replay is seen everywhere at once: on the open page, on the wall, in the mail."""

import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from email import message_from_bytes, policy
from pathlib import Path
from typing import Any

import httpx
import pytest
from aiosmtpd.controller import Controller
from playwright.sync_api import expect

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from service.operations.monitoring.replay import SUFFIX
from tests.browser.conftest import Visit
from tests.browser.states import WORN, measurement
from tests.conftest import free_port
from tests.service.conftest import ForkedServer, servers
from tests.service.test_notices import receivers_file, wait_until

WITHIN = timedelta(seconds=2)


@contextmanager
def mailbox() -> Iterator[tuple[int, list[tuple[datetime, bytes]]]]:
    """Take mail at a port, each with the moment when it came."""
    mails: list[tuple[datetime, bytes]] = []

    class Mailbox:
        async def handle_DATA(self, _server: object, _session: object, envelope: Any) -> str:  # noqa: N802
            mails.append((datetime.now(UTC), envelope.content))
            return "250 taken"

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = Controller(Mailbox(), hostname="127.0.0.1", port=port)
    server.start()
    try:
        yield port, mails
    finally:
        server.stop()


@pytest.mark.release
def test_an_alarm_of_a_replay_is_seen_everywhere_within_two_seconds(states: Path, tmp_path: Path, visit: Visit) -> None:
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    windows = [window for day in range(9, 13) for window in measurement("normal", day, WORN)]
    write_session(sessions / f"wear{SUFFIX}", Session("normal", tuple(windows), "of a worn axis"))
    shutil.copytree(states, tmp_path / "var")
    starting = servers(tmp_path, ForkedServer)
    with mailbox() as (port, mails):
        server = next(starting)(
            tmp_path / "var",
            free_port(),
            PRELOAD_RECEIVERS_FILE=str(receivers_file(tmp_path, mail_port=port)),
            PRELOAD_REPLAY_DIR=str(sessions),
        )
        server.wait_until_up()
        page, wall = visit(server.url, "/axes/normal"), visit(server.url, "/wall")
        expect(page.locator("#state")).to_contain_text("normal")
        on_the_wall = wall.locator(".tiles li", has=wall.locator("a[href='/axes/normal']"))
        expect(on_the_wall).to_have_class("normal")
        with httpx.Client(base_url=server.url, trust_env=False, timeout=60.0) as http:
            http.post("/v1/axes/normal/replays", json={"session": "wear"}).raise_for_status()
            expect(page.locator("#state")).to_contain_text("alarm")
            expect(on_the_wall).to_have_class("alarm")
            seen_at = datetime.now(UTC)
            wait_until(lambda: bool(mails))
            (alarm,) = http.get("/v1/alarms", params={"axis": "normal"}).json()["alarms"]
    raised_at = datetime.fromisoformat(alarm["events"][0]["at"])
    came_at, content = mails[0]
    next(starting, None)
    assert seen_at - raised_at < WITHIN
    assert came_at - raised_at < WITHIN
    mail = message_from_bytes(content, policy=policy.default)
    assert mail["Subject"] == f"normal: alarm {alarm['id']} raised"
    assert "/axes/normal" in mail.get_content()
