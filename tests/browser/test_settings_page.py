"""Settings: what they would change stands on a page before they are saved; who saves second is told what changed."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import LOOKS, Site, Visit, violations
from tests.browser.test_axis_actions import press
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.conftest import canary

PATH = "/axes/alarm/settings"


def fill_in(page: Page) -> None:
    page.get_by_label("False alarms a year").fill("0.2")
    page.get_by_label("Silent after (hours)").fill("20")
    page.get_by_label("Commissioned preload, in N").fill("320")
    page.get_by_label(re.compile("^Put into service")).fill("2026-03-01T08:00")
    page.get_by_label("Machine", exact=True).fill("Mill 3")


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_both_steps(served: Site, visit: Visit, size: str, theme: str) -> None:
    page = visit(served.url, PATH, size, theme)
    for step in range(2):
        assert not violations(page)
        assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
        assert small_texts(page) == []
        assert small_targets(page) == []
        if step == 0:
            fill_in(page)
            page.get_by_role("button", name="What would this change?").click()
            expect(page.locator("#consequences")).to_be_visible()


@pytest.mark.release
@pytest.mark.parametrize("script", [True, False])
def test_consequences_stand_before_anything_is_saved(fresh_service: Site, visit: Visit, script: bool) -> None:
    page = visit(fresh_service.url, "/axes/alarm", script=script)
    before = fresh_service.api.axis("alarm")["configuration"]
    press(page, "Settings")
    fill_in(page)
    press(page, "What would this change?")
    said = page.locator("#consequences")
    expect(said).to_contain_text("0.2 false alarms a year are expected, until now 1.")
    expect(said).to_contain_text(re.compile(r"loss of 20 N is alarmed after [\d.]+ days on average, until now [\d.]+"))
    expect(said).to_contain_text("(computed from the limits of the charts)")
    expect(said).to_contain_text(re.compile(r"In the last (\d+) sessions that happened \d+ times"))
    expect(said).to_contain_text("(counted in what was measured)")
    expect(said).to_contain_text("56 % of 320 N are left")
    assert fresh_service.api.axis("alarm")["configuration"] == before
    press(page, "Save")
    expect(page.locator("#said")).to_have_text("The settings are saved.")
    moment = "2026-03-01T07:00:00Z" if script else "2026-03-01T08:00:00Z"  # the browser is in Berlin
    assert fresh_service.api.axis("alarm")["configuration"] == before | {
        "false_alarms_per_year": 0.2, "silent_after_hours": 20.0, "machine": "Mill 3",
        "commissioned_preload_n": 320.0, "commissioned_at": moment,
    }  # fmt: skip


def test_nothing_changed_is_said(served: Site, visit: Visit) -> None:
    page = visit(served.url, PATH)
    page.get_by_role("button", name="What would this change?").click()
    expect(page.locator("main")).to_contain_text("Nothing differs from what is stored.")
    assert page.get_by_role("button", name="Save").count() == 0


@pytest.mark.release
@pytest.mark.parametrize("late", ["What would this change?", "Save"])
def test_the_second_is_told_what_the_first_changed(fresh_service: Site, visit: Visit, late: str) -> None:
    site = fresh_service
    page = visit(site.url, PATH, allowed="409")
    page.get_by_label("Windows of a measurement").fill("9")
    if late == "Save":
        press(page, "What would this change?")
        expect(page.locator("#changes")).to_be_visible()
    configuration = site.api.axis("alarm")["configuration"] | {"silent_after_hours": 72.5}
    site.api.http.put("/v1/axes/alarm", json={"name": "alarm", "configuration": configuration}).raise_for_status()
    press(page, late)
    expect(page.locator("#theirs")).to_contain_text("Somebody else changed the settings meanwhile.")
    expect(page.locator("#theirs tbody tr")).to_have_count(1)
    expect(page.locator("#theirs tbody")).to_contain_text(re.compile(r"Silent after \(hours\)\s*1000000\s*72.5"))
    assert not violations(page)
    assert site.api.axis("alarm")["configuration"] == configuration
    assert page.get_by_label("Windows of a measurement").input_value() == "9"  # what was typed is still there
    page.get_by_label("Silent after (hours)").fill("72.5")
    press(page, "What would this change?")
    expect(page.locator("#changes tbody tr")).to_have_count(1)
    press(page, "Save")
    expect(page.locator("#said")).to_be_visible()
    assert site.api.axis("alarm")["configuration"] == configuration | {"windows_per_measurement": 9}


@pytest.mark.parametrize(
    ("label", "typed", "sentence"),
    canary(
        [
            ("False alarms a year", "few", "false_alarms_per_year: expected a number; got 'few'"),
            ("False alarms a year", "-1", "false_alarms_per_year: Input should be greater than or equal to 0.000001"),
            ("Windows of a measurement", "2.5", "windows_per_measurement: Input should be a valid integer"),
            ("Windows of a measurement", "inf", "windows_per_measurement: Input should be"),
            ("Search band from, in Hz", "", "expected both ends of the band, or neither; got one of them"),
            ("Search band from, in Hz", "300", "search_band_hz must be [low, high] with low < high"),
            ("Commissioned preload, in N", "300", "commissioned_preload_n and commissioned_at are stated together"),
        ]
    ),
)
def test_what_cannot_be_is_said_at_the_form(
    served: Site, visit: Visit, label: str, typed: str, sentence: str
) -> None:  # fmt: skip
    page = visit(served.url, PATH, allowed="422")
    page.get_by_label(label).fill(typed)
    page.get_by_label("Name").fill("still here")
    press(page, "What would this change?")
    expect(page.locator("#refusal")).to_contain_text(sentence)
    assert page.get_by_label("Name").input_value() == "still here"


def test_it_speaks_german_and_takes_a_decimal_comma(served: Site, visit: Visit) -> None:
    page = visit(served.url, PATH, language="de")
    page.get_by_label("Fehlalarme im Jahr").fill("0,25")
    press(page, "Was würde sich ändern?")
    expect(page.locator("#consequences")).to_contain_text("0,25 Fehlalarme im Jahr sind zu erwarten, bisher 1.")
