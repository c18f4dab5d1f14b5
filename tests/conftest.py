"""Where the tests find measurements made by others and the published tables."""

import gc
import json
import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, settings

from service.blas_threads import compute_in_one_thread
from service.cli.main import main

compute_in_one_thread()  # as in the command line

# on a machine that is busy an example may take any time
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

PROJECT_ROOT = Path(__file__).resolve().parent.parent


def canary(cases: Iterable[object]) -> list[object]:
    """Return cases for ``parametrize``: the first is tried by ``make test``, the others before a release."""
    first, *others = cases
    return [
        first,
        *(pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.release) for case in others),
    ]


@pytest.fixture(autouse=True, scope="module")
def umask_of_the_tests() -> Iterator[None]:
    """Give other tests the umask back that a service in this process has made stricter."""
    umask = os.umask(0)
    os.umask(umask)
    yield
    os.umask(umask)


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Compile the tests once in a clean clone: each worker begins with files of its own, and finds those of others."""
    if "PYTEST_XDIST_WORKER" not in os.environ or session.config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    worker, n_workers = int(os.environ["PYTEST_XDIST_WORKER"][2:]), int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    files = sorted(PROJECT_ROOT.glob("tests/**/test_*.py"))[worker::n_workers]
    for file in files:
        with suppress(Exception, pytest.skip.Exception):  # the collection says what is wrong with it
            import_module(".".join(file.relative_to(PROJECT_ROOT).with_suffix("").parts))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the files with long tests first: several processes, a file each at a time, then end together."""
    long = {item.path for item in items if item.get_closest_marker("release")}
    items.sort(key=lambda item: item.path not in long)


def pytest_collection_finish() -> None:
    """Spare the collector of garbage what stays until the end: all modules and tests, looked at again and again."""
    gc.collect()
    gc.freeze()


class Answer(NamedTuple):
    """What a command left behind."""

    exit_code: int
    out: str
    err: str

    def json(self) -> Any:
        assert self.exit_code == 0, self.err
        return json.loads(self.out)  # one document and nothing else


def run_here(*words: object) -> int:
    """Run ``preload`` with some words in this process, and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["preload", *map(str, words)])
        with pytest.raises(SystemExit) as exit_:
            main()
    return int(exit_.value.code or 0)


def free_port() -> int:
    """Return a port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def preload(capfd: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """Return what runs ``preload`` with some words in this process and returns its answer."""

    def run(*words: object) -> Answer:
        capfd.readouterr()
        code = run_here(*words)
        captured = capfd.readouterr()
        return Answer(code, captured.out, captured.err)

    return run


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder of real measurements, which carry no licence and therefore stay outside the project."""
    default = PROJECT_ROOT.parent / "shared" / "data" / "measured"
    folder = Path(os.environ.get("PRELOAD_MEASURED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real measurements at {folder}; set PRELOAD_MEASURED_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def hard_cases() -> Path:
    """Folder of small files that are read wrongly by the first reader that comes to mind."""
    folder = PROJECT_ROOT.parent / "shared" / "data" / "cases"
    if not folder.is_dir():
        pytest.skip(f"no cases at {folder}")
    return folder


@pytest.fixture(scope="session")
def published_data() -> Path:
    """Folder of the papers' tables."""
    return PROJECT_ROOT / "replay_data" / "published"
