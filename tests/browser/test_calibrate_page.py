"""Guided calibration: what to measure next, a map that fills, a fit that is found again, review, roll back."""

import itertools
import re
from datetime import timedelta

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.browser.conftest import LOOKS, Site, Visit, violations
from tests.browser.states import CONFIGURATION
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.service.conftest import START, Api, simulated_measurement

SETTINGS = list(itertools.product((200.0, 400.0, 600.0, 800.0), (100.0, 200.0, 300.0)))
AXIS = "to-calibrate"


def measure(api: Api, numbers: range) -> None:
    """Measure so many of the settings, each with four windows."""
    for number in numbers:
        place, preload = SETTINGS[number]
        windows = simulated_measurement(
            np.random.default_rng(number), f"setting-{number}", preload=preload, position_mm=place, n_windows=4,
            started_at=START + timedelta(minutes=number), set_preload=preload,
        )  # fmt: skip
        api.accept(AXIS, windows)


@pytest.fixture
def calibrating(fresh_service: Site) -> Site:
    """Serve an axis that is to be calibrated, nothing of it measured yet."""
    fresh_service.api.register(AXIS, **CONFIGURATION | {"search_band_hz": [140, 230]})
    return fresh_service


@pytest.mark.release
def test_the_map_fills_as_windows_arrive(calibrating: Site, visit: Visit) -> None:
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate")
    expect(page.locator("#next .value")).to_have_text(re.compile(r"Next: move to \d+ mm, set \d+ N"))
    expect(page.locator("#coverage svg:visible .hole")).to_have_count(15)
    expect(page.locator("#next")).to_contain_text("15 more measurements.")
    expect(page.get_by_role("link", name="Import a recording").first).to_be_visible()
    measure(calibrating.api, range(2))
    expect(page.locator("#coverage svg:visible .measured")).to_have_count(2)
    measure(calibrating.api, range(2, len(SETTINGS)))
    expect(page.locator("#coverage h2")).to_have_text("Settings: 12 measured, 0 holes")
    expect(page.locator("#next")).to_contain_text(re.compile(r"With what is measured it sees a loss of \d"))
    expect(page.locator("#coverage")).to_contain_text("The scatter is that of these measurements.")


def test_holes_are_named_and_a_plan_of_ones_own_moves_them(calibrating: Site, visit: Visit) -> None:
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate", script=False)
    expect(page.locator("#holes")).to_contain_text("300 N: 100, 300, 500, 700, 900 mm.")
    page.locator("#plan-otherwise summary").click()
    page.get_by_label("From position").fill("250")
    page.get_by_label("To position").fill("650")
    page.get_by_label("Healthy preload").fill("600")
    page.get_by_role("button", name="Plan", exact=True).click()
    expect(page.locator("#holes")).to_contain_text("600 N: 250, 350, 450, 550, 650 mm.")


@pytest.mark.release
def test_a_plan_that_is_none_says_why(calibrating: Site, visit: Visit) -> None:
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate?from_mm=500&to_mm=400", allowed="status of 422")
    expect(page.get_by_role("alert")).to_contain_text("must be 10 mm or more; got 500 to 400 mm")
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate?highest_n=many", allowed="status of 422")
    expect(page.get_by_role("alert")).to_contain_text("expected positions in mm")


@pytest.mark.release
def test_a_calibration_started_closed_in_the_browser_is_found_again(calibrating: Site, visit: Visit) -> None:
    measure(calibrating.api, range(len(SETTINGS)))
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate")
    page.get_by_role("button", name="Fit", exact=True).press("Enter")
    expect(page.locator("#said")).to_have_text("The fit has begun.")
    page.close()
    calibrating.restart()  # and the service may go, too
    again = visit(calibrating.url, f"/axes/{AXIS}/calibrate", "phone")
    expect(again.locator("#next")).to_contain_text(re.compile(r"Calibration \d+ is fitted"), timeout=30_000)
    again.get_by_role("link", name="Review").click()
    expect(again.locator(".value")).to_have_text(re.compile(r"Sees a loss of [\d.]+ N"))
    expect(again.locator("#residuals svg:visible .spot")).to_have_count(12)
    expect(again.locator("#figures")).to_contain_text("condition number")
    again.get_by_role("button", name="Put in force").click()
    expect(again.locator("#calibration")).to_contain_text("in force", timeout=30_000)


@pytest.mark.release
def test_compare_put_in_force_and_roll_back(calibrating: Site, visit: Visit) -> None:
    measure(calibrating.api, range(len(SETTINGS)))
    first = calibrating.api.calibrate(AXIS)
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate")
    page.get_by_role("button", name="Fit", exact=True).click()
    page.get_by_role("link", name="Review").click(timeout=30_000)
    expect(page.locator("#figures th").nth(2)).to_have_text(f"{first} (in force)")
    page.locator("#rejudge").uncheck()
    page.get_by_role("button", name="Put in force").click()
    expect(page.locator("#said")).to_have_text("The calibration is in force; a new baseline begins.")
    page.goto(f"{calibrating.url}/axes/{AXIS}/calibrate")
    page.get_by_role("button", name="Roll back to it").click()
    expect(page.locator("#said")).to_be_visible()
    assert calibrating.api.http.get(f"/v1/axes/{AXIS}").json()["active_calibration"] == first
    page.goto(f"{calibrating.url}/axes/{AXIS}/calibrations/{first}")
    page.get_by_role("button", name="Compare").click()
    expect(page.locator("#figures th").nth(2)).to_have_text(str(first + 1))


@pytest.mark.release
def test_who_comes_second_is_told(calibrating: Site, visit: Visit) -> None:
    measure(calibrating.api, range(len(SETTINGS)))
    numbers = [
        calibrating.api.http.post(f"/v1/axes/{AXIS}/calibrations", json={"measurements": {}}).json()["id"]
        for _ in range(2)
    ]
    pages = [
        visit(calibrating.url, f"/axes/{AXIS}/calibrations/{number}", script=False, allowed="status of 409")
        for number in numbers
    ]
    for page in pages:
        page.locator("#rejudge").uncheck()
        page.get_by_role("button", name="Put in force").click()
    expect(pages[1].locator("h1")).to_have_text("Somebody was faster, or it was done already")
    expect(pages[1].locator("main")).to_contain_text("another calibration came into force meanwhile")
    assert calibrating.api.http.get(f"/v1/axes/{AXIS}").json()["active_calibration"] == numbers[0]


def test_too_little_for_a_fit_is_said_where_the_fit_was_asked_for(calibrating: Site, visit: Visit) -> None:
    measure(calibrating.api, range(3))
    page = visit(calibrating.url, f"/axes/{AXIS}/calibrate")
    page.get_by_role("button", name="Fit", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("three positions", timeout=30_000)


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_it(calibrating: Site, visit: Visit, size: str, theme: str) -> None:
    measure(calibrating.api, range(len(SETTINGS)))
    number = calibrating.api.calibrate(AXIS)
    for path in ("calibrate", f"calibrations/{number}"):
        page = visit(calibrating.url, f"/axes/{AXIS}/{path}", size, theme)
        for summary in page.locator("summary").all():
            summary.click()
        assert not violations(page)
        assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
        assert small_texts(page) == []
        assert small_targets(page) == []


@pytest.mark.release
def test_it_speaks_german(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/normal/calibrate", language="de-DE")
    expect(page.locator("h1")).to_have_text("normal kalibrieren")
    expect(page.locator("#calibrations")).to_contain_text("Sieht einen Verlust von")
