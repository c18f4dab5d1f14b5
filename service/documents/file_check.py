"""Lay out what ``check`` found in files: the result of a job of kind ``check``."""

from datetime import datetime
from typing import Final

from monitor_core.recordings.check import FileReport
from monitor_core.recordings.elements.fields import format_instant
from monitor_core.recordings.raw.inspection import ChannelSummary
from monitor_core.recordings.recognition import KINDS
from service.json_types import Json, JsonObject

_MOST_CHANNELS: Final = 200
_MOST_VALUES: Final = 500


def file_check_document(
    found: FileReport, problems: tuple[str, ...], *, lacks: str, channel_map: str | None
) -> JsonObject:
    """Lay it out; ``lacks``: what a calibration from it would need; ``channel_map``: the proposal, TOML, to fill in."""
    kind = KINDS.get(found.format)
    return {
        "format": found.format,
        "kind": found.format if kind is None else kind.what,
        "valid": found.valid and not problems,
        "problems": list(problems),
        "doubts": list(found.doubts),
        "contents": {name: json_fact(value, _MOST_VALUES) for name, value in found.contents},
        "channels": [_channel(channel) for channel in found.channels[:_MOST_CHANNELS]],
        "lacks_for_calibration": lacks or None,
        "map": channel_map,
    }


def _channel(channel: ChannelSummary) -> JsonObject:
    return {
        "name": channel.name,
        "shape": list(channel.shape),
        "unit": channel.unit,
        "sample_rate_hz": channel.sample_rate,
        "looks_like": None if channel.kind is None else str(channel.kind),
        "remarks": list(channel.remarks),
    }


def json_fact(value: object, most: int | None = None) -> Json:
    """Return a fact of a file as JSON has it; of many values the first ones."""
    if isinstance(value, tuple):
        return [json_fact(item) for item in value[:most]]
    if isinstance(value, datetime):
        return format_instant(value)
    return value if isinstance(value, (int, float)) else str(value)
