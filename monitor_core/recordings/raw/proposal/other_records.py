"""Propose the entries of a motion record, and of lines of a frequency response."""

from collections.abc import Iterator, Sequence

from monitor_core.recordings.elements.units import Quantity, canonical_unit
from monitor_core.recordings.raw.channel_kind import ChannelKind
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.proposal.entries import CONFIRM, blank, channel_lines, entry, plain, printed
from monitor_core.recordings.raw.proposal.parts import Part, first_like, quantity_of
from monitor_core.recordings.raw.proposal.sampling import rate_line, rate_of_numbers, time_lines
from monitor_core.recordings.raw.text.text_times import TextTimes


def motion_lines(parts: Sequence[Part], texts: TextTimes | None, channels: Channels) -> Iterator[str]:
    """Yield the entries of a motion record: drive, position, commanded position, and when they were sampled."""
    drive = first_like(parts, (ChannelKind.FORCE, ChannelKind.TORQUE))
    position = first_like(parts, (ChannelKind.POSITION,), (drive,))
    others = [part for part in parts if part.kind is ChannelKind.POSITION and part is not position]
    times = first_like(parts, (ChannelKind.TIME,)) or texts
    signals = [part for part in (drive, position) if part is not None]
    yield ""
    yield "# position and drive without an acceleration: a motion record, for preload explain (family motion)"
    yield "[motion]"
    if times is None and not any(part.channel.sample_rate for part in signals):
        yield rate_line(rate_of_numbers(channels))
    yield "[motion.position]"
    yield from channel_lines(position, Quantity.POSITION, parts)
    quantity = quantity_of(drive) or Quantity.FORCE
    yield f"[motion.{quantity}]"
    yield from channel_lines(drive, quantity, parts)
    if others:
        yield "[motion.reference]                     # the position that was commanded; may be left out"
        yield from channel_lines(others[0], Quantity.POSITION, parts)
    yield from time_lines(times, signals)


def frf_lines(channels: Channels, parts: Sequence[Part]) -> Iterator[str]:
    """Yield the entries of a frequency response: one of the file, or columns of its lines."""
    yield ""
    yield "# lines of a frequency response: a set of them, for preload identify and preload explain"
    yield "[frf]"
    yield blank("input", '"torque-at-screw" | "torque-at-motor" | "force-at-table"')
    yield blank(
        "output", '"acceleration-at-table" | "acceleration-at-nut" | "displacement-at-table" | "angle-at-motor"'
    )
    yield blank("standard_deviation", "of real and imaginary part, in the unit of the response; or relative = 0.01")
    if channels.responses:
        response = channels.responses[0]
        names = ", ".join(printed(other.name) for other in channels.responses[1:5])
        yield "[frf.response]"
        yield entry("channel", printed(response.name), f"{CONFIRM} a frequency response{names and f'; also {names}'}")
        above, below = canonical_unit(response.response_unit), canonical_unit(response.reference_unit)
        if above is None or below is None:
            yield blank("unit", f"unit of the response, such as m/(N.s2); the file says {_ratio(channels)}")
        else:
            yield entry("unit", printed(f"{above}/{below}"), f"{CONFIRM} as the file says: {_ratio(channels)}")
    else:
        yield from _columns_of_response(parts)
    yield ""
    yield "[window]"
    yield blank("position_mm", "where the table stood, in mm from the fixed bearing")
    yield "# preload_n = 300                      # optional: only where it was set on purpose"


def _ratio(channels: Channels) -> str:
    response = channels.responses[0]
    return f"{plain(response.response_unit or 'nothing')} per {plain(response.reference_unit or 'nothing')}"


def _columns_of_response(parts: Sequence[Part]) -> Iterator[str]:
    lines = next(part for part in parts if part.kind is ChannelKind.FREQUENCY)
    rest = [part for part in parts if part is not lines]
    yield "[frf.frequency]"
    yield entry("channel", printed(lines.channel.name), f"{CONFIRM} frequency-like")
    yield entry("unit", printed("Hz"), f"{CONFIRM} unit of the lines")
    names = [part.channel.name.lower() for part in rest]
    by_phase = any(name.startswith(("mag", "amp", "abs", "phase", "ang")) for name in names)
    roles = (("magnitude", ("mag", "amp", "abs")), ("phase", ("phase", "ang"))) if by_phase else (
        ("real", ("re",)), ("imaginary", ("im",)),
    )  # fmt: skip
    for role, beginnings in roles:
        named = next((part for part in rest if part.channel.name.lower().startswith(beginnings)), None)
        part = named or (rest[0] if rest else None)
        yield f"[frf.{role}]"
        if part is None:
            yield blank("channel", f"the column of the {role}")
        else:
            rest.remove(part)
            yield entry("channel", printed(part.channel.name), f"{CONFIRM} by its name, or its place in the file")
        yield blank("unit", '"deg" | "rad"' if role == "phase" else "unit of the response, such as m/(N.s2) or m/N")
