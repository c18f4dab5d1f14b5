"""What is done to an axis from its page: by clicking, by keyboard, without script, in German, by two people at once."""

import csv
import io
import re
import uuid

import pytest
from playwright.sync_api import Page, expect

from service.store.database import Database
from service.store.jobs import ReportStore
from service.store.tables import JobRow
from tests.browser.conftest import LOOKS, Site, Visit, unfold, violations
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.conftest import canary
from tests.service.conftest import START
from tests.service.test_discrepancies import MODEL
from tests.service.test_jobs import wait_for

PAGES = (
    "/axes/alarm/work", "/axes/alarm/stored", "/axes/alarm/discrepancies", "/axes/alarm/identifications",
    "/?state=archived",
)  # fmt: skip
#: What is measured of the axes: once a day from the second of March 2026, at six o'clock UTC.
DAY = "2026-03-05T12:00"


def press(page: Page, name: str) -> None:
    """Use a button or a link of this name as somebody without a mouse does."""
    target = page.get_by_role("button", name=name, exact=True).or_(page.get_by_role("link", name=name, exact=True))
    target.first.focus()
    page.keyboard.press("Enter")


def entries(site: Site, axis: str) -> list[dict[str, object]]:
    found: list[dict[str, object]] = site.api.http.get(f"/v1/axes/{axis}/maintenance").json()["entries"]
    return found


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
@pytest.mark.parametrize("path", canary(PAGES))
def test_everybody_can_read_it(served: Site, visit: Visit, path: str, size: str, theme: str) -> None:
    page = visit(served.url, path, size, theme)
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    assert small_texts(page) == []
    assert small_targets(page) == []


@pytest.mark.release
@pytest.mark.parametrize("script", [True, False])
def test_work_is_logged_and_marked_on_every_chart(fresh_service: Site, visit: Visit, script: bool) -> None:
    page = visit(fresh_service.url, "/axes/normal", script=script)
    page.get_by_role("link", name="Log work").first.click()
    page.get_by_label("What was done").select_option("lubricated")
    page.get_by_label(re.compile("^When")).fill(DAY)
    page.get_by_label("Note").fill("grease gun")
    page.get_by_role("button", name="Enter").click()
    expect(page.locator("#said")).to_have_text("The work is in the log, and marked on every chart.")
    expect(page.locator("#work")).to_contain_text("grease gun")
    (entry,) = entries(fresh_service, "normal")
    # the browser is in Berlin; without a script it says, and means, UTC
    assert entry["at"] == ("2026-03-05T11:00:00Z" if script else "2026-03-05T12:00:00Z")
    assert (entry["kind"], entry["who"]) == ("lubricated", "anyone on this machine")
    assert page.locator("#preload-chart .wide line.event.work").count() == 1
    assert page.locator("#second .wide line.event.work").count() == 2
    expect(page.locator("#preload-chart .wide")).to_contain_text("lubricated")


