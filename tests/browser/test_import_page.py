"""A recording is looked into at once, its channels are given a meaning in a form, and its windows are taken."""

import re
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from playwright.sync_api import expect

from tests.browser.conftest import LOOKS, Site, Visit, violations
from tests.browser.states import measure
from tests.browser.test_fleet_page import small_targets, small_texts
from tests.browser.test_new_axis_page import MOST_CLICKS, SESSION, Hand
from tests.service.conftest import START, axial_frequency, simulated_window

RATE, N_SECONDS = 1024, 6


def samples(seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Torque and acceleration over some seconds of a mode at 180 Hz."""
    rng = np.random.default_rng(seed)
    windows = [simulated_window(rng, 180.0, **_SOMEWHERE) for _ in range(N_SECONDS)]
    return np.concatenate([w.excitation for w in windows]), np.concatenate([w.response for w in windows])


def _somewhere() -> dict[str, object]:
    from monitor_core.recording import Conditions

    return {"started_at": START, "conditions": Conditions(0.5, 0.0, 21.5, None), "measurement": "m"}


_SOMEWHERE = _somewhere()


def csv_file(folder: Path) -> Path:
    """Write a table as a data-acquisition system does: names with units, no word of when and where."""
    torque, acceleration = samples()
    path = folder / "run7.csv"
    lines = ["Time [s],Motor torque [Nm],Acc nut [m/s2]"]
    rows = enumerate(zip(torque.tolist(), acceleration.tolist(), strict=True))
    lines += [f"{i / RATE:.6f},{t:.6g},{a:.6g}" for i, (t, a) in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def mat_file(folder: Path) -> Path:
    torque, acceleration = samples()
    path = folder / "run8.mat"
    scipy.io.savemat(path, {"torque_Nm": torque, "acceleration_ms2": acceleration})
    return path


@pytest.mark.release
@pytest.mark.parametrize("make", [csv_file, mat_file])
def test_a_raw_file_is_taken_with_the_map_that_was_filled_in(
    fresh_service: Site, visit: Visit, tmp_path: Path, make
) -> None:
    page = visit(fresh_service.url, "/axes/uncalibrated/import", allowed="the server responded with a status of 4")
    page.locator("#file").set_input_files(make(tmp_path))
    page.get_by_role("button", name="Look into it").click()
    expect(page.locator("fieldset").first).to_be_visible(timeout=30_000)
    expect(page.locator("[name='excitation.quantity']")).to_have_value("torque")
    expect(page.locator("[name='.axis_id']")).to_have_value("uncalibrated")
    # what the file does not say is asked for; a slip is said, and nothing that was typed is lost
    page.locator("[name='window.started_at']").fill("yesterday")
    page.locator("[name='window.position_mm']").fill("250")
    page.locator("[name='window.preload_n']").fill("300")
    if page.locator("[name='window.sample_rate_hz']").count():
        page.locator("[name='window.sample_rate_hz']").fill(str(RATE))
    if page.locator("[name='window.samples_per_window']").count():
        page.locator("[name='window.samples_per_window']").fill(str(RATE))
    page.get_by_role("button", name="Import").click()
    expect(page.get_by_role("alert")).to_contain_text("started_at")
    expect(page.locator("[name='window.position_mm']")).to_have_value("250")
    page.locator("[name='window.started_at']").fill("2026-03-01T06:00:00Z")
    page.get_by_role("button", name="Import").click()
    expect(page.locator("#taken")).to_contain_text(f"Imported: {N_SECONDS} windows", timeout=30_000)
    trend = fresh_service.api.http.get("/v1/axes/uncalibrated/trend").json()
    assert trend["points"][-1]["position_mm"] == 250
    plan = fresh_service.api.http.get("/v1/axes/uncalibrated/calibration-plan").json()
    assert plan["measured"][0]["frequency_hz"] == pytest.approx(180.0, abs=0.5)


def shop_files(folder: Path, preloads: Sequence[float], places_mm: Sequence[float]) -> list[Path]:
    """Write a table for each preload and place, which only its name tells of, as a shop does."""
    rng, paths = np.random.default_rng(6), list[Path]()
    for preload in preloads:
        for place in places_mm:
            frequency = axial_frequency(preload, place * 1e-3)
            windows = [simulated_window(rng, frequency, **_SOMEWHERE) for _ in range(N_SECONDS)]
            torque, acceleration = (np.concatenate([getattr(w, name) for w in windows]) for name in CHANNELS)
            at = START + timedelta(minutes=10 * len(paths))
            paths.append(folder / f"{at:%Y-%m-%d_%H%M}_{preload:.0f}N_x{place:.0f}.csv")
            table = np.column_stack([np.arange(torque.size) / RATE, torque, acceleration])
            header = "Time [s],Motor torque [Nm],Acc nut [m/s2]"
            np.savetxt(paths[-1], table, delimiter=",", header=header, comments="", fmt="%.6g")
    return paths


CHANNELS = ("excitation", "response")


@pytest.mark.release
@pytest.mark.parametrize("script", [True, False])
def test_a_shop_calibrates_from_twenty_raw_files_in_ten_clicks(
    fresh_service: Site, visit: Visit, tmp_path: Path, script: bool
) -> None:
    hand = Hand(page := visit(fresh_service.url, "/", script=script))
    hand.click("link", "New axis")
    hand.type("Name of the axis", "Mill 9, X")
    hand.click("button", "Register")
    hand.choose(shop_files(tmp_path, (100, 150, 200, 250, 300), (250, 400, 550, 700)))
    hand.click("button", "Look into it")
    sheet = page.locator(".sheet tbody tr")
    for _ in range(60):
        if script or sheet.count():
            break
        page.wait_for_timeout(1000)
        page.reload()
    expect(sheet).to_have_count(20)
    expect(sheet.nth(6).locator("input").nth(0)).to_have_value("150")
    expect(sheet.nth(6).locator("input").nth(2)).to_have_value("550")
    assert not violations(page) if script else True
    page.locator("[name='window.samples_per_window']").fill(str(RATE))
    hand.click("button", "Import")
    if not script:
        page.wait_for_timeout(8000)
        page.reload()
    expect(page.locator("#taken")).to_contain_text(f"Imported: {20 * N_SECONDS} windows in 20 measurements")
    plan = fresh_service.api.http.get("/v1/axes/mill-9-x/calibration-plan").json()
    assert {(item["position_mm"], item["preload_n"]) for item in plan["measured"]} == {
        (place, preload) for preload in (100, 150, 200, 250, 300) for place in (250, 400, 550, 700)
    }
    hand.click("link", "Calibrate")
    hand.click("button", "Fit")
    if not script:
        page.wait_for_timeout(8000)
        page.reload()
    hand.click("link", "Review", timeout=60_000)
    hand.click("button", "Put in force")
    assert hand.clicks <= MOST_CLICKS


def test_files_are_given_a_row_each_and_what_was_typed_stays(fresh_service: Site, visit: Visit, tmp_path: Path) -> None:
    page = visit(fresh_service.url, "/axes/uncalibrated/import", allowed="the server responded with a status of 4")
    page.locator("#file").set_input_files(shop_files(tmp_path, (200,), (300, 600)))
    page.get_by_role("button", name="Look into it").click()
    places = page.get_by_label(re.compile("Position"))
    expect(places.first).to_have_value("300")
    page.locator("[name='window.samples_per_window']").fill(str(RATE))
    places.first.fill("three")
    page.get_by_role("button", name="Import").first.click()
    expect(page.get_by_role("alert")).to_contain_text("_x300.csv, position_mm: expected a number; got 'three'")
    expect(places.first).to_have_value("three")
    places.first.fill("310,5")
    page.get_by_role("button", name="Import").first.click()
    expect(page.locator("#taken")).to_contain_text(f"Imported: {2 * N_SECONDS} windows in 2 measurements")
    plan = fresh_service.api.http.get("/v1/axes/uncalibrated/calibration-plan").json()
    assert [(item["position_mm"], item["preload_n"]) for item in plan["measured"]] == [(310.5, 200), (600, 200)]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("notes.txt", b"dear diary"),
        pytest.param("empty.csv", b"", marks=pytest.mark.release),
        pytest.param("model.toml", (SESSION.parent / "models" / "lumped.toml").read_bytes(), marks=pytest.mark.release),
        pytest.param("half.session.h5", SESSION.read_bytes()[:50_000], marks=pytest.mark.release),
    ],
)
def test_a_file_that_cannot_be_taken_says_what_was_expected(
    fresh_service: Site, visit: Visit, tmp_path: Path, name: str, content: bytes
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    page = visit(fresh_service.url, "/axes/normal/import")
    page.locator("#file").set_input_files(path)
    page.get_by_role("button", name="Look into it").click()
    expect(page.locator("#problems")).to_contain_text("expected", timeout=30_000)
    assert page.get_by_role("button", name="Import").count() == 0
    page.get_by_role("link", name="Choose another file").click()
    expect(page.locator("table")).to_contain_text(name)  # it is kept


@pytest.mark.release
def test_a_chosen_file_stays_chosen_while_others_measure(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal/import")
    page.locator("#file").set_input_files(SESSION)
    mark = page.evaluate("document.documentElement.dataset.mark")
    measure(fresh_service.api, "learning", range(3, 4))
    page.wait_for_function("before => document.documentElement.dataset.mark !== before", arg=mark)
    page.get_by_role("button", name="Look into it").click()
    expect(page.locator("#windows")).to_have_text("585 in 39 measurements", timeout=60_000)


@pytest.mark.release
def test_two_people_at_once_the_second_is_told(fresh_service: Site, visit: Visit) -> None:
    pages = [visit(fresh_service.url, "/axes/normal/import", allowed="status of 409")]
    pages[0].locator("#file").set_input_files(SESSION)
    pages[0].get_by_role("button", name="Look into it").click()
    pages[0].get_by_role("button", name="Import").wait_for(timeout=60_000)
    path = pages[0].url.removeprefix(fresh_service.url)
    other = visit(fresh_service.url, path, script=False, allowed="status of 409")
    pages[0].get_by_role("button", name="Import").click()
    expect(pages[0].locator("#taken")).to_be_visible()
    other.get_by_role("button", name="Import").click()
    expect(other.locator("h1")).to_have_text("Somebody was faster, or it was done already")
    expect(other.locator("main")).to_contain_text("are taken already")


@pytest.mark.release
@pytest.mark.parametrize(("size", "theme"), LOOKS)
def test_everybody_can_read_it(fresh_service: Site, visit: Visit, tmp_path: Path, size: str, theme: str) -> None:
    page = visit(fresh_service.url, "/axes/normal/import", size, theme)
    for number in range(2):
        assert not violations(page)
        assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0
        assert small_texts(page) == []
        assert small_targets(page) == []
        if not number:
            page.locator("#file").set_input_files(csv_file(tmp_path))
            page.get_by_role("button", name="Look into it").press("Enter")
            expect(page.locator("fieldset").first).to_be_visible(timeout=30_000)


@pytest.mark.release
def test_it_works_without_a_script_and_in_german(fresh_service: Site, visit: Visit) -> None:
    page = visit(fresh_service.url, "/axes/normal/import", script=False, language="de-DE")
    expect(page.locator("h1")).to_have_text("Aufzeichnung von normal importieren")
    page.locator("#file").set_input_files(SESSION)
    page.get_by_role("button", name="Hineinsehen").click()
    for _ in range(60):
        if page.locator("#windows").count():
            break
        page.wait_for_timeout(500)
        page.reload()
    expect(page.locator("#windows")).to_have_text("585 in 39 Messungen")
