"""A new axis from its name alone: band, drive model, and the whole way to a trend with few clicks and words."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import LOOKS, Site, Visit, violations
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.conftest import PROJECT_ROOT, canary

SESSION = PROJECT_ROOT / "replay_data" / "calibration.session.h5"
#: What the way from an empty service to a trend may take.
MOST_CLICKS, MOST_FIELDS = 10, 3


class Hand:
    """A hand that counts what it clicks and types."""

    def __init__(self, page: Page) -> None:
        self.page, self.clicks, self.fields = page, 0, 0

    def click(self, role: str, name: str, *, timeout: float = 10_000) -> None:
        self.clicks += 1
        self.page.get_by_role(role, name=name, exact=True).first.click(timeout=timeout)

    def type(self, label: str, text: str) -> None:
        self.fields += 1
        self.page.get_by_label(label).first.fill(text)

    def choose(self, path: Path | list[Path]) -> None:
        self.clicks += 2  # the button of the field, and the file in the browser's own dialogue
        self.page.locator("#file").set_input_files(path)


@pytest.mark.release
def test_from_register_to_trend_in_ten_clicks_and_three_fields(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/")
    hand = Hand(page)
    hand.click("link", "New axis")
    hand.type("Name of the axis", "Mill 3, X")
    hand.type("Machine", "Mill 3")
    hand.click("button", "Register")
    expect(page.locator("#said")).to_have_text("Registered. Now import a recording of it.")
    hand.choose(SESSION)
    hand.click("button", "Look into it")
    expect(page.locator("#windows")).to_have_text("585 in 39 measurements", timeout=60_000)
    hand.click("button", "Import")
    expect(page.locator("main")).to_contain_text("Imported: 585 windows", timeout=60_000)
    hand.click("link", "Calibrate")
    hand.click("button", "Fit")
    hand.click("link", "Review", timeout=60_000)
    expect(page.locator("#residuals svg:visible .spot")).to_have_count(39)
    hand.click("button", "Put in force")
    expect(page.locator("#sentence")).to_contain_text("Nothing was measured with it yet", timeout=60_000)
    expect(page.locator("#value")).to_contain_text(re.compile(r"(29|30|31)\d N .* set on purpose"))  # to 300 N
    assert page.url.removesuffix("?done=judged-anew") == f"{fresh_service.url}/axes/mill-3-x"
    fresh_service.api.http.post("/v1/axes/mill-3-x/replays", json={"session": "healthy-month"}).raise_for_status()
    expect(page.locator("#preload-chart svg:visible .mark").first).to_be_visible()
    assert hand.clicks <= MOST_CLICKS
    assert hand.fields <= MOST_FIELDS
    stored = fresh_service.api.http.get("/v1/axes/mill-3-x").json()
    assert stored["name"] == "Mill 3, X"
    assert stored["configuration"]["machine"] == "Mill 3"
    assert (stored["configuration"]["search_band_hz"], stored["configuration"]["drive_model"]) == (None, None)


@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_it(served: Site, visit: Visit, size: str, theme: str) -> None:
    page = visit(served.url, "/axes/new", size, theme)
    expect(page.get_by_role("button", name="Register")).to_be_in_viewport()
    assert not violations(page)
    page.get_by_role("link", name="Values of a small milling machine").click()
    page.locator("#expected-table summary").click()
    page.locator("#model-text summary").click()
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    assert small_texts(page) == []
    assert small_targets(page) == []


def test_the_band_follows_the_catalogue_without_a_script(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/new", script=False)
    assert page.locator("#expected").count() == 0
    page.get_by_role("link", name="Values of a small milling machine").click()
    expect(page.locator("#expected strong")).to_have_text("Looked for between 153 and 286 Hz")
    page.get_by_label("Moved mass").fill("400")
    page.locator("#bearings").select_option("fixed-fixed")
    page.get_by_role("button", name="Draw the band").click()
    expect(page.get_by_label("Moved mass")).to_have_value("400")
    low, high = map(float, re.findall(r"[\d.]+", page.locator("#expected strong").inner_text()))
    assert low < high < 286
    assert page.locator("#expected tbody tr").count() == 5


def test_an_axis_of_a_catalogue_is_registered_with_its_model(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/new")
    page.get_by_role("link", name="Values of a small milling machine").click()
    page.get_by_label("Name of the axis").fill("Mill 4, X")
    page.get_by_role("button", name="Register").click()
    expect(page.locator("#said")).to_contain_text("Registered")
    stored = fresh_service.api.http.get("/v1/axes/mill-4-x").json()["configuration"]
    assert stored["search_band_hz"] == [153.0, 286.0]
    assert 'family = "receptance"' in stored["drive_model"]


@pytest.mark.release
def test_it_works_by_keyboard(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/new")
    page.locator("#name").focus()
    page.keyboard.type("Lathe Z")
    page.keyboard.press("Enter")
    expect(page.locator("h1")).to_have_text("Import a recording of Lathe Z")
    stored = fresh_service.api.http.get("/v1/axes/lathe-z").json()["configuration"]
    assert (stored["search_band_hz"], stored["drive_model"]) == (None, None)  # nothing was stated


@pytest.mark.parametrize(
    ("typed", "sentence"),
    canary(
        [
            ({"name": "normal"}, "an axis 'normal' is registered already"),
            ({"name": "new"}, "choose another name"),
            ({"name": "***"}, "name: "),
            ({"name": "X", "screw_diameter_mm": "0"}, "screw_diameter_mm: Input should be greater than or equal to 1"),
            ({"name": "X", "screw_diameter_mm": "20"}, "screw_lead_mm"),  # all of it, or nothing
        ]
    ),
)
def test_what_does_not_fit_is_said_and_nothing_typed_is_lost(
    served: Site, visit: Visit, typed: dict[str, str], sentence: str
) -> None:
    page = visit(served.url, "/axes/new", allowed="the server responded with a status of")
    page.locator("#machine").fill("Mill 7")
    for key, text in typed.items():
        page.locator(f"#{key}").fill(text)
    page.get_by_role("button", name="Register").click()
    expect(page.get_by_role("alert")).to_contain_text(sentence)
    for key, text in ({"machine": "Mill 7"} | typed).items():
        expect(page.locator(f"#{key}")).to_have_value(text)


def test_it_speaks_german(served: Site, visit: Visit) -> None:
    page = visit(
        served.url,
        "/axes/new?screw_diameter_mm=20&screw_lead_mm=6&screw_length_mm=971&moved_mass_kg=12,5"
        "&nut_stiffness_n_per_um=470&dynamic_load_rating_n=4000",
        language="de-DE",
    )
    expect(page.locator("h1")).to_have_text("Neue Achse")
    expect(page.get_by_role("button", name="Anmelden")).to_be_visible()
    expect(page.locator("#moved_mass_kg")).to_have_value("12,5")
    assert page.get_by_role("alert").count() == 0  # a decimal comma is read
