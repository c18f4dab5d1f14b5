"""All words of the pages are in the catalogues, each language has all of them, and numbers follow the language.

``python -m tests.service.test_words`` adds what is new in the sources to every language, untranslated.
"""

import ast
import re
from html.parser import HTMLParser

import pytest
from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.pofile import read_po, write_po

from service.documents.measurement import SHARES
from service.documents.said import Said
from service.web.shown import number, percent, say, with_interval
from service.web.site import environment
from service.web.words import LANGUAGES, words_for
from tests.conftest import PROJECT_ROOT
from tests.service.sentences import said_by_program, sentences_of

TEMPLATES = PROJECT_ROOT / "service" / "web" / "templates"
#: Drawn by a program of others, which has its own words.
OF_OTHERS = ("swagger.html",)
#: The name of the product, formula signs and units; the same in every language.
NAMES = r"Preload Monitor|POST|PUT|\bN\b|\bHz\b|\bmm\b|\bkg\b|N·m|°C"
ALL_LANGUAGES = sorted(path.stem for path in LANGUAGES.glob("*.po"))


def extracted() -> Catalog:
    """Return all texts that are marked in the sources."""
    catalog = Catalog(project="Preload Monitor", charset="utf-8")
    keywords = {"_": None, "N_": None, "Said": (1,), "gettext": None, "ngettext": (1, 2)}
    for folder in ("web", "documents"):
        found = extract_from_dir(
            PROJECT_ROOT / "service" / folder,
            method_map=[("**.py", "python"), ("**.html", "jinja2.ext:babel_extract")],
            options_map={"**.html": {"trimmed": "false", "silent": "false"}},
            keywords=keywords,
        )
        for name, _line, message, comments, context in found:
            catalog.add(message, locations=[(f"service/{folder}/{name}", 0)], auto_comments=comments, context=context)
    for text in SHARES.values():
        catalog.add(text, locations=[("service/documents/measurement.py", 0)])
    for text, written_in in said_by_program():
        catalog.add(text, locations=[(written_in, 0)])
    return catalog


def read(language: str) -> Catalog:
    with (LANGUAGES / f"{language}.po").open("rb") as file:
        return read_po(file, locale=language, abort_invalid=True)


def texts(catalog: Catalog) -> dict[str, str | tuple[str, ...]]:
    """Return what is said for each text, plural forms together."""
    return {
        message.id if isinstance(message.id, str) else message.id[0]: message.string
        for message in catalog
        if message.id
    }


@pytest.mark.parametrize("language", ALL_LANGUAGES)
def test_a_language_has_every_text_and_no_other(language: str) -> None:
    wanted, said = set(texts(extracted())), texts(read(language))
    assert set(said) == wanted
    empty = [
        text
        for text, translated in said.items()
        if not all([translated] if isinstance(translated, str) else translated)
    ]
    assert not empty
    assert not [message.id for message in read(language) if message.fuzzy and message.id]


def names(text: str) -> set[str]:
    return set(re.findall(r"%\((\w+)\)s|<(/?\w+)", text)) | set(re.findall(r"\{(\w+)[^{}]*\}", text))


@pytest.mark.parametrize("language", ALL_LANGUAGES)
def test_a_language_names_the_same_values_and_marks(language: str) -> None:
    for text, translated in texts(read(language)).items():
        for said in [translated] if isinstance(translated, str) else translated:
            assert names(said) == names(text), text


