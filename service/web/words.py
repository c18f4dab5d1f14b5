"""Words of the pages: English in the templates, other languages in ``languages/*.po``, each read once.

A text is marked where it stands: ``_("…")`` or ``{% trans %}`` in a template, ``N_("…")`` in Python where it is chosen.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from gettext import GNUTranslations, NullTranslations
from io import BytesIO
from pathlib import Path
from typing import Final

from babel import Locale, UnknownLocaleError
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po

LANGUAGES: Final = Path(__file__).parent / "languages"
#: Of the texts as they stand in the sources.
SOURCE: Final = "en"


@dataclass(frozen=True, slots=True)
class Words:
    """A language that pages are written in: its texts, and how it writes numbers."""

    language: str
    locale: Locale
    texts: NullTranslations

    def __call__(self, text: str) -> str:
        """Return a text in this language."""
        return self.texts.gettext(text)


_FILES: Final = {path.stem: path for path in LANGUAGES.glob("*.po")}


@cache
def _texts_of(language: str) -> NullTranslations:
    """Return the texts of a language, read for its first page."""
    if language == SOURCE:
        return NullTranslations()
    compiled = BytesIO()
    with _FILES[language].open("rb") as file:
        write_mo(compiled, read_po(file, locale=language, abort_invalid=True))
    compiled.seek(0)
    return GNUTranslations(compiled)


@lru_cache(maxsize=256)
def words_for(accepted: str) -> Words:
    """Return the language that a browser likes best of those there are, by its ``Accept-Language``."""
    for tag in _by_preference(accepted):
        language = tag.partition("-")[0].lower()
        if language in (SOURCE, *_FILES):
            return Words(language, _locale(tag, language), _texts_of(language))
    return Words(SOURCE, Locale(SOURCE), _texts_of(SOURCE))


def _locale(tag: str, language: str) -> Locale:
    try:
        return Locale.parse(tag, sep="-")
    except (UnknownLocaleError, ValueError):
        return Locale(language)


def _by_preference(accepted: str) -> list[str]:
    ranked = []
    for part in accepted[:200].split(","):
        tag, _, quality = part.strip().partition(";q=")
        try:
            ranked.append((float(quality or 1.0), tag))
        except ValueError:
            continue
    return [tag for quality, tag in sorted(ranked, key=lambda item: -item[0]) if quality > 0.0 and tag]
