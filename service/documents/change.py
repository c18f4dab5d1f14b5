"""Write what an alarm says of its cause: the change that explains it, or why none was looked for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING

from pydantic import TypeAdapter

from monitor_core.uncertainty import plus_minus
from service.clock import text_of
from service.documents.measurement import finite_or_null, members
from service.documents.said import N_
from service.json_types import JsonObject
from service.store.tables import MeasurementRow

if TYPE_CHECKING:
    from monitor_core.change import ChangeAttribution, TriedChange


class NotExamined(StrEnum):
    """Why the cause of an alarm was not examined."""

    NO_BASELINE = "no-baseline"
    NO_DRIVE_MODEL = "no-drive-model"
    TOO_FEW_POSITIONS = "too-few-places"
    NOT_YET = "not-yet"
    UNDER_WAY = "under-way"
    FAILED = "failed"
    REFUSED = "refused"
    CLOSED = "closed"
    LOST_MOTION = "lost-motion"


#: What is said of each; of too few positions, by how many there are.
_SENTENCES: dict[NotExamined, tuple[str, ...]] = {
    NotExamined.NO_BASELINE: (N_("cause not examined: there is no baseline yet to compare with"),),
    NotExamined.NO_DRIVE_MODEL: (N_("cause not examined: the axis has no drive model"),),
    NotExamined.TOO_FEW_POSITIONS: (
        N_("cause not examined yet: it takes measurements at three positions, and since the onset there are none"),
        N_("cause not examined yet: it takes measurements at three positions, and since the onset there is one"),
        N_("cause not examined yet: it takes measurements at three positions, and since the onset there are two"),
    ),
    NotExamined.NOT_YET: (N_("cause not examined yet"),),
    NotExamined.UNDER_WAY: (N_("the cause is being examined"),),
    NotExamined.FAILED: (N_("cause not examined: the last attempt failed"),),
    NotExamined.CLOSED: (N_("the cause was not examined as long as the alarm stood"),),
    NotExamined.LOST_MOTION: (N_("no cause is looked for: lost motion tells that motion is lost, not where"),),
}


def not_examined(reason: NotExamined, n_positions: int = 0) -> JsonObject:
    """Return what an alarm says whose cause was not examined."""
    sentences = _SENTENCES[reason]
    return {
        "examined": False, "reason": str(reason), "sentence": sentences[min(n_positions, len(sentences) - 1)],
        "recent": None,
    }  # fmt: skip


def refused_document(refusal: Exception, recent: Sequence[MeasurementRow]) -> JsonObject:
    """Return what an alarm says whose cause could not be examined."""
    return {
        "examined": False,
        "reason": str(NotExamined.REFUSED),
        "sentence": f"cause not examined: {refusal}",
        "recent": _measured(recent),
    }


def examined_document(
    attribution: "ChangeAttribution",
    at: datetime,
    reference: Sequence[MeasurementRow],
    recent: Sequence[MeasurementRow],
) -> JsonObject:
    """Return what an alarm says of its cause, with all that was tried and what it rests on."""
    return finite_or_null({
        "examined": True,
        "at": text_of(at),
        "sentence": attribution_sentence(attribution),
        **members(attribution, "outcome", "cause", "confidence", "equivalent_to", "gap_before", "gap_after"),
        "changes": [_change(change) for change in attribution.changes],
        "reference": _measured(reference),
        "recent": _measured(recent),
    })  # fmt: skip


@dataclass(frozen=True, slots=True)
class _RecentSide:
    n_measurements: int
    first_at: datetime


@dataclass(frozen=True, slots=True)
class StatedCause:
    """What is read again of what an alarm says of its cause."""

    examined: bool
    sentence: str
    recent: _RecentSide | None
    reason: NotExamined | None = None
    cause: str | None = None


_CAUSE = TypeAdapter(StatedCause)


def read_cause(document: JsonObject) -> StatedCause:
    """Return what an alarm says of its cause, as it is stored."""
    return _CAUSE.validate_python(document)


def _change(change: "TriedChange") -> dict[str, object]:
    return {
        "effect": change.key,
        "size": None if change.size is None else change.size.value,
        "size_standard_uncertainty": None if change.size is None else change.size.standard_uncertainty,
        **members(change, "cause", "probability", "unit", "delta_bic", "gap"),
        "sentence": change_sentence(change),
    }


def _measured(rows: Sequence[MeasurementRow]) -> JsonObject:
    return {
        "n_measurements": len(rows),
        "first_at": text_of(rows[0].started_at),
        "last_at": text_of(rows[-1].started_at),
    }


# --- sentences

#: Of each change by the key of its effect: a sentence, what less and more of it is called, and its units in one of SI.
_CHANGES = {
    "preload-change": ("the preload {change} by {size} N", "fell", "rose", 1.0),
    "added-mass": ("the table carries {size} kg {change}", "less", "more", 1.0),
    "position-offset": (
        "the table stands {size} mm {change} the fixed bearing than is stated", "nearer to", "further from", 1e3,
    ),
    "torque-delay": ("the response is recorded {size} ms {change} late against the torque", "less", "more", 1e3),
    "sensor-gain": ("the gain of the sensors {change} by {size} %", "fell", "rose", 100.0),
    "bearing-change": ("the fixed bearing {change} {size} % of its stiffness", "lost", "gained", 100.0),
    "far-bearing-change": ("the far bearing {change} {size} % of its stiffness", "lost", "gained", 100.0),
    "warming": ("the axis is {size} K {change}", "colder", "warmer", 1.0),
}  # fmt: skip
#: Whose size is ln of a ratio.
_RATIOS = frozenset({"bearing-change", "far-bearing-change"})


def attribution_sentence(attribution: "ChangeAttribution") -> str:
    """Return which change explains that an axis moved, how surely, and what else would."""
    likeliest = attribution.changes[0]
    if attribution.is_unknown:
        return (
            f"no single change explains it, {_percent(attribution.confidence)} confidence; the best, "
            f"{change_sentence(likeliest)}, leaves {likeliest.gap:.1f} times the noise"
        )
    if likeliest.size is None:
        return f"nothing has changed beyond the noise, {_percent(attribution.confidence)} confidence"
    parts = [f"{change_sentence(likeliest)} (95 %), {_percent(attribution.confidence)} confidence"]
    if attribution.look_alikes:
        parts.append("nearly alike: " + ", or ".join(map(change_sentence, attribution.look_alikes)))
    mentioned = {attribution.cause, *(change.cause for change in attribution.look_alikes)}
    rest = [
        each for each in attribution.changes if each.plausible and each.size is not None and each.cause not in mentioned
    ]
    if rest:
        causes = ", ".join(dict.fromkeys(str(change.cause) for change in rest))
        parts.append(f"{causes}: worse by ΔBIC ≥ {min(likeliest.delta_bic - change.delta_bic for change in rest):.0f}")
    if attribution.may_be_unknown:
        parts.append(f"none of these: {_percent(attribution.probability_of_unknown)}")
    return "; ".join(parts)


def change_sentence(change: "TriedChange") -> str:
    """Return what a change is, with the 95 % interval of its size."""
    if change.size is None:
        return "nothing has changed"
    text, less, more, per_unit = _CHANGES[change.key]
    size, half_width = change.size.value, 1.959964 * change.size.standard_uncertainty
    shown = abs(size)
    if change.key in _RATIOS:
        shown, half_width = abs(math.exp(size) - 1.0), math.exp(size) * half_width
    return text.format(change=less if size < 0.0 else more, size=plus_minus(per_unit * shown, per_unit * half_width))


def _percent(probability: float) -> str:
    return "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