class Texts(HTMLParser):
    """Collects what a person reads of a page: texts, and attributes that are read out or shown."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value or "" for name, value in attrs if name in ("aria-label", "title", "placeholder", "alt")]

    def handle_data(self, data: str) -> None:
        self.found.append(data)


def outside_catalogue(source: str) -> list[str]:
    """Return the words of a template that no catalogue knows."""
    parts, depth, in_trans = [], 0, False
    for _line, kind, text in environment.lex(source):
        if kind in ("variable_begin", "block_begin", "comment_begin"):
            depth, code = depth + 1, []
        elif kind in ("variable_end", "block_end", "comment_end"):
            depth -= 1
            if kind == "block_end":
                in_trans = code[:1] == ["trans"] or (in_trans and code[:1] != ["endtrans"])
        elif depth:
            code += [text] if kind not in ("whitespace", "comment") else []
        elif kind == "data" and not in_trans:
            parts.append(text)
    parser = Texts()
    parser.feed("".join(parts))
    return [text.strip() for text in parser.found if re.search(r"[^\W\d_]{2,}", re.sub(NAMES, "", text))]


def test_no_word_of_a_template_is_outside_the_catalogue(subtests: pytest.Subtests) -> None:
    for path in sorted(TEMPLATES.glob("*.html")):
        with subtests.test(path=path):
            if path.name not in OF_OTHERS:
                assert not outside_catalogue(path.read_text(encoding="utf-8"))


def test_a_word_outside_is_found() -> None:
    source = '<p title="{{ _("a") }}">{% trans %}b{% endtrans %}<b title="said">{{ _("c") }} Forgotten</b></p>'
    assert outside_catalogue(source) == ["said", "Forgotten"]


@pytest.mark.parametrize(
    ("accepted", "language", "half"),
    [("de-DE,de;q=0.9,en;q=0.8", "de", "0,5"), ("de-CH", "de", "0.5"), ("en-US", "en", "0.5"), ("fr", "en", "0.5"),
     ("", "en", "0.5"), ("fr;q=0.9, de;q=0.2, en;q=0.1", "de", "0,5"), ("de;q=0, en", "en", "0.5"),
     ("de;q=x", "en", "0.5")],
)  # fmt: skip
def test_the_browser_chooses_the_language_and_how_numbers_are_written(accepted: str, language: str, half: str) -> None:
    words = words_for(accepted)
    assert (words.language, number(words, 0.5, 1)) == (language, half)


def test_values_have_the_digits_that_their_interval_warrants() -> None:
    words = words_for("de")
    assert with_interval(words, 177.264, (172.1, 182.4)) == ("177,3", "5,2")
    assert with_interval(words, 177.264, (176.9, 177.6)) == ("177,26", "0,35")
    assert with_interval(words, 177.264, (172.1, None)) == ("177", "")
    assert with_interval(words, None, None) == ("—", "")


def test_what_people_wrote_is_escaped_in_a_sentence() -> None:
    said = Said("%(who)s did it", {"who": "<script>"})
    assert str(say(words_for("en"), said)) == "&lt;script&gt; did it"


#: What may stand in a place.
VALUES = ("7.5", "Y-axis", "'x'")
#: Words that English sentences are made of and German ones are not.
ENGLISH = re.compile(r"\b(the|of|is|and|with|are|has|been|which|than|its|must|each|expected)\b")
PLACE = re.compile(r"%\(\w+\)s|\{[^{}]*\}")
#: German texts that name what is English: a page of the documentation.
ENGLISH_NAMES = re.compile("keep and let go")


def test_a_sentence_is_german_as_a_whole_or_english_as_a_whole() -> None:
    words = words_for("de")
    every = {text for path in (PROJECT_ROOT / "service", PROJECT_ROOT / "monitor_core") for file in path.rglob("*.py")
             for text in sentences_of(ast.parse(file.read_text(encoding="utf-8")))}  # fmt: skip
    every |= {"expected the reversal value and half of its interval", "the disk is full and the network is down"}
    said = {PLACE.sub(value, text): str(words.told(PLACE.sub(value, text))) for text in every for value in VALUES}
    translated = {sentence: german for sentence, german in said.items() if not german.startswith('<span lang="en">')}
    assert len(translated) > 1000
    assert not [german for german in translated.values() if ENGLISH.search(ENGLISH_NAMES.sub("", german))]


@pytest.mark.parametrize(
    ("english", "german"),
    [
        ("no axis 'a' is registered; register it with PUT /v1/axes/a",
         "keine Achse „a“ ist angelegt; anlegen mit PUT /v1/axes/a"),
        ("axis 'a' has no measurement 7", "Achse „a“: Messung 7 gibt es dort nicht"),
        ("there is no alarm 7", "Alarm 7 gibt es nicht"),
    ],
)  # fmt: skip
def test_what_is_not_there_is_said_in_german(english: str, german: str) -> None:
    assert words_for("de").told(english) == german


@pytest.mark.parametrize(
    ("share", "english", "german"),
    [
        (0.894, "89 %", "89 %"),
        (1.3e-17, "less than 0.01 %", "weniger als 0,01 %"),
        (0.0, "0 %", "0 %"),
        (1.01, "101 %", "101 %"),
    ],
)
def test_a_share_of_next_to_nothing_is_said_to_be_that(share: float, english: str, german: str) -> None:
    assert (percent(words_for("en"), share), percent(words_for("de"), share)) == (english, german)


if __name__ == "__main__":
    for each in ALL_LANGUAGES:
        updated = read(each)
        updated.update(extracted(), no_fuzzy_matching=True)
        updated.obsolete.clear()
        with (LANGUAGES / f"{each}.po").open("wb") as file:
            write_po(file, updated, width=120, no_location=True, sort_output=True, omit_header=False)
