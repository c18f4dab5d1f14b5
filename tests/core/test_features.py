"""The matrix of features names what is there: each tick has a test or a picture behind it."""

import ast
import re
from dataclasses import dataclass

import pytest

from tests.conftest import PROJECT_ROOT

PAGE = PROJECT_ROOT / "docs" / "explanation" / "features.md"


@dataclass(frozen=True)
class Feature:
    number: int
    product: str
    page: str
    shown_by: str


def features() -> list[Feature]:
    rows = [line.split(" | ") for line in PAGE.read_text(encoding="utf-8").splitlines() if re.match(r"\| \d", line)]
    return [Feature(int(row[0].lstrip("| ")), row[2], row[3], row[-1].rstrip(" |").strip("`")) for row in rows]


def test_there_are_36_and_most_are_there() -> None:
    found = features()
    assert [feature.number for feature in found] == list(range(1, 37))
    assert {feature.product for feature in found} <= {"yes", "partly", "no"}
    assert {feature.page for feature in found} <= {"yes", "partly", "no"}
    assert sum(feature.product == "yes" for feature in found) >= 33
    assert sum(feature.page == "yes" for feature in found) >= 30


def test_what_shows_it_exists(subtests: pytest.Subtests) -> None:
    for feature in features():
        with subtests.test(feature=feature):
            path, _, name = feature.shown_by.partition("::")
            assert (PROJECT_ROOT / path).is_file(), path
            if name:
                body = ast.parse((PROJECT_ROOT / path).read_text(encoding="utf-8")).body
                assert name in {node.name for node in body if isinstance(node, ast.FunctionDef)}, feature.shown_by
