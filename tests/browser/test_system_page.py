"""The system: what is stored, how far intake is behind, what was refused, jobs, receivers, the log of changes."""

import uuid

import pytest
from playwright.sync_api import expect

from service.operations.access.people import People
from service.store.database import Database
from service.store.tables import JobRow
from tests.browser.conftest import LOOKS, WITH_AND_WITHOUT_SCRIPT, Site, Visit, unfold, violations
from tests.browser.states import measure
from tests.browser.test_axis_actions import press
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.service.conftest import START
from tests.service.test_discrepancies import LUMPED, published_peaks

PASSWORD = "correct horse battery"  # noqa: S105 - of a test


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_it(served: Site, visit: Visit, size: str, theme: str) -> None:
    page = visit(served.url, "/system", size, theme)
    unfold(page)
    page.locator("#paces summary").click()
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    assert small_texts(page) == []
    assert small_targets(page) == []


def test_every_page_leads_to_it_and_it_says_what_the_api_says(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm")
    press(page, "System")
    storage = served.api.http.get("/v1/retention").json()
    expect(page.locator("main")).to_contain_text(f"{storage['files']} files")
    unfold(page)
    expect(page.locator("#storage")).to_contain_text("Every waveform is kept for ever: no rule is set.")
    expect(page.locator("#storage")).to_contain_text("keep and let go")
    versions = served.api.http.get("/v1/system").json()["versions"]
    for words in (versions["program"], versions["schema"], versions["python"], "sqlite"):
        expect(page.locator(".cards")).to_contain_text(words)
    expect(page.locator("#receivers")).to_contain_text("Nobody outside is told of alarms")
    expect(page.locator("#lag").get_by_role("row", name="requests that wait")).to_contain_text("0")


def test_refusals_of_all_axes_are_summed_by_reason(fresh_service: Site, visit: Visit) -> None:
    for axis in ("normal", "alert"):
        configuration = fresh_service.api.axis(axis)["configuration"] | {"sample_rate_hz": 2000.0}
        fresh_service.api.http.put(f"/v1/axes/{axis}", json={"name": axis, "configuration": configuration})
        measure(fresh_service.api, axis, range(20, 21))
    page = visit(fresh_service.url, "/system", script=False)
    unfold(page)
    expect(page.locator("#refusals").get_by_role("row", name="another sample rate")).to_contain_text("8")


@pytest.mark.parametrize("script", WITH_AND_WITHOUT_SCRIPT)
def test_a_job_is_seen_and_cancelled(fresh_service: Site, visit: Visit, script: bool) -> None:
    body = {"baseline": LUMPED, "peaks": published_peaks()}
    job = fresh_service.api.http.post("/v1/axes/alarm/discrepancies", json=body).json()["id"]
    page = visit(fresh_service.url, "/system", script=script)
    expect(page.locator("#jobs tbody tr")).to_contain_text("Model compared with measurements")
    press(page, "Cancel")
    expect(page.locator("#said")).to_contain_text("It was asked to stop.")
    expect(page.locator("#jobs tbody tr")).to_contain_text("cancelled")
    assert fresh_service.api.http.get(f"/v1/jobs/{job}").json()["status"] == "cancelled"


@pytest.mark.release
def test_a_failed_job_says_its_sentence(fresh_service: Site, visit: Visit) -> None:
    error = "NotIdentifiableError: expected measurements at two positions or more; got one"
    database = Database(f"sqlite:///{fresh_service.api.data_dir / 'preload.db'}")
    with database.write() as session:
        session.add(
            JobRow(
                id=str(uuid.uuid4()), kind="discrepancy", axis_id="alarm", arguments={}, status="failed", done=1,
                total=None, result=None, error=error, created_at=START, updated_at=START,
            )
        )  # fmt: skip
    database.close()
    page = visit(fresh_service.url, "/system")
    expect(page.locator("#jobs tbody tr")).to_contain_text(f"failed: {error}")
    unfold(page)
    press(page, "Model compared with measurements")
    expect(page.locator("#job-status")).to_contain_text(error)
    assert not violations(page)


@pytest.mark.release
def test_the_log_says_who_changed_what_page_by_page(fresh_service: Site, visit: Visit) -> None:
    fresh_service.api.http.post("/v1/axes/normal/archive").raise_for_status()
    page = visit(fresh_service.url, "/system")
    unfold(page)
    newest = page.locator("#log tbody tr").first
    for words in ("anyone on this machine", "POST /v1/axes/{axis}/archive", "/v1/axes/normal/archive", "200"):
        expect(newest).to_contain_text(words)
    press(page, "Older")
    expect(page.locator("#log")).not_to_contain_text("/v1/axes/normal/archive")


def test_the_log_is_for_administrators_and_buttons_for_those_who_may(fresh_service: Site, visit: Visit) -> None:
    database = Database(f"sqlite:///{fresh_service.api.data_dir / 'preload.db'}")
    people = People(database, "test")
    people.add_user("anna", "administrator", PASSWORD)
    people.add_user("vera", "viewer", PASSWORD)
    database.close()
    fresh_service.restart()
    for user, may in (("anna", True), ("vera", False)):
        page = visit(fresh_service.url, "/system", theme="light" if may else "dark", allowed="403")
        page.get_by_label("Name").fill(user)
        page.get_by_label("Password").fill(PASSWORD)
        press(page, "Log in")
        expect(page.locator("h1")).to_have_text("System")
        assert page.locator("#log").count() == may
        page.goto(f"{fresh_service.url}/axes/normal")
        for words in ("Log work", "Compare with the model"):
            assert (page.get_by_role("link", name=words).count() > 0) is may
        assert page.locator("#archive").count() == may
        page.goto(f"{fresh_service.url}/axes/normal/work")
        expect(page.locator("h1")).to_have_text("Log work" if may else "You may not do this")


@pytest.mark.release
def test_it_speaks_german(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/system", language="de")
    expect(page.locator("main")).to_contain_text("Rückstand der Annahme")
