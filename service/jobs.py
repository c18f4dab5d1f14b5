"""Run long work in the background: a thread for each kind, progress in the database, resumed after a restart.

Of several services on one database each takes up what waits. A job is held by a lease, which its owner renews; when the
owner is gone another takes it up, and a report of who has lost it is refused.
"""

import logging
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from typing import Protocol, TypeVar

from sqlalchemy.orm import Session

from service.clock import now
from service.errors import BusyError, ConflictError, StorageError, tell_failure
from service.json_types import JsonObject
from service.store import axes, jobs
from service.store.database import Database
from service.store.service_order import lease_owner
from service.store.tables import JobRow

log = logging.getLogger(__name__)


#: How soon waiting work notices that it was cancelled.
CANCEL_CHECK_S = 1.0
#: How soon a job is taken up that another service was asked for, or left behind.
POLL_S = 1.0
#: So long after the last sign of life of its owner; a sign is given three times in that time.
LEASE = timedelta(seconds=30)


#: After a step that disk or database refused it is tried again, in the end after a minute each: five minutes in all.
PAUSES_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 60.0, 60.0, 60.0)

Result = TypeVar("Result")


class JobCancelledError(Exception):
    """The job was asked to stop, another service has taken it up, or this one is stopping."""


class JobHandle:
    """What running work may do: read its arguments, report progress, wait, and learn by either that it should stop.

    What it does raises JobCancelledError then.
    """

    def __init__(self, runner: "JobRunner", row: JobRow, owner: str) -> None:
        self._runner, self._owner, self._of_axis = runner, owner, row.axis_id
        self.job_id = row.id
        self.arguments = row.arguments
        self.done = row.done  # as last reported: 0, or how far the job had come when it was interrupted
        self.result = row.result  # as last reported

    @property
    def axis_id(self) -> str:
        """The axis that it is about."""
        if self._of_axis is None:
            raise AssertionError(f"job {self.job_id} is about all axes")
        return self._of_axis

    def report(self, done: int, total: int | None, result: JsonObject) -> None:
        """Say how far the work has come, of how much where that is known, and what came of it so far."""
        self._store(done, total, lambda _: result)

    def say(self, done: int, total: int | None, sentence: str | None) -> None:
        """Say how far the work has come, and in a few words what is being done."""
        self.report(done, total, {} if sentence is None else {"progress": sentence})

    def conclude(self, total: int, store: Callable[[Session], JsonObject]) -> None:
        """Report the total as done, and store more in the same transaction: what is stored returns the result."""
        self._store(total, total, store)

    def conclude_within(self, session: Session, total: int, result: JsonObject) -> None:
        """Report the total as done in the transaction of the work, which is open."""
        self._store_within(session, total, total, lambda _: result)

    def sleep(self, seconds: float) -> None:
        """Wait."""
        due = time.monotonic() + seconds
        while (left := due - time.monotonic()) > 0.0:
            if self._runner.stopping.wait(min(left, CANCEL_CHECK_S)):
                raise JobCancelledError
            _require_own(self._runner.get(self.job_id), self._owner)

    def _store(self, done: int, total: int | None, store: Callable[[Session], JsonObject]) -> None:
        self._runner.persistently(self.job_id, partial(self._store_once, done, total, store))

    def _store_once(self, done: int, total: int | None, store: Callable[[Session], JsonObject]) -> None:
        if self._runner.stopping.is_set():
            raise JobCancelledError
        with self._runner.database.write() as session:
            self._store_within(session, done, total, store)

    def _store_within(
        self, session: Session, done: int, total: int | None, store: Callable[[Session], JsonObject]
    ) -> None:
        row = jobs.locked_job(session, self.job_id)
        _require_own(row, self._owner)
        row.done, row.total, row.result, row.updated_at = done, total, store(session), now()
        session.flush()


#: Work of one kind; what came of it is in its last report.
Work = Callable[[JobHandle], None]


