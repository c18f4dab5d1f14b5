"""The tutorial of the library does what it shows, from its face alone."""

import doctest

import pytest

from tests.conftest import PROJECT_ROOT


@pytest.mark.release
def test_the_tutorial_of_the_library_answers_what_it_shows(monkeypatch):
    monkeypatch.chdir(PROJECT_ROOT)
    text = (PROJECT_ROOT / "docs/tutorial/library.md").read_text(encoding="utf-8")
    examples = doctest.DocTestParser().get_doctest(text, {}, "library.md", "docs/tutorial/library.md", 0)
    result = doctest.DocTestRunner().run(examples)
    assert (result.attempted, result.failed) == (len(examples.examples), 0)
    assert len(examples.examples) > 15
