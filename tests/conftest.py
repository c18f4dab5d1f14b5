"""Where the tests find measurements made by others and the published tables."""

import os
from pathlib import Path

import pytest

from service.blas_threads import compute_in_one_thread

compute_in_one_thread()  # as in the command line

PROJECT_ROOT = Path(__file__).resolve().parent.parent


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the files with long tests first: several processes, a file each at a time, then end together."""
    long = {item.path for item in items if item.get_closest_marker("release")}
    items.sort(key=lambda item: item.path not in long)


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder of real measurements, which carry no licence and therefore stay outside the project."""
    default = PROJECT_ROOT.parent / "shared" / "data" / "measured"
    folder = Path(os.environ.get("PRELOAD_MEASURED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real measurements at {folder}; set PRELOAD_MEASURED_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def published_data() -> Path:
    """Folder of the papers' tables."""
    return PROJECT_ROOT / "replay_data" / "published"
