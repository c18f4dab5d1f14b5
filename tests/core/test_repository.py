"""What the repository says of itself is consistent: version, licence, authors, lock files."""

import re
import sys
import tomllib

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.conftest import PROJECT_ROOT

PROJECT = tomllib.loads((PROJECT_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def text_of(name: str) -> str:
    return (PROJECT_ROOT / name).read_text(encoding="utf-8")


def test_the_citation_names_the_version_the_licence_and_the_authors_of_the_package():
    lines = text_of("CITATION.cff").splitlines()
    assert f"version: {PROJECT['version']}" in lines
    assert f"license: {PROJECT['license']}" in lines
    for author in PROJECT["authors"]:
        assert f"  - name: {author['name']}" in lines


def test_the_licence_is_the_full_text_that_the_package_names():
    text = text_of("LICENSE")
    assert PROJECT["license"] == "Apache-2.0"
    assert PROJECT["license-files"] == ["LICENSE"]
    assert text.lstrip().startswith("Apache License")
    assert "END OF TERMS AND CONDITIONS" in text


def test_every_dependency_of_the_package_is_locked():
    def locked(name: str) -> set[str]:
        return {line.partition("==")[0] for line in text_of(name).splitlines() if "==" in line and line[0].isalnum()}

    def normalised(requirement: str) -> str:
        return requirement.partition(">=")[0].partition("[")[0].lower().replace("_", "-")

    everything, running = locked("requirements/dev.lock"), locked("requirements/runtime.lock")
    serving = locked("requirements/serve.lock")
    assert {normalised(requirement) for requirement in PROJECT["dependencies"]} <= serving <= running <= everything
    for extra in PROJECT["optional-dependencies"].values():
        assert {normalised(requirement) for requirement in extra} <= everything


def test_every_dependency_is_bounded_by_the_major_version_that_is_tested():
    tested = dict(re.findall(r"^([\w.-]+)==(\S+)", text_of("requirements/dev.lock"), flags=re.MULTILINE))
    extras = PROJECT["optional-dependencies"].items()
    of_users = [text for name, extra in extras if name not in {"bench", "docs", "dev"} for text in extra]
    for requirement in map(Requirement, [*PROJECT["dependencies"], *of_users]):
        version = Version(tested[canonicalize_name(requirement.name)])
        assert version in requirement.specifier
        assert Version(f"{version.major + 1}") not in requirement.specifier, requirement


def test_every_library_that_a_text_has_installed_is_one_that_is_locked():
    """The project is on no index: whoever is told to fetch it there gets an error today, a stranger's code later."""
    locked = set(re.findall(r"^([\w.-]+)==", text_of("requirements/dev.lock"), flags=re.MULTILINE))
    files = [*PROJECT_ROOT.glob("docs/**/*.md"), PROJECT_ROOT / "README.md"]
    files += [
        file for room in ("monitor_core", "service", "preload_client") for file in PROJECT_ROOT.glob(f"{room}/**/*.py")
    ]
    told = [
        word
        for file in files
        for words in re.findall(r"pip install ((?:[A-Za-z'][\w.\[\]'-]* ?)+)", file.read_text(encoding="utf-8"))
        for word in words.split()
    ]
    assert "paho-mqtt" in told
    assert sorted({word for word in told if canonicalize_name(word) not in locked}) == []


def test_the_changelog_has_forty_short_lines_at_most_for_each_version():
    versions = re.split(r"^## ", text_of("CHANGELOG.md"), flags=re.MULTILINE)[1:]
    names = [version.partition("\n")[0].split(" ")[0] for version in versions]
    assert names[0] == "Unreleased"
    assert PROJECT["version"] in names
    for version in versions:
        groups = re.split(r"^### ", version, flags=re.MULTILINE)[1:]
        assert {group.partition("\n")[0] for group in groups} <= {"Added", "Changed", "Removed", "Fixed"}
        lines = [line for line in version.splitlines() if line.strip()]
        assert len(lines) <= 40, lines[0]
        for line in lines:
            assert len(line.split()) <= 26, line  # twenty-five words behind the mark of the list
            assert not line.startswith(" "), line  # a change that goes on in a second line


def test_the_package_claims_the_python_that_runs_its_tests():
    claimed = {text.rpartition(" :: ")[2] for text in PROJECT["classifiers"] if "Python :: 3." in text}
    assert f"3.{sys.version_info.minor}" in claimed


def test_what_passes_between_layers_has_names():
    """A dictionary of anything hides from the type checker what its reader relies on."""
    modules = [path for package in ("monitor_core", "service") for path in (PROJECT_ROOT / package).rglob("*.py")]
    unnamed = re.compile(r"\b(dict|Mapping)\[str, Any\]")
    assert [str(path) for path in modules if unnamed.search(path.read_text(encoding="utf-8"))] == []
