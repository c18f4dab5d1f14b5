"""How long a reader waits: the first chart of an axis, a poll that finds nothing new, and a fleet.

``python -m benchmarks.pages`` prints, for an axis of 5,000 and of 1,000,000 measurements, when its first chart stands
in Chromium (each time in a new profile, so that nothing is cached), what was sent and what that unpacks to, how long a
poll takes on the wire and of the processor, how soon an open page has what was measured, and after each event of
``tests/browser/test_open_page.py`` when the last of its open pages says what a fresh one says; then how long the fleet
of 1000 axes takes, with and without the browser.
"""

import shutil
import statistics
import sys
import tempfile
import time
from datetime import timedelta
from pathlib import Path

import httpx
from playwright.sync_api import Browser, sync_playwright
from psutil import Process

from benchmarks.hostile_connections import register, service
from tests.browser.conftest import Site, sites
from tests.browser.states import learn, measure
from tests.browser.test_open_page import EVENTS, FRESH, OPEN
from tests.service.conftest import Api, running_service
from tests.service.long_history import lengthen

LENGTHS = (5_000, 1_000_000)
REPEATED = 7
POLLS = 400
N_AXES = 1000
CHART = "#preload-chart svg"
AXIS = "axis"
PATHS = ("/", "/wall", f"/axes/{AXIS}", f"/axes/{AXIS}?range=all", "/alarms")
#: Each event begins from what those before it left: an alarm, which is acknowledged, then cleared, and so on.
IN_ORDER = ("alarm", "acknowledge", "clear", "measurement", "activation", "silence", "restart")
#: Notes the moment at which what is looked for stands in the page and the browser has drawn it.
WATCH = """(() => { const look = () => document.querySelector(%r)
  ? requestAnimationFrame(() => { window.shownMs = performance.now(); }) : requestAnimationFrame(look); look(); })()"""
SENT = """() => ["navigation", "resource"].flatMap(kind => performance.getEntriesByType(kind))
  .reduce((sum, entry) => [sum[0] + entry.transferSize, sum[1] + entry.decodedBodySize], [0, 0])"""


def shown(browser: Browser, address: str, selector: str) -> tuple[float, float, float]:
    """Return after how many seconds something stands in a page, and the bytes that were sent and unpacked."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    page = context.new_page()
    page.add_init_script(WATCH % selector)
    page.goto(address)
    page.wait_for_function("window.shownMs !== undefined")
    seconds, (sent, unpacked) = page.evaluate("window.shownMs") / 1e3, page.evaluate(SENT)
    context.close()
    return seconds, sent, unpacked


def poll(http: httpx.Client, process: Process) -> str:
    """Return what a poll that finds nothing new takes."""
    mark = http.get("/v1/changes").json()["mark"]
    before, waited = sum(process.cpu_times()[:2]), []
    for _ in range(POLLS):
        began = time.perf_counter()
        answer = http.get("/v1/changes", params={"since": mark})
        waited.append(time.perf_counter() - began)
        if answer.status_code != 304:
            sys.exit(f"expected 304, nothing was written; got {answer.status_code}")
    spent = (sum(process.cpu_times()[:2]) - before) / POLLS
    return f"{1e3 * statistics.median(waited):.2f} ms on the wire, {1e3 * spent:.2f} ms of the processor"


def taken_over(browser: Browser, api: Api) -> str:
    """Return how long after a measurement was accepted an open page shows it."""
    page, late = browser.new_page(), []
    page.goto(f"{api.http.base_url}/axes/{AXIS}")
    for day in range(9, 9 + REPEATED):
        measure(api, AXIS, range(day, day + 1))
        began, mark = time.perf_counter(), api.http.get("/v1/changes").json()["mark"]
        page.wait_for_function("mark => document.documentElement.dataset.mark === mark", arg=mark)
        late.append(time.perf_counter() - began)
    page.close()
    return f"{statistics.median(late):.2f} s (longest {max(late):.2f})"


def truthful_after(browser: Browser, site: Site, event: str) -> float:
    """Return how long after an event the last of the open pages says what a fresh one says, and that it is live."""
    pages = [browser.new_page() for _ in PATHS]
    for page, path in zip(pages, PATHS, strict=True):
        page.goto(site.url + path)
    EVENTS[event](site)
    began = time.perf_counter()
    for page in pages:
        while page.locator("#connection.lost").count() or page.evaluate(OPEN) != page.evaluate(FRESH):
            page.wait_for_timeout(20)
    late = time.perf_counter() - began
    for page in pages:
        page.close()
    return late


def axis_of(browser: Browser, n_measurements: int) -> None:
    """Print what the page of an axis with so many measurements takes."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "var"
        with running_service(data) as api:
            learn(api, AXIS)
        lengthen(data, AXIS, n_measurements, every=timedelta(minutes=1))
        with (
            service(data) as (port, process),
            httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False) as http,
        ):
            for span in ("", "?range=all"):
                found = [shown(browser, f"{http.base_url}/axes/{AXIS}{span}", CHART) for _ in range(REPEATED)]
                seconds, sent, unpacked = (sorted(column) for column in zip(*found, strict=True))
                print(
                    f"{n_measurements:>9} measurements, axis{span}: first chart {statistics.median(seconds):.2f} s "
                    f"(longest {seconds[-1]:.2f}); {sent[0] / 1e3:.0f} kB sent, {unpacked[0] / 1e3:.0f} kB unpacked"
                )
            print(f"{n_measurements:>9} measurements, poll: {poll(http, process)}")
            soon = taken_over(browser, Api(http, data))
            print(f"{n_measurements:>9} measurements, an open page shows a new one after {soon}")
        for site in sites(Path(folder) / "served", data):
            for event in IN_ORDER:
                late = truthful_after(browser, site, event)
                print(f"{n_measurements:>9} measurements, {event}: the last open page is true after {late:.2f} s")


def fleet(browser: Browser) -> None:
    """Print what the fleet of 1000 axes takes."""
    with tempfile.TemporaryDirectory() as folder, service(Path(folder)) as (port, _):
        for number in range(N_AXES):
            register(port, f"axis-{number:04d}")
        address, answered = f"http://127.0.0.1:{port}/", []
        for _ in range(REPEATED):
            began = time.perf_counter()
            httpx.get(address, headers={"accept": "text/html"}, trust_env=False).raise_for_status()
            answered.append(time.perf_counter() - began)
        seconds = [shown(browser, address, "table.fleet tbody tr")[0] for _ in range(REPEATED)]
        print(
            f"fleet of {N_AXES} axes: answered in {statistics.median(answered):.2f} s (longest {max(answered):.2f}), "
            f"its rows stand after {statistics.median(seconds):.2f} s (longest {max(seconds):.2f})"
        )


def main() -> None:
    """Run all of it."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        sys.exit("the pages are opened in Chromium: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        for length in LENGTHS:
            axis_of(browser, length)
        fleet(browser)
        browser.close()


if __name__ == "__main__":
    main()
