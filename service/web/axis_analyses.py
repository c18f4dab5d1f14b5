"""``/axes/{axis}/identifications`` and ``…/discrepancies``: begin an analysis of stored measurements of an axis."""

from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Form, Response
from pydantic import Field, ValidationError

from monitor_core.errors import MonitorCoreError
from service.api.access import needs
from service.api.services import Services, ServicesOf
from service.errors import ServiceError, first_refusal
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.analysis_job import MOST_MEASUREMENTS
from service.operations.discrepancy_job import DiscrepancyIn
from service.operations.fields import AxisId
from service.operations.identification_job import IdentificationIn
from service.operations.monitoring.axis_configuration import load_configuration
from service.store.tables import JobRow
from service.store.trend.points import Span
from service.web.forms import SpanForm, number_of
from service.web.site import Page, PageOf, done

router = APIRouter(include_in_schema=False)

Question = Literal["identifications", "discrepancies"]


class AnalysisForm(SpanForm):
    """Which measurements are held against which model."""

    model: Annotated[str, Field(max_length=20_000)] = ""
    hold_out_mm: Annotated[str, Field(max_length=400)] = ""
    accelerometer: Literal["", "table", "nut"] = ""

    def arguments(self) -> JsonObject:
        """Return what both questions have in common, as the API takes it."""
        span = self.span
        positions = [number_of(part, "hold_out_mm") for part in self.hold_out_mm.replace(";", " ").split()]
        return {
            "measurements": {"from": _text(span.start), "to": _text(span.end)},
            "hold_out_mm": [position for position in positions if position is not None],
            "accelerometer": self.accelerometer or None,
        }


def _text(moment: datetime | None) -> str | None:
    return None if moment is None else moment.isoformat()


@router.get("/axes/{axis}/identifications", dependencies=[needs(Scope.REPLAYS_RUN)])
def identifications_page(axis: AxisId, page: PageOf, on: ServicesOf) -> Response:
    """Show the form that begins an identification."""
    return _form(axis, "identifications", page, on)


@router.get("/axes/{axis}/discrepancies", dependencies=[needs(Scope.REPLAYS_RUN)])
def discrepancies_page(axis: AxisId, page: PageOf, on: ServicesOf) -> Response:
    """Show the form that begins a comparison with the model."""
    return _form(axis, "discrepancies", page, on)


@router.post("/axes/{axis}/identifications", dependencies=[needs(Scope.REPLAYS_RUN)])
def identify(axis: AxisId, form: Annotated[AnalysisForm, Form()], page: PageOf, on: ServicesOf) -> Response:
    """Begin an identification."""
    return _begin(axis, "identifications", page, on, form)


@router.post("/axes/{axis}/discrepancies", dependencies=[needs(Scope.REPLAYS_RUN)])
def compare(axis: AxisId, form: Annotated[AnalysisForm, Form()], page: PageOf, on: ServicesOf) -> Response:
    """Begin a comparison with the model."""
    return _begin(axis, "discrepancies", page, on, form)


def _form(axis: str, question: Question, page: Page, on: Services) -> Response:
    """Show the form, with the model of the axis and its newest measurements in it."""
    newest = on.trend.page(axis, Span(), cursor=None, limit=MOST_MEASUREMENTS, newest_first=True).points
    model = load_configuration(on.axes.get(axis).configuration).drive_model
    return _page(axis, question, page, on, AnalysisForm(model=model or ""), first=newest[-1].at if newest else None)


def _page(
    axis: str, question: Question, page: Page, on: Services, form: AnalysisForm, *,
    first: datetime | None = None, refusal: str | None = None
) -> Response:  # fmt: skip
    return page.show(
        "axis_analysis.html",
        status=200 if refusal is None else 422,
        axis=on.axes.get(axis),
        question=question,
        form=form,
        first=first,
        refusal=refusal,
        most=MOST_MEASUREMENTS,
    )


def _begin(axis: str, question: Question, page: Page, on: Services, form: AnalysisForm) -> Response:
    """Begin the job and lead to it; what cannot be answered is said at the form, with what was typed still in it."""
    try:
        row = _begun(axis, question, form, on)
    except ValidationError as error:
        return _page(axis, question, page, on, form, refusal=first_refusal(error))
    except (ServiceError, MonitorCoreError) as error:
        return _page(axis, question, page, on, form, refusal=str(error))
    return done(f"/jobs/{row.id}", "begun")


def _begun(axis: str, question: Question, form: AnalysisForm, on: Services) -> JobRow:
    if question == "identifications":
        return on.identifications.start(axis, IdentificationIn.model_validate(form.arguments() | {"model": form.model}))
    return on.discrepancies.start(axis, DiscrepancyIn.model_validate(form.arguments() | {"baseline": form.model}))
