"""Delete waveforms that the rule does not keep, file by file: a crash at any point leaves nothing half done.

Files are noted as unsettled in the database before they are written or removed. What is kept of a file is written into
a new one in its folder; one transaction says where it lies now and which windows are let go; then every unsettled file
that no window names is removed. After a crash the last step is done at the next start, and the purge goes on.
"""

import logging
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path, PurePosixPath

from pydantic import BaseModel
from sqlalchemy import Connection
from sqlalchemy.orm import Session

from service.clock import now
from service.errors import ConflictError, WaveformDamagedError
from service.jobs import JobHandle, JobRunner, Repeatedly
from service.json_types import JsonObject
from service.operations.retention import Holds, Rule, holds_of
from service.store import jobs, retention
from service.store.database import Database, reading, writing
from service.store.retention import StoredWindow
from service.store.safekeeping.purge_lock import purging
from service.store.tables import AuditRow, JobRow, PurgeRow
from service.store.waveforms import WaveformPlace, WaveformStore, folder_of_day

log = logging.getLogger(__name__)

#: So many files are settled in one transaction: a window waits for it as for that of another window.
FILES_AT_ONCE = 16
#: How often it is looked whether a backup is done.
_WAIT_S = 1.0

#: Told how many files are looked at, and of how many.
Report = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class _Plan:
    """What is to become of a file."""

    path: str
    kept: list[StoredWindow]
    n_gone: int


@dataclass(frozen=True, slots=True)
class _Replacement:
    """A new file with what is kept of another one."""

    path: str
    places: dict[int, WaveformPlace]  # by the number of the window


class Purge:
    """Deletes the waveforms of a data folder that a rule does not keep."""

    def __init__(self, database: Database, waveforms: WaveformStore, rule: Rule, data_dir: Path) -> None:
        self.data_dir = data_dir
        self._database = database
        self._waveforms = waveforms
        self.rule = rule

    def begin(self, session: Session, who: str, at: datetime) -> PurgeRow:
        """Store a purge that is about to begin, with its entry of the log; raises ConflictError if there is no rule."""
        days, lets_go_before = self.rule.keep_raw_days, self.rule.lets_go_before(at)
        if days is None or lets_go_before is None:
            raise ConflictError("no rule is set (PRELOAD_KEEP_RAW_DAYS): every waveform is kept for ever")
        entry = AuditRow(at=at, who=who[:120], action=f"purge by the rule of {days} days", target="/v1/retention")
        session.add(entry)
        session.flush()
        row = PurgeRow(
            begun_at=at, ended_at=None, keep_raw_days=days, lets_go_before=lets_go_before, n_windows=0, freed_bytes=0,
            audit_id=entry.id,
        )  # fmt: skip
        session.add(row)
        session.flush()
        entry.target = f"purge {row.id}"
        return row

    def run(self, purge_id: int, report: Report, wait: Callable[[float], None]) -> PurgeRow:
        """Let go what the purge is to let go, and return what came of it; begun again if it was interrupted.

        A purge that a longer rule has overtaken lets nothing go any more.
        """
        with self._database.read() as session:
            purge = retention.get_purge(session, purge_id)
        folder_before = folder_of_day(purge.lets_go_before)
        if self.rule.keep_raw_days == purge.keep_raw_days:
            self._settle(wait)
            with self._database.reading() as connection:
                total = retention.count_files(connection, folder_before)
            done, at = 0, ""
            report(done, total)
            while paths := self._next(at, folder_before):
                self._alone(wait, partial(self._let_go, purge_id, paths))
                done, at = done + len(paths), paths[-1]
                report(min(done, total), total)
        return self._end(purge_id)

    def settle(self) -> None:
        """Remove what a crash left over, unless another process is at work on it."""
        with purging(self._database, self.data_dir) as alone:
            if alone:
                self._remove_unnamed()

    def _settle(self, wait: Callable[[float], None]) -> None:
        self._alone(wait, self._remove_unnamed)

    def _alone(self, wait: Callable[[float], None], step: Callable[[], None]) -> None:
        """Do a step while no backup and no other purge is at work."""
        while True:
            with purging(self._database, self.data_dir) as alone:
                if alone:
                    step()
                    return
            wait(_WAIT_S)

    def _next(self, after: str, before: str) -> list[str]:
        """Return the next files to look at."""
        paths: list[str] = []
        with self._database.reading() as connection:
            while len(paths) < FILES_AT_ONCE and (path := retention.next_file(connection, after, before)) is not None:
                paths.append(path)
                after = path
        return paths

    def _let_go(self, purge_id: int, paths: Sequence[str]) -> None:
        """Let go what is not kept of some files."""
        with self._database.connect() as connection:
            with reading(connection):
                plans = [plan for plan in self._plans(connection, paths) if plan.n_gone]
            replacements = {plan.path: self._rewritten(connection, plan) for plan in plans if plan.kept}
            with writing(connection), retention.settled_with(connection):
                # what was pinned, moved or raised meanwhile changes the plan: that file waits for the next purge
                as_before = {plan.path: plan for plan in self._plans(connection, paths)}
                for plan in plans:
                    replacement = replacements.get(plan.path)
                    if as_before[plan.path] == plan and (replacement is not None or not plan.kept):
                        self._note(connection, purge_id, plan, replacement)
        self._remove_unnamed()

    def _plans(self, connection: Connection, paths: Sequence[str]) -> list[_Plan]:
        holds: dict[str, Holds] = {}
        plans = []
        for path in paths:
            windows = retention.windows_in(connection, path)
            for axis_id in {window.axis_id for window in windows} - holds.keys():
                holds[axis_id] = holds_of(connection, axis_id, self.rule)
            kept = [window for window in windows if holds[window.axis_id].why(window) is not None]
            plans.append(_Plan(path, kept, len(windows) - len(kept)))
        return plans

    def _rewritten(self, connection: Connection, plan: _Plan) -> _Replacement | None:
        """Write what is kept of a file into a new one; None if it cannot be read: then the file stays as it is."""
        path = str(PurePosixPath(plan.path).with_name(f"{uuid.uuid4().hex}.windows.zst"))
        with writing(connection):
            retention.unsettle(connection, [path])
        try:
            places = self._waveforms.write_beside(path, [window.place for window in plan.kept])
        except WaveformDamagedError as error:
            log.warning("nothing of %s is let go, since what is kept of it cannot be read: %s", plan.path, error)
            return None
        return _Replacement(path, dict(zip((window.id for window in plan.kept), places, strict=True)))

    def _note(self, connection: Connection, purge_id: int, plan: _Plan, replacement: _Replacement | None) -> None:
        """Say in the open transaction what becomes of a file."""
        freed = self._waveforms.size_of_file(plan.path)
        if replacement is not None:
            retention.move_windows(connection, replacement.places)
            freed -= self._waveforms.size_of_file(replacement.path)
        n_windows = retention.let_windows_go(connection, purge_id, plan.path)
        retention.unsettle(connection, [plan.path])
        retention.add_to_purge(connection, purge_id, n_windows=n_windows, freed_bytes=freed)

    def _remove_unnamed(self) -> None:
        """Remove the unsettled files that no window names, and settle all."""
        with self._database.connect() as connection:
            with reading(connection):
                unsettled = retention.unsettled(connection)
            for path, is_named in unsettled.items():
                if not is_named:
                    self._waveforms.remove(path)
            if unsettled:
                with writing(connection):
                    retention.settle(connection, unsettled)

    def _end(self, purge_id: int) -> PurgeRow:
        with self._database.write() as session:
            row = retention.get_purge(session, purge_id)
            row.ended_at = now()
            entry = session.get(AuditRow, row.audit_id)
            if entry is not None:
                entry.status = 200
                entry.target = f"purge {row.id}: {row.n_windows} windows, {row.freed_bytes} bytes"
            return row


