"""``/axes/new``: name and machine, and what a catalogue says of the axis, if anything; no model is made up."""

import re
import unicodedata
from typing import Annotated, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Form, Query, Response
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from monitor_core.errors import MonitorCoreError
from service.api.access import needs
from service.api.services import Services, ServicesOf
from service.errors import ConflictError, ServiceError, first_refusal, status_of
from service.operations.access.scopes import Scope
from service.operations.calibrating.catalogue import AxisProposal, CatalogueIn, axis_proposal
from service.operations.fields import AxisName, Label
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.web.calibrate_page import expected_charts
from service.web.forms import decimal_point
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)

NEW: Final = "new"
_NAME: Final[TypeAdapter[str]] = TypeAdapter(AxisName)
_LABEL: Final[TypeAdapter[str]] = TypeAdapter(Label)
#: What a catalogue states in numbers: all of it, or nothing, and then no model is made up.
NUMBERS: Final = (
    "screw_diameter_mm", "screw_lead_mm", "screw_length_mm", "moved_mass_kg", "nut_stiffness_n_per_um",
    "dynamic_load_rating_n",
)  # fmt: skip


class NewAxisForm(BaseModel):
    """What the page sends, as it was typed: what does not fit is said on the page, with all that was typed."""

    name: Annotated[str, Field(max_length=200)] = ""
    machine: Annotated[str, Field(max_length=200)] = ""
    screw_diameter_mm: Annotated[str, Field(max_length=40)] = ""
    screw_lead_mm: Annotated[str, Field(max_length=40)] = ""
    screw_length_mm: Annotated[str, Field(max_length=40)] = ""
    moved_mass_kg: Annotated[str, Field(max_length=40)] = ""
    nut_stiffness_n_per_um: Annotated[str, Field(max_length=40)] = ""
    dynamic_load_rating_n: Annotated[str, Field(max_length=40)] = ""
    nut: Annotated[str, Field(max_length=40)] = "double"
    bearings: Annotated[str, Field(max_length=40)] = "fixed-supported"
    excitation_source: Annotated[str, Field(max_length=40)] = "sensor"

    def catalogue(self) -> CatalogueIn | None:
        """Return the catalogue data, None if nothing of it is stated; raises ValidationError."""
        typed = self.model_dump(exclude={"name", "machine"})
        if not any(typed[name].strip() for name in NUMBERS):
            return None
        return CatalogueIn.model_validate({name: decimal_point(text) for name, text in typed.items()})


@router.get("/axes/new", dependencies=[needs(Scope.TRENDS_READ)])
def new_axis_page(page: PageOf, form: Annotated[NewAxisForm, Query()], on: ServicesOf) -> Response:
    """Show the form, and the band that its data let expect."""
    proposal, refusal = _proposal(form)
    return _page(page, form, on, proposal, refusal=refusal)


@router.post("/axes/new", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def register_axis(page: PageOf, form: Annotated[NewAxisForm, Form()], on: ServicesOf) -> Response:
    """Register the axis and lead on to its first recording; what does not fit is said, and stays as it was typed."""
    proposal, refusal = _proposal(form)
    if refusal:
        return _page(page, form, on, None, refusal=refusal, status=422)
    name, machine = form.name.strip(), form.machine.strip()
    try:
        axis_id = axis_id_of(name)
        configuration = AxisConfiguration(
            search_band_hz=None if proposal is None else proposal.search_band_hz,
            excitation_source="drive" if form.excitation_source == "drive" else "sensor",
            drive_model=None if proposal is None else proposal.drive_model,
            machine=_LABEL.validate_python(machine) if machine else None,
        )
        on.axes.register(axis_id, _LABEL.validate_python(name), configuration, only_new=True)
    except ValidationError as error:
        return _page(page, form, on, proposal, refusal=f"name: {first_refusal(error)}", status=422)
    except ConflictError as error:
        return _page(page, form, on, proposal, refusal=str(error), status=409)
    except (ServiceError, MonitorCoreError) as error:
        return _page(page, form, on, proposal, refusal=str(error), status=status_of(error)[0])
    return done(f"/axes/{axis_id}/import", "registered")


def axis_id_of(name: str) -> str:
    """Return the identifier of an axis of that name; raises ValidationError or ConflictError."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    axis_id = _NAME.validate_python(re.sub(r"[^A-Za-z0-9._]+", "-", plain).strip("-._")[:64].lower())
    if axis_id == NEW:  # the address of this page
        raise ConflictError(f"an axis cannot be called '{NEW}'; choose another name")
    return axis_id


def _proposal(form: NewAxisForm) -> tuple[AxisProposal | None, str]:
    """Return what follows from the data, or why nothing does, in a sentence; neither if nothing is stated."""
    try:
        catalogue = form.catalogue()
        return None if catalogue is None else axis_proposal(catalogue), ""
    except ValidationError as error:
        return None, first_refusal(error)
    except MonitorCoreError as error:
        return None, str(error)


#: What a catalogue says of a small milling machine, to look at.
_EXAMPLE: Final = urlencode(CatalogueIn().model_dump(include=set(NUMBERS)))


def _page(
    page: PageOf, form: NewAxisForm, on: Services, proposal: AxisProposal | None, *, refusal: str, status: int = 200
) -> Response:
    charts = None if proposal is None else expected_charts(page.words, proposal)
    machines = sorted({m for axis in on.trend.fleet().axes if (m := axis.configuration.machine)})
    return page.show(
        "new_axis.html",
        status=status,
        form=form,
        proposal=proposal,
        refusal=refusal,
        machines=machines,
        charts=charts,
        example=_EXAMPLE,
    )