def test_a_new_nut_begins_the_baseline_anew_by_keyboard(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal")
    press(page, "Log work")
    page.get_by_label("What was done").focus()
    page.keyboard.type("nut")
    page.get_by_label(re.compile("^When")).fill("2026-03-06T12:00")
    press(page, "Enter")
    expect(page.locator("#said")).to_be_visible()
    expect(page.locator("#state")).to_contain_text("learning")
    expect(page.locator("#preload-chart .wide")).to_contain_text("nut replaced")


def test_an_entry_is_corrected_and_the_second_one_is_told(fresh_service: Site, visit: Visit) -> None:
    site = fresh_service
    entry = {"at": "2026-03-05T11:00:00Z", "who": "Anna", "kind": "lubricated", "note": "wrong axis"}
    number = site.api.http.post("/v1/axes/normal/maintenance", json=entry).json()["id"]
    pages = [visit(site.url, "/axes/normal/work", allowed="409") for _ in range(2)]
    for page, note in zip(pages, ("right", "too late"), strict=True):
        page.get_by_role("link", name=f"Correct entry {number}").click()
        page.get_by_label("Note").fill(note)
    pages[0].get_by_role("button", name="Enter").click()
    expect(pages[0].locator("#work")).to_contain_text("right")
    expect(pages[0].locator("#work")).not_to_contain_text("wrong axis")
    pages[1].get_by_role("button", name="Enter").click()
    expect(pages[1].locator("h1")).to_have_text("Somebody was faster, or it was done already")
    expect(pages[1].locator("main")).to_contain_text(f"entry {number} is corrected by entry")


def test_what_is_typed_stays_while_the_axis_is_measured(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal/work")
    page.get_by_label("Note").fill("half a sent")
    mark = page.evaluate("document.documentElement.dataset.mark")
    fresh_service.api.http.post("/v1/axes/alarm/archive").raise_for_status()
    page.wait_for_function("mark => document.documentElement.dataset.mark !== mark", arg=mark)
    assert page.get_by_label("Note").input_value() == "half a sent"
    assert (
        page.evaluate("Intl.DateTimeFormat().resolvedOptions().timeZone") == page.locator("[name=zone]").input_value()
    )


@pytest.mark.release
def test_an_axis_is_archived_found_and_taken_back(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal")
    unfold(page)
    page.locator("#archive summary").click()
    page.get_by_role("button", name="Archive").click()
    expect(page.locator("#said")).to_contain_text("hidden from the fleet")
    page.goto(fresh_service.url)
    assert page.get_by_role("link", name="normal", exact=True).count() == 0
    page.get_by_label("State").select_option("archived")
    page.get_by_role("button", name="Find").click()
    press(page, "normal")
    press(page, "Take it back")
    expect(page.locator("#said")).to_contain_text("Taken back")
    page.goto(fresh_service.url)
    assert page.get_by_role("link", name="normal", exact=True).count() == 1


@pytest.mark.release
@pytest.mark.parametrize("script", [True, False])
def test_a_period_is_kept_and_no_longer(fresh_service: Site, visit: Visit, script: bool) -> None:
    page = visit(fresh_service.url, "/axes/normal", script=script)
    page.get_by_role("link", name="Stored periods").click()
    page.locator("#pin-from").fill("2026-03-02T00:00")
    page.locator("#pin-to").fill(DAY)
    page.locator("#pin-reason").fill("acceptance")
    page.get_by_role("button", name="Keep", exact=True).click()
    (pin,) = fresh_service.api.http.get("/v1/axes/normal/pins").json()["pins"]
    assert pin["to"] == ("2026-03-05T11:00:00Z" if script else "2026-03-05T12:00:00Z")
    assert (pin["reason"], pin["who"]) == ("acceptance", "anyone on this machine")
    press(page, "Keep no longer")
    expect(page.locator("#said")).to_contain_text("The rule decides")
    assert fresh_service.api.http.get("/v1/axes/normal/pins").json()["pins"] == []


@pytest.mark.release
@pytest.mark.parametrize("script", [True, False])
def test_a_history_is_compared_and_then_stands(fresh_service: Site, visit: Visit, script: bool) -> None:
    site = fresh_service
    before = site.api.http.get("/v1/axes/alarm/calibrations").json()
    document = before["calibrations"][0]["document"]
    other = site.api.http.post("/v1/axes/alarm/calibrations", json={"document": document}).json()["id"]
    page = visit(site.url, "/axes/alarm/stored", script=script)
    page.get_by_label("By which calibration").select_option(str(other))
    page.get_by_role("button", name="Compare").click()
    job_page = page.url.split("?")[0]
    wait_for(site.api, job_page.rpartition("/")[2], "done", "failed")
    page.close()
    page = visit(site.url, "/axes/alarm", script=script)  # closed, and found again
    unfold(page)
    page.get_by_role("link", name="History judged anew").first.click()
    expect(page.locator("#compared")).to_contain_text("The alarms are the same.")
    assert site.api.axis("alarm")["active_calibration"] != other
    page.get_by_label("Why").fill("reviewed")
    page.get_by_role("button", name="Let it stand").click()
    wait_for(site.api, page.url.split("?")[0].rpartition("/")[2], "done", "failed")
    assert site.api.axis("alarm")["active_calibration"] == other
    page.goto(job_page)
    expect(page.locator("#compared")).to_contain_text("Another calibration came into force since.")


@pytest.mark.release
def test_a_part_is_compared_and_cannot_stand_alone(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/alarm/stored")
    page.locator("#to").fill(DAY)
    press(page, "Compare")
    expect(page.locator("#compared")).to_contain_text("compare without an end", timeout=20_000)
    expect(page.get_by_role("row", name=re.compile("^Measurements"))).to_contain_text("4")


@pytest.mark.release
def test_measurements_are_filtered_and_taken_away_as_a_table(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm")
    unfold(page)
    page.get_by_label(re.compile("^From")).fill("2026-03-04T00:00")
    page.get_by_label(re.compile("^To")).fill("2026-03-06T00:00")
    page.get_by_role("button", name="Show").click()
    rows = page.locator("#measurements tbody time")
    assert [row.get_attribute("datetime") for row in rows.all()] == ["2026-03-05T06:00:00Z", "2026-03-04T06:00:00Z"]
    assert page.get_by_label(re.compile("^From")).input_value() == "2026-03-04T00:00"  # in Berlin, as it was typed
    link = page.get_by_role("link", name="As a table (CSV)").get_attribute("href")
    table = list(csv.DictReader(io.StringIO(served.api.http.get(str(link)).text)))
    assert [row["at"][:10] for row in table] == ["2026-03-05", "2026-03-04"]
    page.get_by_label("Which").select_option("refused")
    page.get_by_role("button", name="Show").click()
    expect(page.locator("#measurements")).to_contain_text("No measurement is so.")
    page.get_by_role("link", name="All measurements").click()
    assert page.locator("#measurements tbody tr").count() == 13


def test_data_quality_counts_the_newest(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm")
    unfold(page)
    expect(page.locator("#quality")).to_contain_text("The last 13 measurements")
    expect(page.locator("#quality").get_by_role("row", name=re.compile("^without friction torque"))).to_contain_text(
        "13"
    )


@pytest.mark.release
@pytest.mark.parametrize(
    ("button", "kind"), [("Compare with the model", "discrepancy"), ("Identify the joints", "identification")]
)
def test_an_analysis_is_begun_closed_found_again_and_cancelled(
    fresh_service: Site, visit: Visit, button: str, kind: str
) -> None:
    page = visit(fresh_service.url, "/axes/alarm", allowed="422")
    page.get_by_role("link", name=button).click()
    page.get_by_label("Drive model (TOML)").fill("nonsense")
    page.get_by_role("button", name="Begin").click()
    expect(page.locator("#refusal")).to_be_visible()
    assert page.get_by_label("Drive model (TOML)").input_value() == "nonsense"
    page.get_by_label("Drive model (TOML)").fill(MODEL.read_text(encoding="utf-8"))
    page.get_by_role("button", name="Begin").click()
    expect(page.locator("#said")).to_contain_text("You may close this page")
    job = page.url.split("?")[0].rpartition("/")[2]
    page.close()
    page = visit(fresh_service.url, "/axes/alarm")
    unfold(page)
    page.locator("#jobs a").first.click()
    assert page.url.endswith(job)
    if page.get_by_role("button", name="Cancel").count():
        press(page, "Cancel")
    expect(page.locator("#job-status")).to_have_text(re.compile("cancelled|done|failed"), timeout=30_000)
    assert fresh_service.api.http.get(f"/v1/jobs/{job}").json()["kind"] == kind


@pytest.mark.release
def test_it_speaks_german(served: Site, visit: Visit) -> None:
    for path, words in (
        ("/axes/alarm", "Arbeiten an der Achse"), ("/axes/alarm/work", "Arbeit eintragen"),
        ("/axes/alarm/stored", "Einen Zeitraum festhalten"), ("/axes/alarm/identifications", "Fügestellen bestimmen"),
    ):  # fmt: skip
        page = visit(served.url, path, language="de")
        expect(page.locator("main")).to_contain_text(words)
        assert page.locator("html").get_attribute("lang") == "de"


def test_a_wrong_moment_is_refused_in_a_sentence(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm?since=yesterday", allowed="422")
    expect(page.locator("main")).to_contain_text("expected date and time as in 2026-03-02T06:00; got yesterday")


JOINTS = {
    "parameters": {
        "nut_stiffness_n_per_m": {
            "value": 2.1e8, "standard_uncertainty": 1e7, "unit": "N/m", "interval_95": [1.9e8, 2.3e8],
            "interval_kind": "profile of χ²", "verdict": "determined", "at_limit": False,
        },
        "nut_damping_ns_per_m": {
            "value": 22.5, "standard_uncertainty": None, "unit": "N·s/m", "interval_95": None,
            "interval_kind": "linear in the logarithm", "verdict": "not determined", "at_limit": True,
        },
    },
    "not_identifiable": ["nut_damping_ns_per_m is not determined by these data"],
    "missing_modes": [],
    "taken_as": [],
    "model": 'family = "receptance"',
}  # fmt: skip
LACKS = {"outcome": "explained", "effects": [{"key": "pedestal-compliance"}]}


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_what_came_of_an_analysis_is_read(
    fresh_service: Site, visit: Visit, size: str, theme: str
) -> None:  # fmt: skip
    rows = {kind: str(uuid.uuid4()) for kind in ("identification", "discrepancy")}
    database = Database(f"sqlite:///{fresh_service.api.data_dir / 'preload.db'}")
    with database.write() as session:
        for (kind, job), result in zip(rows.items(), (JOINTS, LACKS), strict=True):
            session.add(
                JobRow(
                    id=job, kind=kind, axis_id="alarm", arguments={}, status="done", done=1, total=1, result=result,
                    created_at=START, updated_at=START,
                )
            )  # fmt: skip
    database.close()
    ReportStore(fresh_service.api.data_dir).write(rows["discrepancy"], "<h1>what is missing</h1>")
    page = visit(fresh_service.url, f"/jobs/{rows['identification']}", size, theme)
    page.locator("summary").click()
    expect(page.locator("#joints")).to_contain_text("not determined by these data")
    expect(page.locator("#identified-model")).to_contain_text('family = "receptance"')
    assert not violations(page)
    assert small_texts(page) == small_targets(page) == []
    page = visit(fresh_service.url, f"/jobs/{rows['discrepancy']}", size, theme)
    expect(page.locator("#discrepancy")).to_contain_text("explained: pedestal-compliance")
    assert not violations(page)
    press(page, "Read the report")
    expect(page.locator("h1")).to_have_text("what is missing")
