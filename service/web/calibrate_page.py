"""``/axes/{axis}/calibrate``: guided calibration, fitted as a job; ``…/calibrations/{n}``: review, activate."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Final

import numpy as np
from fastapi import APIRouter, Form, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from monitor_core.errors import MonitorCoreError
from monitor_core.preload import Calibration, axial_frequency, estimate_preload
from monitor_core.recording import Conditions, Rejection
from monitor_core.recordings.calibration_file import calibration_from_document
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.uncertainty import Estimate
from service.api.access import needs
from service.api.calibrating import CalibrationPlanOut
from service.api.jobs import JobOut
from service.api.services import Services, ServicesOf
from service.documents.said import N_
from service.errors import ConflictError, InvalidRequestError, PreconditionError, status_of
from service.operations.access.scopes import Scope
from service.operations.calibrating.catalogue import AxisProposal
from service.operations.calibrating.fit_job import KIND, CalibrationJobIn, FittedReading
from service.operations.calibrating.plan import AxisPlan, PlanIn, calibration_plan
from service.operations.fields import AxisId, JobId, RowId, Text
from service.operations.monitoring.axis_configuration import load_configuration
from service.operations.monitoring.rejudgements import RejudgementIn
from service.report.calibration_charts import (
    NARROW,
    WIDE,
    Curve,
    Region,
    Spot,
    expected_chart,
    region_chart,
    residual_chart,
    settings_chart,
)
from service.web.forms import decimal_point
from service.web.shown import number
from service.web.site import Page, PageOf, done
from service.web.trend_view import Charts, twice
from service.web.words import Words

router = APIRouter(include_in_schema=False)

#: Measurements of the table, the newest first; the picture shows all that the plan rests on.
_LISTED: Final = 20
#: Preload levels whose regions are drawn, and places of each.
_LEVELS, _PLACES = 3, 9


class PlanForm(BaseModel):
    """What the page sends to plan otherwise, as it was typed."""

    from_mm: Annotated[str, Field(max_length=40)] = ""
    to_mm: Annotated[str, Field(max_length=40)] = ""
    highest_n: Annotated[str, Field(max_length=40)] = ""
    wished_loss_n: Annotated[str, Field(max_length=40)] = ""
    bolt_mm: Annotated[str, Field(max_length=40)] = ""
    bolts: Annotated[str, Field(max_length=40)] = ""

    def asked(self) -> PlanIn:
        """Return what is asked for; raises InvalidRequestError where a number is none."""
        typed = {name: decimal_point(text) for name, text in self.model_dump().items()}
        try:
            return PlanIn.model_validate({name: float(text) for name, text in typed.items() if text})
        except ValueError as error:  # pydantic's refusals are such, too
            raise InvalidRequestError(
                "expected positions in mm, a preload and a loss above 0 N, 1 to 100 bolts of 0.5 to 100 mm; got "
                f"{', '.join(typed.values())}"
            ) from error


class FitForm(BaseModel):
    """What the page sends to begin a fit."""

    comment: Annotated[str, Field(max_length=1000)] = ""
    use_known: bool = False
    by_drive_model: bool = False
    preload_n: Annotated[str, Field(max_length=40)] = ""
    preload_standard_uncertainty_n: Annotated[str, Field(max_length=40)] = ""

    def asked(self, prior: int | None) -> CalibrationJobIn:
        """Return what is asked for; raises InvalidRequestError where a number is none."""
        typed = {
            "preload_n": decimal_point(self.preload_n),
            "preload_standard_uncertainty_n": decimal_point(self.preload_standard_uncertainty_n),
        }
        try:
            stated = {name: float(text) for name, text in typed.items() if text}
            return CalibrationJobIn.model_validate(
                {"prior": prior, "comment": self.comment, "by_drive_model": self.by_drive_model, **stated}
            )
        except ValueError as error:  # pydantic's refusals are such, too
            raise InvalidRequestError(
                "expected a preload and its standard uncertainty, both above 0 N, or none of both; got "
                f"{' and '.join(text or 'nothing' for text in typed.values())}"
            ) from error


class ActivateForm(BaseModel):
    """What the page sends to put a calibration in force."""

    reason: Text = "reviewed"
    in_force: Annotated[str, Field(max_length=20)] = "none"  # when the page was read
    rejudge: bool = False


class ValidRange(BaseModel):
    """Where a calibration holds."""

    position_mm: tuple[float, float]
    preload_n: tuple[float, float]


class Document(BaseModel):
    """What the page shows of a calibration."""

    model_config = ConfigDict(extra="ignore")

    coefficients: dict[str, float]
    covariance: list[list[float]]
    n_readings: int
    residual_rms_hz: float | None
    residual_max_hz: float | None
    reproducibility_hz: float
    condition_number: float
    minimum_detectable_loss_n: float
    valid_range: ValidRange
    leave_one_position_out: list[dict[str, float | None]]
    prior: str | None = None


@router.get("/axes/{axis}/calibrate", dependencies=[needs(Scope.TRENDS_READ)])
def calibrate_page(axis: AxisId, page: PageOf, form: Annotated[PlanForm, Query()], on: ServicesOf) -> Response:
    """Show what to measure next, what is measured, how the fit stands, and the calibrations that there are."""
    return _calibrate_page(page, axis, form, on)


@router.post("/axes/{axis}/calibrate", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def fit(axis: AxisId, page: PageOf, form: Annotated[FitForm, Form()], on: ServicesOf) -> Response:
    """Begin a fit in the background; whoever comes back to the page finds it."""
    prior = on.axes.get(axis).active_calibration_id if form.use_known else None
    try:
        on.calibration_jobs.start(axis, form.asked(prior))
    except (InvalidRequestError, MonitorCoreError) as error:
        return _calibrate_page(page, axis, PlanForm(), on, refusal=str(error), status=status_of(error)[0])
    return done(f"/axes/{axis}/calibrate", "fit-begun")


@router.post("/axes/{axis}/calibrate/{job}/cancel", dependencies=[needs(Scope.REPLAYS_RUN)])
def cancel(axis: AxisId, job: JobId, on: ServicesOf) -> Response:
    """Stop a fit."""
    row = on.jobs.get(job)
    if (row.kind, row.axis_id) != (KIND, axis):
        raise InvalidRequestError(f"expected a fit of axis '{axis}'; got job {job} of kind {row.kind}")
    on.jobs.cancel(job)
    return done(f"/axes/{axis}/calibrate", "fit-cancelled")


@router.get("/axes/{axis}/calibrations/{calibration}", dependencies=[needs(Scope.TRENDS_READ)])
def calibration_page(
    axis: AxisId,
    calibration: RowId,
    page: PageOf,
    on: ServicesOf,
    other: Annotated[int | None, Query(alias="with", ge=1, lt=2**63)] = None,
) -> Response:
    """Show a calibration for review, against the one in force or another one."""
    overview = on.calibrations.overview(axis)
    chosen, active = on.calibrations.get(axis, calibration)
    against = other or (active if active != calibration else None)
    rival = None if against is None else on.calibrations.get(axis, against)[0]
    readings, row = on.calibration_jobs.readings_of(axis, calibration), on.axes.get(axis)
    document = Document.model_validate(chosen.document)
    regions = preload_regions(calibration_from_document(chosen.document))
    return page.show(
        "calibration.html",
        axis=row,
        calibration=chosen,
        document=document,
        uncertainties=_uncertainties(document),
        rival=rival,
        rival_document=None if rival is None else Document.model_validate(rival.document),
        active=active,
        stale=on.trend.revision(axis)[1],
        others=[row for row in overview.calibrations if row.id != calibration],
        readings=readings,
        charts=residual_charts(page.words, readings),
        regions=regions,
        region_charts=region_charts(page.words, regions),
        regions_apart=all(are_apart(*levels) for levels in pairwise(regions)),
        can_rejudge=row.last_measurement_id is not None,
    )


@router.post("/axes/{axis}/calibrations/{calibration}/activate", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def activate(axis: AxisId, calibration: RowId, form: Annotated[ActivateForm, Form()], on: ServicesOf) -> Response:
    """Put a calibration in force, or an earlier one again; what was measured before is judged by it where wanted."""
    _, active = on.calibrations.get(axis, calibration)
    seen = "none" if active is None else str(active)
    refused = ConflictError(
        f"another calibration came into force meanwhile: expected {form.in_force}, as the page said; got {seen}. "
        "Look at it before you put another one in its place"
    )
    if seen != form.in_force:
        raise refused
    if form.rejudge:
        on.rejudgements.start(axis, RejudgementIn(calibration=calibration, reason=form.reason))
        return done(f"/axes/{axis}", "judged-anew")
    try:
        on.calibrations.activate(axis, calibration, form.reason, expected_active=form.in_force)
    except PreconditionError as error:
        raise refused from error
    return done(f"/axes/{axis}", "activated")


def _calibrate_page(
    page: Page, axis: str, form: PlanForm, on: Services, *, refusal: str = "", status: int = 200
) -> Response:
    from monitor_core.models.preload_share import usual_log_preload  # noqa: PLC0415  # a start pays for no analysis

    row, overview, newest = on.axes.get(axis), on.calibrations.overview(axis), on.calibration_jobs.newest(axis)
    try:
        plan = calibration_plan(on.database, axis, form.asked())
    except (InvalidRequestError, MonitorCoreError) as error:
        refusal, status, plan = refusal or str(error), 422, calibration_plan(on.database, axis, PlanIn())
    shown = CalibrationPlanOut.model_validate(plan)
    return page.show(
        "calibrate.html",
        status=status,
        axis=row,
        plan=shown,
        next_to_set=next((each for each in shown.preloads if each.preload_n == shown.next.preload_n), None),
        settings=[(item, kind_of(item.status, item.frequency_hz)) for item in shown.measured[: -_LISTED - 1 : -1]],
        n_usable=len(plan.usable),
        charts=settings_charts(page.words, plan),
        form=form,
        configuration=load_configuration(row.configuration),
        usual_factor=math.exp(1.96 * usual_log_preload(1.0).standard_uncertainty),
        job=None if newest is None else JobOut.model_validate(newest),
        calibrations=overview.calibrations,
        active=overview.active,
        stale=on.trend.revision(axis)[1],
        activations=overview.activations,
        documents={row.id: Document.model_validate(row.document) for row in overview.calibrations},
        refusal=refusal,
    )


def _uncertainties(document: Document) -> dict[str, float]:
    """Return the standard uncertainties of the coefficients; they come first in the covariance."""
    return {name: document.covariance[i][i] ** 0.5 for i, name in enumerate(document.coefficients)}


def expected_charts(words: Words, proposal: AxisProposal) -> Charts:
    """Draw where the first axial mode is expected."""
    mode = proposal.mode
    curve = Curve(
        [to_millimetres(x) for x in mode.position.tolist()], mode.frequency.tolist(), mode.lower.tolist(),
        mode.upper.tolist(), proposal.search_band_hz,
    )  # fmt: skip
    title = words(N_("Expected first axial frequency over the position of the table"))
    return twice(words, lambda size, write: expected_chart(curve, size, title, write), WIDE, NARROW)


def settings_charts(words: Words, plan: AxisPlan) -> Charts:
    """Draw the map of positions and preloads, with what is measured, awaited, refused and still to be measured."""
    spots = [
        *(
            Spot(to_millimetres(hole.position), hole.preload, "hole", words(N_("not measured yet")))
            for hole in plan.plan.holes
        ),
        *(
            Spot(item.position_mm, item.set_preload_n, kind, _words_of(words, kind))
            for item in plan.measured
            for kind in [kind_of(item.status, item.frequency_hz)]
        ),
        Spot(to_millimetres(plan.plan.proposed.position), plan.plan.proposed.preload, "next", words(N_("next"))),
    ]
    title = words(N_("Settings of the calibration: preload over position"))
    return twice(words, lambda size, write: settings_chart(spots, size, title, write), WIDE, NARROW)


def kind_of(status: str, frequency_hz: float | None) -> str:
    """Return how a measurement stands on the map."""
    if frequency_hz is not None:
        return "measured"
    return "waiting" if status == "open" else "refused"


def residual_charts(words: Words, readings: Sequence[FittedReading]) -> Charts | None:
    """Draw what is left of the readings about a fit; None if they are not known."""
    if not readings:
        return None
    spots = [
        Spot(item.position_mm, item.residual_hz, "measured", f"{number(words, item.preload_n)} N") for item in readings
    ]
    title = words(N_("What is left of each reading about the fit, over the position"))
    return twice(words, lambda size, write: residual_chart(spots, size, title, write), WIDE, NARROW)


def preload_regions(calibration: Calibration) -> list[Region]:
    """Return where one measurement reads each of three levels; none if the calibration holds at one preload alone.

    Fig. 8 of Nguyen et al. (2018), by the 95 % interval of a measurement where the paper has that of a mean. The levels
    span the calibrated preloads, under the payload and temperature of the calibration.
    """
    reference = (calibration.reference_payload, calibration.reference_temperature)
    travel = np.linspace(calibration.position.lower, calibration.position.upper, _PLACES).tolist()

    def read(position: float, preload: float) -> tuple[float, float]:
        frequency = Estimate(axial_frequency(position, preload, calibration.coefficients), 0.0)
        told = estimate_preload(frequency, Conditions(position, *reference), calibration)
        if isinstance(told, Rejection):
            raise AssertionError(f"a calibration answers where it holds; got {told.detail}")
        return told.interval.lower, told.interval.upper

    levels = np.unique(np.linspace(calibration.preload.lower, calibration.preload.upper, _LEVELS)).tolist()
    return [
        Region(level, [to_millimetres(x) for x in travel], [read(x, level) for x in travel])
        for level in levels
        if len(levels) > 1
    ]


def are_apart(lower: Region, higher: Region) -> bool:
    """Return whether two regions overlap nowhere."""
    return all(a[1] < b[0] for a, b in zip(lower.interval_95_n, higher.interval_95_n, strict=True))


def region_charts(words: Words, regions: Sequence[Region]) -> Charts | None:
    """Draw regions over the position; None if there are none."""
    if not regions:
        return None
    title = words(N_("Between which preloads each of three levels is read, over the position"))
    return twice(words, lambda size, write: region_chart(regions, size, title, write), WIDE, NARROW)


def _words_of(words: Words, kind: str) -> str:
    return words(
        {"measured": N_("measured"), "waiting": N_("windows are awaited"), "refused": N_("no mode was found")}[kind]
    )
