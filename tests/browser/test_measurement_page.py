"""Why this value: readable by everybody, each part on the page, neighbours by keyboard, downloads, German."""

import dataclasses

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.browser.conftest import LOOKS, SIZES, WITH_AND_WITHOUT_SCRIPT, Site, Visit, bytes_of, violations
from tests.browser.states import measurement
from tests.browser.test_axis_page import bottom
from tests.browser.test_fleet_page import small_targets, small_texts


def number(site: Site, axis: str) -> int:
    """Return the newest measurement of an axis that has a preload."""
    points = site.api.trend(axis, limit=100, order="newest-first")
    return next(point["measurement_id"] for point in points if point["preload_n"] is not None)


def path(site: Site, axis: str = "alarm") -> str:
    return f"/axes/{axis}/measurements/{number(site, axis)}"


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_it(served: Site, visit: Visit, size: str, theme: str) -> None:
    page = visit(served.url, path(served), size, theme)
    for summary in page.locator("summary").all():
        summary.click()
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    assert small_texts(page) == []
    assert small_targets(page) == []
    assert bottom(page, "#headline") < SIZES[size][1] / 2
    assert page.locator("#response .wide svg" if size == "desk" else "#response .narrow svg").first.is_visible()


def test_it_says_what_the_value_rests_on(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    told = served.api.http.get(f"/v1{path(served)}").json()
    said = told["outcome"]
    headline = page.locator("#headline").inner_text()
    assert (
        f"{said['frequency_hz']:.2f} Hz at {said['position_mm']:.0f} mm gives {said['preload_n']:.0f} N ±" in headline
    )
    assert page.locator("#gates tbody tr").count() == len(told["gates"])
    assert page.locator("#gates .bad").count() == 0
    ladder = page.locator("#ladder tbody").inner_text()
    assert f"{1e6 * told['ladder']['inverse_square_s2']:.3f}" in ladder
    assert f"{said['preload_n']:.0f} N" in ladder
    expect(page.locator("#response")).to_contain_text("measurements of the baseline at this place")
    assert page.locator("#response .wide .curve.reference").count() == 3
    assert page.locator("#response .wide .picked").count() == 3
    expect(page.locator("#other-calibrations")).to_contain_text("the one that it was judged by")
    assert page.locator("#windows tbody tr").count() == 4


@pytest.mark.parametrize("size", ["desk", "phone"])
def test_two_measurements_lie_in_one_picture(served: Site, visit: Visit, size: str) -> None:
    points = [each["measurement_id"] for each in served.api.trend("alarm", limit=100) if each["preload_n"] is not None]
    newest, oldest = f"/axes/alarm/measurements/{points[-1]}", points[0]
    page = visit(served.url, newest, size, "light")
    choice = page.get_by_label("Over another measurement")
    choice.select_option(str(oldest))
    page.get_by_role("button", name="Compare").press("Enter")
    page.wait_for_url(f"**{newest}?with={oldest}**")
    expect(page.locator("#response .legend")).to_contain_text("Dashed: that of")
    assert page.locator("#response .wide .curve.reference").count() == 3  # its coherence, too
    assert choice.input_value() == str(oldest)
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
    page.locator("#response-table summary").click()
    told = served.api.http.get(f"/v1/axes/alarm/measurements/{oldest}/evidence").json()["response"]
    size_of_it = np.hypot(told["real"], told["imaginary"])
    for row in page.locator("#response-table tbody tr").all():
        hertz, _, other, *_ = (float(cell.rstrip("°")) for cell in row.locator("td").all_inner_texts())
        assert other == pytest.approx(np.interp(hertz, told["frequency_hz"], size_of_it), rel=0.02)
    page.get_by_role("link", name="over the baseline").click()
    expect(page.locator("#response .legend")).to_contain_text("of the baseline at this place")


def test_the_picked_mode_stands_where_the_response_is_largest(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    picked, highest = page.locator("#response .wide svg").first.evaluate(
        """svg => [Number(svg.querySelector(".picked").getAttribute("x1")),
          svg.querySelector(".curve.measured").getAttribute("d").slice(1).split("L")
          .map(pair => pair.split(" ").map(Number))
          .reduce((best, point) => point[1] < best[1] ? point : best)[0]]"""
    )
    assert picked == pytest.approx(highest, abs=30)


@pytest.mark.parametrize("script", WITH_AND_WITHOUT_SCRIPT)
def test_the_neighbours_are_one_click_away(served: Site, visit: Visit, script: bool) -> None:
    page = visit(served.url, path(served), script=script)
    here = page.url
    page.get_by_role("link", name="previous").click()
    page.wait_for_url(lambda url: url != here)
    page.get_by_role("link", name="next").click()
    page.wait_for_url(here)


@pytest.mark.release
def test_arrow_keys_lead_to_the_neighbours(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    here = page.url
    page.keyboard.press("ArrowLeft")
    page.wait_for_url(lambda url: url != here)
    page.keyboard.press("ArrowRight")
    page.wait_for_url(here)


@pytest.mark.release
def test_windows_are_downloaded(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    with page.expect_download() as started:
        page.get_by_role("link", name="Download CSV").click()
    lines = started.value.path().read_text().splitlines()
    assert lines[0].startswith("window,time_s,torque_nm,acceleration_m_s2")
    assert np.isfinite(float(lines[1].split(",")[2]))


def test_a_refused_measurement_says_which_gate_and_what_to_check(fresh_service: Site, visit: Visit) -> None:
    rng = np.random.default_rng(1)
    windows = [
        dataclasses.replace(window, response=rng.normal(0.0, 1.0, window.n_samples))
        for window in measurement("normal", 20)
    ]
    fresh_service.api.accept("normal", windows)
    refused = fresh_service.api.trend("normal")[-1]["measurement_id"]
    page = visit(fresh_service.url, f"/axes/normal/measurements/{refused}", "phone")
    expect(page.locator("#headline")).to_contain_text("Refused:")
    assert page.locator("#gates .bad").count() >= 1
    expect(page.locator(".advice")).to_contain_text("What to check")
    assert not violations(page)


def test_from_the_fleet_the_reason_is_two_clicks_away(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/")
    page.locator("tr", has=page.get_by_role("link", name="alarm", exact=True)).get_by_role(
        "link", name="nobody has it yet"
    ).click()
    page.get_by_role("link", name="why this value").click()
    expect(page.locator("#headline")).to_contain_text("gives")


@pytest.mark.release
def test_it_speaks_german(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served), language="de-DE")
    expect(page.locator("#headline")).to_contain_text("ergeben")
    expect(page.locator("#ladder h2")).to_have_text("Von Hertz zu Newton")


@pytest.mark.release
def test_it_is_small_and_prints(served: Site, visit: Visit) -> None:
    page = visit(served.url, path(served))
    assert bytes_of(page) < 100_000
    page.emulate_media(media="print")
    assert page.locator("#response .wide svg").first.is_visible()
    assert page.pdf(format="A4")[:4] == b"%PDF"


@pytest.mark.release
def test_a_missing_measurement_is_a_page(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm/measurements/999999", allowed="404")
    expect(page.locator("h1")).to_have_text("There is no such page")
