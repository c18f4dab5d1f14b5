"""What a start imports: nothing that it does not need to take a window, show a page or read its arguments."""

import json
import subprocess
import sys
from collections.abc import Iterable

import pytest

from service.cli.main import COMMANDS, MODULES
from tests.conftest import canary

#: Of no command: each comes when it is first used.
LATER = (
    *("scipy.stats", "scipy.signal", "scipy.optimize", "scipy.linalg", "scipy.special"),
    *("h5py", "pyarrow", "openpyxl", "asammdf", "nptdms", "numba", "distributed", "paho", "asyncua", "matplotlib"),
)
ANALYSES = ("monitor_core.discrepancy", "monitor_core.identification", "monitor_core.change")
MODELS = ("monitor_core.models.extended", "monitor_core.models.generator", "monitor_core.effects")
SERVICE = ("service.api", "service.web", "service.store", "fastapi", "sqlalchemy", "uvicorn", "httpx")

#: What a command must not import besides.
NOT = {
    "serve": (*ANALYSES, *MODELS, "monitor_core.fitting", "service.report.page", "httpx"),
    "demo": ANALYSES,
    "retention": (*ANALYSES, *MODELS, "service.web"),
    "replay": (*ANALYSES, *MODELS, "service.web"),
    "rejudge": (*ANALYSES, *MODELS, "service.web", "service.store", "sqlalchemy"),
    "backup": (*ANALYSES, *MODELS, "service.web", "service.api", "fastapi"),
    "people": (*ANALYSES, *MODELS, "service.web", "service.api", "fastapi"),
    "batch": (*ANALYSES, *MODELS, *SERVICE),
    "mqtt": (*ANALYSES, *MODELS, *SERVICE, "numpy"),
    "opcua": (*ANALYSES, *MODELS, *SERVICE, "numpy"),
    "explain": ("monitor_core.identification", *SERVICE),
    "identify": ("monitor_core.discrepancy", "monitor_core.change", *SERVICE),
    "modes": (*ANALYSES, *SERVICE),
    "simulate": (*ANALYSES, *SERVICE),
    "frf": (*ANALYSES, *MODELS, *SERVICE),
    "lost_motion": (*ANALYSES, *MODELS, *SERVICE),
    "torque": (*ANALYSES, *MODELS, *SERVICE),
    "estimate": (*ANALYSES, *MODELS, *SERVICE),
    "calibrate": (*ANALYSES, *MODELS, *SERVICE),
    "check": (*ANALYSES, *MODELS, *SERVICE),
    "import_raw": (*ANALYSES, *MODELS, *SERVICE),
}
#: Of the product, of 521 once.
MOST_OWN_MODULES_OF_SERVE = 269

#: Each command in a child of one process that has imported none of them.
SCRIPT = """
import importlib, json, os, sys
for name in sys.argv[1:]:
    sys.stdout.flush()
    if os.fork() == 0:
        importlib.import_module("service.cli." + name)
        print(json.dumps([name, sorted(sys.modules)]), flush=True)
        os._exit(0)
    os.wait()
"""


def imported(commands: Iterable[str]) -> dict[str, set[str]]:
    """Return the modules that each of the commands imports before it reads its arguments."""
    ran = subprocess.run([sys.executable, "-c", SCRIPT, *commands], capture_output=True, text=True, check=True)
    return {name: set(modules) for name, modules in map(json.loads, ran.stdout.splitlines())}


@pytest.mark.parametrize("commands", canary([["serve", "mqtt", "explain"], list(NOT)]))
def test_a_start_imports_what_it_needs(commands, subtests):
    assert {MODULES.get(name, name) for name in COMMANDS} == set(NOT)
    modules_of = imported(commands)
    for command in commands:
        with subtests.test(command=command):
            assert sorted({*LATER, *NOT[command]} & modules_of[command]) == []
    own = [name for name in modules_of["serve"] if name.partition(".")[0] in {"monitor_core", "service"}]
    assert len(own) <= MOST_OWN_MODULES_OF_SERVE
