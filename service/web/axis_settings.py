"""``/axes/{axis}/settings``: change settings in two steps: what they would change is shown before they are saved.

The form carries the settings as they were when it was shown. If somebody else changed them meanwhile, nothing is saved,
and the form is shown again with what was typed, and with what the other one changed.
"""

import json
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Form, Response
from pydantic import BaseModel, Field, ValidationError

from service.api.access import needs
from service.api.services import Services, ServicesOf
from service.errors import InvalidRequestError, PreconditionError, first_refusal
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, Label
from service.operations.monitoring.axes import settings_tag
from service.operations.monitoring.axis_configuration import AxisConfiguration, load_configuration
from service.operations.monitoring.consequences import Change, changes_between, outlook_of
from service.store.tables import AxisRow
from service.web.forms import MomentText, moment_of, number_of
from service.web.site import Page, PageOf, done

_Number = Annotated[str, Field(max_length=40)]


class SettingsForm(BaseModel):
    """What is typed; numbers with a decimal point or comma."""

    name: Label
    false_alarms_per_year: _Number
    silent_after_hours: _Number
    windows_per_measurement: _Number
    band_low_hz: _Number = ""
    band_high_hz: _Number = ""
    machine: Annotated[str, Field(max_length=200)] = ""
    machine_place: Annotated[str, Field(max_length=200)] = ""
    commissioned_preload_n: _Number = ""
    commissioned_at: MomentText = ""
    zone: Annotated[str, Field(max_length=60)] = "UTC"

    def settings(self) -> JsonObject:
        """Return the settings by their names in the configuration.

        Raises InvalidRequestError if something is no number or no moment, or one end of the band is missing.
        """
        low, high = number_of(self.band_low_hz, "search_band_hz"), number_of(self.band_high_hz, "search_band_hz")
        if (low is None) != (high is None):
            raise InvalidRequestError("search_band_hz: expected both ends of the band, or neither; got one of them")
        windows = number_of(self.windows_per_measurement, "windows_per_measurement")
        commissioned_at = self.moment
        return {
            "false_alarms_per_year": number_of(self.false_alarms_per_year, "false_alarms_per_year"),
            "silent_after_hours": number_of(self.silent_after_hours, "silent_after_hours"),
            "windows_per_measurement": int(windows) if windows is not None and windows.is_integer() else windows,
            "search_band_hz": None if low is None or high is None else [low, high],
            "machine": self.machine.strip() or None,
            "machine_place": self.machine_place.strip() or None,
            "commissioned_preload_n": number_of(self.commissioned_preload_n, "commissioned_preload_n"),
            "commissioned_at": None if commissioned_at is None else commissioned_at.isoformat(),
        }

    @property
    def moment(self) -> datetime | None:
        """When the axis was put into service; None if that was left empty, or is no moment yet."""
        return moment_of(self.commissioned_at, self.zone)


def form_of(name: str, configuration: AxisConfiguration) -> SettingsForm:
    """Return the form as it is shown first."""
    low, high = configuration.search_band_hz or (None, None)
    at = configuration.commissioned_at
    return SettingsForm(
        name=name,
        false_alarms_per_year=_text(configuration.false_alarms_per_year),
        silent_after_hours=_text(configuration.silent_after_hours),
        windows_per_measurement=_text(configuration.windows_per_measurement),
        band_low_hz=_text(low),
        band_high_hz=_text(high),
        machine=configuration.machine or "",
        machine_place=configuration.machine_place or "",
        commissioned_preload_n=_text(configuration.commissioned_preload_n),
        commissioned_at="" if at is None else at.strftime("%Y-%m-%dT%H:%M"),
    )


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.10g}"


router = APIRouter(include_in_schema=False)


class ChangeForm(SettingsForm):
    """What both steps send: the settings, and those that were stored when the form was shown."""

    tag: Annotated[str, Field(max_length=40)]
    was: Annotated[str, Field(max_length=40_000)]
    was_name: Annotated[str, Field(max_length=200)] = ""


@router.get("/axes/{axis}/settings", dependencies=[needs(Scope.TRENDS_READ)])
def settings_page(axis: AxisId, page: PageOf, on: ServicesOf) -> Response:
    """Show the settings as they are."""
    row, configuration = _stored(axis, on)
    return _form(axis, page, on, form_of(row.name, configuration))


def _stored(axis: str, on: Services) -> tuple[AxisRow, AxisConfiguration]:
    row = on.axes.get(axis)
    return row, load_configuration(row.configuration)


def _form(
    axis: str, page: Page, on: Services, form: SettingsForm, *,
    status: int = 200, refusal: str | None = None, theirs: tuple[Change, ...] = ()
) -> Response:  # fmt: skip
    row, configuration = _stored(axis, on)
    return page.show(
        "axis_settings.html",
        status=status,
        axis=row,
        form=form,
        tag=settings_tag(row.name, configuration),
        was=configuration.model_dump_json(exclude={"drive_model"}),
        was_name=row.name,
        refusal=refusal,
        theirs=theirs,
    )


@router.post("/axes/{axis}/settings/review", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def review(axis: AxisId, form: Annotated[ChangeForm, Form()], page: PageOf, on: ServicesOf) -> Response:
    """Show what would be changed and what follows from it; nothing is saved."""
    try:
        name, wanted = _wanted(axis, form, on)
        outlook = outlook_of(on.database, axis, name, wanted)
    except (ValidationError, InvalidRequestError) as error:
        return _form(axis, page, on, form, status=422, refusal=_sentence(error))
    row, configuration = _stored(axis, on)
    if form.tag != settings_tag(row.name, configuration):
        return _conflict(axis, page, on, form)
    return page.show("axis_settings_review.html", axis=row, form=form, outlook=outlook)


@router.post("/axes/{axis}/settings", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def save(axis: AxisId, form: Annotated[ChangeForm, Form()], page: PageOf, on: ServicesOf) -> Response:
    """Save, and go back to the axis; refused if somebody was faster."""
    try:
        name, wanted = _wanted(axis, form, on)
        on.axes.register(axis, name, wanted, if_match=form.tag)
    except PreconditionError:
        return _conflict(axis, page, on, form)
    except (ValidationError, InvalidRequestError) as error:
        return _form(axis, page, on, form, status=422, refusal=_sentence(error))
    return done(f"/axes/{axis}", "settings-saved")


def _wanted(axis: str, form: SettingsForm, on: Services) -> tuple[str, AxisConfiguration]:
    """Return name and configuration that are asked for; what the form does not hold stays as it is stored."""
    (_, configuration), settings = _stored(axis, on), form.settings()
    stored = configuration.model_dump(mode="json")
    moment = configuration.commissioned_at
    if moment is not None and moment.replace(second=0, microsecond=0) == form.moment:  # a form has no seconds
        del settings["commissioned_at"]
    return form.name, AxisConfiguration.model_validate_json(json.dumps(stored | settings))


def _conflict(axis: str, page: Page, on: Services, form: ChangeForm) -> Response:
    """Show the form again, with what was typed, and what somebody else changed since it was first shown."""
    row, configuration = _stored(axis, on)
    try:
        before = AxisConfiguration.model_validate_json(form.was).model_copy(
            update={"drive_model": configuration.drive_model}
        )
    except ValidationError as error:
        raise InvalidRequestError("the settings that the form was shown with cannot be read; open it again") from error
    theirs = changes_between((form.was_name, before), (row.name, configuration))
    return _form(axis, page, on, form, status=409, theirs=theirs)


def _sentence(error: ValidationError | InvalidRequestError) -> str:
    return str(error) if isinstance(error, InvalidRequestError) else first_refusal(error)
