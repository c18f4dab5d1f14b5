"""What users and newcomers read is in plain words; names in the code are the names of things."""

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

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


def messages(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the texts of what is raised or printed, with their lines, and the docstring of the module."""
    yield 1, ast.get_docstring(tree) or ""
    for node in ast.walk(tree):
        printed = isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in PRINTING
        if isinstance(node, ast.Raise) or printed:
            texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
            yield node.lineno, " ".join(text for text in texts if isinstance(text, str))


PRINTING = {"echo", "print_table", "BadParameter", "UsageError", "ClickException", "option", "argument"}


def strange_words(text: str) -> list[str]:
    flat = re.sub(r"\s+", " ", text)
    return [f"{found.group()!r}: {plain}" for word, plain in WORDS.items() if (found := re.search(word, flat))]


def test_messages_and_module_docstrings_are_in_plain_words() -> None:
    assert not [
        f"{path.relative_to(PROJECT_ROOT)}:{line} {words}"
        for path in sources("monitor_core", "service")
        for line, text in messages(ast.parse(path.read_text(encoding="utf-8")))
        if (words := strange_words(text))
    ]


def test_a_variable_is_called_by_what_it_is() -> None:
    assert not [
        f"{path.relative_to(PROJECT_ROOT)}:{line}"
        for path in sources("monitor_core", "service", "tests", "benchmarks")
        for line in lines_of_one(path)
    ]


def lines_of_one(path: Path) -> list[int]:
    """Return where a variable or an argument is called "one"."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = [(node.lineno, node.id) for node in nodes if isinstance(node, ast.Name)]
    names += [(node.lineno, node.arg) for node in nodes if isinstance(node, ast.arg)]
    return [line for line, name in names if name == "one"]


def product_modules() -> dict[str, ast.Module]:
    files = {path.relative_to(PROJECT_ROOT): path for path in sources("monitor_core", "service", "preload_client")}
    trees = {".".join(name.with_suffix("").parts): ast.parse(path.read_text("utf-8")) for name, path in files.items()}
    return {name.removesuffix(".__init__"): tree for name, tree in trees.items()}


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
    for name, tree in product_modules().items():
        summary, *rest = (ast.get_docstring(tree) or "").split("\n\n")
        assert "\n" not in summary, name
        assert not [paragraph for paragraph in rest if IMPERATIVE.match(paragraph)], name


def test_no_module_imports_itself_through_others() -> None:
    trees = product_modules()
    imports: dict[str, set[str]] = {}
    for name, tree in trees.items():
        nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
        named = {(f"{node.module}.{alias.name}", node.module) for node in nodes for alias in node.names}
        # a package lends what its modules define: who asks the package for a name does not import all of them
        imports[name] = {module if module in trees else package for module, package in named} & trees.keys() - {name}
    TopologicalSorter(imports).prepare()  # raises CycleError, with the circle


def test_the_list_finds_what_it_names() -> None:
    tree = ast.parse('"""What may be said of it."""\nraise ValueError(f"{path} is to be written here; {x} is none")\n')
    assert [len(strange_words(text)) for _, text in messages(tree)] == [1, 2]
