"""What users and newcomers read is in plain words; names in the code are the names of things."""

import ast
import re
import symtable
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

from tests.conftest import PROJECT_ROOT


def sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (PROJECT_ROOT / folder).rglob("*.py"))


#: Turns of phrase that a reader stumbles over, each with the plain words to write.
WORDS = {
    r"\b(tell|tells|told) (\w+ )?apart\b": "distinguish",
    r"\bbeside\b": "besides, with",
    r"\b(there (is|are)|is|are) none\b": "say what is missing",
    r"\bgot not\b": "say what was got",
    r"\bis to be written\b": "cannot write",
    r"\bpart(s)? from\b": "differ",
    r"\bmay be said\b": "say what is returned",
    r"\bthat there (is|are)\b": "leave it out",
    r"\bin (its|the) (eyes|place) of\b": "instead of, according to",
    r"\b(yardstick|twin|twins|leader|promise|whereof|wherein|hence|lest|shy)\b": "the word of the nomenclature",
    r"\bas against\b": "compared with",
    r"\bworth of\b": "say how much",
    r"\bof its own right\b": "leave it out",
}


class Module(NamedTuple):
    """What is looked at in a module."""

    docstring: str
    messages: tuple[tuple[int, str], ...]  # what is raised or printed, with its lines
    imports: tuple[tuple[str, str], ...]  # name of what is imported, and where from


@cache
def module_at(path: Path) -> Module:
    return read_module(path.read_text(encoding="utf-8"))


def read_module(text: str) -> Module:
    tree = ast.parse(text)
    said, imports = [], []
    for node in ast.walk(tree):
        printed = isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in PRINTING
        if isinstance(node, ast.Raise) or printed:
            texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
            said.append((node.lineno, " ".join(text for text in texts if isinstance(text, str))))
        if isinstance(node, ast.ImportFrom) and node.module:
            imports += [(f"{node.module}.{alias.name}", node.module) for alias in node.names]
    return Module(ast.get_docstring(tree) or "", tuple(said), tuple(imports))


PRINTING = {"echo", "print_table", "BadParameter", "UsageError", "ClickException", "option", "argument"}


def strange_words(text: str) -> list[str]:
    flat = re.sub(r"\s+", " ", text)
    return [f"{found.group()!r}: {plain}" for word, plain in WORDS.items() if (found := re.search(word, flat))]


def test_messages_and_module_docstrings_are_in_plain_words() -> None:
    assert not [
        f"{path.relative_to(PROJECT_ROOT)}:{line} {words}"
        for path in sources("monitor_core", "service")
        for module in [module_at(path)]
        for line, text in ((1, module.docstring), *module.messages)
        if (words := strange_words(text))
    ]


def test_a_variable_is_called_by_what_it_is() -> None:
    assert not [
        f"{path.relative_to(PROJECT_ROOT)}:{line}"
        for path in sources("monitor_core", "service", "tests", "benchmarks")
        for line in scopes_of_one(symtable.symtable(path.read_text(encoding="utf-8"), str(path), "exec"))
    ]


def scopes_of_one(scope: symtable.SymbolTable) -> list[int]:
    """Return where something begins that calls a variable or an argument "one"."""
    own = [scope.get_lineno()] if "one" in scope.get_identifiers() else []
    return own + [line for inner in scope.get_children() for line in scopes_of_one(inner)]


def product_modules() -> dict[str, Module]:
    files = {path.relative_to(PROJECT_ROOT): path for path in sources("monitor_core", "service", "preload_client")}
    modules = {".".join(name.with_suffix("").parts): module_at(path) for name, path in files.items()}
    return {name.removesuffix(".__init__"): module for name, module in modules.items()}


#: A summary begins with one of these; a paragraph after it that does, too, is the summary of something else.
IMPERATIVE = re.compile(
    r"(Add|Answer|Arrange|Ask|Assign|Average|Build|Check|Choose|Collect|Compare|Compute|Convert|Copy|Count|Decide|"
    r"Define|Derive|Describe|Differentiate|Draw|Estimate|Evaluate|Explain|Find|Fit|Free|Give|Group|Guard|Hold|"
    r"Identify|Integrate|Join|Judge|Keep|Learn|Lay|List|Locate|Look|Make|Measure|Model|Name|Parse|Place|Plan|Pose|"
    r"Predict|Prepare|Print|Propose|Put|Query|Read|Recognise|Record|Records|Refuse|Remember|Replace|Report|Run|Say|"
    r"Screen|Search|Send|Serve|Show|Simulate|Solve|Sort|Start|State|Step|Stop|Store|Take|Tell|Test|Trace|Try|Turn|"
    r"Weigh|Write)\b"
)


def test_the_docstring_of_a_module_says_one_thing() -> None:
    for name, module in product_modules().items():
        summary, *rest = module.docstring.split("\n\n")
        assert "\n" not in summary, name
        assert not [paragraph for paragraph in rest if IMPERATIVE.match(paragraph)], name


def test_no_module_imports_itself_through_others() -> None:
    modules = product_modules()
    # a package lends what its modules define: who asks the package for a name does not import all of them
    imports = {
        name: {thing if thing in modules else source for thing, source in module.imports} & modules.keys() - {name}
        for name, module in modules.items()
    }
    TopologicalSorter(imports).prepare()  # raises CycleError, with the circle


def test_the_list_finds_what_it_names() -> None:
    module = read_module(
        '"""What may be said of it."""\nraise ValueError(f"{path} is to be written here; {x} is none")\n'
    )
    assert len(strange_words(module.docstring)) == 1
    assert [len(strange_words(text)) for _, text in module.messages] == [2]
