"""The documentation is a test: what it names exists, what it lists is complete, its examples give what they show."""

import ast
import doctest
import importlib
import inspect
import os
import pkgutil
import pydoc
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

import monitor_core
from monitor_core import recordings
from monitor_core.models.families import FAMILIES
from monitor_core.models.parameters import PARAMETERS, name_in_file
from monitor_core.recording import RejectionReason
from monitor_core.trend import TrendStatus
from service.api.http.problems import TYPE_PREFIX
from service.app import create_app
from service.cli.main import command_named
from service.cli.remote.server import embedded_service
from service.errors import STATUS_OF_ERROR
from service.gateways.mqtt_windows import MqttSettings
from service.gateways.opcua_server import OpcuaSettings
from service.observability import FleetGauges, Metrics
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.settings import Settings
from service.store import schema
from tests.conftest import PROJECT_ROOT

DOCS = PROJECT_ROOT / "docs"
TOP_PAGES = [PROJECT_ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES = [*TOP_PAGES, *sorted(DOCS.rglob("*.md")), *sorted((PROJECT_ROOT / "benchmarks").rglob("*.md"))]
MODULES = sorted(info.name for info in pkgutil.walk_packages(monitor_core.__path__, "monitor_core."))
#: Pages that name functions and tests.
NAMING = ("reference/equations.md", "reference/errata.md", "explanation/four-papers.md")
#: How many equations, tables and figures each paper has.
NUMBERED = {
    "Nguyen": {"Eq.": 10, "Table": 3, "Fig.": 8},
    "Sun": {"Eq.": 14, "Table": 1, "Fig.": 7},
    "Tian": {"Eq.": 27, "Table": 9, "Fig.": 15},
    "Moreno-Castaneda": {"Eq.": 59, "Table": 2, "Fig.": 9},
}
CODE_SPAN = re.compile(r"`([^`\n]+)`")


def text_of(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


def code_spans(text: str) -> set[str]:
    return set(CODE_SPAN.findall(without_blocks(text)))


def first_cells(text: str) -> set[str]:
    """Return the code spans in the first column of all tables."""
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    return {span for row in rows for span in CODE_SPAN.findall(row.split(" | ")[0])}


# --- what is named exists --------------------------------------------------------------------------------------------


@cache
def names_of_tests(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.FunctionDef)}


def named_tests() -> list[tuple[str, str, str]]:
    """Return page, file and name of each test that the pages name; a section may say where its tests are."""
    named = []
    for page in NAMING:
        for section in text_of(page).split("\n## "):
            default = re.search(r"Tests are in `tests/(\S+)` unless another file is named", section)
            for span in sorted(code_spans(section)):
                file, separator, name = span.rpartition("::")
                if separator:
                    named.append((page, file.removeprefix("tests/"), name))
                elif span.startswith("test_") and not span.endswith(".py"):
                    assert default is not None, f"{page} names {span} without its file"
                    named.append((page, default[1], span))
    return named


def test_every_test_that_is_named_exists():
    assert not [
        f"{page} names {file}::{name}"
        for page, file, name in named_tests()
        if name not in names_of_tests(PROJECT_ROOT / "tests" / file)
    ]


def exists(dotted: str) -> bool:
    """Tell whether monitor_core has a module.function of this name, or a module.class.member."""
    parts = dotted.split(".")
    for n in range(len(parts) - 1, 0, -1):
        name = ".".join(["monitor_core", *parts[:n]])
        if name in MODULES:
            found = importlib.import_module(name)
            for part in parts[n:]:
                found = getattr(found, part, None)
            return found is not None
    return False


def named_functions() -> list[str]:
    heads = {name.split(".")[1] for name in MODULES}
    spans = set[str]().union(*(code_spans(text_of(page)) for page in NAMING))
    return sorted(s for s in spans if re.fullmatch(r"\w+(\.\w+)+", s) and s.split(".")[0] in heads)


def test_every_file_of_tests_that_is_named_exists():
    for page in NAMING:
        for span in code_spans(text_of(page)):
            if re.fullmatch(r"(\w+/)*test_\w+\.py", span):
                assert (PROJECT_ROOT / "tests" / span.removeprefix("tests/")).exists(), f"{page} names {span}"


def test_every_function_that_is_named_exists():
    assert not [dotted for dotted in named_functions() if not exists(dotted)]


def test_equations_name_functions_of_every_package_that_computes():
    computing = {"quality", "spectral", "modal", "preload", "trend", "models", "identification"}
    assert {name.split(".")[0] for name in named_functions()} >= computing
    assert not exists("preload.feature.no_such_function")


def numbers_in(cell: str) -> set[tuple[str, int]]:
    """Return what "Eq. 1–3, 5; Fig. 2" names."""
    named = set()
    for kind, numbers in re.findall(r"(Eq\.|Table|Fig\.) ([\d–, ]+)", cell):
        for first, last in re.findall(r"(\d+)(?:–(\d+))?", numbers):
            named |= {(kind, number) for number in range(int(first), int(last or first) + 1)}
    return named


def test_every_number_of_the_four_papers_has_a_row_with_a_test_or_is_said_to_be_not_built():
    sections = text_of("explanation/four-papers.md").split("\n## ")[1:]
    for section, (paper, highest) in zip(sections, NUMBERED.items(), strict=True):
        assert section.startswith(paper)
        lines = [line for line in section.splitlines() if line.startswith("| ")]
        rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[1:]]
        named = set[tuple[str, int]]().union(*(numbers_in(where) for where, *_ in rows))
        assert named == {(kind, number) for kind, last in highest.items() for number in range(1, last + 1)}
        for where, _, what, test, remark in rows:
            built = what != "not built" and remark != "a picture"
            assert built == bool(code_spans(what)) == ("::" in test), where


