"""Lay out what ``check`` found in files: the result of a job of kind ``check``."""

from dataclasses import asdict
from datetime import datetime
from typing import Final

from monitor_core.recordings.check import FileReport
from monitor_core.recordings.elements.fields import format_instant
from monitor_core.recordings.raw.inspection import ChannelSummary
from monitor_core.recordings.raw.proposal.entries import MapProposal
from monitor_core.recordings.raw.proposal.file_facts import FileFacts
from monitor_core.recordings.recognition import KINDS
from service.documents.map_form import map_fields
from service.documents.measurement import finite_or_null, members
from service.json_types import Json, JsonObject

_MOST_CHANNELS: Final = 200
_MOST_VALUES: Final = 500


def file_check_document(
    report: FileReport, problems: tuple[str, ...], *, lacks: str, proposal: MapProposal | None,
    files: tuple[FileFacts, ...] = (),
) -> JsonObject:  # fmt: skip
    """Lay it out; ``lacks``: what a calibration from it would need; ``proposal``: a channel map, to fill in.

    ``files``: what each of several seems to be measured under.
    """
    kind = KINDS.get(report.format)
    return {
        "format": report.format,
        "kind": report.format if kind is None else kind.what,
        "valid": report.valid and not problems,
        "problems": list(problems),
        "doubts": list(report.doubts),
        "contents": {name: json_fact(value, _MOST_VALUES) for name, value in report.contents},
        "channels": [_channel(channel) for channel in report.channels[:_MOST_CHANNELS]],
        "lacks_for_calibration": lacks or None,
        "map": None if proposal is None else proposal.toml(),
        "files": [asdict(facts) for facts in files],
        "map_form": None if proposal is None else [asdict(table) for table in map_fields(proposal)],
    }


def _channel(channel: ChannelSummary) -> JsonObject:
    named = members(channel, "name", "shape", "unit", "remarks")
    return finite_or_null({**named, "sample_rate_hz": channel.sample_rate, "looks_like": channel.kind})


def json_fact(value: object, most: int | None = None) -> Json:
    """Return a fact of a file as JSON has it; of many values the first ones."""
    if isinstance(value, tuple):
        return [json_fact(item) for item in value[:most]]
    if isinstance(value, datetime):
        return format_instant(value)
    return value if isinstance(value, (int, float)) else str(value)
