"""Find every sentence that the program writes in English and that a page may show: texts, and places for values.

A sentence is told by its form: words with blanks between them. Whatever is put together of pieces is one text, whose
values are numbered: ``f"{a} is not {b}"`` is "{0} is not {1}".
"""

import ast
import re
import tomllib
from collections.abc import Iterator

from monitor_core.change.changes import Cause
from monitor_core.identification.identifiability import Verdict
from monitor_core.preload.witnesses import WitnessName
from monitor_core.recording import ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.recordings.elements.units import Quantity
from monitor_core.recordings.raw.mapping.map_records import MapKind
from monitor_core.uncertainty import IntervalKind
from tests.conftest import PROJECT_ROOT

#: Where sentences of pages are written.
WRITES: tuple[str, ...] = (
    "monitor_core", "service/documents", "service/operations", "service/errors.py", "service/jobs.py", "service/api",
    "service/store/alarms.py", "service/store/axes.py", "service/store/jobs.py", "service/store/lookup.py",
)  # fmt: skip
#: What is written there and reaches no page: the report of `explain` and what it is made of, code that is generated,
#: models that commands alone fit, bodies and tables of programs, and what people of the trial say.
ELSEWHERE: tuple[str, ...] = (
    "monitor_core/__init__.py", "monitor_core/cross_checks.py", "monitor_core/discrepancy", "monitor_core/effects",
    "monitor_core/fitting", "monitor_core/models/extended", "monitor_core/models/generator",
    "monitor_core/models/published", "monitor_core/recordings/effect_file.py", "monitor_core/shown.py",
    "service/api/health.py",
    "service/api/http/body.py", "service/api/http/observer.py", "service/api/http/samples.py",
    "service/api/http/tables.py", "service/api/trend_points.py", "service/api/windows.py",
    "service/documents/explanation_sentences.py", "service/operations/notices", "service/operations/trial",
)  # fmt: skip
#: Calls and arguments whose texts are for a program, a log, the description of the API, or who wrote the program.
_NOT_SAID = frozenset({
    "AssertionError", "TypeError", "Field", "debug", "info", "warning", "error", "exception", "compile", "text",
    "mapped_column", "APIRouter", "Query", "Body", "Header", "ConfigDict", "AttributeError", "cast", "removeprefix",
    "N_", "Said",
    "__repr__", "_panels", "description", "examples", "openapi_examples", "responses", "summary",
})  # fmt: skip
#: What has blanks and is no sentence: commands, elements, headers.
_NO_SENTENCE = re.compile(r"<|--|`?preload [a-z]+ [{A-Z-]|(user|key) [a-z]+|default-src |attachment;")
#: Words that stand in sentences as their values.
_KINDS = (
    Cause, ExcitationQuantity, ExcitationSource, IntervalKind, MapKind, Quantity, ResponseQuantity,
    Verdict, WitnessName,
)  # fmt: skip
_WORDS = (
    "95 % coverage", "colder", "confidence", "failed", "falls", "fell", "frequency", "gain", "gained", "less",
    "lost", "loss", "more", "rises", "rose", "the peak at {0} Hz at {1} mm", "warmer",
)  # fmt: skip
_SQL = re.compile(r"\b(SELECT|INSERT|UPDATE|CREATE|DELETE|PRAGMA|DROP|ALTER)\b")


def said_by_program() -> Iterator[tuple[str, str]]:
    """Yield each sentence with the file that writes it."""
    for root in WRITES:
        path = PROJECT_ROOT / root
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            name = str(file.relative_to(PROJECT_ROOT))
            if not name.startswith(ELSEWHERE):
                yield from ((text, name) for text in sentences_of(ast.parse(file.read_text(encoding="utf-8"))))
    values = {str(member) for kind in _KINDS for member in kind}
    for value in sorted(values | {value.replace("-", " ") for value in values} | set(_WORDS)):
        yield value, "values of sentences"
    advice = PROJECT_ROOT / "service/operations/advice.toml"
    for codes in tomllib.loads(advice.read_text(encoding="utf-8")).values():
        for entry in codes.values():
            looks = [look[name] for look in entry["look"] for name in ("cause", "effect", "check", "tool")]
            yield from ((text, advice.name) for text in (entry["says"], *looks))


def sentences_of(node: ast.AST) -> Iterator[str]:
    """Yield the sentences of a part of a program; docstrings, annotations and keys are none."""
    match node:
        case ast.Expr(value=ast.Constant()):
            return
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in _NOT_SAID:
            return
        case ast.keyword(arg=name) if name in _NOT_SAID:
            return
        case ast.AnnAssign():
            inside: list[ast.AST] = [node.value] if node.value is not None else []
        case ast.FunctionDef(name=name) if name in _NOT_SAID:
            return
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            inside = list(node.body)
        case ast.Dict():
            inside = list(node.values)
        case _:
            inside = list(ast.iter_child_nodes(node))
    if (pieces := _pieces(node)) is not None:
        inside = [piece for piece in pieces if not isinstance(piece, str)]
        numbered = iter(range(len(inside)))
        text = "".join(piece if isinstance(piece, str) else f"{{{next(numbered)}}}" for piece in pieces)
        if _is_sentence(text):
            yield text
    for part in inside:
        yield from sentences_of(part)


def _pieces(node: ast.AST) -> list[str | ast.AST] | None:
    """Return texts and values that a string is made of; None if it is no string."""
    match node:
        case ast.Constant(value=str(text)):
            return [text]
        case ast.JoinedStr():
            return [
                value.value if isinstance(value, ast.FormattedValue) else str(ast.literal_eval(value))
                for value in node.values
            ]
        case ast.BinOp(op=ast.Add()):
            sides = [_pieces(side) or [side] for side in (node.left, node.right)]
            together = [*sides[0], *sides[1]]
            return together if any(isinstance(piece, str) for piece in together) else None
    return None


def _is_sentence(text: str) -> bool:
    words, n_places = re.subn(r"%\(\w+\)s|\{[^{}]*\}", " ", text)
    is_one = " " in text.strip() and "\n" not in text and not _NO_SENTENCE.match(text)
    return is_one and len(re.findall(r"[^\W\d_]{2,}", words)) > (n_places == 0) and not _SQL.search(words)
