"""Keep the maintenance log of each axis, and let its charts know from when it was done.

With a new nut or screw they begin anew; with fresh grease the level is open to what it does.
"""

from collections.abc import Iterable
from datetime import datetime
from enum import StrEnum
from typing import Annotated

from pydantic import ConfigDict, Field

from service.clock import now, text_of
from service.errors import ConflictError, InvalidRequestError, UnknownResourceError
from service.operations.fields import Label, Moment, RequestModel, SetPreload
from service.operations.monitoring.intake.admission import MOST_AHEAD
from service.operations.monitoring.intake.epochs import begin_by_maintenance, go_on_from, take_back
from service.operations.monitoring.lost_motion import chart_again
from service.store import axes, intake
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import MaintenanceRow
from service.store.trend.epochs import MAINTENANCE, EpochRecord


class Work(StrEnum):
    """What was done."""

    LUBRICATED = axes.LUBRICATED
    NUT_REPLACED = axes.NUT_REPLACED
    SCREW_REPLACED = axes.SCREW_REPLACED
    MOUNTING = "mounting"
    OTHER = "other"


class MaintenanceIn(RequestModel):
    """An entry of the maintenance log."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "at": "2026-03-02T06:00:00Z", "who": "Anna", "kind": "nut-replaced", "note": "lot 7",
                    "set_preload_n": 300.0,
                }
            ]
        },
    )  # fmt: skip

    at: Annotated[Moment, Field(description="when it was done, which may be long ago")]
    who: Annotated[Label, Field(max_length=120, description="who did it")]
    kind: Work
    note: Annotated[str, Field(max_length=1000, pattern=r"^[^\x00]*$")] = ""
    set_preload_n: SetPreload | None = Field(default=None, description="to which the preload was set")
    corrects: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(
        default=None, description="number of the entry that this one takes the place of"
    )


def log_of(database: Database, axis_id: str) -> list[MaintenanceRow]:
    """Return all entries by when the work was done, corrected ones included."""
    with database.read() as session:
        get_axis(session, axis_id)
        return axes.maintenance_log(session, axis_id)


def enter(database: Database, axis_id: str, entry: MaintenanceIn) -> tuple[MaintenanceRow, bool]:
    """Add an entry and fold the charts again from where it changes them; tell whether it is new.

    The same entry sent once more is the one that is there. Raises InvalidRequestError if the work is still to be
    done; UnknownResourceError or ConflictError if it corrects no entry of the axis, or one that is corrected.
    """
    at = now()
    if entry.at > at + MOST_AHEAD:
        raise InvalidRequestError(f"an entry says what was done, until now ({text_of(at)}); got {text_of(entry.at)}")
    with database.write(axis_id) as session:
        get_axis(session, axis_id)
        log = axes.maintenance_log(session, axis_id)
        same = [row for row in log if _said(row) == entry.model_dump()]
        if same:
            return same[-1], False
        if entry.corrects is not None:
            _require_standing(axis_id, log, entry.corrects)
        row = MaintenanceRow(axis_id=axis_id, entered_at=at, **entry.model_dump())
        session.add(row)
        session.flush()
        connection = session.connection()
        before, after = _begins(axes.standing_entries(log)), _begins(axes.standing_entries([*log, row]))
        for moment in sorted(before ^ after):
            axis = intake.read_axis(connection, axis_id)
            epoch = EpochRecord(axis.number, moment, MAINTENANCE)
            (begin_by_maintenance if moment in after else take_back)(connection, axis, epoch)
        lubricated = _lubrications(axes.standing_entries(log)) ^ _lubrications(axes.standing_entries([*log, row]))
        if lubricated:
            go_on_from(connection, intake.read_axis(connection, axis_id), min(lubricated))
        if lubricated or before != after:
            chart_again(connection, axis_id)
        return row, True


def _said(row: MaintenanceRow) -> dict[str, object]:
    return {name: getattr(row, name) for name in MaintenanceIn.model_fields}


def _begins(rows: Iterable[MaintenanceRow]) -> set[datetime]:
    """Return when the charts begin anew."""
    return {row.at for row in rows if row.kind in axes.RENEWALS}


def _lubrications(rows: Iterable[MaintenanceRow]) -> set[datetime]:
    """Return when the axis was lubricated."""
    return {row.at for row in rows if row.kind == Work.LUBRICATED}


def _require_standing(axis_id: str, log: list[MaintenanceRow], number: int) -> None:
    if number not in {row.id for row in log}:
        raise UnknownResourceError(f"axis '{axis_id}' has no entry {number} in its maintenance log")
    by = next((row.id for row in log if row.corrects == number), None)
    if by is not None:
        raise ConflictError(f"entry {number} is corrected by entry {by} already; correct that one")
