"""Purges in the service: once a day by themselves, or because somebody asks; jobs of kind ``purge``."""

from functools import partial

from pydantic import BaseModel
from sqlalchemy.orm import Session

from service.clock import now
from service.jobs import JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.keeping.purge import Purge
from service.operations.keeping.rule import Rule
from service.repeatedly import Repeatedly
from service.store import jobs, retention
from service.store.database import Database
from service.store.tables import JobRow
from service.store.waveforms import folder_of_day

KIND = "purge"
#: How often it is looked whether today's purge has begun.
LOOKED_EVERY_S = 600.0


class _Arguments(BaseModel):
    """Which purge a job is."""

    purge: int


class Purges:
    """Begins purges and runs them in the background."""

    def __init__(self, database: Database, runner: JobRunner, purge: Purge, rule: Rule) -> None:
        self._database = database
        self._jobs = runner
        self._purge = purge
        self._rule = rule
        self._looking = Repeatedly("purges", self.begin_if_due, every_s=LOOKED_EVERY_S, waits="today's purge")

    def start(self) -> None:
        """Remove what a crash left over, and begin a purge a day; jobs are resumed after this."""
        self._purge.settle()
        if self._rule.keep_raw_days is not None:
            self._looking.start()

    def close(self) -> None:
        """Begin no more."""
        self._looking.close()

    def begin(self, who: str) -> JobRow:
        """Begin a purge, or return the one that is not done yet; raises ConflictError if there is no rule."""
        with self._database.read() as session:
            unfinished = [row for row in jobs.unfinished_jobs(session) if row.kind == KIND]
        return unfinished[0] if unfinished else self._jobs.submit(KIND, None, {}, partial(self._stored, who))

    def run(self, job: JobHandle) -> None:
        """Purge; what was let go is let go if it was interrupted, and the rest follows."""
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
        before = self._rule.lets_go_before(at)
        if before is None:
            return
        with self._database.read() as session:
            newest = retention.newest_purges(session, 1)
            is_old = retention.next_file(session.connection(), "", folder_of_day(before)) is not None
        if is_old and not (newest and newest[0].lets_go_before >= before):
            self.begin("service")

    def _stored(self, who: str, session: Session, job: JobRow) -> JsonObject:
        del job
        return _Arguments(purge=self._purge.begin(session, who, now()).id).model_dump()
