"""The wheel, installed into an environment of its own far from the checkout, does what the checkout does."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import PROJECT_ROOT

#: Nothing of the checkout or of this environment reaches the one that is tried.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}


def run(folder: Path, *command: str | Path) -> str:
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.release
def test_the_wheel_replays_the_demo(tmp_path):
    python = tmp_path / "environment" / "bin" / "python"
    run(tmp_path, sys.executable, "-m", "venv", tmp_path / "environment")
    lock = PROJECT_ROOT / "requirements" / "serve.lock"
    pip = (python, "-m", "pip", "install", "--quiet", "--no-deps")
    run(tmp_path, *pip, "--require-hashes", "-r", lock)
    run(tmp_path, python, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", PROJECT_ROOT)
    run(tmp_path, *pip, *tmp_path.glob("*.whl"))
    answer = json.loads(run(tmp_path, python.with_name("preload"), "demo", "--json"))
    assert {alarm["axis"] for alarm in answer["alarms"]} == {"slow-wear", "sudden-loss"}
