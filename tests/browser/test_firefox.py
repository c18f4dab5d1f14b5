"""Every page in Firefox as it is shipped: both widths, both themes; charts, live pages and forms as in Chromium.

Playwright drives it by WebDriver BiDi, the protocol that Firefox itself brings. What Firefox cannot be told over it, it
is told when it starts: the theme, and that no name is resolved.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, Playwright, expect

from service.web.pages import PAGES
from tests.browser.conftest import SIZES, THEMES, Site, Visit, sites, violations, zoom_by_dragging
from tests.browser.states import measure
from tests.browser.test_alarm_page import number, press
from tests.browser.test_fleet_page import small_targets
from tests.browser.test_import_page import csv_file
from tests.service.test_jobs import wait_for

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
pytestmark = [
    pytest.mark.release,
    pytest.mark.skipif(FIREFOX is None, reason="Firefox is not installed: apt-get install firefox-esr"),
]

PREFERENCES = {"light": 1, "dark": 0}
#: Each width and each theme is judged once: what axe finds of both together, it finds in Chromium.
AXE_AT = (("desk", "light"), ("phone", "dark"))
AXIS = "alarm"
#: Pages that draw something of what was measured.
DRAWN = ("/", "/axes/{axis}", "/axes/{axis}/measurements/{measurement}", "/alarms/{alarm}", "/axes/{axis}/long-run")
#: Cards that are wider than the window leaves them room.
CUT_OFF = "cards => cards.filter(card => card.scrollWidth > card.clientWidth).map(card => card.outerHTML.slice(0, 80))"
#: Addresses of all pages as they are routed; what is in braces is filled in from what is stored.
ROUTES = tuple(route.path for router in PAGES for route in router.routes if "GET" in route.methods)


@pytest.fixture(scope="module", params=THEMES)
def theme(request: pytest.FixtureRequest) -> str:
    """Return what the browser is told about light and dark."""
    return str(request.param)


@pytest.fixture(scope="module")
def browser(playwright: Playwright, theme: str) -> Iterator[Browser]:
    """Start the system's Firefox in this theme, for the tests of this file."""
    started = playwright.firefox.launch(
        channel="moz-firefox",
        executable_path=FIREFOX,
        firefox_user_prefs={
            "layout.css.prefers-color-scheme.content-override": PREFERENCES[theme],
            "network.dns.disabled": True,
        },
    )
    yield started
    started.close()


@pytest.fixture(scope="module")
def stored(states: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Site, dict[str, object]]]:
    """Serve every state, a file that was looked into among them, with what stands for the braces of an address."""
    for site in sites(tmp_path_factory.mktemp("firefox"), states):
        answer = site.api.http.post(
            f"/v1/axes/{AXIS}/recordings",
            params={"check_only": True},
            files=[("file", ("run7.csv", csv_file(tmp_path_factory.mktemp("file")).read_bytes()))],
        ).json()
        wait_for(site.api, answer["id"], "done")
        filled = {
            "axis": AXIS,
            "recording": answer["arguments"]["recording"],
            "job": answer["id"],
            "calibration": site.api.axis(AXIS)["active_calibration"],
            "measurement": site.api.trend(AXIS, limit=1, order="newest-first")[0]["measurement_id"],
            "alarm": number(site),
        }
        yield site, filled


def drawn_outside(page: Page) -> list[str]:
    """Return curves and marks that do not stand in their picture; without any, that there are none."""
    return page.evaluate("""() => {
      const pictures = [...document.querySelectorAll("main svg")].filter(svg => svg.getClientRects().length);
      const shapes = pictures.flatMap(svg => [...svg.querySelectorAll("path, circle")].map(shape => [svg, shape]));
      const placed = shapes.map(([svg, shape]) => [svg.getBoundingClientRect(), shape.getBoundingClientRect(), shape]);
      const wrong = placed.filter(([all, one]) => !(one.width + one.height > 0 && one.left >= all.left - 1
        && one.right <= all.right + 1 && one.top >= all.top - 1 && one.bottom <= all.bottom + 1));
      return placed.length ? wrong.map(([, , shape]) => shape.outerHTML.slice(0, 160)) : ["nothing is drawn"];
    }""")


@pytest.mark.parametrize("route", ROUTES)
def test_every_page_stands(stored: tuple[Site, dict[str, object]], visit: Visit, route: str, theme: str) -> None:
    site, filled = stored
    page = visit(site.url, route.format(**filled), theme=theme)
    assert page.evaluate("() => matchMedia('(prefers-color-scheme: dark)').matches") == (theme == "dark")
    for size, (width, height) in SIZES.items():
        page.set_viewport_size({"width": width, "height": height})
        if route == "/docs":  # drawn by a library of others
            expect(page.locator("h1, h2").first).to_contain_text("Preload Monitor")
            continue
        expect(page.locator("h1")).to_be_visible()
        if (size, theme) in AXE_AT:
            assert not violations(page)
        assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
        assert page.locator("section").evaluate_all(CUT_OFF) == []
        assert small_targets(page) == []
        if route in DRAWN:
            assert drawn_outside(page) == []


def test_an_open_page_shows_what_was_measured(fresh_service: Site, visit: Visit, theme: str) -> None:
    page = visit(fresh_service.url, "/axes/normal", theme=theme)
    expect(page.locator("#connection")).to_have_text("● live")
    before = page.locator("#measurements tbody tr").count()
    measure(fresh_service.api, "normal", range(20, 21))
    expect(page.locator("#measurements tbody tr")).to_have_count(before + 1, timeout=60_000)
    assert drawn_outside(page) == []


@pytest.mark.parametrize("keyboard", [False, True])
def test_an_alarm_is_acknowledged(fresh_service: Site, visit: Visit, theme: str, keyboard: bool) -> None:
    page = visit(fresh_service.url, f"/alarms/{number(fresh_service)}", "phone", theme)
    press(page, "I have seen it", keyboard=keyboard)
    expect(page.locator("#said")).to_have_text("Noted: you have seen the alarm.")
    expect(page.locator("#status")).to_contain_text("seen")


def test_the_trend_is_read_by_keyboard_and_zoomed_by_dragging(
    stored: tuple[Site, dict[str, object]], visit: Visit, theme: str
) -> None:
    page = visit(stored[0].url, f"/axes/{AXIS}", theme=theme)
    page.locator("#preload-chart").focus()
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#reading")).to_contain_text("N ±")
    zoom_by_dragging(page)
