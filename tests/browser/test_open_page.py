"""An open page says what a fresh one says: after every event, from every state that it was opened in."""

import os
import signal
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import Site, Visit
from tests.browser.states import CONFIGURATION, MISSING, STATES, WORN, measure, say
from tests.conftest import canary
from tests.service.conftest import START, Api

AXES = (*STATES, "long", MISSING)
PATHS = ("/", "/wall", *(f"/axes/{axis}" for axis in AXES))

#: The text of a page without moments and ages, which pass by themselves, and without the zone that the script names.
_TEXT = """document => {
  const main = document.querySelector("main").cloneNode(true);
  main.querySelectorAll("time, [data-zone]").forEach(time => time.replaceWith("…"));
  return main.textContent.replace(/\\s+/g, " ").trim();
}"""
#: What an open page says, and what a fresh one would say.
OPEN = f"() => ({_TEXT})(document)"
FRESH = f"""async () => {{
  const answer = await fetch(location.href, {{ cache: "no-store", headers: {{ Accept: "text/html" }} }});
  return ({_TEXT})(new DOMParser().parseFromString(await answer.text(), "text/html"));
}}"""


def registered(api: Api) -> list[str]:
    return [axis["id"] for axis in api.http.get("/v1/axes").json()["axes"]]


def measured(site: Site) -> None:
    """Each axis is measured once; one that nobody knew is registered."""
    site.api.register(MISSING, **CONFIGURATION)
    for axis in registered(site.api):
        measure(site.api, axis, range(24, 25))


def alarmed(site: Site) -> None:
    """Each axis is found worn."""
    for axis in registered(site.api):
        measure(site.api, axis, range(20, 24), WORN)


def alarms_are(verb: str, status: str) -> Callable[[Site], None]:
    def event(site: Site) -> None:
        for alarm in site.api.http.get("/v1/alarms").json()["alarms"]:
            if alarm["status"] in status:
                say(site.api, alarm["id"], verb, "looked at")

    return event


def activated(site: Site) -> None:
    """Each axis gets another calibration."""
    for axis in registered(site.api):
        site.api.http.get(f"/v1/axes/{axis}")
        answer = site.api.http.get(f"/v1/axes/{axis}/calibrations").json()
        body = {"document": answer["calibrations"][0]["document"]} if answer["calibrations"] else None
        if body is None:
            site.api.calibrate(axis)
            continue
        number = site.api.http.post(f"/v1/axes/{axis}/calibrations", json=body).json()["id"]
        site.api.http.post(
            f"/v1/axes/{axis}/calibrations/{number}/activate", json={"reason": "again"}
        ).raise_for_status()


def silenced(site: Site) -> None:
    """Each axis falls silent by time alone, half a second after the last word was written."""
    soon = datetime.now(UTC) + timedelta(seconds=1.5)
    for axis in registered(site.api):
        last = site.api.axis(axis)["last_measurement"]
        if last is not None:
            heard_at = START + timedelta(days=0) if last is None else datetime.fromisoformat(last["started_at"])
            hours = (soon - heard_at).total_seconds() / 3600.0
            site.api.register(axis, **CONFIGURATION | {"silent_after_hours": hours})
    time.sleep(max((soon - datetime.now(UTC)).total_seconds(), 0.0))


def restarted(site: Site) -> None:
    """End the service, and start it again."""
    site.restart()


EVENTS: dict[str, Callable[[Site], None]] = {
    "measurement": measured,
    "alarm": alarmed,
    "acknowledge": alarms_are("acknowledge", "active"),
    "clear": alarms_are("clear", "active acknowledged"),
    "activation": activated,
    "silence": silenced,
    "restart": restarted,
}


def differing(pages: dict[str, Page]) -> dict[str, tuple[str, str]]:
    """Return the pages that do not say what a fresh one says, with both texts."""
    texts = {path: (page.evaluate(OPEN), page.evaluate(FRESH)) for path, page in pages.items()}
    return {path: both for path, both in texts.items() if both[0] != both[1]}


@pytest.mark.parametrize(
    ("event", "paths"), canary([("alarm", ("/", "/wall", "/axes/normal")), *((event, PATHS) for event in EVENTS)])
)
def test_an_open_page_equals_a_fresh_one(
    fresh_service: Site, visit: Visit, event: str, paths: tuple[str, ...]
) -> None:  # fmt: skip
    allowed = "Failed to load resource"  # of an axis that nobody knows yet, and while the service is gone
    pages = {path: visit(fresh_service.url, path, allowed=allowed) for path in paths}
    assert not differing(pages)
    before = {path: page.evaluate(OPEN) for path, page in pages.items()}
    EVENTS[event](fresh_service)
    until = time.monotonic() + 60.0
    while (differences := differing(pages)) and time.monotonic() < until:
        next(iter(pages.values())).wait_for_timeout(200)
    assert not differences
    changed = [path for path, page in pages.items() if page.evaluate(OPEN) != before[path]]
    assert changed or event == "restart"  # else nothing was tried


def test_a_page_says_that_the_service_is_gone_and_heals(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal", allowed="Failed to load resource")
    expect(page.locator("#connection")).to_have_text("● live")
    fresh_service.server.process.kill()
    fresh_service.server.process.wait()
    gone_at = datetime.now(UTC)
    expect(page.locator("#connection")).to_contain_text("no connection since", timeout=60_000)
    expect(page.locator("#connection")).to_have_class("lost")
    shown = page.locator("#connection").inner_text()
    assert any(f"{(gone_at + timedelta(hours=1, seconds=s)).strftime('%I:%M').lstrip('0')}" in shown for s in (0, 60))
    fresh_service.restart()
    expect(page.locator("#connection")).to_have_text("● live", timeout=60_000)


@pytest.mark.release
def test_a_page_says_that_the_service_hangs_and_heals(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal", allowed="Failed to load resource")
    expect(page.locator("#connection")).to_have_text("● live")
    process = fresh_service.server.process.pid
    assert process is not None
    os.kill(process, signal.SIGSTOP)  # connections are taken, and nothing answers
    try:
        expect(page.locator("#connection")).to_contain_text("no connection since", timeout=60_000)
    finally:
        os.kill(process, signal.SIGCONT)
    expect(page.locator("#connection")).to_have_text("● live", timeout=60_000)


@pytest.mark.release
def test_what_somebody_typed_opened_and_looks_at_stays(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/")
    page.locator("#q").fill("half a na")
    page.locator("#q").evaluate("field => field.setSelectionRange(2, 4)")
    axis = visit(fresh_service.url, "/axes/normal")
    axis.locator("#second summary").click()
    axis.evaluate("() => scrollTo(0, 300)")
    before = axis.locator("#measurements").inner_text()
    measure(fresh_service.api, "normal", range(20, 21))
    expect(axis.locator("#measurements")).not_to_have_text(before, timeout=60_000)
    assert axis.locator("#second").get_attribute("open") is not None
    assert axis.evaluate("() => scrollY") == 300
    page.wait_for_timeout(1500)
    assert page.locator("#q").input_value() == "half a na"
    assert page.evaluate("() => [document.activeElement.id, document.activeElement.selectionStart]") == ["q", 2]
