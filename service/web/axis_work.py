"""``/axes/{axis}/work``: log what was done to an axis, and all that was logged; archive it and take it back."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Form, Query, Request, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import ServicesOf
from service.clock import now
from service.errors import InvalidRequestError, UnknownResourceError
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, RequestModel
from service.operations.monitoring import maintenance
from service.operations.monitoring.lost_motion import LostMotionIn, TorqueQuantity
from service.operations.monitoring.maintenance import MaintenanceIn, Work
from service.store.tables import MaintenanceRow
from service.web.forms import MomentText, moment_of, number_of
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)


class WorkQuery(RequestModel):
    """Which entry is to be corrected, if any."""

    corrects: Annotated[int, Field(ge=1, lt=2**63)] | None = None
    done: Annotated[str, Field(max_length=40)] = ""


class WorkForm(BaseModel):
    """What the page sends."""

    kind: Work
    at: MomentText = ""
    zone: Annotated[str, Field(max_length=60)] = "UTC"
    note: Annotated[str, Field(max_length=1000, pattern=r"^[^\x00]*$")] = ""
    set_preload_n: Annotated[str, Field(max_length=40)] = ""
    corrects: Annotated[int, Field(ge=1, lt=2**63)] | None = None


@router.get("/axes/{axis}/work", dependencies=[needs(Scope.ALARMS_ACK)])
def work_page(axis: AxisId, page: PageOf, query: Annotated[WorkQuery, Query()], on: ServicesOf) -> Response:
    """Show the form and the log, newest first."""
    log = maintenance.log_of(on.database, axis)[::-1]
    return page.show(
        "axis_work.html",
        axis=on.axes.get(axis),
        log=log,
        corrected={row.corrects for row in log},
        meant=_entry(axis, log, query.corrects),
        kinds=list(Work),
        now=now(),
    )


def _entry(axis: str, log: list[MaintenanceRow], number: int | None) -> MaintenanceRow | None:
    if number is None:
        return None
    entry = next((row for row in log if row.id == number), None)
    if entry is None:
        raise UnknownResourceError(f"axis '{axis}' has no entry {number} in its maintenance log")
    return entry


@router.post("/axes/{axis}/work", dependencies=[needs(Scope.ALARMS_ACK)])
def log_work(axis: AxisId, form: Annotated[WorkForm, Form()], request: Request, on: ServicesOf) -> Response:
    """Enter what was done, by who is logged in, and go back to the axis."""
    entry = {
        "at": _when(form),
        "who": request.state.caller.signature[:120],
        "kind": form.kind,
        "note": form.note,
        "set_preload_n": number_of(form.set_preload_n, "set_preload_n"),
        "corrects": form.corrects,
    }
    maintenance.enter(on.database, axis, MaintenanceIn.model_validate(entry))
    return done(f"/axes/{axis}", "logged")


def _when(form: WorkForm) -> datetime:
    at = moment_of(form.at, form.zone)
    if at is None:
        raise InvalidRequestError("expected when the work was done; got nothing")
    return at


class LostMotionForm(BaseModel):
    """Lost motion as somebody measured it, in numbers with a decimal point or comma."""

    measurement: Annotated[str, Field(min_length=1, max_length=200)]
    at: MomentText
    zone: Annotated[str, Field(max_length=60)] = "UTC"
    position_mm: Annotated[str, Field(max_length=40)]
    reversal_value_um: Annotated[str, Field(max_length=40)]
    standard_uncertainty_um: Annotated[str, Field(max_length=40)]
    half_interval_um: Annotated[str, Field(max_length=40)]
    n_reversals: Annotated[int, Field(ge=4, le=1_000_000)]


@router.post("/axes/{axis}/lost-motion", dependencies=[needs(Scope.WINDOWS_WRITE)])
def enter_lost_motion(axis: AxisId, form: Annotated[LostMotionForm, Form()], on: ServicesOf) -> Response:
    """Take lost motion as `preload lost-motion` or a dial gauge tells it, and go back to the axis."""
    names = ("position_mm", "reversal_value_um", "standard_uncertainty_um", "half_interval_um")
    stated = {name: number_of(getattr(form, name), name) for name in names}
    value, half = stated["reversal_value_um"], stated["half_interval_um"]
    if value is None or half is None:
        raise InvalidRequestError("expected the reversal value and half of its interval; got nothing")
    reading = {
        "at": moment_of(form.at, form.zone),
        "measurement": form.measurement,
        "position_mm": stated["position_mm"],
        "reversal_value_um": value,
        "reversal_value_standard_uncertainty_um": stated["standard_uncertainty_um"],
        "reversal_value_interval_95_um": (value - half, value + half),
        "n_reversals": form.n_reversals,
    }
    on.readings.take(axis, [LostMotionIn.model_validate(reading)])
    return done(f"/axes/{axis}", "lost-motion-entered")


@router.post("/axes/{axis}/torque/{quantity}/found-in-order", dependencies=[needs(Scope.ALARMS_ACK)])
def find_in_order(axis: AxisId, quantity: TorqueQuantity, on: ServicesOf) -> Response:
    """Learn the level of a quantity anew, and go back to the axis."""
    on.readings.find_in_order(axis, quantity)
    return done(f"/axes/{axis}", "learnt-anew")


@router.post("/axes/{axis}/archive", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def archive(axis: AxisId, on: ServicesOf) -> Response:
    """Hide an axis from the fleet."""
    on.axes.archive(axis, archived=True)
    return done(f"/axes/{axis}", "archived")


@router.post("/axes/{axis}/unarchive", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def take_back(axis: AxisId, on: ServicesOf) -> Response:
    """Take an archived axis back."""
    on.axes.archive(axis, archived=False)
    return done(f"/axes/{axis}", "taken-back")
