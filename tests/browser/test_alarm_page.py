"""An alarm: readable by everybody, what happened, why, what to check; actions by mouse, keyboard, without script."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import LOOKS, SIZES, Site, Visit, violations
from tests.browser.test_axis_page import bottom
from tests.browser.test_fleet_page import small_targets, small_texts


def number(site: Site, axis: str = "alarm") -> int:
    """Return the newest alarm of an axis."""
    return int(site.api.http.get("/v1/alarms", params={"axis": axis}).json()["alarms"][0]["id"])


def path(site: Site, axis: str = "alarm") -> str:
    return f"/alarms/{number(site, axis)}"


@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_it(served: Site, visit: Visit, size: str, theme: str) -> None:
    for address in ("/alarms", path(served), path(served, "cleared")):
        page = visit(served.url, address, size, theme)
        assert not violations(page)
        assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
        assert small_texts(page) == []
        assert small_targets(page) == []


def test_what_happened_and_the_first_action_are_above_the_fold(served: Site, visit: Visit) -> None:
    for size, (_, height) in SIZES.items():
        page = visit(served.url, path(served), size)
        assert bottom(page, "#sentence") < height
        assert bottom(page, ".head button.primary") < height


def test_it_says_what_happened_and_how_it_is_now(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    sentence = page.locator("#sentence").inner_text()
    assert re.search(r"had lost \d+ N of its baseline of \d+ N", sentence)
    assert "Nobody has the alarm yet." in sentence
    now = served.api.axis("alarm")["last_measurement"]["preload_n"]
    expect(page.locator("#preload-now")).to_contain_text(f"{now:.0f} N")
    expect(page.locator("#cause")).to_contain_text("cause not examined: the axis has no drive model.")
    expect(page.locator("#advice-preload")).to_contain_text("dial gauge")
    expect(page.locator("#advice-preload")).to_contain_text("20 min")
    expect(page.locator("#log tbody")).to_contain_text("raised by measurement")


def test_the_picture_ends_with_the_alarm(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    raised = served.api.http.get(f"/v1/alarms/{number(served)}").json()["evidence"]["at"]
    newest = served.api.trend("alarm", limit=1, order="newest-first")[0]["at"]
    assert raised < newest
    links = page.locator("#then .wide a").all()
    assert links
    told = [link.locator("title").text_content() for link in links]
    assert told[-1] is not None
    assert told[-1].startswith(raised[:10])


def test_the_list_begins_with_what_nobody_has_seen(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/alarms")
    expect(page.locator("h1")).to_contain_text("for somebody.")
    rows = page.locator("#open tbody tr").all_inner_texts()
    seen = ["nobody has it yet" not in row for row in rows]
    assert seen == sorted(seen)
    assert any(seen)
    expect(page.locator("#closed tbody tr").first).to_contain_text("cleared by anyone on this machine")


def press(page: Page, name: str, *, keyboard: bool) -> None:
    button = page.get_by_role("button", name=name, exact=True)
    if keyboard:
        button.focus()
        page.keyboard.press("Enter")
    else:
        button.click()


@pytest.mark.release
@pytest.mark.parametrize(("script", "keyboard"), [(True, False), (True, True), (False, False)])
def test_each_action_is_done_and_stands_in_the_log(
    fresh_service: Site, visit: Visit, script: bool, keyboard: bool
) -> None:
    page = visit(fresh_service.url, path(fresh_service), "phone", script=script)
    press(page, "I have seen it", keyboard=keyboard)
    expect(page.locator("#said")).to_have_text("Noted: you have seen the alarm.")
    expect(page.locator("#status")).to_contain_text("seen")
    page.get_by_label("Comment").fill("heard a knock")
    press(page, "Write it down", keyboard=keyboard)
    expect(page.locator("#log tbody")).to_contain_text("heard a knock")
    page.get_by_label("Why").fill("spare part is ordered")
    press(page, "Shelve it", keyboard=keyboard)
    expect(page.locator("#status")).to_contain_text("shelved")
    expect(page.locator("#sentence")).to_contain_text("Shelved until")
    expect(page.locator("#log tbody")).to_contain_text("spare part is ordered")
    expect(page.locator("#clear")).to_contain_text("What is now becomes normal.")
    page.get_by_label("What was found or done").fill("nut was tightened")
    press(page, "Clear the alarm", keyboard=keyboard)
    expect(page.locator("#status")).to_contain_text("cleared")
    expect(page.locator("#sentence")).to_contain_text("“nut was tightened”")
    assert page.locator("#clear").count() == 0


def test_a_shelved_alarm_says_so_everywhere(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, path(fresh_service))
    page.get_by_label("Why").fill("waits for the part")
    page.get_by_role("button", name="Shelve it").click()
    expect(page.locator("#status")).to_contain_text("shelved")
    for address in ("/", "/alarms", "/axes/alarm"):
        text = visit(fresh_service.url, address).locator("main").inner_text().lower()
        assert "shelved until" in text, address


def test_a_reason_is_required_to_clear(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, path(fresh_service))
    page.get_by_role("button", name="Clear the alarm").click()
    assert fresh_service.api.http.get(f"/v1{path(fresh_service)}").json()["status"] == "active"


@pytest.mark.release
def test_the_second_of_two_people_is_told(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, path(fresh_service), script=False, allowed="409")
    fresh_service.api.http.post(f"/v1{path(fresh_service)}/acknowledge", json={"comment": "mine"}).raise_for_status()
    page.get_by_label("What was found or done").fill("nothing")
    page.get_by_role("button", name="Clear the alarm").click()
    expect(page.locator("h1")).to_have_text("Somebody was faster, or it was done already")
    expect(page.locator("main")).to_contain_text("anyone on this machine, acknowledged, “mine”")


def test_the_cause_is_one_click_from_the_axis_and_the_alarm_is_seen_two_from_the_fleet(
    fresh_service: Site, visit: Visit
) -> None:
    page = visit(fresh_service.url, "/axes/alarm")
    page.get_by_role("link", name="Cause and what to check").click()
    expect(page.locator("#cause")).to_be_visible()
    page.goto(fresh_service.url)
    page.locator("tr", has=page.get_by_role("link", name="alarm", exact=True)).get_by_role(
        "link", name="nobody has it yet"
    ).click()
    page.get_by_role("button", name="I have seen it").click()
    expect(page.locator("#status")).to_contain_text("seen")


def test_it_speaks_german_and_prints(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served), language="de-DE")
    expect(page.locator("#clear")).to_contain_text("Was jetzt ist, wird normal.")
    page.emulate_media(media="print")
    assert not page.locator("#clear").is_visible()
    assert page.locator("#then .wide svg").is_visible()
    assert page.pdf(format="A4")[:4] == b"%PDF"
