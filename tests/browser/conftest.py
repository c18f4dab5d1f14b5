"""Pages in the system's Chromium against a service that is a process of its own.

A page that asks for anything from outside, or writes an error to its console, fails its test. Pages that others add use
``served`` (every state, only read), ``fresh_service`` (a copy of it to change) and ``visit``.
"""

import fcntl
import itertools
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    Playwright,
    Request,
    expect,
    sync_playwright,
)

from tests.browser.states import build
from tests.conftest import canary, free_port
from tests.service.conftest import Api, ForkedServer, ServerProcess, client_of, servers

#: No name is resolved: what a page asks of others fails inside the browser. (A route of Playwright's would do it here,
#: where nothing is answered while a test waits.)
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
SIZES = {"desk": (1280, 720), "phone": (420, 800)}
THEMES = ("light", "dark")
expect.set_options(timeout=60_000)  # a machine that has much else to do takes its time

#: Size and theme in which a page is seen: on a desk in light, and before a release in every way.
LOOKS = canary(itertools.product(SIZES, THEMES))
#: A form is sent by a script, and before a release without one, too.
WITH_AND_WITHOUT_SCRIPT = canary([True, False])
#: Rules of WCAG 2.2 A and AA, and what axe calls best practice.
AXE = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}


#: Chromium without windows opens a page in half the time of one that draws its own frame around it, unseen.
CHROMIUMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="package")
def playwright() -> Iterator[Playwright]:
    """Start what drives browsers, once for the tests of this folder that follow one another.

    It keeps an event loop in this thread: that ends with them, since other tests run loops of their own.
    """
    with sync_playwright() as driver:
        yield driver


@pytest.fixture(scope="package")
def browser(playwright: Playwright) -> Iterator[Browser]:
    """Start the system's Chromium."""
    path = next(filter(None, map(shutil.which, CHROMIUMS)), None)
    if path is None:
        pytest.fail("the tests of the pages need Chromium: apt-get install chromium-headless-shell, or any on the PATH")
    started = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
    yield started
    started.close()


@pytest.fixture(scope="session")
def states(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a data folder with an axis in every state, once for all workers; nobody writes into it."""
    own = tmp_path_factory.getbasetemp()
    of_all = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    folder = of_all / "states"
    with (of_all / "states.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # whoever comes meanwhile waits until it is made
        if not folder.exists():
            build(made := tmp_path_factory.mktemp("states") / "var")
            made.rename(folder)
    return folder


@dataclass
class Site:
    """A running service, and the ways in for a browser and for a program."""

    server: ServerProcess
    api: Api
    restart: Callable[[], None] = field(repr=False)

    @property
    def url(self) -> str:
        return self.server.url


def sites(folder: Path, states: Path) -> Iterator[Site]:
    """Serve a copy of the data folder by a process of its own."""
    data_dir = folder / "var"
    shutil.copytree(states, data_dir)
    starting = servers(folder, ForkedServer)
    start, port = next(starting), free_port()
    with client_of(f"http://127.0.0.1:{port}") as http:
        site = Site(start(data_dir, port), Api(http, data_dir), restart=lambda: None)

        def restart() -> None:
            site.server.process.terminate()
            site.server.process.wait()
            site.server = start(data_dir, port)
            site.server.wait_until_up()

        site.restart = restart
        site.server.wait_until_up()
        try:
            yield site
        finally:
            next(starting, None)


@pytest.fixture(scope="session")
def served(states: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Serve an axis in every state, for tests that only read."""
    yield from sites(tmp_path_factory.mktemp("served"), states)


@pytest.fixture
def fresh_service(states: Path, tmp_path: Path) -> Iterator[Site]:
    """Serve an axis in every state, for a test that changes something."""
    yield from sites(tmp_path, states)


@pytest.fixture(scope="session")
def nothing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the data folder of a service that knows no axis."""
    folder = tmp_path_factory.mktemp("nothing")
    (folder / "var").mkdir()
    return folder / "var"


@pytest.fixture(scope="session")
def tried(nothing: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Serve a trial that was made by one request, for tests that only read."""
    for site in sites(tmp_path_factory.mktemp("tried"), nothing):
        job = site.api.http.post("/v1/trials").json()
        wait_for(site, job["id"])
        yield site


def wait_for(site: Site, job: str, seconds: float = 120.0) -> dict[str, object]:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found: dict[str, object] = site.api.http.get(f"/v1/jobs/{job}").json()
        if found["status"] not in ("queued", "running"):
            assert (found["status"], found["error"]) == ("done", None)
            return found
        time.sleep(0.2)
    raise AssertionError(f"job {job} did not end within {seconds} s")


Visit = Callable[..., Page]


@pytest.fixture
def visit(browser: Browser) -> Iterator[Visit]:
    """Open a page in a window of its own; in the end no page may have said an error or asked outside for anything."""
    wrong: list[str] = []
    contexts: dict[tuple[object, ...], BrowserContext] = {}

    def watch(request: Request, url: str) -> None:
        if not request.url.startswith((url, "data:")):
            wrong.append(f"asked for {request.url}")

    def note(text: str, allowed: str) -> None:
        # that a service is gone, or that a page is missing on purpose, a browser says by itself
        if not (allowed and allowed in text):
            wrong.append(text)

    def read(message: ConsoleMessage, allowed: str) -> None:
        if message.type == "error":
            note(f"console: {message.text}", allowed)

    def opened(
        url: str, path: str, size: str = "desk", theme: str = "light", *, language: str = "en",
        zone: str = "Europe/Berlin", script: bool = True, allowed: str = "",
    ) -> Page:  # fmt: skip
        kind = (size, theme, language, zone, script)
        if kind not in contexts:
            width, height = SIZES[size]
            contexts[kind] = browser.new_context(
                viewport={"width": width, "height": height},
                color_scheme=theme,
                locale=language,
                timezone_id=zone,
                java_script_enabled=script,
            )
            contexts[kind].set_default_timeout(60_000)
        page = contexts[kind].new_page()
        page.on("console", lambda message: read(message, allowed))
        page.on("pageerror", lambda error: note(f"script: {error}", allowed))
        page.on("request", lambda request: watch(request, url))
        page.goto(url + path)
        return page

    yield opened
    for context in contexts.values():
        context.close()
    assert not wrong


def bytes_of(page: Page) -> int:
    """Return what a page and all it brought unpack to."""
    script = """() => ["navigation", "resource"].flatMap(kind => performance.getEntriesByType(kind))
      .reduce((sum, entry) => sum + entry.decodedBodySize, 0)"""
    return int(page.evaluate(script))


def violations(page: Page) -> list[str]:
    """Return what axe finds wrong with a page, each with the place."""
    found = Axe().run(page, options=AXE).response["violations"]
    return [
        f"{rule['id']}: {node['target']} {node['failureSummary'][:200]}" for rule in found for node in rule["nodes"]
    ]


def unfold(page: Page) -> None:
    """Open every part of a page."""
    folded = page.locator("main > details:not([open]) > summary")
    while folded.count():
        folded.first.click()


def zoom_by_dragging(page: Page) -> None:
    """Drag over the third quarter of the trend of an axis, and wait for the page that shows it alone."""
    box = page.locator("#preload-chart .wide svg").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.75, box["y"] + 60, steps=3)
    page.mouse.up()
    page.wait_for_url("**from=*")
