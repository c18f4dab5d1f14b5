"""The libraries behind the readers: the versions that are tried are stated, the newest are tried before a release."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIBRARIES = ("npTDMS", "asammdf", "pyarrow", "openpyxl", "h5py", "scipy", "pyuff", "numpy")
TESTS = ("raw", "mdf4", "parquet", "xlsx", "mat", "npz", "wav", "uff_responses", "times", "stored", "hdf5_of_others",
         "cells", "session")  # fmt: skip


def test_the_docs_say_which_versions_of_the_libraries_are_tried():
    page = (ROOT / "docs" / "reference" / "recordings.md").read_text(encoding="utf-8")
    tried = [f"{name} {version(name)}" for name in LIBRARIES]
    assert [words for words in tried if words not in page] == []


@pytest.mark.release
def test_the_readers_pass_their_tests_at_the_newest_release_of_each_library(tmp_path):
    folder = tmp_path / "newest"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--upgrade"]
    installed = subprocess.run([*pip, "--target", folder, *LIBRARIES], check=False, capture_output=True, text=True)
    if installed.returncode:
        pytest.skip(f"the newest releases cannot be installed here: {installed.stderr.strip().splitlines()[-1]}")
    environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    names = [name.lower() for name in LIBRARIES]
    program = f"import {', '.join(names)}\nprint(*(module.__file__ for module in ({', '.join(names)})))"
    run = {"env": environment, "capture_output": True, "text": True, "cwd": ROOT}
    used = subprocess.run([sys.executable, "-c", program], check=True, **run).stdout.split()
    assert [place for place in used if not place.startswith(str(folder))] == []
    files = [f"tests/recordings/test_{name}.py" for name in TESTS]
    pytest_of_it = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not release"]
    tried = subprocess.run([*pytest_of_it, *files], check=False, **run)
    assert tried.returncode == 0, tried.stdout[-4000:]
