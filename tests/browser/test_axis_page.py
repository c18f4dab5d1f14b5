"""One axis: what is above the fold, nothing false in any state, the trend at any age, the alarm in two clicks."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import (
    LOOKS,
    SIZES,
    Site,
    Visit,
    bytes_of,
    violations,
    zoom_by_dragging,
)
from tests.browser.states import MISSING, STATES
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.conftest import canary


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
@pytest.mark.parametrize("axis", canary(["alarm", "long"]))
def test_everybody_can_read_it(served: Site, visit: Visit, axis: str, size: str, theme: str) -> None:
    page = visit(served.url, f"/axes/{axis}", size, theme)
    for summary in page.locator("summary").all():
        summary.click()
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    assert small_texts(page) == []
    assert small_targets(page) == []


@pytest.mark.parametrize("axis", canary(axis for axis in STATES if axis != "alarm"))
def test_every_state_can_be_read(served: Site, visit: Visit, axis: str) -> None:
    assert not violations(visit(served.url, f"/axes/{axis}", "phone", "dark"))


def bottom(page: Page, selector: str) -> float:
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box["y"] + box["height"]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    "axis",
    canary(["alarm", "silent", "alert", "normal", "cleared", "long"]),
)
def test_state_value_age_next_step_and_last_point_are_above_the_fold(
    served: Site, visit: Visit, size: str, axis: str
) -> None:
    page = visit(served.url, f"/axes/{axis}", size)
    height = SIZES[size][1]
    for selector in ("#state", "#value", "#sentence time[data-age]", "#sentence strong"):
        assert bottom(page, selector) < height, selector
    frame = ".wide" if size == "desk" else ".narrow"
    places = page.locator(f"#preload-chart {frame} svg").evaluate(
        """svg => [...svg.querySelectorAll(".mark")].map(mark => mark.getBoundingClientRect())
          .map(box => [box.right, box.bottom])"""
    )
    right, lowest = max(places)
    assert 0 < lowest < height
    assert right < SIZES[size][0]


@pytest.mark.parametrize("size", canary(list(SIZES)))
def test_what_a_person_comes_for_is_on_the_first_screen(served: Site, visit: Visit, size: str) -> None:
    page = visit(served.url, "/axes/alarm", size)
    for place in ("#state", "#value", "#sentence"):
        expect(page.locator(place)).to_be_in_viewport(ratio=1.0)
    expect(page.locator("#trend")).to_be_in_viewport()
    assert page.evaluate("document.documentElement.scrollHeight") < {"desk": 1500, "phone": 2400}[size]
    page.goto(f"{served.url}/axes/alarm#alarms")  # a link into a part unfolds it
    expect(page.locator("#alarms")).to_be_in_viewport()


def sentence(page: Page) -> str:
    return re.sub(r"\s+", " ", page.locator("#sentence").inner_text())


SENTENCES = {
    "uncalibrated": "Nothing was measured yet, so nothing is known about the preload. Next: Measure the axis: from",
    "never-measured": "Nothing was measured yet",
    "learning": "The baseline is being learnt. Until then only a preload that falls all the while raises an alarm.",
    "normal": "No loss of preload is seen. Next: Nothing is to be done.",
    "alert": "above the baseline on average. That is no loss.",
    "alarm": " Nobody has the alarm yet. Next: Measure at another position",
    "acknowledged": "anyone on this machine has the alarm.",
    "silent": "Nothing is known about the preload now: the last measurement is of 2026-03-10, more than 1 h ago.",
    "cleared": "anyone on this machine cleared the alarm on",
}


def test_each_state_has_its_sentence(served: Site, visit: Visit, subtests: pytest.Subtests) -> None:
    page = visit(served.url, "/")
    for axis in STATES:
        with subtests.test(axis=axis):
            page.goto(f"{served.url}/axes/{axis}")
            assert SENTENCES[axis] in sentence(page)


def test_a_cleared_alarm_says_so_and_why(served: Site, visit: Visit) -> None:
    """The page once said "no accepted measurement for 1e+06 h", and of the clearing nothing."""
    page = visit(served.url, "/axes/cleared")
    assert "“nut was tightened”. Nothing was accepted since." in sentence(page)
    assert "e+0" not in page.locator("main").inner_text()
    expect(page.locator("#alarms")).to_contain_text("cleared by anyone on this machine, “nut was tightened”")


def test_the_newest_of_12000_measurements_are_shown(served: Site, visit: Visit) -> None:
    """Beyond 10 000 the page once showed the oldest, and loaded itself again and again."""
    newest = served.api.trend("long", limit=1, order="newest-first")[0]
    page = visit(served.url, "/axes/long")
    loads: list[str] = []
    page.on("request", lambda request: loads.append(request.url))
    first = page.locator("#measurements tbody time").first
    assert first.get_attribute("datetime") == newest["at"]
    last = page.locator("#preload-chart .wide a").last
    assert last.get_attribute("href") == f"/axes/long/measurements/{newest['measurement_id']}"
    page.wait_for_timeout(2500)
    assert all("/v1/changes" in url for url in loads)
    assert 1 <= len(loads) <= 4


def test_the_present_preload_stands_beside_that_of_the_alarm(served: Site, visit: Visit) -> None:
    """The page once said only what was measured when the alarm was raised."""
    page = visit(served.url, "/axes/alarm")
    now = served.api.axis("alarm")["last_measurement"]["preload_n"]
    expect(page.locator("#value")).to_contain_text(f"{now:.0f} N")
    expect(page.locator("#alarms")).to_contain_text("Preload then")
    assert re.search(r"(mo\.?|month|day|week|year)s? ago", sentence(page))


def test_the_smallest_loss_is_not_below_the_interval_here(served: Site, visit: Visit) -> None:
    """The page once said that 19 N can be seen beside an interval of ± 55 N."""
    for axis in ("normal", "alarm", "long"):
        last = served.api.axis(axis)["last_measurement"]
        half = (last["interval_95_n"][1] - last["interval_95_n"][0]) / 2.0
        text = visit(served.url, f"/axes/{axis}").locator(".cards section").last.inner_text()
        seen = re.search(r"sees ([\d.]+) N and more", text)
        assert seen is None or float(seen[1]) >= half * 0.95
        assert seen or "here only" in text


def test_ranges_and_zoom_show_less_and_more(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/long")

    def span() -> float:
        return page.locator("#preload-chart .wide svg").evaluate(
            "svg => (Date.parse(svg.dataset.to) - Date.parse(svg.dataset.from)) / 86400e3"
        )

    spans = {}
    for name in ("day", "month", "year", "all"):
        page.get_by_role("link", name=name, exact=True).click()
        spans[name] = span()
        assert 1 <= page.locator("#preload-chart .wide a").count() <= 150
    assert spans["day"] < 2 < spans["month"] < 40 < spans["year"] < 400 < spans["all"]
    page.get_by_role("link", name="closer").click()
    assert span() == pytest.approx(spans["all"] / 2, rel=0.01)
    zoom_by_dragging(page)
    assert span() == pytest.approx(spans["all"] / 2 * 0.25 * 1180 / 1082, rel=0.05)


def test_refused_measurements_are_hollow_marks(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/long?from=2026-02-01T00:00:00Z&to=2026-02-04T00:00:00Z")
    # of 72 hours, without the one in fifty in which a preload was set on purpose
    assert page.locator("#preload-chart .wide a").count() in (70, 71)
    refused = page.locator("#preload-chart .wide .mark.refused")
    assert refused.count() in (3, 4)
    assert refused.first.evaluate("mark => getComputedStyle(mark).fill") == "rgb(255, 255, 255)"
    expect(page.locator("#preload-chart .wide a:has(.refused) title").first).to_contain_text("refused")


def test_points_are_reached_by_keyboard(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm")
    page.locator("#preload-chart").focus()
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#reading")).to_contain_text("N ±")
    newest = page.evaluate("() => document.activeElement.getAttribute('href')")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("() => document.activeElement.getAttribute('href')") != newest
    page.keyboard.press("End")
    assert page.evaluate("() => document.activeElement.getAttribute('href')") == newest


@pytest.mark.release
@pytest.mark.parametrize("script", [True, False])
def test_from_the_fleet_an_alarm_is_acknowledged_in_two_clicks(fresh_service: Site, visit: Visit, script: bool) -> None:
    page = visit(fresh_service.url, "/", "phone", script=script)
    page.get_by_role("link", name="alarm", exact=True).click()
    page.get_by_role("button", name="I have seen it").first.click()
    expect(page.locator("#said")).to_have_text("Noted: you have seen the alarm.")
    assert "anyone on this machine has the alarm." in sentence(page)
    assert page.get_by_role("button", name="I have seen it").count() == 0
    if script:
        page.reload()
        assert page.locator("#said").count() == 0


@pytest.mark.release
def test_the_second_who_acknowledges_is_told(fresh_service: Site, visit: Visit) -> None:
    """Two people looked at the same alarm, and both press."""
    page = visit(fresh_service.url, "/axes/alarm", script=False, allowed="409")
    alarm = fresh_service.api.http.get("/v1/alarms", params={"axis": "alarm"}).json()["alarms"][0]["id"]
    fresh_service.api.http.post(f"/v1/alarms/{alarm}/acknowledge", json={"comment": "first"}).raise_for_status()
    page.get_by_role("button", name="I have seen it").first.click()
    expect(page.locator("h1")).to_have_text("Somebody was faster, or it was done already")
    expect(page.locator("main")).to_contain_text("only an active alarm can be acknowledged")


def test_times_are_those_of_the_browser(served: Site, visit: Visit) -> None:
    utc = visit(served.url, "/axes/alarm", script=False).locator("#sentence time").nth(1).inner_text()
    local = visit(served.url, "/axes/alarm", zone="Asia/Tokyo").locator("#sentence time").nth(1).inner_text()
    assert (utc, local) == ("2026-03-14 06:00 UTC", "2026-03-14 15:00 GMT+9")


def test_a_missing_axis_is_a_page(served: Site, visit: Visit) -> None:
    page = visit(served.url, f"/axes/{MISSING}", allowed="404")
    expect(page.locator("h1")).to_have_text("There is no such page")
    assert not violations(page)


def test_pages_are_small_and_drawn_at_once(served: Site, visit: Visit) -> None:
    for path in ("/", "/wall", "/axes/long", "/axes/alarm"):
        page = visit(served.url, path)
        assert bytes_of(page) < 100_000, path


def test_it_prints_on_a4(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm")
    page.emulate_media(media="print")
    assert not page.locator(".actions").first.is_visible()
    assert page.locator("#preload-chart .wide svg").is_visible()
    assert page.pdf(format="A4")[:4] == b"%PDF"