def test_every_command_that_the_four_papers_name_exists():
    spans = [span.split() for span in code_spans(text_of("explanation/four-papers.md")) if span.startswith("preload ")]
    assert len(spans) > 5
    for _, name, *words in spans:
        options = {option for parameter in command_named(name).params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options, name


def test_links_and_paths_lead_somewhere(subtests):
    for page in PAGES:
        with subtests.test(str(page.relative_to(PROJECT_ROOT))):
            assert_links_and_paths_lead_somewhere(page)


def assert_links_and_paths_lead_somewhere(page):
    text = without_blocks(page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        linked = page.parent / file if file else page
        assert linked.exists(), f"{page.name} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", linked.read_text(encoding="utf-8"), flags=re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in headings}, target
    for span in code_spans(text):
        if re.match(r"(docs|monitor_core|service|tests|replay_data|benchmarks)/", span):
            assert any(PROJECT_ROOT.glob(span.partition("::")[0])), f"{page.name} names {span}"


# --- docstrings ------------------------------------------------------------------------------------------------------


def test_examples_of_docstrings_give_what_they_show(subtests, monkeypatch):
    monkeypatch.chdir(PROJECT_ROOT)  # they read what is bundled
    for name in MODULES:
        with subtests.test(name):
            outcome = doctest.testmod(importlib.import_module(name))
            assert outcome.failed == 0


def test_every_function_of_the_library_shows_an_example():
    functions = [name for name in monitor_core.__all__ if inspect.isfunction(getattr(monitor_core, name))]
    assert [name for name in functions if ">>> " not in getattr(monitor_core, name).__doc__] == []


def exported(package: ModuleType) -> list[str]:
    """Return the names that a package lends: imported into its ``__init__`` as themselves."""
    imports = [node for node in ast.walk(ast.parse(inspect.getsource(package))) if isinstance(node, ast.ImportFrom)]
    return [alias.name for node in imports for alias in node.names if alias.asname == alias.name]


def test_every_public_name_says_what_it_is():
    for name in MODULES:
        package = importlib.import_module(name)
        for public in exported(package):
            item = getattr(package, public)
            if inspect.isclass(item) or inspect.isfunction(item):
                # a dataclass without a docstring gets its own signature for one
                assert not (item.__doc__ or f"{public}(").startswith(f"{public}("), f"{name}.{public}"


# --- what is listed is complete --------------------------------------------------------------------------------------


def shown_default(value: object) -> str:
    if value is None:
        return "unset"
    if isinstance(value, Path) and value.is_absolute():
        value = value.relative_to(PROJECT_ROOT)
    return f"`{value}`"


@pytest.mark.parametrize(
    ("settings", "prefix", "page"),
    [
        (Settings, "PRELOAD_", "how-to/settings.md"),
        (MqttSettings, "PRELOAD_MQTT_", "how-to/mqtt.md"),
        (OpcuaSettings, "PRELOAD_OPCUA_", "how-to/opcua.md"),
    ],
)
def test_every_setting_is_listed_with_its_default(settings, prefix, page):
    for name, field in settings.model_fields.items():
        assert f"| `{prefix}{name.upper()}` | {shown_default(field.default)} | " in text_of(page)


def test_every_item_of_an_axis_configuration_is_listed_with_its_default():
    for name, field in AxisConfiguration.model_fields.items():
        assert f"| `{name}` | {shown_default(field.default)} | " in text_of("how-to/settings.md")


def test_every_reason_and_every_state_has_a_row():
    assert set(RejectionReason) <= first_cells(text_of("how-to/refusals.md"))
    assert set(TrendStatus) <= first_cells(text_of("how-to/alarms.md"))


def test_every_parameter_of_every_family_is_listed():
    of_family = [{field.name: field.default is MISSING for field in fields(family.parameters)} for family in FAMILIES]
    says = {None: "", True: "needed", False: "may be"}
    for word in PARAMETERS:
        cells = [says[needed.get(word.name)] for needed in of_family]
        if any(cells):
            row = " | ".join([f"| `{name_in_file(word.name)}`", word.meaning, *cells]) + " |"
            assert row in text_of("reference/recordings.md")


def test_every_metric_is_listed():
    now = FleetGauges((), (), 0, {}, ()).collect()
    families = {metric.name: metric.type for metric in (*Metrics().registry.collect(), *now)}
    names = {name + ("_total" if kind == "counter" else "") for name, kind in families.items()}
    assert names <= first_cells(text_of("how-to/supervise.md"))


def test_every_problem_and_every_route_is_listed():
    listed = first_cells(text_of("reference/http-api.md"))
    assert {name for _, _, name in STATUS_OF_ERROR} <= listed
    for path, methods in create_app(Settings()).openapi()["paths"].items():
        for method in methods:
            assert f"{method.upper()} {path}" in listed


def test_the_schema_that_folders_are_opened_from_and_the_one_they_get_are_told():
    page = text_of("how-to/data.md")
    assert f"The schema is of version {schema.VERSION}:" in page
    assert f"Folders of {schema.BASELINE}," in page


def test_the_help_of_the_library_lists_its_public_names():
    shown = pydoc.render_doc(monitor_core, renderer=pydoc.plaintext)
    assert [name for name in monitor_core.__all__ if name not in shown] == []
    assert all(f"\n    {name}(" in shown for name in ("calibrate", "identify", "explain"))
    assert monitor_core.__version__ in text_of("../CITATION.cff")


def test_a_checkout_that_is_not_installed_has_no_version(monkeypatch):
    monkeypatch.setattr(sys, "path", [])
    assert not hasattr(monitor_core, "__version__")


def test_every_public_name_of_the_library_is_in_its_reference():
    shown = set(re.findall(r"^::: (\S+)$", text_of("reference/library.md"), flags=re.MULTILINE))
    face = {f"{home}.{name}" for home, names in monitor_core._HOMES.items() for name in names}
    assert shown >= face
    assert shown >= {f"monitor_core.recordings.{name}" for name in exported(recordings)}
    assert all(exists(name.removeprefix("monitor_core.")) for name in shown)


def test_every_page_is_in_the_navigation_of_the_site():
    navigation = (PROJECT_ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    listed = re.findall(r"(\S+\.md)$", navigation, flags=re.MULTILINE)
    assert sorted(listed) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
    how_to = [str(page.relative_to(DOCS)) for page in (DOCS / "how-to").glob("*.md")]
    assert [page for page in how_to if page not in text_of("index.md")] == []


# --- the guided tours ------------------------------------------------------------------------------------------------

TOURS = [
    "how-to/python-client.md",
    "how-to/access.md",
    "reference/http-api.md",
    "tutorial/first-axis.md",
    "tutorial/your-own-data.md",
]


def examples_of_the_tour(page: str) -> Iterator[tuple[str, str]]:
    """Yield each shell command of a tour with what it is said to answer."""
    for block in re.findall(r"^```console\n(.*?)^```", text_of(page), flags=re.MULTILINE | re.DOTALL):
        for example in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            lines = example.splitlines(keepends=True)
            n_command = next((i for i, line in enumerate(lines) if i and not line.startswith("    ")), len(lines))
            yield "".join(lines[:n_command]), re.sub(r"\n {4}", "", "".join(lines[n_command:]))


def cells_of(text: str) -> str:
    """Return a text with its tables as cells alone: a page shows the lines of a terminal, a pipe has columns."""
    lines = (re.sub(r"[│ ]+", " ", line).strip() for line in text.splitlines())
    return "".join(re.sub(r" ?\.\.\. ?", "...", line) + "\n" for line in lines)


@pytest.mark.release  # commands of pages are tried by the tests of what they do, too
@pytest.mark.parametrize("page", TOURS)
def test_the_tour_answers_what_it_shows(tmp_path, page):
    if shutil.which("curl") is None:
        pytest.skip("the tour is told with curl, which is not installed")
    scripts = re.findall(r'^```python(?: title="(\S+)")?\n(.*?)^```', text_of(page), flags=re.MULTILINE | re.DOTALL)
    for name, script in scripts:
        (tmp_path / (name or "encodings.py")).write_text(script, encoding="utf-8")
    (tmp_path / "replay_data").symlink_to(PROJECT_ROOT / "replay_data")
    (tmp_path / ".venv").symlink_to(sys.prefix)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with embedded_service(Settings(data_dir=tmp_path / "var", port=0)) as url:
        environment = os.environ | {
            "URL": url,
            "PATH": path,
            "NO_PROXY": "127.0.0.1",
            "PASSWORD": "of-anna-alone",
            "COLUMNS": "200",
        }
        for command, expected in examples_of_the_tour(page):
            answer = subprocess.run(
                ["bash", "-c", command],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                timeout=120,
                check=False,
            )
            assert answer.returncode == 0, f"{command}{answer.stderr}"
            got = cells_of(answer.stdout)
            assert doctest.OutputChecker().check_output(cells_of(expected), got, doctest.ELLIPSIS), f"{command}{got}"


#: Pages whose blocks of commands are run as they stand, one after the other in one folder, with a service.
RUN = ["how-to/models-and-sessions.md", "how-to/identify-joints.md", "how-to/calibrate.md"]
#: Why blocks of commands of other pages are not run here.
NOT_RUN = {
    "how-to/backup.md": "paths of a plant; test_backup.py runs both commands",
    "how-to/data.md": "a list of files",
    "how-to/explain.md": "minutes of search, one in a recording of the reader; test_cli_explain.py runs the command",
    "how-to/install.md": "containers",
    "how-to/maintenance.md": "an axis of a plant; test_maintenance.py sends the same requests",
    "how-to/mqtt.md": "a broker",
    "how-to/opcua.md": "a client that stays connected",
    "how-to/resonance-tests.md": "commands of a printer and a control; its files are read in test_resonance_tests.py",
    "how-to/retention.md": "a service that stays up, an axis of a plant",
    "how-to/several-services.md": "a database and a proxy",
}


def blocks_of(page: str) -> list[str]:
    """Return the blocks of a page that have no language, or are for a shell."""
    found = re.findall(r"^```(\w*)[^\n]*\n(.*?)^```$", text_of(page), flags=re.MULTILINE | re.DOTALL)
    return [block for language, block in found if language in ("", "sh")]


def test_every_block_of_commands_is_run_or_said_not_to_be():
    pages = [
        f"{folder}/{path.name}"
        for folder in ("tutorial", "how-to")
        for path in sorted((PROJECT_ROOT / "docs" / folder).glob("*.md"))
    ]
    with_blocks = {page for page in pages if blocks_of(page)}
    assert with_blocks - {*TOURS, *RUN} == set(NOT_RUN)
    for page in RUN:
        assert page in with_blocks


@pytest.mark.release
@pytest.mark.parametrize("page", RUN)
def test_blocks_of_commands_run(tmp_path, page):
    if shutil.which("curl") is None:
        pytest.skip("pages are told with curl, which is not installed")
    (tmp_path / "replay_data").symlink_to(PROJECT_ROOT / "replay_data")
    (tmp_path / ".venv").symlink_to(sys.prefix)
    with embedded_service(Settings(data_dir=tmp_path / "var", port=0)) as url:
        environment = os.environ | {"URL": url, "NO_PROXY": "127.0.0.1", "COLUMNS": "200"}
        for block in blocks_of(page):
            commands = "set -e\n" + block.replace("URL=http://127.0.0.1:8710; ", "")
            answer = subprocess.run(
                ["bash", "-c", commands], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600,
                check=False,
            )  # fmt: skip
            assert answer.returncode == 0, f"{block}{answer.stderr}"
            assert TYPE_PREFIX not in answer.stdout, f"{block}{answer.stdout}"


def test_the_tour_of_the_api_names_the_type_of_problems():
    assert TYPE_PREFIX in text_of("reference/http-api.md")
