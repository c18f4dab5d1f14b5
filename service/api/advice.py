"""``/v1/advice``: what a cause, state, refusal or doubt means, and what to check next."""

from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel

from service.api.access import needs
from service.api.services import Services, services
from service.operations.access.scopes import Scope
from service.operations.advice import Advice, Look, Section

router = APIRouter(prefix="/v1", tags=["operations"])


class AdviceOut(BaseModel):
    """What a code means, and what to check, the likeliest first; so many rows are of the plant's own file."""

    section: Section
    code: str
    says: str
    look: list[Look]
    own: int


class AdviceTableOut(BaseModel):
    """All that is known."""

    advice: list[AdviceOut]


def advice_out(advice: Advice) -> AdviceOut:
    """Return advice as it is answered."""
    return AdviceOut(
        section=advice.section, code=advice.code, says=advice.says, look=list(advice.look), own=advice.n_own
    )


@router.get("/advice", dependencies=[needs(Scope.TRENDS_READ)])
def list_advice(on: Annotated[Services, Depends(services)]) -> AdviceTableOut:
    """List what to check for each cause of an alarm, state, refusal and doubt."""
    return AdviceTableOut(advice=[advice_out(advice) for advice in on.advice.entries.values()])
