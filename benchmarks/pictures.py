"""Photograph the pages of the trial into ``docs/pictures``, as the README shows them: light, dark, on a phone.

``python -m benchmarks.pictures`` starts a service with nothing in it, makes the trial with the one click, and opens the
pages in the system's Chromium. The story is the same each time; its dates are those of the day.
"""

import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import httpx
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from service.cli.remote.server import embedded_service
from service.settings import Settings

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
#: Together, so that a clone stays small. [bytes]
MOST_BYTES = 300_000
_COLOURS = 200


@dataclass(frozen=True)
class Picture:
    """A page as it is photographed."""

    name: str
    path: str
    theme: str
    size: tuple[int, int]


SHOWN = (
    Picture("axis-light", "/axes/trial", "light", (1280, 720)),
    Picture("long-run-dark", "/axes/trial/long-run", "dark", (1280, 1040)),
    Picture("axis-phone", "/axes/trial", "dark", (420, 800)),
    Picture("alarm-phone", "/alarms/2", "light", (420, 800)),
)


def main() -> None:
    """Make the trial and photograph it."""
    names = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        sys.exit("pictures of the pages need Chromium: apt-get install chromium")
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), port=0, host="127.0.0.1", database_url=None)
        with embedded_service(settings) as url, sync_playwright() as playwright:
            make_trial(url)
            browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
            sizes = [photograph(browser, url, picture) for picture in SHOWN]
            browser.close()
    print(f"{len(sizes)} pictures, {sum(sizes)} bytes, in {PICTURES}")
    if sum(sizes) > MOST_BYTES:
        sys.exit(f"together they must not be larger than {MOST_BYTES} bytes")


def make_trial(url: str) -> None:
    """Make the trial axis, and wait until the causes of its alarms are found."""
    with httpx.Client(base_url=url, trust_env=False, timeout=60.0) as http:
        http.post("/v1/trials").raise_for_status()
        while any(job["status"] in ("queued", "running") for job in http.get("/v1/jobs").json()["jobs"]):
            time.sleep(0.5)


def photograph(browser: Browser, url: str, picture: Picture) -> int:
    """Write one picture, with so few colours that it is small; return its size."""
    width, height = picture.size
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=picture.theme, locale="en", timezone_id="UTC"
    )
    page = context.new_page()
    page.goto(url + picture.path)
    page.locator(".open").evaluate("notice => notice.remove()")  # the service of the pictures is open to all
    page.wait_for_timeout(500)
    target = PICTURES / f"{picture.name}.png"
    with Image.open(BytesIO(page.screenshot())) as taken:
        taken.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)
    context.close()
    return target.stat().st_size


if __name__ == "__main__":
    main()
