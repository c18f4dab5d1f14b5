"""``/v1/system``, ``/v1/receivers``, ``/v1/audit``, ``/v1/changes``, ``/v1/advice``: how the service itself stands."""

from datetime import datetime
from typing import Annotated

from fastapi import Query, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.http.tables import TABLE_RESPONSE, TableQuery, table
from service.api.services import ServicesOf, api_router
from service.operations.access.scopes import Scope
from service.operations.advice import Look, Section
from service.operations.fields import AnswerModel, AxisName, RequestModel, ViewModel
from service.operations.system import system_status

router = api_router("operations")


class VersionsOut(AnswerModel):
    """What runs: the program, the schema and kind of the database, Python."""

    program: str
    schema_: Annotated[str, Field(alias="schema")]
    database: str
    python: str


class LagOut(AnswerModel):
    """How far intake is behind."""

    waiting_requests: Annotated[
        int, Field(validation_alias="n_waiting", description="that wait for their turn in this process")
    ]
    open_measurements: Annotated[int, Field(validation_alias="n_open", description="that wait for further windows")]
    last_received_at: Annotated[
        datetime | None, Field(validation_alias="received_at", description="when the newest window arrived")
    ]
    last_started_at: Annotated[
        datetime | None, Field(validation_alias="started_at", description="when that window was measured")
    ]
    mean_judging_s: Annotated[
        float | None,
        Field(
            validation_alias="judging_s",
            description="time to judge a measurement, since this process began; null: none yet",
        ),
    ]


class SystemOut(AnswerModel):
    """How the service stands; counts are of all axes since they were registered."""

    versions: VersionsOut
    lag: LagOut
    axes: Annotated[int, Field(validation_alias="n_axes")]
    archived_axes: Annotated[int, Field(validation_alias="n_archived")]
    refused_windows: dict[str, int]
    uncharted: dict[str, int]


@router.get("/system", dependencies=[needs(Scope.TRENDS_READ)])
def get_system(services: ServicesOf) -> SystemOut:
    """Return versions, how far intake is behind, and what was refused of all axes, by reason."""
    return SystemOut.model_validate(system_status(services.database, services.metrics, services.ingest))


class DeadLetterOut(AnswerModel):
    """A notice that a receiver never got."""

    notice: Annotated[int, Field(validation_alias="notice_id")]
    at: datetime
    error: str


class ReceiverOut(ViewModel):
    """A receiver: how many notices wait for it, since when it takes none, and the last reason."""

    name: str
    waiting: Annotated[int, Field(validation_alias="n_waiting")]
    last_told_at: datetime | None
    failing_since: datetime | None
    next_try_at: datetime
    last_error: str | None
    dead_letters: list[DeadLetterOut]


class ReceiversOut(BaseModel):
    """All that are set up now."""

    receivers: list[ReceiverOut]


@router.get("/receivers", dependencies=[needs(Scope.TRENDS_READ)])
def list_receivers(services: ServicesOf) -> ReceiversOut:
    """List who is told of alarms, and how that stands."""
    return ReceiversOut(receivers=services.dispatcher.standings())


class AuditEntryOut(AnswerModel):
    """One attempt to change something; `status` is that of the answer, null if the service ended before it gave any."""

    id: int
    at: datetime
    who: str
    action: str
    target: str
    axis: Annotated[str | None, Field(validation_alias="axis_id")]
    status: int | None
    request_id: str | None


class AuditOut(BaseModel):
    """Entries of the log, newest first; `next_cursor` fetches older ones."""

    entries: list[AuditEntryOut]
    next_cursor: int | None


class AuditQuery(TableQuery):
    """Which entries."""

    axis: AxisName | None = None
    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=1000)] = 100


@router.get("/audit", response_model=AuditOut, responses={200: TABLE_RESPONSE})
def list_audit(query: Annotated[AuditQuery, Query()], services: ServicesOf) -> AuditOut | StreamingResponse:
    """List who changed what, newest first."""

    def page(query: AuditQuery) -> tuple[list[AuditEntryOut], int | None]:
        rows = services.access.log(query.axis, query.cursor, query.limit)
        return [AuditEntryOut.model_validate(row) for row in rows], rows[-1].id if len(rows) == query.limit else None

    if query.format is not None:
        return table("audit", AuditEntryOut, query, page)
    entries, cursor = page(query)
    return AuditOut(entries=entries, next_cursor=cursor)


class ChangesQuery(RequestModel):
    """Since when."""

    since: Annotated[str, Field(max_length=200)] | None = Field(default=None, description="mark of an earlier answer")


class ChangesOut(BaseModel):
    """The mark of what is stored now; it says nothing but that it is another one."""

    mark: str


@router.get(
    "/changes",
    response_model=ChangesOut,
    responses={304: {"description": "nothing changed since"}},
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_changes(query: Annotated[ChangesQuery, Query()], services: ServicesOf) -> Response:
    """Ask whether anything changed: 304 if not, else the new mark. Made to be asked every second."""
    mark = services.changes.mark()
    if query.since == mark:
        return Response(status_code=304)
    return Response(ChangesOut(mark=mark).model_dump_json(), media_type="application/json")


class AdviceOut(AnswerModel):
    """What a code means, and what to check, the likeliest first; so many rows are of the plant's own file."""

    section: Section
    code: str
    says: str
    look: list[Look]
    own: Annotated[int, Field(validation_alias="n_own")]


class AdviceTableOut(BaseModel):
    """All that is known."""

    advice: list[AdviceOut]


@router.get("/advice", dependencies=[needs(Scope.TRENDS_READ)])
def list_advice(services: ServicesOf) -> AdviceTableOut:
    """List what to check for each cause of an alarm, state, refusal and doubt."""
    return AdviceTableOut(advice=list(services.advice.entries.values()))