class JobRunner:
    """Runs jobs, those of a kind one after another; after a stop or a crash a job goes on from its last report.

    So it does after a time in which disk or database refused to take something. What was done since that report is done
    once more, so work must be repeatable.
    """

    def __init__(self, database: Database, work: dict[str, Work], most_waiting: int) -> None:
        self.database = database
        self.work = work  # by kind
        self._most_waiting = most_waiting  # of a kind
        self._lanes: dict[str, _Lane] = {}  # by kind: what is soon done does not wait for what is not
        self._held: dict[str, str] = {}  # owners of the jobs that are worked on here
        self.stopping = threading.Event()
        waits = "the renewal of the leases of jobs"
        self._heart = Repeatedly("job-leases", self._renew, every_s=LEASE.total_seconds() / 3.0, waits=waits)
        self._heart.start()

    def resume(self) -> None:
        """Take up the jobs that a stop or a crash left unfinished, and those that wait for any service."""
        if self.database.file is not None:  # no other process has it: whoever worked on one is gone
            with self.database.write() as session:
                jobs.let_go(session)
        for kind in self.work:
            self.wake(kind)

    def submit(
        self,
        kind: str,
        axis_id: str | None,
        arguments: JsonObject,
        store_with: Callable[[Session, JobRow], JsonObject] | None = None,
        *,
        alone: str | None = None,
    ) -> JobRow:
        """Store a new job, of an axis or of all, and queue it.

        ``store_with``: stores more in the same transaction, and returns the arguments with what it adds to them.
        ``alone``: what is under way where another one of its kind and axis is not done yet, for the ConflictError.
        Raises BusyError if too many of its kind are not done yet.
        """
        with self.database.write() as session:
            row = self.enter(session, kind, axis_id, arguments, alone=alone)
            if store_with is not None:
                row.arguments = store_with(session, row)
        self.wake(kind)
        return row

    def enter(
        self, session: Session, kind: str, axis_id: str | None, arguments: JsonObject, *, alone: str | None = None
    ) -> JobRow:
        """Store a new job in a transaction that does more; :meth:`wake` queues it. Raises as :meth:`submit`."""
        at = now()
        row = JobRow(
            id=str(uuid.uuid4()), kind=kind, axis_id=axis_id, arguments=arguments, status=jobs.QUEUED,
            done=0, total=None, result=None, error=None, created_at=at, updated_at=at, owner=None, lease_until=None,
        )  # fmt: skip
        self._require_place(session, kind, axis_id)
        if alone is not None and (others := jobs.unfinished_jobs(session, kind, axis_id)):
            raise ConflictError(f"{alone} already, by job {others[0].id}")
        session.add(row)
        session.flush()
        return row

    def require_place(self, kind: str, axis_id: str) -> None:
        """Refuse a job before what it needs is sent; raises as :meth:`submit`."""
        with self.database.read() as session:
            self._require_place(session, kind, axis_id)

    def _require_place(self, session: Session, kind: str, axis_id: str | None) -> None:
        if axis_id is not None:
            axes.get_axis(session, axis_id)
        waiting = jobs.count_unfinished(session, kind)
        if waiting >= self._most_waiting:
            raise BusyError(f"{waiting} jobs of kind {kind} are not done yet, more do not wait; come back later")

    def get(self, job_id: str) -> JobRow:
        """Return a job as it stands."""
        with self.database.read() as session:
            return jobs.get_job(session, job_id)

    def list(self, axis_id: str | None, limit: int, after: str | None = None) -> list[JobRow]:
        """Return jobs, newest first; those older than a job if it is named."""
        with self.database.read() as session:
            return jobs.list_jobs(session, axis_id, limit, after)

    def unfinished(self) -> dict[tuple[str, str], int]:
        """Count the jobs that wait or are at work, by kind and status."""
        with self.database.read() as session:
            return jobs.unfinished_by_kind(session)

    def cancel(self, job_id: str) -> JobRow:
        """Ask a job to stop; work already done stays done."""
        with self.database.write() as session:
            row = jobs.locked_job(session, job_id)
            if row.status in (jobs.QUEUED, jobs.RUNNING):
                row.status, row.updated_at = jobs.CANCELLED, now()
            return row

    def close(self) -> None:
        """Stop; running work ends at its next report and is resumed at the next start, or by another service."""
        self.stopping.set()
        for lane in list(self._lanes.values()):
            lane.wake.set()
            lane.thread.join()
        self._heart.close()

    def wake(self, kind: str) -> None:
        """Have the jobs of a kind taken up that were stored meanwhile."""
        lane = self._lanes.get(kind)
        if lane is None:
            wake = threading.Event()
            thread = threading.Thread(target=self._serve, args=(kind, wake), name=f"job-{kind}", daemon=True)
            lane = self._lanes.setdefault(kind, _Lane(thread, wake))
            if lane.thread is thread:
                thread.start()
        lane.wake.set()

    def _serve(self, kind: str, wake: threading.Event) -> None:
        """Take up one job of a kind after another."""
        alone = self.database.file is not None  # then whoever submits a job wakes this thread
        while not self.stopping.is_set():
            wake.clear()
            try:
                owner = lease_owner()
                with self.database.write() as session:
                    row = jobs.take_next(session, kind, owner, LEASE)
            except (BusyError, StorageError) as error:
                log.warning("jobs of kind %s wait for the database: %s", kind, error)
                wake.wait(POLL_S)
                continue
            if row is None:
                wake.wait(None if alone else POLL_S)
                continue
            self._held[row.id] = owner
            self._run(row.id, owner)
            del self._held[row.id]

    def _renew(self) -> None:
        """Renew the leases of the jobs that are worked on here."""
        if held := dict(self._held):
            with self.database.write() as session:
                jobs.renew_leases(session, held, LEASE)

    def _run(self, job_id: str, owner: str) -> None:
        try:
            self.persistently(job_id, partial(self._work_on, job_id, owner))
            end = partial(self._finish, job_id, owner, jobs.DONE, None)
        except JobCancelledError:  # cancelled, or taken up by another: the row says so
            if self.stopping.is_set():
                self._let_go(job_id, owner)
            return
        except Exception as error:  # noqa: BLE001 - the edge of this thread: whatever broke is told to who asks for it
            tell_failure(log, f"job {job_id} failed", error)
            end = partial(self._finish, job_id, owner, jobs.FAILED, f"{type(error).__name__}: {error}"[:1000])
        try:
            self.persistently(job_id, end)
        except (JobCancelledError, BusyError, StorageError) as error:
            log.warning("job %s came to its end, which was not stored; it goes on at the next start: %s", job_id, error)

    def _let_go(self, job_id: str, owner: str) -> None:
        """Let another service go on at once; the row still says running, and is resumed."""
        try:
            with self.database.write() as session:
                jobs.let_go(session, owner)
        except (BusyError, StorageError) as error:
            log.warning("job %s is taken up by another service when its lease has run out: %s", job_id, error)

    def persistently(self, job_id: str, step: Callable[[], Result]) -> Result:
        """Do a step, with retries while disk or database refuse it."""
        for pause in PAUSES_S:
            try:
                return step()
            except (BusyError, StorageError) as error:
                log.warning("job %s tries again in %g s: %s", job_id, pause, error)
                if self.stopping.wait(pause):
                    raise JobCancelledError from error
        return step()

    def _work_on(self, job_id: str, owner: str) -> None:
        """Do the work of a job from its last report on."""
        with self.database.read() as session:
            row = jobs.get_job(session, job_id)
            _require_own(row, owner)
        self.work[row.kind](JobHandle(self, row, owner))

    def _finish(self, job_id: str, owner: str, status: str, error: str | None) -> None:
        with self.database.write() as session:
            row = jobs.locked_job(session, job_id)
            if row.status == jobs.RUNNING and row.owner == owner:  # not if it was cancelled after its last report
                row.status, row.error, row.updated_at = status, error, now()
                row.owner = row.lease_until = None


