"""Say what is in the files of a recording before any window of it is taken: as ``preload check`` does."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from monitor_core.errors import MissingReaderError
from monitor_core.recordings.check import FileReport, check_file
from monitor_core.recordings.raw.proposal.entries import MapProposal
from monitor_core.recordings.raw.proposal.file_facts import file_facts
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map
from monitor_core.recordings.raw.proposal.parts import Made, made_of
from monitor_core.recordings.recognition import KINDS, SESSION, UNKNOWN
from service.documents.file_check import file_check_document
from service.json_types import JsonObject
from service.operations.own_process import Progress

#: So many files of one recording are read; the map of their channels is proposed by the first. Of the others the names
#: alone say what they were measured under.
_MOST_READ: Final = 40


def checked(paths: Sequence[Path], axis_id: str, report: Callable[[Progress], None]) -> JsonObject:
    """Return what is in the files, what is missing, and the map that is proposed for the channels of raw ones."""
    first: FileReport | None = None
    proposal: MapProposal | None = None  # for the first
    problems: list[str] = []
    facts = [file_facts(path.name) for path in paths]
    read = paths[:_MOST_READ]
    for done, path in enumerate(read):
        report(Progress(done, len(read)))
        try:
            file_report = check_file(path)
        except MissingReaderError as error:
            return unreadable(path.name, str(error))
        problems += file_report.problems
        if file_report.read is not None:
            channels = file_report.read.channels
            proposed = proposed_map(channels, file_report.read.layout)
            facts[done] = file_facts(path.name, channels, proposed)
            proposal = proposed if first is None else proposal
        if first is None:
            first = file_report
        elif file_report.format != first.format:
            problems.append(
                f"{path.name}: expected {KINDS[first.format].what} as the first file; got {file_report.format}"
            )
    if all(fact.states_start for fact in facts[: len(read)]):  # then the others do, too; a name would say it twice
        facts[len(read) :] = [replace(fact, started_at=None) for fact in facts[len(read) :]]
    if first is None:
        return unreadable("", "expected a file; got none")
    if first.format == SESSION and len(paths) > 1:
        problems.append(f"expected one session at once, or raw files with a map; got {len(paths)} files")
    problems += _not_windows(paths[0].name, first)
    needs_map = not problems and bool(first.usable_with_map)
    proposal = proposal.for_axis(axis_id) if needs_map and proposal is not None else None
    lacks = first.lacks if first.valid else ""
    files = tuple(facts) if proposal is not None and len(paths) > 1 else ()
    return file_check_document(first, tuple(problems), lacks=lacks, proposal=proposal, files=files)


def unreadable(name: str, problem: str) -> JsonObject:
    """Return the answer for a file that nothing can be said of."""
    return file_check_document(FileReport(UNKNOWN, False, (problem or name,)), (problem,), lacks="", proposal=None)


def _not_windows(name: str, report: FileReport) -> list[str]:
    """Refuse files that are valid and hold no windows, in a sentence."""
    if not report.valid or report.format == SESSION:
        return []
    if report.usable_with_map and report.read is not None and made_of(report.read.channels) is Made.SESSION:
        return []
    return [
        f"{name}: expected a session, or a raw file with what drives the axis and what answers over time; got "
        f"{KINDS[report.format].what}, which has no windows"
    ]
