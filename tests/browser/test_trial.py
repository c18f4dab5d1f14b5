"""An empty service is tried with one click: a year of an axis, which every page has something to show of."""

import os
import time
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import LOOKS, Site, Visit, sites, violations, wait_for
from tests.conftest import canary
from tests.service.conftest import assert_problem


@pytest.fixture
def empty_service(nothing: Path, tmp_path: Path) -> Iterator[Site]:
    """Serve no axis."""
    yield from sites(tmp_path, nothing)


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_the_offer(empty_service: Site, visit: Visit, size: str, theme: str) -> None:
    assert not violations(visit(empty_service.url, "/", size, theme))


@pytest.mark.release
def test_one_click_makes_a_year_and_one_puts_it_away(empty_service: Site, visit: Visit) -> None:
    page = visit(empty_service.url, "/")
    page.get_by_role("button", name="Make the trial axis").click()
    expect(page.locator("#said")).to_have_text("The trial axis is being made.")
    expect(page.locator("#trial-progress")).to_be_visible()
    expect(page.locator("#trial")).to_contain_text("measurements")
    (job,) = [job for job in empty_service.api.http.get("/v1/jobs").json()["jobs"] if job["kind"] == "trial"]
    problem = assert_problem(empty_service.api.http.post("/v1/trials"), 409, "conflict")
    assert "being made already" in problem["detail"]
    wait_for(empty_service, job["id"])
    expect(page.locator("#trial")).to_have_count(0)
    expect(page.locator("h1")).to_have_text("1 of 2 needs you.")
    page.get_by_role("link", name="Trial: X axis of the bundled machine").click()
    expect(page.locator("#state")).to_contain_text("alarm")
    page.get_by_role("link", name="Show the long run").click()
    expect(page.locator("h1")).to_contain_text("The long run")
    assert not violations(page)
    page.go_back()
    page.get_by_role("button", name="Put the trial away").click()
    expect(page.locator("#said")).to_have_text("The trial is put away.")
    expect(page.get_by_role("button", name="Make the trial axis")).to_be_visible()


@pytest.mark.release
def test_its_year_is_worth_looking_at(tried: Site) -> None:
    """A loose nut that was repaired, a payload without an alarm, refusals, work, and wear that stands."""
    points = tried.api.trend("trial", limit=1000)
    assert len(points) == 213
    worn, repaired = tried.api.http.get("/v1/alarms", params={"axis": "trial"}).json()["alarms"]
    assert (worn["status"], repaired["status"]) == ("active", "cleared")
    people = [(event["new_status"], event["who"]) for event in repaired["events"] if event["who"]]
    assert people == [("acknowledged", "Anna (trial)"), ("cleared", "Anna (trial)")]
    moments = [event["at"] for event in repaired["events"] if event["who"]]
    assert repaired["evidence"]["at"] < moments[0] < moments[1] < worn["evidence"]["at"]
    assert repaired["explanation"]["sentence"].startswith("the preload fell by")
    by_name = {point["measurement"]: point for point in points}
    with_workpiece = {by_name[f"day-{day:03d}"]["state"] for day in range(90, 120, 2)}
    assert with_workpiece <= {"normal", "alert"}
    refused = [point for point in points if point["refusal_reason"] not in (None, "not-calibrated")]
    assert len(refused) == 2
    log = tried.api.http.get("/v1/axes/trial/maintenance").json()["entries"]
    assert [entry["kind"] for entry in log] == ["mounting", "lubricated"]
    judged = [point for point in points if point["preload_n"] is not None]
    truth_now = 300.0 - 1.5 * (364 - 322)
    lower, upper = judged[-1]["interval_95_n"]
    assert lower < truth_now < upper
    # with the workpiece no move is long enough for the drag torque, and the work of its short, ringing moves tells none
    without_friction = {point["measurement"] for point in judged if point["friction_torque_nm"] is None}
    assert without_friction <= {f"day-{day:03d}" for day in range(90, 120, 2)}


@pytest.mark.release
def test_it_takes_the_service_less_than_20_seconds(empty_service: Site) -> None:
    """Of its processor: on a machine that has nothing else to do it is there sooner."""
    before = processor_seconds(empty_service)
    wait_for(empty_service, empty_service.api.http.post("/v1/trials").json()["id"])
    assert processor_seconds(empty_service) - before < 20.0


@pytest.mark.release
def test_it_goes_on_after_a_restart(empty_service: Site) -> None:
    job = empty_service.api.http.post("/v1/trials").json()["id"]
    until = time.monotonic() + 60.0
    while empty_service.api.http.get(f"/v1/jobs/{job}").json()["done"] < 40 and time.monotonic() < until:
        time.sleep(0.05)
    empty_service.server.process.kill()
    empty_service.restart()
    wait_for(empty_service, job)
    assert len(empty_service.api.trend("trial", limit=1000)) == 213
    assert len(empty_service.api.trend("trial-sister", limit=1000)) == 46
    assert len(empty_service.api.http.get("/v1/axes/trial/calibrations").json()["calibrations"]) == 1
    alarms = empty_service.api.http.get("/v1/alarms", params={"axis": "trial"}).json()["alarms"]
    assert [alarm["status"] for alarm in alarms] == ["active", "cleared"]


def processor_seconds(site: Site) -> float:
    """Return what the process of a service has taken so far, in all its threads."""
    words = Path(f"/proc/{site.server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_the_long_run(tried: Site, visit: Visit, size: str, theme: str) -> None:
    page = visit(tried.url, "/axes/trial/long-run", size, theme)
    for summary in page.locator("summary").all():
        summary.click()
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0


@pytest.mark.release
def test_the_long_run_shows_projection_mode_and_sister(tried: Site, visit: Visit) -> None:
    page = visit(tried.url, "/axes/trial")
    page.get_by_role("link", name="Show the long run").click()
    expect(page.locator("h1")).to_contain_text("The long run")
    projected = tried.api.http.get("/v1/axes/trial/projection").json()
    assert -1.9 < projected["slope_n_per_day"] < -1.0  # 1.5 N a day are lost
    in_truth = 300.0 - 1.5 * (364 - 322 + _days(projected["points"][0]["at"], projected["points"][-1]["at"]))
    lower, upper = projected["points"][-1]["interval_95_n"]
    assert lower < in_truth < upper
    expect(page.locator("#projection")).to_contain_text("Projection, if it goes on like this")
    chart = page.locator("#spectrum .wide svg")
    assert len(chart.evaluate("svg => svg.outerHTML")) < 30_000
    modes = page.locator("#spectrum tbody tr")
    assert modes.count() > 20
    expect(page.locator("#sisters tbody tr")).to_have_count(2)
    expect(page.locator("#sisters")).to_contain_text("Trial: Y axis of the bundled machine")


@pytest.mark.parametrize("axis", canary(["uncalibrated", "never-measured", "normal"]))
def test_a_short_run_says_what_it_needs(served: Site, visit: Visit, axis: str) -> None:
    page = visit(served.url, f"/axes/{axis}/long-run")
    expect(page.locator("#sisters")).to_contain_text("No other axis of this type has a baseline")
    assert not violations(page)


def _days(first: str, last: str) -> float:
    return (datetime.fromisoformat(last) - datetime.fromisoformat(first)) / timedelta(days=1)
