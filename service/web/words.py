"""Words of the pages: English in the templates, other languages in ``languages/*.po``, each read once.

A text is marked where it stands: ``_("…")`` or ``{% trans %}`` in a template, ``N_("…")`` in Python where it is chosen.
Sentences that the program writes in English, many of them stored, are found again by their templates (:func:`told`).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from gettext import GNUTranslations, NullTranslations
from io import BytesIO
from pathlib import Path
from typing import Final

from babel import Locale, UnknownLocaleError
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po
from markupsafe import Markup, escape

from service.documents.said import N_

LANGUAGES: Final = Path(__file__).parent / "languages"
#: Of the texts as they stand in the sources.
SOURCE: Final = "en"

#: What the codes of the service are called on pages, by their kind.
CALLED: Final[dict[str, dict[str, str]]] = {
    "state": {
        "alarm": N_("alarm"), "alert": N_("alert"), "unknown": N_("unknown"), "learning": N_("learning"),
        "normal": N_("normal"), "refused": N_("refused"), "doubt": N_("in doubt"), "not monitored": N_("not monitored"),
    },
    "reason": {
        "not-finite": N_("samples that are no numbers"), "clipped": N_("a channel is clipped"),
        "dead-channel": N_("a channel is dead"), "stuck-channel": N_("a channel is stuck"),
        "too-short": N_("too short"), "slow-length": N_("a length that takes too long to compute"),
        "sample-rate-mismatch": N_("another sample rate"), "length-mismatch": N_("another length"),
        "position-wraps": N_("a position that begins anew"),
        "position-span-too-wide": N_("the table moved too far"), "little-excitation": N_("too little excitation"),
        "outlying-window": N_("unlike the other windows"), "position-mismatch": N_("another position"),
        "clock-ahead": N_("a clock that is ahead"), "too-late": N_("arrived too late"),
        "too-few-averages": N_("too few windows"), "no-peak-in-band": N_("no mode in the band"),
        "low-coherence": N_("low coherence"), "wrong-phase": N_("wrong phase"), "ambiguous-modes": N_("several modes"),
        "uncertain-frequency": N_("frequency too uncertain"), "fit-failed": N_("no fit was found"),
        "excitation-source-mismatch": N_("another source of excitation"), "not-calibrated": N_("not calibrated"),
        "outside-calibration": N_("outside the calibration"), "moved-mass-mismatch": N_("another moved mass"),
        "damping-mismatch": N_("another damping"), "waveform-damaged": N_("stored samples are damaged"),
    },
    "quantity": {
        "lost-motion": N_("Lost motion over time"), "drag-torque": N_("Drag torque over time"),
        "screw-order": N_("Torque ripple, once in a turn of the screw"),
        "ball-pass-order": N_("Torque ripple, as balls pass the nut"),
    },
    "number": {
        "frequency": N_("Natural frequency"), "friction-torque": N_("Friction torque"),
        "damping-ratio": N_("Damping ratio"), "residue": N_("Residue"),
    },
    "work": {
        "lubricated": N_("lubricated"), "nut-replaced": N_("nut replaced"), "screw-replaced": N_("screw replaced"),
        "mounting": N_("mounting changed"), "other": N_("other work"),
    },
    "job": {
        "replay": N_("Replay of a session"), "rejudgement": N_("History judged anew"),
        "identification": N_("Joints identified"), "discrepancy": N_("Model compared with measurements"),
        "purge": N_("Waveforms let go"), "import": N_("Recording taken"), "check": N_("Recording looked into"),
        "calibration": N_("Calibration fitted"), "alarm-explanation": N_("Cause of an alarm"),
        "trial": N_("Trial axis made"),
    },
    "job status": {
        "queued": N_("waits"), "running": N_("at work"), "done": N_("done"), "failed": N_("failed"),
        "cancelled": N_("cancelled"),
    },
    "uncharted": {
        "preload-set": N_("preload was set on purpose"), "too-late": N_("arrived too late"),
        "waveform-gone": N_("its waveform is gone"),
        "not-comparable": N_("at a place, payload or temperature that nothing is known of yet"),
    },
    "entry": {
        "axis_id": N_("Axis"), "channel": N_("Channel"), "quantity": N_("Quantity"), "unit": N_("Unit"),
        "source": N_("Where it comes from"), "sensitivity": N_("Sensitivity"),
        "sensitivity_unit": N_("Unit of the sensitivity"),
        "column": N_("Column of the array"), "row": N_("Row of the array"), "lead_mm": N_("Way for a turn [mm]"),
        "format": N_("How the times are written"), "date": N_("Channel of the date"), "zone": N_("Time zone"),
        "started_at": N_("Begun"), "position_mm": N_("Position [mm]"), "preload_n": N_("Preload [N]"),
        "payload_kg": N_("Payload [kg]"), "temperature_c": N_("Temperature [°C]"),
        "position_span_mm": N_("Travel during a window [mm]"), "sample_rate_hz": N_("Sample rate [Hz]"),
        "samples_per_window": N_("Samples of a window"), "windows_in": N_("Windows stand in"),
        "window_interval_s": N_("From window to window [s]"), "file_interval_s": N_("From file to file [s]"),
        "measurement": N_("Name of the measurement"), "separator": N_("Between columns"), "decimal": N_("Decimal mark"),
        "header_row": N_("Row of the names"), "unit_row": N_("Row of the units"),
        "first_row": N_("First row of numbers"),
    },
    "choice": {
        "torque": N_("torque"), "force": N_("force"), "current": N_("current"), "acceleration": N_("acceleration"),
        "sensor": N_("measured by a sensor"), "drive": N_("from the current of the motor"),
        "commanded": N_("asked for by the control"), "rows": N_("rows"), "columns": N_("columns"),
    },
    "setting": {
        "name": N_("Name"), "false_alarms_per_year": N_("False alarms a year"),
        "silent_after_hours": N_("Silent after (hours)"), "windows_per_measurement": N_("Windows of a measurement"),
        "search_band_hz": N_("Search band"), "machine": N_("Machine"), "machine_place": N_("Place of the machine"),
        "commissioned_preload_n": N_("Commissioned preload"), "commissioned_at": N_("Put into service"),
        "drive_model": N_("Drive model"),
    },
}  # fmt: skip

#: Entries of a channel map that are one of a few.
CHOICES: Final = {
    "excitation.quantity": ("torque", "force", "current", "acceleration"),
    "excitation.source": ("sensor", "drive", "commanded"),
    "window.windows_in": ("rows", "columns"),
}


@dataclass(frozen=True, slots=True)
class Words:
    """A language that pages are written in: its texts, and how it writes numbers."""

    language: str
    locale: Locale
    texts: NullTranslations
    decimal: str  # mark in numbers

    def __call__(self, text: str) -> str:
        """Return a text in this language."""
        return self.texts.gettext(text)

    def marked(self, text: str, /, **values: object) -> Markup:
        """Return a text of a template, which may hold elements, with values in the places that it names."""
        return _marked(self.texts, text) % values if values else _marked_alone(self.texts, text)

    def told(self, sentence: str) -> Markup:
        """Return a sentence that was written in English; where no text of the catalogue is behind it, as it is."""
        if self.language == SOURCE:
            return escape(sentence)
        found = _told(self, sentence) or _told(self, sentence, names=True)
        return Markup('<span lang="en">{}</span>').format(sentence) if found is None else escape(found)

    def called(self, code: str, kind: str) -> Markup:
        """Return what a code is called; one that nobody has named stands as it is."""
        text = CALLED[kind].get(code)
        return escape(code) if text is None else self.marked(text)


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


@cache  # there are as many as the templates have
def _marked(texts: NullTranslations, text: str) -> Markup:
    return Markup(texts.gettext(text))  # noqa: S704 - as the template has it, or the catalogue


@cache
def _marked_alone(texts: NullTranslations, text: str) -> Markup:
    return _marked(texts, text) % {}


#: Where a value stands in a text: of sentences that are written at once, and of those that are put together.
_PLACE: Final = re.compile(r"%\((\w+)\)s|\{(\w+)[^{}]*\}")
#: What joins sentences and values, each known by itself.
_JOINTS: Final = {"; ": "; ", ", or ": N_(", or "), ", ": ", ", " and ": N_(" and "), " or ": N_(" or "), ". ": ". "}
_QUOTED: Final = re.compile(r"'[^']*'|\"[^\"]*\"|“[^”]*”")
#: Words that English sentences are made of, and names are not: with one, a value is no name, and would stay English.
_ENGLISH: Final = re.compile(
    r"\b(the|an|of|is|are|be|been|has|have|must|cannot|and|or|not|with|from|for|by|to|than|as|at|it|its|that|this|these"
    r"|which|what|where|each|every|one|but|there|got|expected)\b"
)
_DECIMAL: Final = re.compile(r"(?<![\w.])(\d+)\.(\d+)(?![\w.]*\d)")


@dataclass(frozen=True, slots=True)
class _Template:
    """A text with places, and what tells a sentence that was made of it."""

    longest: str  # of its pieces
    pattern: re.Pattern[str]
    names: tuple[str, ...]
    translated: str

    def filled(self, values: Sequence[str | None]) -> str:
        """Return the translated text with values in its places."""
        named = dict(zip(self.names, map(str, values), strict=True))
        return _PLACE.sub(lambda place: named[place[1] or place[2]], self.translated).replace("%%", "%")


@cache
def _catalogue(texts: NullTranslations) -> dict[str, str]:
    """Return all texts of a language, each with what it is in it."""
    every: dict[object, str] = getattr(texts, "_catalog", {})  # GNUTranslations has no other way to list them
    return {text: said for text, said in every.items() if isinstance(text, str) and text}


@cache
def _templates(texts: NullTranslations) -> tuple[_Template, ...]:
    """Return all texts with places, those that say most by themselves first."""
    found = []
    for text, translated in _catalogue(texts).items():
        if _PLACE.search(text):
            pieces = _PLACE.split(text.replace("%%", "%"))
            literal, names = pieces[::3], tuple(a or b for a, b in zip(pieces[1::3], pieces[2::3], strict=True))
            pattern = re.compile("(.*?)".join(map(re.escape, literal)), re.DOTALL)
            found.append((sum(map(len, literal)), _Template(max(literal, key=len), pattern, names, translated)))
    return tuple(template for _, template in sorted(found, key=lambda item: -item[0]))


@lru_cache(maxsize=4096)
def _told(words: Words, sentence: str, *, names: bool = False) -> str | None:
    """Return a sentence in another language by the text that it was made of; None if there is none.

    Its values may be sentences themselves; several may be joined, or follow the name of what they are about. With
    ``names`` a value may be what somebody called something, of several words.
    """
    if (text := _catalogue(words.texts).get(sentence)) is not None:
        return text
    if not re.search(r"[^\W\d_]{3}", sentence) and not _ENGLISH.search(sentence):  # numbers and units
        return _number(words, sentence)
    for joint, translated in _JOINTS.items():
        parts = sentence.split(joint) if joint in sentence else ()
        if parts and None not in (told := [_told(words, part) for part in parts]):
            return words(translated).join(filter(None, told))
    for template in _templates(words.texts):
        if template.longest in sentence and (match := template.pattern.fullmatch(sentence)):
            told = [_value(words, value, names=names) for value in match.groups()]
            if None not in told:
                return template.filled(told)
    head, mark, rest = sentence.partition(": ")
    said = _told(words, rest, names=names) if mark else None
    named = None if said is None else _value(words, head, names=True)
    return None if named is None else f"{named}{mark}{said}"


def _value(words: Words, value: str, *, names: bool) -> str | None:
    """Return a value of a sentence: in its language if it is one itself, else as a number or as somebody called it."""
    unquoted = _QUOTED.sub("", value)
    is_quoted = value[:1] in ("'", '"', "“")
    found = None if is_quoted else _told(words, value)
    is_name = is_quoted or names or " " not in value.strip()
    return value if found is None and is_name and not _ENGLISH.search(unquoted) else found


def _number(words: Words, text: str) -> str:
    return _DECIMAL.sub(rf"\1{words.decimal}\2", text)


@lru_cache(maxsize=256)
def words_for(accepted: str) -> Words:
    """Return the language that a browser likes best of those there are, by its ``Accept-Language``."""
    for tag in _by_preference(accepted):
        language = tag.partition("-")[0].lower()
        if language in (SOURCE, *_FILES):
            return _words(language, _locale(tag, language))
    return _words(SOURCE, Locale(SOURCE))


def _words(language: str, locale: Locale) -> Words:
    return Words(language, locale, _texts_of(language), locale.number_symbols["latn"]["decimal"])


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
