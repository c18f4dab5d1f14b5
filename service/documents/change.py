"""Write what an alarm says of its cause: the change that explains it, or why none was looked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING

from pydantic import TypeAdapter

from service.clock import text_of
from service.documents.measurement import finite_or_null
from service.json_types import JsonObject
from service.store.tables import MeasurementRow

if TYPE_CHECKING:
    from monitor_core.change import ChangeAttribution, TriedChange


class NotExamined(StrEnum):
    """Why the cause of an alarm was not examined."""

    NO_DRIVE_MODEL = "no-drive-model"
    TOO_FEW_POSITIONS = "too-few-places"
    REFUSED = "refused"


_SENTENCES = {
    NotExamined.NO_DRIVE_MODEL: "cause not examined: the axis has no drive model",
    NotExamined.TOO_FEW_POSITIONS: "cause not examined yet: it takes measurements at three positions since the onset",
}


def not_examined_yet(configuration: JsonObject) -> JsonObject:
    """Return what an alarm says when it is raised on an axis of this configuration."""
    has_model = configuration.get("drive_model") is not None
    reason = NotExamined.TOO_FEW_POSITIONS if has_model else NotExamined.NO_DRIVE_MODEL
    return {"examined": False, "reason": str(reason), "sentence": _SENTENCES[reason], "recent": None}


def refused_document(refusal: Exception, recent: Sequence[MeasurementRow]) -> JsonObject:
    """Return what an alarm says whose cause could not be examined."""
    return {
        "examined": False,
        "reason": str(NotExamined.REFUSED),
        "sentence": f"cause not examined: {refusal}",
        "recent": _measured(recent),
    }


def examined_document(
    found: "ChangeAttribution", at: datetime, reference: Sequence[MeasurementRow], recent: Sequence[MeasurementRow]
) -> JsonObject:
    """Return what an alarm says of its cause, with all that was tried and what it rests on."""
    return finite_or_null({
        "examined": True,
        "at": text_of(at),
        "outcome": str(found.outcome),
        "cause": str(found.cause),
        "confidence": found.confidence,
        "sentence": found.sentence,
        "equivalent_to": [str(cause) for cause in found.equivalent_to],
        "gap_before": float(found.gap_before),
        "gap_after": float(found.gap_after),
        "changes": [_change(change) for change in found.changes],
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


_CAUSE = TypeAdapter(StatedCause)


def read_cause(document: JsonObject) -> StatedCause:
    """Return what an alarm says of its cause, as it is stored."""
    return _CAUSE.validate_python(document)


def _change(change: "TriedChange") -> JsonObject:
    return {
        "cause": str(change.cause),
        "effect": change.key,
        "probability": change.probability,
        "size": None if change.size is None else float(change.size.value),
        "size_standard_uncertainty": None if change.size is None else float(change.size.standard_uncertainty),
        "unit": change.unit,
        "delta_bic": float(change.delta_bic),
        "gap": float(change.gap),
        "sentence": change.words,
    }


def _measured(rows: Sequence[MeasurementRow]) -> JsonObject:
    return {
        "n_measurements": len(rows),
        "first_at": text_of(rows[0].started_at),
        "last_at": text_of(rows[-1].started_at),
    }
