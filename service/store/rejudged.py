"""Keep aside what another calibration says of the measurements of an axis, until all of it takes its place."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import (
    Connection,
    and_,
    bindparam,
    delete,
    exists,
    func,
    insert,
    literal,
    or_,
    select,
    tuple_,
    update,
)
from sqlalchemy.orm import Session

from service.json_types import JsonObject
from service.store.intake import MeasurementRecord
from service.store.jobs import UNFINISHED
from service.store.tables import PLACE, AxisRow, JobRow, MeasurementRow, RejudgedRow, WindowRow
from service.store.trend.points import Cursor, Span
from service.store.waveforms import WaveformPlace

#: Kind of the jobs that judge a history anew.
KIND = "rejudgement"
_STAGED, _JOBS, _AXES, _MEASUREMENTS = (
    mapped.metadata.tables[mapped.__tablename__] for mapped in (RejudgedRow, JobRow, AxisRow, MeasurementRow)
)
#: Built once: to build it takes longer than to run it.
_UNFINISHED = select(_JOBS.c.id, _JOBS.c.axis_id, _JOBS.c.arguments).where(UNFINISHED, _JOBS.c.kind == KIND)
_UNFINISHED_OF_AXIS = _UNFINISHED.where(_JOBS.c.axis_id == bindparam("axis_id")).order_by(_JOBS.c.created_at)
_MEASUREMENT = [_MEASUREMENTS.c[name] for name in MeasurementRecord.__slots__]


@dataclass(frozen=True, slots=True)
class StagedRecord:
    """A measurement as another calibration judges it; without any of it where its waveform is gone."""

    job_id: str
    measurement_id: int
    seen_revision: int
    measurement: JsonObject | None = None
    point: JsonObject | None = None
    outcome: JsonObject | None = None
    response: JsonObject | None = None
    refusals: JsonObject | None = None


@dataclass(frozen=True, slots=True)
class StoredWindow:
    """A window of a measurement: where it lies, and why it was refused."""

    place: WaveformPlace
    started_at: datetime
    refusal_reason: str | None
    refusal_detail: str | None


@dataclass(frozen=True, slots=True)
class Stale:
    """The job that judges a history anew, and by which calibration."""

    job: str
    calibration: int


def stale_axes(connection: Session | Connection, axis_id: str | None = None) -> dict[str, Stale]:
    """Return the axes whose values are about to be replaced, all or one of them; dry runs replace nothing."""
    rows = connection.execute(_UNFINISHED if axis_id is None else _UNFINISHED_OF_AXIS, {"axis_id": axis_id})
    return {
        own_axis: Stale(job, calibration)
        for job, own_axis, arguments in rows
        if own_axis is not None
        and not arguments.get("dry_run")
        and isinstance(calibration := arguments.get("calibration"), int)
    }


def left_to_judge(
    connection: Connection, job_id: str, axis_id: str, span: Span, *, after: Cursor | None, limit: int
) -> list[MeasurementRecord]:
    """Return measurements beyond a cursor that are not staged as they stand now, in time order."""
    staged = and_(_STAGED.c.measurement_id == _MEASUREMENTS.c.id, _STAGED.c.job_id == job_id)
    joined = _MEASUREMENTS.outerjoin(_STAGED, staged)
    left = or_(_STAGED.c.seen_revision.is_(None), _STAGED.c.seen_revision != _MEASUREMENTS.c.revision)
    query = select(*_MEASUREMENT).select_from(joined)
    query = query.where(_MEASUREMENTS.c.axis_id == axis_id, *span.bounds(_MEASUREMENTS.c.started_at), left)
    order = (_MEASUREMENTS.c.started_at, _MEASUREMENTS.c.id)
    if after is not None:
        cursor = tuple_(literal(after[0], _MEASUREMENTS.c.started_at.type), literal(after[1]))
        query = query.where(cursor < tuple_(*order))
    return [MeasurementRecord(*row) for row in connection.execute(query.order_by(*order).limit(limit))]


def progress_of(connection: Connection, job_id: str, axis_id: str, span: Span) -> tuple[int, int]:
    """Return how many measurements a job has kept aside, and how many there are in its span."""
    within = (_MEASUREMENTS.c.axis_id == axis_id, *span.bounds(_MEASUREMENTS.c.started_at))
    total = connection.execute(select(func.count()).select_from(_MEASUREMENTS).where(*within)).scalar_one()
    done = connection.execute(select(func.count()).where(_STAGED.c.job_id == job_id)).scalar_one()
    return done, total


def windows_with_places(connection: Connection, measurement_id: int) -> list[StoredWindow]:
    """Return the windows of a measurement, refused ones included, in time order."""
    query = select(*PLACE, WindowRow.started_at, WindowRow.refusal_reason, WindowRow.refusal_detail)
    rows = connection.execute(query.where(WindowRow.measurement_id == measurement_id).order_by(WindowRow.started_at))
    return [StoredWindow(WaveformPlace(*row[:4]), *row[4:]) for row in rows]


def stage(connection: Connection, records: Sequence[StagedRecord]) -> None:
    """Keep measurements aside, in place of what was kept of them."""
    for record in records:
        own = (_STAGED.c.job_id == record.job_id, _STAGED.c.measurement_id == record.measurement_id)
        connection.execute(delete(_STAGED).where(*own))
        connection.execute(insert(_STAGED), {name: getattr(record, name) for name in StagedRecord.__slots__})


def staged(connection: Connection, job_id: str) -> Iterator[StagedRecord]:
    """Return what is kept aside, some at a time."""
    columns, after = [_STAGED.c[name] for name in StagedRecord.__slots__], 0
    while True:
        query = select(*columns).where(_STAGED.c.job_id == job_id, _STAGED.c.measurement_id > after)
        rows = connection.execute(query.order_by(_STAGED.c.measurement_id).limit(200)).all()
        yield from (StagedRecord(*row) for row in rows)
        if not rows:
            return
        after = rows[-1].measurement_id


def forget_staged(connection: Connection, job_id: str | None) -> None:
    """Forget what a job kept aside; by default what jobs did that are at their end."""
    if job_id is None:
        unfinished = select(_JOBS.c.id).where(UNFINISHED)
        connection.execute(delete(_STAGED).where(_STAGED.c.job_id.not_in(unfinished)))
    else:
        connection.execute(delete(_STAGED).where(_STAGED.c.job_id == job_id))


def forget_gone(connection: Connection, job_id: str) -> None:
    """Forget what a job kept aside of measurements that were joined into others before it was written."""
    is_there = exists().where(_MEASUREMENTS.c.id == _STAGED.c.measurement_id)
    connection.execute(delete(_STAGED).where(_STAGED.c.job_id == job_id, ~is_there))


def put_in_force(connection: Connection, axis_id: str, calibration_id: int) -> None:
    """Name the calibration that is in force on an axis."""
    connection.execute(update(_AXES).where(_AXES.c.id == axis_id).values(active_calibration_id=calibration_id))