@dataclass(frozen=True, slots=True)
class _Lane:
    """The thread of a kind, and what wakes it."""

    thread: threading.Thread
    wake: threading.Event


def _require_own(row: JobRow, owner: str) -> None:
    if row.status != jobs.RUNNING or row.owner != owner:
        raise JobCancelledError


class Repeatedly:
    """Calls a function again and again, with a pause whenever it did nothing.

    What fails is logged as waiting, and tried again.
    """

    def __init__(self, name: str, act: Callable[[], int | None], *, every_s: float, waits: str) -> None:
        self._act = act
        self._every_s = every_s
        self._waits = waits  # what waits where it fails
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Begin nothing more."""
        self._stopping.set()

    def close(self, within_s: float | None = None) -> None:
        """Stop; what is under way is finished first, or left after so long."""
        self.stop()
        if self._thread.is_alive():
            self._thread.join(within_s)

    def _serve(self) -> None:
        while not self._stopping.is_set():
            n_done: int | None = 0
            try:
                n_done = self._act()
            except Exception as error:  # noqa: BLE001 - the edge of this thread, which must live on
                tell_failure(log, f"{self._waits} waits", error)
            if not n_done:
                self._stopping.wait(self._every_s)


class Background(Protocol):
    """What goes on in threads of its own until it is closed."""

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """Begin nothing more."""

    def close(self, within_s: float) -> None:
        """Stop; what is under way is left after so long."""


def close_all(running: Sequence[Background], within_s: float) -> None:
    """Stop all, each before another is waited for, and wait for them together."""
    due = time.monotonic() + within_s
    for each in running:
        each.stop()
    for each in running:
        each.close(max(0.0, due - time.monotonic()))
