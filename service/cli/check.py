"""``preload check FILE``: what is in a file, which commands can use it, and what to do next with it."""

import shlex
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from itertools import islice
from pathlib import Path

import click
import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.recordings.check import FileReport, check_file
from monitor_core.recordings.elements.fields import format_instant
from monitor_core.recordings.raw.channels import Channel
from monitor_core.recordings.raw.inspection import ChannelSummary
from monitor_core.recordings.raw.proposal.entries import MapProposal
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map
from monitor_core.recordings.raw.proposal.parts import Made
from monitor_core.recordings.recognition import KINDS, SESSION
from monitor_core.recordings.session_hdf5 import channels_of, open_session
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table
from service.cli.targets import require_target
from service.documents.file_check import json_fact
from service.documents.measurement import members
from service.operations.foreign_file import read_foreign

_TERMINAL = "-"
_PAGES = (".html", ".htm")
_PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg")  # meant as the name of a page, and refused as one
#: So many channels, doubts and places of a list a person is shown; --json has all.
_MOST_ROWS, _MOST_LINES, _MOST_VALUES = 100, 20, 12
_MOST_WINDOWS = 1000  # of a session are drawn


class _CheckCommand(click.Command):
    """``--plot`` stands alone, or in front of ``-`` or the name of a page; any other word behind it is the file."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give --plot its value, empty where none stands behind it."""
        words = list[str]()
        for word in args:
            if words and words[-1] == "--plot=" and (word == _TERMINAL or word.lower().endswith((*_PAGES, *_PICTURES))):
                words[-1] += word
            else:
                words.append("--plot=" if word == "--plot" else word)
        return super().parse_args(ctx, words)


@click.command(cls=_CheckCommand)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--write-map", "map_path", type=click.Path(path_type=Path), metavar="MAP",
    help="Write a channel map for a raw file, to fill in: what is proposed and what is missing is marked.",
)  # fmt: skip
@click.option(
    "--plot", metavar="[PAGE]",
    help="Draw each channel: into a page of HTML (without a name: FILE.html in this folder), or - into the terminal.",
)  # fmt: skip
@json_option
@click.pass_context
def check(context: click.Context, file: Path, map_path: Path | None, plot: str | None, as_json: bool) -> None:
    """Say what is in a file, which commands can use it, and what to do next with it.

    FILE is a session, an FRF set, a modal table, a motion record, a calibration, a drive model, a channel map, or a
    raw file (TDMS, MAT, CSV, …).
    """
    page = _page_of(file, plot)
    if as_json and plot == _TERMINAL:
        raise click.UsageError("--json prints one document and nothing else; give --plot the name of a page")
    require_target(map_path, "channel map", inputs=[file], replaces=False)
    require_target(page, "page", inputs=[file])
    work = partial(_checked, file, with_map=map_path is not None, with_samples=plot is not None)
    report, proposal, channels = read_foreign(work, file.name)
    written, n_places = [], 0
    if report.valid and map_path is not None:
        if proposal is None:
            kind = KINDS[report.format].what
            raise click.UsageError(
                f"--write-map goes with a raw file; got {kind}, which takes no map here: {report.next_step}"
            )
        map_path.write_text(proposal.toml(), encoding="utf-8")
        n_places = proposal.n_places
        written.append(map_path)
    if report.valid and plot is not None:
        written += _plotted(file, report, channels, page)
    if as_json:
        print_json(_document(report, written))
    else:
        _print(file, report, map_path, written, n_places)
    if not report.valid:
        if not as_json:
            print_line(f"preload: {' '.join(report.problems[0].split())}", err=True)
        context.exit(2)


def _checked(
    file: Path, *, with_map: bool, with_samples: bool
) -> tuple[FileReport, MapProposal | None, Sequence[Channel]]:
    """Look at a file; with the map that is proposed for it, and all samples, where they are wanted and it has them."""
    report, proposal, channels = check_file(file), None, tuple[Channel, ...]()
    if with_map and report.read is not None and report.usable_with_map:
        proposal = proposed_map(report.read.channels, report.read.layout)
    if with_samples and report.valid and report.format == SESSION:
        channels = _channels_of_session(file)
    elif with_samples and report.read is not None and report.channels:
        channels = report.read.channels.read()
    return replace(report, read=None), proposal, channels


def _page_of(file: Path, plot: str | None) -> Path | None:
    """Return where the page is written; None without one."""
    if plot is None or plot == _TERMINAL:
        return None
    if plot and not plot.lower().endswith(_PAGES):
        raise click.UsageError(f"--plot writes a page of HTML, whose name ends in .html; got {plot}")
    return Path(plot) if plot else Path(f"{file.resolve().name}.html")


