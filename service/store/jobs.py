"""Query jobs, and keep their reports as files ``reports/<job>.html``, written whole or not at all."""

from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path

from sqlalchemy import and_, bindparam, func, literal, or_, select, text, tuple_, update
from sqlalchemy.orm import Session

from service.clock import now
from service.errors import StorageError, UnknownResourceError
from service.store.lookup import existing
from service.store.service_order import database_time
from service.store.tables import JobRow


class ReportStore:
    """Writes and reads the pages below one folder."""

    def __init__(self, root: Path) -> None:
        self._folder = root / "reports"

    def write(self, job_id: str, page: str) -> None:
        """Write the report of a job; an earlier one, of a run that was interrupted, is replaced.

        Raises StorageError if the disk does not take it.
        """
        path = self._path(job_id)
        half_written = path.with_suffix(".part")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            half_written.write_text(page, encoding="utf-8")
            half_written.replace(path)
        except OSError as error:
            raise StorageError(f"the report of job {job_id} was not stored: {error}") from error

    def read(self, job_id: str) -> str:
        """Return the report of a job.

        Raises UnknownResourceError if there is none.
        """
        try:
            return self._path(job_id).read_text(encoding="utf-8")
        except FileNotFoundError as error:
            raise UnknownResourceError(f"job '{job_id}' has no report") from error

    def _path(self, job_id: str) -> Path:
        return self._folder / f"{job_id}.html"


QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
#: As the index has it: a parameter in its place would hide that from the database.
UNFINISHED = text("jobs.status IN ('queued', 'running')")
_FINISHED = (
    select(JobRow)
    .where(JobRow.axis_id == bindparam("axis_id"), JobRow.kind == bindparam("kind"), JobRow.status == DONE)
    .order_by(JobRow.updated_at.desc())
    .limit(bindparam("most"))
)


def get_job(session: Session, job_id: str) -> JobRow:
    """Return one job or say that there is none."""
    return existing(session.get(JobRow, job_id), f"job '{job_id}'")


def list_jobs(session: Session, axis_id: str | None, limit: int, after: str | None = None) -> list[JobRow]:
    """Return jobs, newest first; those older than a job if it is named."""
    query = select(JobRow)
    if axis_id is not None:
        query = query.where(JobRow.axis_id == axis_id)
    if after is not None:
        last = get_job(session, after)
        place = tuple_(literal(last.created_at, JobRow.created_at.type), literal(last.id))
        query = query.where(tuple_(JobRow.created_at, JobRow.id) < place)
    return list(session.scalars(query.order_by(JobRow.created_at.desc(), JobRow.id.desc()).limit(limit)))


def finished_jobs(session: Session, axis_id: str, kind: str, limit: int) -> list[JobRow]:
    """Return jobs of one kind that came to their end, the one that ended last first."""
    return list(session.scalars(_FINISHED, {"axis_id": axis_id, "kind": kind, "most": limit}))


def newest_job(session: Session, axis_id: str, kind: str) -> JobRow | None:
    """Return the job of one kind of an axis that was begun last; None if there was none."""
    query = select(JobRow).where(JobRow.axis_id == axis_id, JobRow.kind == kind)
    return session.scalar(query.order_by(JobRow.created_at.desc(), JobRow.id.desc()).limit(1))


def unfinished_jobs(session: Session, kind: str, axis_id: str | None = None) -> list[JobRow]:
    """Return the jobs of one kind that wait or are at work, of one axis or of all, oldest first."""
    query = select(JobRow).where(UNFINISHED, JobRow.kind == kind)
    if axis_id is not None:
        query = query.where(JobRow.axis_id == axis_id)
    return list(session.scalars(query.order_by(JobRow.created_at)))


def count_unfinished(session: Session, kind: str) -> int:
    """Count the jobs of one kind that wait or are at work."""
    query = select(func.count()).where(JobRow.kind == kind, UNFINISHED)
    return int(session.scalar(query) or 0)


def unfinished_by_kind(session: Session) -> dict[tuple[str, str], int]:
    """Count the jobs that wait or are at work, by kind and status."""
    query = select(JobRow.kind, JobRow.status, func.count()).where(UNFINISHED)
    return {(kind, status): n for kind, status, n in session.execute(query.group_by(JobRow.kind, JobRow.status))}


def locked_job(session: Session, job_id: str) -> JobRow:
    """Return one job as it stands, which nobody else changes until the transaction ends."""
    return existing(session.scalar(select(JobRow).where(JobRow.id == job_id).with_for_update()), f"job '{job_id}'")


def take_next(session: Session, kind: str, owner: str, lease: timedelta) -> JobRow | None:
    """Give the oldest job of a kind to an owner that waits, or whose last owner is gone; None if there is none."""
    at = database_time(session)
    abandoned = and_(JobRow.status == RUNNING, or_(JobRow.lease_until.is_(None), JobRow.lease_until <= at))
    query = select(JobRow).where(JobRow.kind == kind, or_(JobRow.status == QUEUED, abandoned))
    oldest = query.order_by(JobRow.created_at, JobRow.id).limit(1).with_for_update(skip_locked=True)
    row = session.scalar(oldest)
    if row is not None:
        row.status, row.owner, row.lease_until, row.updated_at = RUNNING, owner, at + lease, now()
    return row


def renew_leases(session: Session, owners: Mapping[str, str], lease: timedelta) -> None:
    """Keep jobs, of which each has an owner, for as long again; what another has taken up stays his."""
    until = database_time(session) + lease
    for job_id, owner in owners.items():
        session.execute(update(JobRow).where(JobRow.id == job_id, JobRow.owner == owner).values(lease_until=until))


def let_go(session: Session, owner: str | None = None) -> None:
    """Let others take up what an owner works on; without one, what anybody works on: all of them are gone."""
    whose = JobRow.status == RUNNING if owner is None else JobRow.owner == owner
    session.execute(update(JobRow).where(whose).values(owner=None, lease_until=None))
