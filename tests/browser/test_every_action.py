"""Every action in both themes and widths, by click and by keyboard: each control can be seen and hit; it is done."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.conftest import LOOKS, Site, Visit, unfold
from tests.browser.states import CONFIGURATION
from tests.browser.test_alarm_page import path as alarm_path
from tests.browser.test_axis_actions import DAY
from tests.browser.test_calibrate_page import AXIS as TO_CALIBRATE, SETTINGS, measure as measure_settings
from tests.browser.test_import_page import N_SECONDS, RATE, csv_file
from tests.browser.test_settings_page import fill_in
from tests.service.test_jobs import wait_for

#: What is wrong with the controls of the form that a button belongs to: lower than a finger of 44 px, beyond the edge
#: of the window, covered by something else, or asked for and not shown. The words of a box that is ticked belong to it.
_WRONG = """button => [...button.form.elements].filter(control =>
    control.matches("button, input:not([type=hidden]), select, textarea")).flatMap(control => {
  const words = [];
  if (!control.getClientRects().length) {
    if (control.required || control === button) words.push("not shown");
  } else {
    control.scrollIntoView({ block: "center" });
    const target = control.type === "checkbox" && control.closest("label") || control;
    const box = target.getBoundingClientRect();
    const there = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
    if (box.height < 43.5) words.push(`${box.height} px high`);
    if (box.left < 0 || box.right > document.documentElement.clientWidth) words.push("beyond the edge");
    if (!target.contains(there)) words.push(`covered by ${there && there.outerHTML.slice(0, 80)}`);
  }
  return words.map(word => `${word}: ${control.outerHTML.slice(0, 120)}`);
})"""


Submit = Callable[[Page, str], None]


def by_click(page: Page, name: str) -> None:
    """Click a button after a look at every control of its form."""
    _looked_at(page, name).click()


def by_keyboard(page: Page, name: str) -> None:
    """Come to a button with the tabulator, after a look at every control of its form, and press Enter."""
    button = _looked_at(page, name)
    button.focus()
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")
    expect(button).to_be_focused()
    page.keyboard.press("Enter")


def _looked_at(page: Page, name: str) -> Locator:
    button = page.get_by_role("button", name=name, exact=True).first
    button.wait_for()
    page.wait_for_load_state()  # with its style sheet: a browser shows nothing before
    assert button.evaluate(_WRONG) == []
    return button


def register(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(f"{site.url}/axes/new")
    page.locator("#name").fill("Lathe Z")
    submit(page, "Register")
    expect(page.locator("h1")).to_have_text("Import a recording of Lathe Z")


def import_recording(page: Page, submit: Submit, site: Site, folder: Path) -> None:
    page.goto(f"{site.url}/axes/uncalibrated/import")
    page.locator("#file").set_input_files(csv_file(folder))
    submit(page, "Look into it")
    expect(page.locator("fieldset").first).to_be_visible(timeout=30_000)
    known = {
        "started_at": "2026-03-01T06:00:00Z", "position_mm": "250", "preload_n": "300", "sample_rate_hz": str(RATE),
        "samples_per_window": str(RATE),
    }  # fmt: skip
    for key, text in known.items():
        for asked in page.locator(f"[name='window.{key}']").all():
            asked.fill(text)
    submit(page, "Import")
    expect(page.locator("#taken")).to_contain_text(f"Imported: {N_SECONDS} windows", timeout=30_000)


def calibrate_activate_and_roll_back(page: Page, submit: Submit, site: Site, _: Path) -> None:
    site.api.register(TO_CALIBRATE, **CONFIGURATION | {"search_band_hz": [140, 230]})
    measure_settings(site.api, range(len(SETTINGS)))
    first = site.api.calibrate(TO_CALIBRATE)
    page.goto(f"{site.url}/axes/{TO_CALIBRATE}/calibrate")
    submit(page, "Fit")
    page.get_by_role("link", name="Review").click(timeout=30_000)
    page.locator("#rejudge").uncheck()
    submit(page, "Put in force")
    expect(page.locator("#said")).to_have_text("The calibration is in force; a new baseline begins.")
    assert site.api.axis(TO_CALIBRATE)["active_calibration"] == first + 1
    page.goto(f"{site.url}/axes/{TO_CALIBRATE}/calibrate")
    submit(page, "Roll back to it")
    expect(page.locator("#said")).to_be_visible()
    assert site.api.axis(TO_CALIBRATE)["active_calibration"] == first


def change_settings(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(f"{site.url}/axes/alarm/settings")
    fill_in(page)
    submit(page, "What would this change?")
    expect(page.locator("#consequences")).to_be_visible()
    submit(page, "Save")
    expect(page.locator("#said")).to_have_text("The settings are saved.")


def answer_an_alarm(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(site.url + alarm_path(site))
    submit(page, "I have seen it")
    expect(page.locator("#said")).to_have_text("Noted: you have seen the alarm.")
    page.get_by_label("Comment").fill("heard a knock")
    submit(page, "Write it down")
    expect(page.locator("#log tbody")).to_contain_text("heard a knock")
    page.get_by_label("Why").fill("spare part is ordered")
    submit(page, "Shelve it")
    expect(page.locator("#status")).to_contain_text("shelved")
    page.get_by_label("What was found or done").fill("nut was tightened")
    submit(page, "Clear the alarm")
    expect(page.locator("#status")).to_contain_text("cleared")


def log_work(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(f"{site.url}/axes/normal/work")
    page.get_by_label("What was done").select_option("lubricated")
    page.get_by_label(re.compile("^When")).fill(DAY)
    page.get_by_label("Note").fill("grease gun")
    submit(page, "Enter")
    expect(page.locator("#work")).to_contain_text("grease gun")


def pin_a_period(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(f"{site.url}/axes/normal/stored")
    page.locator("#pin-from").fill("2026-03-02T00:00")
    page.locator("#pin-to").fill(DAY)
    page.locator("#pin-reason").fill("acceptance")
    submit(page, "Keep")
    submit(page, "Keep no longer")
    expect(page.locator("#said")).to_contain_text("The rule decides")


def replay_a_stored_period(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(f"{site.url}/axes/acknowledged/stored")
    page.locator("#to").fill(DAY)
    submit(page, "Compare")
    expect(page.locator("#compared")).to_contain_text("compare without an end", timeout=30_000)


def judge_again_by_another_calibration(page: Page, submit: Submit, site: Site, _: Path) -> None:
    document = site.api.http.get("/v1/axes/acknowledged/calibrations").json()["calibrations"][0]["document"]
    other = site.api.http.post("/v1/axes/acknowledged/calibrations", json={"document": document}).json()["id"]
    page.goto(f"{site.url}/axes/acknowledged/stored")
    page.get_by_label("By which calibration").select_option(str(other))
    submit(page, "Compare")
    expect(page.locator("#compared")).to_contain_text("The alarms are the same.", timeout=30_000)
    page.get_by_label("Why").fill("reviewed")
    compared = page.url
    submit(page, "Let it stand")
    page.wait_for_url(lambda url: url != compared)
    wait_for(site.api, page.url.split("?")[0].rpartition("/")[2], "done")
    assert site.api.axis("acknowledged")["active_calibration"] == other


def archive_and_take_back(page: Page, submit: Submit, site: Site, _: Path) -> None:
    page.goto(f"{site.url}/axes/alert")
    unfold(page)
    page.locator("#archive summary").click()
    submit(page, "Archive")
    expect(page.locator("#said")).to_contain_text("hidden from the fleet")
    page.goto(f"{site.url}/axes/alert")
    submit(page, "Take it back")
    expect(page.locator("#said")).to_contain_text("Taken back")


ACTIONS: tuple[Callable[[Page, Submit, Site, Path], None], ...] = (
    register, import_recording, calibrate_activate_and_roll_back, change_settings, answer_an_alarm, log_work,
    pin_a_period, replay_a_stored_period, judge_again_by_another_calibration, archive_and_take_back,
)  # fmt: skip


@pytest.mark.parametrize(("size", "theme"), LOOKS)
@pytest.mark.parametrize("submit", [by_click, pytest.param(by_keyboard, marks=pytest.mark.release)])
def test_every_action_can_be_seen_hit_and_done(
    fresh_service: Site, visit: Visit, tmp_path: Path, *, size: str, theme: str, submit: Submit
) -> None:
    page = visit(fresh_service.url, "/", size, theme)
    for act in ACTIONS:
        act(page, submit, fresh_service, tmp_path)
