"""The tutorial of the library does what it shows, from its face alone."""

import ast
import doctest
import json

import pytest

from monitor_core.arrays import Shown
from tests.conftest import PROJECT_ROOT


@pytest.mark.release
def test_the_tutorial_of_the_library_answers_what_it_shows(monkeypatch):
    monkeypatch.chdir(PROJECT_ROOT)
    text = (PROJECT_ROOT / "docs/tutorial/library.md").read_text(encoding="utf-8")
    examples = doctest.DocTestParser().get_doctest(text, {}, "library.md", "docs/tutorial/library.md", 0)
    result = doctest.DocTestRunner().run(examples)
    assert (result.attempted, result.failed) == (len(examples.examples), 0)
    assert len(examples.examples) > 15


@pytest.mark.release
def test_the_notebook_answers_what_it_shows(monkeypatch):
    """Run its cells one after the other; what one ends with is a value, of which the words are stored beside it."""
    monkeypatch.chdir(PROJECT_ROOT)
    cells = json.loads((PROJECT_ROOT / "docs/tutorial/notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    names, told = {}, 0
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        *steps, last = ast.parse("".join(cell["source"])).body
        exec(compile(ast.Module(steps, []), "notebook", "exec"), names)  # noqa: S102 - of this repository
        if not isinstance(last, ast.Expr):
            exec(compile(ast.Module([last], []), "notebook", "exec"), names)  # noqa: S102
            continue
        value = eval(compile(ast.Expression(last.value), "notebook", "eval"), names)  # noqa: S307
        if isinstance(value, Shown):
            [output] = cell["outputs"]
            assert repr(value) == "".join(output["data"]["text/plain"])
            assert value._repr_html_().count("<svg") == 1
            told += 1
    assert told == 4
