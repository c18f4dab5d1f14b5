"""A page in German has no English sentence: whatever the program says has a German form; what people wrote stays."""

import ast
import re
from collections import Counter
from html import unescape
from html.parser import HTMLParser

import pytest

from tests.browser.conftest import Site
from tests.conftest import PROJECT_ROOT
from tests.service.sentences import sentences_of

#: Where texts stand that people wrote, and names: those of the trial, and those that make the states.
_PEOPLE = ("service/operations/trial/trial.py", "service/operations/trial/story.py", "tests/browser/states.py")
#: Names (one of who did something without logging in, one of a page of the documentation), formulas and commands.
_NAMES = (
    r"Preload Monitor|preload [a-z]+ add( NAME --role administrator)?|PRELOAD_\w+|anyone on this machine"
    r"|keep and let go|µ·Δm.*1/f²"
)
#: Words that English sentences are made of and German ones are not.
_ENGLISH = re.compile(r"\b(the|of|is|and|with|are|has|been|from|which|than|its|to)\b")
#: Of pages that are alike in all but their number so many are looked at.
_MOST = 8


class Read(HTMLParser):
    """What a person reads of a page, where its links lead, and what it says is English."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.links: list[str] = []
        self.english = 0
        self._inside: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag not in ("input", "meta", "link", "br"):
            self._inside.append(tag)
        self.english += tag != "html" and given.get("lang") == "en"
        self.links += [given["href"] or ""] if tag == "a" and given.get("href") else []
        self.texts += [given[name] or "" for name in ("aria-label", "title", "placeholder", "alt") if given.get(name)]

    def handle_endtag(self, tag: str) -> None:
        if self._inside:
            self._inside.pop()

    def handle_data(self, data: str) -> None:
        if not {"code", "pre", "textarea", "style", "script"} & set(self._inside):
            self.texts.append(" ".join(data.split()))


def written_by_people() -> re.Pattern[str]:
    """Return what finds the texts that people wrote."""
    texts = {
        text for path in _PEOPLE for text in sentences_of(ast.parse((PROJECT_ROOT / path).read_text(encoding="utf-8")))
    }
    patterns = sorted((re.sub(r"\\{\d+\\}", ".*", re.escape(text)) for text in texts), key=len, reverse=True)
    return re.compile("|".join((*patterns, _NAMES)))


def english_on_german_pages(site: Site) -> dict[str, str]:
    """Return each text of a page that is English where German was asked for, with the page."""
    people, found = written_by_people(), dict[str, str]()
    ahead, seen, alike = ["/", "/alarms", "/system", "/axes/new", "/nothing", "/login"], set[str](), Counter[str]()
    while ahead:
        path = ahead.pop(0).split("#")[0]
        kind = re.sub(r"\d+", "N", path.partition("?")[0])
        if (
            path in seen
            or not path.startswith("/")
            or path.startswith(("/v1", "/static", "/docs"))
            or alike[kind] == _MOST
        ):
            continue
        seen.add(path)
        alike[kind] += 1
        english, german = (
            Read(site.api.http.get(path, headers={"accept": "text/html", "accept-language": language}).text)
            for language in ("en", "de")
        )
        ahead += english.links
        if german.english:
            found[f"{german.english} elements say that they are English"] = path
        for text in german.texts:
            own = people.sub("", unescape(text))
            same = own in english.texts and len(re.findall(r"[^\W\d_]{3,}", own)) > 2
            if same or _ENGLISH.search(own):
                found[text] = path
    assert len(seen) > 20
    return found


def test_an_axis_in_every_state_is_shown_in_german(served: Site) -> None:
    assert english_on_german_pages(served) == {}


@pytest.mark.release
def test_the_trial_is_shown_in_german(tried: Site) -> None:
    assert english_on_german_pages(tried) == {}