def _plotted(file: Path, report: FileReport, channels: Sequence[Channel], page: Path | None) -> list[Path]:
    """Draw the channels of a file into its page, or into the terminal where it has none."""
    # imported here: drawing brings along what the other reports need
    from service.report.channel_page import MOST_PICTURES, channel_letters, channel_page  # noqa: PLC0415

    if not channels:
        raise click.UsageError(f"--plot draws channels; {file.name} is {KINDS[report.format].what}, which has none")
    if page is not None:
        facts = [f"{KINDS[report.format].what}: {fact}" for fact in _facts(report)]
        page.write_text(channel_page(file.name, channels, report.channels, facts), encoding="utf-8")
        return [page]
    for channel, summary in list(zip(channels, report.channels, strict=True))[:MOST_PICTURES]:
        for line in channel_letters(channel, summary):
            print_line(line)
    return []


def _channels_of_session(file: Path) -> tuple[Channel, ...]:
    """Return the channels of the windows in a row, in time order, as many windows as memory is given for."""
    with open_session(file) as reader:
        windows = list(islice(reader.windows(), _MOST_WINDOWS))
    samples = defaultdict[str, list[SampleArray]](list)
    for window in windows:
        for name, (values, _) in channels_of(window).items():
            samples[name].append(values)
    return tuple(Channel(name, np.concatenate(of, dtype=np.float64)) for name, of in samples.items())


def _document(report: FileReport, written: Sequence[Path]) -> dict[str, object]:
    return {
        **members(report, "format", "valid", "problems", "usable_by", "usable_with_map", "doubts"),
        "channels": [_channel_document(channel) for channel in report.channels],
        "commands": {use.command: use.line for use in report.uses},
        "next_step": report.next_step or None,
        "contents": {name: json_fact(value) for name, value in report.contents},
        "written": [str(path) for path in written],
    }


def _channel_document(channel: ChannelSummary) -> dict[str, object]:
    return {
        **members(channel, "name", "shape", "unit"),
        "sample_rate_hz": channel.sample_rate,
        "started_at": None if channel.started_at is None else format_instant(channel.started_at),
        "looks_like": channel.kind,
        **members(channel, "clock", "first_values", "minimum", "maximum", "remarks", "doubts"),
        "not_finite": channel.n_not_finite,
        "constant": channel.is_constant,
        "stuck": channel.is_stuck,
        "clipped": channel.is_clipped,
    }


def _print(file: Path, report: FileReport, map_path: Path | None, written: Sequence[Path], n_places: int) -> None:
    print_line(f"{file.resolve().name}: {report.format}, {'valid' if report.valid else 'not valid'}")
    for fact in _facts(report):
        print_line(fact)
    if report.channels:
        print_table(
            "Channels",
            ("channel", "shape", "unit", "rate", "start", "first values", "looks like", "remarks"),
            [_row(channel) for channel in report.channels[:_MOST_ROWS]],
        )
    if (more := len(report.channels) - _MOST_ROWS) > 0:
        print_line(f"{more} more channels: --json lists them.")
    for doubt in report.doubts[:_MOST_LINES]:
        print_line(f"In doubt: {doubt}.")
    for problem in report.problems[1:]:
        print_line(f"- {problem}")
    if report.uses:
        print_line(f"Commands that take it{', with a channel map' if report.usable_with_map else ' as it is'}:")
        for use in report.uses:
            print_line(f"  {use.line}")
    if report.next_step and map_path not in written:
        print_line(f"Next: {report.next_step}")
    for path in written:
        print_line(f"Written: {path}")
    if map_path is not None and map_path in written:
        print_line(f"Next: {_step_with_map(file, report, map_path, n_places)}")


def _step_with_map(file: Path, report: FileReport, map_path: Path, n_places: int) -> str:
    marked = "its marked place" if n_places == 1 else f"its {n_places} marked places"
    places = f"fill in {marked}, look at what is marked to confirm" if n_places else "look at it"
    (use,) = report.uses
    with_map = f"--map {shlex.quote(str(map_path))}"
    step = f"{places}, then {use.line.replace('--map MAP', with_map)}"
    if not use.line.endswith(Made.SESSION):
        return step
    return f"{step}, or at once preload frf {shlex.quote(str(file))} {with_map}"


def _facts(report: FileReport) -> Iterator[str]:
    for name, value in report.contents:
        yield f"{name}: {_shown(value)}"


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        shown = ", ".join(_shown(item) for item in value[:_MOST_VALUES])
        return f"{shown}, …" if len(value) > _MOST_VALUES else shown or "not stated"
    if isinstance(value, datetime):
        return format_instant(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _row(channel: ChannelSummary) -> tuple[str, ...]:
    return (
        channel.name,
        " × ".join(map(str, channel.shape)),
        channel.unit or "—",
        "—" if channel.sample_rate is None else f"{channel.sample_rate:g} Hz",
        "—" if channel.started_at is None else format_instant(channel.started_at),
        ", ".join(f"{value:.4g}" for value in channel.first_values[:3]),
        "—" if channel.kind is None else str(channel.kind),
        "; ".join(channel.remarks),
    )
