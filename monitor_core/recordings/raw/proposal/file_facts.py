"""Propose what each of several raw files was measured under: by its name, and by what stands in it."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from monitor_core.recordings.elements.files import stem_of
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.proposal.entries import MapProposal

_NUMBER = r"(\d+(?:[.,]\d+)?)"
#: By which words and units names of files, and of single numbers in them, say a condition, in small. A letter alone
#: says a place; p or f may be a part or a feed, and say a preload by its unit only.
_WORDS = {
    "preload_n": (r"preload|vorspannung|vorspannkraft", "n"),
    "payload_kg": (r"payload|load|nutzlast|zuladung", "kg"),
    "position_mm": (r"position|pos|[xyz]", "mm"),
}
_IN_NAME = {
    name: re.compile(
        rf"(?<![a-z0-9.,])[pf]?{_NUMBER}[ _]?{unit}(?![a-z0-9])"
        rf"|(?<![a-z])(?:{words})[ _=-]?{_NUMBER}(?![0-9]|[.,][0-9])"
    )
    for name, (words, unit) in _WORDS.items()
}
_DATED = re.compile(
    r"(?<!\d)(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?:[ tT_-]*(\d\d)[-_:.hH]?(\d\d)(?:[-_:.mM]?(\d\d))?)?(?!\d)"
)


@dataclass(frozen=True, slots=True)
class FileFacts:
    """What one of several files seems to be measured under; None where nothing says it."""

    name: str
    preload_n: float | None
    payload_kg: float | None
    position_mm: float | None
    started_at: str | None  # by the name of the file, date and time without a zone
    states_start: bool  # the file itself says when it begins


def file_facts(name: str, channels: Channels | None = None, proposal: MapProposal | None = None) -> FileFacts:
    """Return what a file seems to be measured under, by its name, its channels and the map proposed for them.

    >>> file_facts("2025-03-01T06-30 100N_x250.csv")  # doctest: +NORMALIZE_WHITESPACE
    FileFacts(name='2025-03-01T06-30 100N_x250.csv', preload_n=100.0, payload_kg=None, position_mm=250.0,
    started_at='2025-03-01T06:30', states_start=False)
    """
    stem = stem_of(name) or name
    rest = _DATED.sub(" ", stem).lower()
    stated = {} if channels is None else dict(_in_file(channels))
    values = {fact: stated.get(fact, _first(pattern, rest)) for fact, pattern in _IN_NAME.items()}
    states_start = proposal is not None and not proposal.asks_for_start
    return FileFacts(name, **values, started_at=None if states_start else _moment(stem), states_start=states_start)


def _first(pattern: re.Pattern[str], text: str) -> float | None:
    match = pattern.search(text)
    return None if match is None else float((match[1] or match[2]).replace(",", "."))


def _in_file(channels: Channels) -> Iterator[tuple[str, float]]:
    """Yield what single numbers of the file say, by their names: whole words, and the unit if they have one."""
    for name, value in channels.numbers.items():
        word, _, unit = name.lower().partition("[")
        for fact, (words, its_unit) in _WORDS.items():
            if re.fullmatch(words, word.strip()) and unit.strip(" ]") in ("", its_unit):
                yield fact, value


def _moment(stem: str) -> str | None:
    match = _DATED.search(stem)
    if match is None or match[4] is None:
        return None
    try:
        moment = datetime(*(int(part or 0) for part in match.groups()))  # type: ignore[arg-type]  # noqa: DTZ001 - the visitor's zone
    except ValueError:
        return None
    return moment.isoformat(timespec="minutes" if match[6] is None else "seconds")
