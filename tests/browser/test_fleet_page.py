"""The fleet and the wall view: who needs somebody, worst first, at a glance and on a phone."""

import time

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import LOOKS, Site, Visit, violations
from tests.browser.states import STATES
from tests.conftest import canary


@pytest.mark.parametrize(("size", "theme"), LOOKS)
@pytest.mark.parametrize("path", canary(["/", "/wall"]))
def test_everybody_can_read_it(served: Site, visit: Visit, path: str, size: str, theme: str) -> None:
    page = visit(served.url, path, size, theme)
    assert not violations(page)
    assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0  # nothing scrolls sideways
    assert small_texts(page) == []
    assert small_targets(page) == []


def small_texts(page) -> list[str]:
    """Return texts that are smaller than 16 px."""
    return page.evaluate("""() => [...document.querySelectorAll("body *")].filter(element =>
      element.getClientRects().length && [...element.childNodes].some(node => node.nodeType === 3 && node.data.trim())
      && parseFloat(getComputedStyle(element).fontSize) < 16).map(element => element.outerHTML.slice(0, 120))""")


def small_targets(page) -> list[str]:
    """Return buttons, fields and links that stand alone and are lower than a finger of 44 px."""
    return page.evaluate("""() =>
      [...document.querySelectorAll("button, .button, input:not([type=hidden]), select, summary, nav a, th a")]
      .filter(element => element.getClientRects().length
        && element.getBoundingClientRect().height < 43.5)
      .map(element => element.outerHTML.slice(0, 120))""")


def test_the_worst_come_first_and_the_page_counts_them(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/")
    expect(page.locator("h1")).to_have_text("7 of 10 need you.")
    states = [badge.split()[-1] for badge in page.locator("tbody .state").all_inner_texts()]
    assert states == sorted(states, key=["alarm", "alert", "unknown", "learning", "normal"].index)
    first = page.locator("tbody tr").first
    expect(first.locator("th")).to_have_text("alarm")
    expect(first).to_contain_text("nobody has it yet")
    expect(first).to_contain_text("ago")
    assert "seen by anyone on this machine" in page.locator("tr", has_text="acknowledged").inner_text()


def test_an_axis_is_found_by_name_and_by_state(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/")
    page.locator("#q").fill("NORM")
    page.keyboard.press("Enter")
    expect(page.locator("tbody th")).to_have_text(["normal"])
    page.goto(served.url + "/")
    page.locator("#state-filter").select_option("unknown")
    page.get_by_role("button", name="Find").click()
    expect(page.locator("tbody th")).to_have_text(["cleared", "never-measured", "silent", "uncalibrated"])
    page.goto(served.url + "/?q=nothing")
    expect(page.locator("main")).to_contain_text("No axis is called so")


def test_it_works_without_script(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/", script=False)
    assert page.locator("tbody tr").count() == len(STATES) + 1
    assert "UTC" in visit(served.url, "/axes/alarm", script=False).locator("#sentence").inner_text()


def test_german_browsers_read_german_with_a_decimal_comma(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/axes/alarm", language="de-DE")
    assert page.locator("html").get_attribute("lang") == "de"
    expect(page.locator("#state")).to_contain_text("Alarm")
    expect(page.locator("#sentence")).to_contain_text("Vorspannung verloren")
    expect(page.locator(".cards")).to_contain_text("Kohärenz 1,0")
    expect(page.locator("#connection")).to_have_text("● aktuell")


def test_the_wall_is_large(served: Site, visit: Visit) -> None:
    page = visit(served.url, "/wall")
    assert page.evaluate("() => parseFloat(getComputedStyle(document.querySelector('.tiles .value')).fontSize)") >= 40
    expect(page.locator(".tiles li").first).to_contain_text("nobody has it yet")


@pytest.mark.release
def test_a_thousand_axes_take_three_tenths_of_a_second(fresh_service: Site) -> None:
    for number in range(1000 - len(STATES) - 1):
        fresh_service.api.register(f"axis-{number:03d}")
    spent = []
    for _ in range(3):
        begin = time.perf_counter()
        answer = fresh_service.api.http.get("/", headers={"accept": "text/html"})
        spent.append(time.perf_counter() - begin)
    assert answer.text.count("<tr>") == 101
    assert min(spent) < 0.3
    assert len(answer.content) < 100_000
