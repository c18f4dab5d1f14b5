"""The libraries behind the readers: the versions that are tried are stated, the newest are tried before a release."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIBRARIES = ("npTDMS", "asammdf", "pyarrow", "openpyxl", "h5py", "scipy", "pyuff", "numpy")
FILES = [path for path in sorted(Path(__file__).parent.glob("test_*.py")) if path != Path(__file__)]


def test_the_docs_say_which_versions_of_the_libraries_are_tried():
    page = (ROOT / "docs" / "reference" / "recordings.md").read_text(encoding="utf-8")
    tried = [f"{name} {version(name)}" for name in LIBRARIES]
    assert [words for words in tried if words not in page] == []


@pytest.fixture(scope="module")
def newest(tmp_path_factory):
    """Environment in which the libraries are of their newest releases."""
    folder = tmp_path_factory.mktemp("newest")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--upgrade"]
    installed = subprocess.run([*pip, "--target", folder, *LIBRARIES], check=False, capture_output=True, text=True)
    if installed.returncode:
        pytest.skip(f"the newest releases cannot be installed here: {installed.stderr.strip().splitlines()[-1]}")
    environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    names = [name.lower() for name in LIBRARIES]
    program = f"import {', '.join(names)}\nprint(*(module.__file__ for module in ({', '.join(names)})))"
    used = subprocess.run([sys.executable, "-c", program], check=True, env=environment, capture_output=True, text=True)
    assert [place for place in used.stdout.split() if not place.startswith(str(folder))] == []
    return environment


@pytest.mark.release
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_readers_pass_their_tests_at_the_newest_release_of_each_library(newest, path):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not release", path]
    tried = subprocess.run(command, check=False, env=newest, capture_output=True, text=True, cwd=ROOT)
    assert tried.returncode == 0, tried.stdout[-4000:]
