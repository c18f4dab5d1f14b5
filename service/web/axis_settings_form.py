"""The fields of the settings of an axis, as a page shows and sends them."""

from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, Field

from service.errors import InvalidRequestError
from service.json_types import JsonObject
from service.operations.fields import Label
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.web.forms import MomentText, moment_of, number_of

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
