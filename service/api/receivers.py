"""``/v1/receivers``: who outside is told of alarms, how far, and what they never got."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel

from service.api.access import needs
from service.api.services import Services, services
from service.operations.access.scopes import Scope

router = APIRouter(prefix="/v1", tags=["operations"])


class DeadLetterOut(BaseModel):
    """A notice that a receiver never got."""

    notice: int
    at: datetime
    error: str


class ReceiverOut(BaseModel):
    """A receiver: how many notices wait for it, since when it takes none, and the last reason."""

    name: str
    waiting: int
    last_told_at: datetime | None
    failing_since: datetime | None
    next_try_at: datetime
    last_error: str | None
    dead_letters: list[DeadLetterOut]


class ReceiversOut(BaseModel):
    """All that are set up now."""

    receivers: list[ReceiverOut]


def receivers_out(on: Services) -> ReceiversOut:
    """Return on the wire how it stands with each receiver."""
    return ReceiversOut(
        receivers=[
            ReceiverOut(
                name=standing.row.name,
                waiting=standing.n_waiting,
                last_told_at=standing.row.last_told_at,
                failing_since=standing.row.failing_since,
                next_try_at=standing.row.next_try_at,
                last_error=standing.row.last_error,
                dead_letters=[
                    DeadLetterOut(notice=letter.notice_id, at=letter.at, error=letter.error)
                    for letter in standing.dead_letters
                ],
            )
            for standing in on.dispatcher.standings()
        ]
    )


@router.get("/receivers", dependencies=[needs(Scope.TRENDS_READ)])
def list_receivers(on: Annotated[Services, Depends(services)]) -> ReceiversOut:
    """List who is told of alarms, and how that stands."""
    return receivers_out(on)