KIND = "purge"
#: How often it is looked whether today's purge has begun.
LOOKED_EVERY_S = 600.0


class _Arguments(BaseModel):
    """Which purge a job is."""

    purge: int


class Purges:
    """Begins purges and runs them in the background."""

    def __init__(self, database: Database, runner: JobRunner, purge: Purge) -> None:
        self._database = database
        self._jobs = runner
        self._purge = purge
        runner.work[KIND] = self.run
        self._looking = Repeatedly("purges", self.begin_if_due, every_s=LOOKED_EVERY_S, waits="today's purge")

    def start(self) -> None:
        """Remove what a crash left over, and begin a purge a day; jobs are resumed after this."""
        self._purge.settle()
        if self._purge.rule.keep_raw_days is not None:
            self._looking.start()

    def stop(self) -> None:
        """Begin no more daily purges."""
        self._looking.stop()

    def close(self, within_s: float) -> None:
        """Stop beginning daily purges; one that is about to begin is left after so long."""
        self._looking.close(within_s)

    def begin(self, who: str) -> JobRow:
        """Begin a purge, or return the one that is not done yet; raises ConflictError if there is no rule."""
        with self._database.read() as session:
            unfinished = jobs.unfinished_jobs(session, KIND)
        return unfinished[0] if unfinished else self._jobs.submit(KIND, None, {}, partial(self._stored, who))

    def run(self, job: JobHandle) -> None:
        """Delete waveforms that the rule no longer keeps; a restart resumes an interrupted purge."""
        purge_id = _Arguments.model_validate(job.arguments).purge
        examined = 0

        def report(done: int, total: int) -> None:
            nonlocal examined
            examined = total
            job.report(done, total, {"purge": purge_id})

        row = self._purge.run(purge_id, report, job.sleep)
        came_of_it: JsonObject = {"purge": purge_id, "windows": row.n_windows, "freed_bytes": row.freed_bytes}
        job.report(examined, examined, came_of_it)

    def begin_if_due(self) -> None:
        """Begin today's purge unless it has begun, or there is nothing old enough."""
        at = now()
        lets_go_before = self._purge.rule.lets_go_before(at)
        if lets_go_before is None:
            return
        with self._database.read() as session:
            newest = retention.newest_purges(session, 1)
            is_old = retention.next_file(session.connection(), "", folder_of_day(lets_go_before)) is not None
        if is_old and not (newest and newest[0].lets_go_before >= lets_go_before):
            self.begin("service")

    def _stored(self, who: str, session: Session, job: JobRow) -> JsonObject:
        del job
        return _Arguments(purge=self._purge.begin(session, who, now()).id).model_dump()
