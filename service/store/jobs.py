"""Query jobs."""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from service.errors import UnknownResourceError
from service.store.tables import JobRow

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"


def get_job(session: Session, job_id: str) -> JobRow:
    """Return one job or say that there is none."""
    row = session.get(JobRow, job_id)
    if row is None:
        raise UnknownResourceError(f"there is no job '{job_id}'")
    return row


def list_jobs(session: Session, axis_id: str | None, limit: int) -> list[JobRow]:
    """Return jobs, newest first."""
    query = select(JobRow)
    if axis_id is not None:
        query = query.where(JobRow.axis_id == axis_id)
    return list(session.scalars(query.order_by(JobRow.created_at.desc()).limit(limit)))


def finished_jobs(session: Session, axis_id: str, kind: str, limit: int) -> list[JobRow]:
    """Return jobs of one kind that came to their end, the one that ended last first."""
    query = select(JobRow).where(JobRow.axis_id == axis_id, JobRow.kind == kind, JobRow.status == DONE)
    return list(session.scalars(query.order_by(JobRow.updated_at.desc()).limit(limit)))


def unfinished_jobs(session: Session) -> list[JobRow]:
    """Return jobs that were waiting or at work when the service last stopped, oldest first."""
    query = select(JobRow).where(JobRow.status.in_((QUEUED, RUNNING))).order_by(JobRow.created_at)
    return list(session.scalars(query))


def count_unfinished(session: Session, kind: str) -> int:
    """Count the jobs of one kind that wait or are at work."""
    query = select(func.count()).where(JobRow.kind == kind, JobRow.status.in_((QUEUED, RUNNING)))
    return int(session.scalar(query) or 0)
