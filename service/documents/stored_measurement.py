"""Read back what was said about a measurement."""

import math
from datetime import datetime
from typing import TYPE_CHECKING

from pydantic import (
    BaseModel,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
)

from monitor_core.preload import SHOWN_BY_SESSIONS
from monitor_core.recording import Conditions, DoubtReason
from monitor_core.recordings.elements.units import metres
from monitor_core.uncertainty import Estimate
from service.documents.frequency_fall import FrequencyFall, fall_between
from service.documents.measurement import (
    Ends,
    Share,
    charted,
    excess_variance,
    if_stated_in_words,
    interval_of,
    with_what_was_learnt,
)
from service.json_types import JsonObject

if TYPE_CHECKING:
    from service.store.trend.points import TrendPoint


class Doubt(BaseModel):
    """What speaks against a preload."""

    model_config = ConfigDict(frozen=True)

    reason: str
    detail: str


class Compared(BaseModel):
    """A quantity of a measurement against the calibration."""

    model_config = ConfigDict(frozen=True)

    relative_difference: float | None
    standard_deviations: float | None


class IfStated(BaseModel):
    """An interval as it would be if some quantities were stated that are not [N]."""

    model_config = ConfigDict(frozen=True)

    quantities: tuple[str, ...]
    interval_95_n: Ends


class StoredMeasurement(BaseModel):
    """What was said about a measurement, as :func:`~service.documents.measurement.measurement_document` laid it out.

    A member that cannot be read is missing, and the rest is read; what nobody here reads goes on as it is.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    measurement_id: int | None = None
    measurement: str | None = None
    started_at: datetime | None = None
    position_mm: float | None = None
    frequency_hz: float | None = None
    preload_n: float | None = None
    interval_95_n: Ends | None = None
    calibration: int | None = None
    refused: bool = False
    reason: str | None = None  # of a refusal
    detail: str | None = None
    frequency_standard_uncertainty_hz: float | None = None
    damping_ratio: float | None = None
    residue_phase_rad: float | None = None
    coherence: float | None = None
    n_averages: float | None = None
    n_modes: int = 1
    warnings: tuple[str, ...] = ()
    windows_dropped: int = 0
    payload_kg: float | None = None
    temperature_c: float | None = None
    interval_kind: str | None = None
    outside: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    compared_with_calibration: dict[str, Compared] = {}
    preload_feature_s2: float | None = None
    preload_feature_standard_uncertainty_s2: float | None = None
    variance_shares: dict[str, float] = {}
    friction_torque_nm: float | None = None
    if_stated: tuple[IfStated, ...] = ()
    drag_torque_nm: float | None = None
    baseline_preload_n: float | None = None
    uncharted: str | None = None  # why it moved no chart
    expected_frequency_hz: float | None = None  # of a healthy axis there; without a calibration
    expected_frequency_standard_uncertainty_hz: float | None = None
    frequency_fall_percent: float | None = None
    frequency_fall_interval_95_percent: tuple[float, float] | None = None

    @field_validator("*", mode="wrap")
    @classmethod
    def _missing_if_unreadable(cls, value: object, read: ValidatorFunctionWrapHandler, info: ValidationInfo) -> object:
        try:
            return read(value)
        except ValidationError:
            return cls.model_fields[str(info.field_name)].default

    @classmethod
    def of(cls, document: object, point: "TrendPoint | None" = None) -> "StoredMeasurement":
        """Read a stored document, with what its point of the trend adds to it."""
        measured = cls.model_validate(document if isinstance(document, dict) else {})
        return measured if point is None else measured.model_copy(update=_added(measured, point))

    def document(self) -> JsonObject:
        """Return the members that are stated, for the wire."""
        return self.model_dump(mode="json", exclude_unset=True)

    @property
    def conditions(self) -> Conditions | None:
        """The conditions that the measurement states."""
        if self.position_mm is None:
            return None
        return Conditions(metres(self.position_mm), self.payload_kg, self.temperature_c)

    def fall(self, share: Share) -> FrequencyFall | None:
        """How far the frequency lies below that of the healthy axis there; None where that is not known.

        ``share`` tells that of 1/f² which depends on the preload, by a drive model, None without one; it takes models.
        """
        frequency, own = self.frequency_hz, self.frequency_standard_uncertainty_hz
        expected, uncertainty = self.expected_frequency_hz, self.expected_frequency_standard_uncertainty_hz
        if frequency is None or own is None or expected is None or uncertainty is None:
            return None
        return fall_between(Estimate(frequency, own), Estimate(expected, uncertainty), share())

    @property
    def half_width_n(self) -> float | None:
        """Half of the width of the interval; None if an end is open."""
        lower, upper = self.interval_95_n or (None, None)
        return None if lower is None or upper is None else (upper - lower) / 2.0

    @property
    def brought(self) -> str:
        """What stating a quantity would bring, in words; empty where all is stated."""
        better = ((each.quantities, each.interval_95_n) for each in self.if_stated)
        return if_stated_in_words(self.interval_95_n or (None, None), better)


#: Of an axis of which nothing was measured yet.
NOTHING_MEASURED = StoredMeasurement()


def _added(measured: StoredMeasurement, point: "TrendPoint") -> dict[str, object]:
    """Return what the measurement did to the charts, and what its axis had learnt, which later arrivals may change."""
    added: dict[str, object] = {"state": point.state, "charted": charted(point), "uncharted": point.uncharted}
    if point.baseline_preload_n is not None:
        added["baseline_preload_n"] = point.baseline_preload_n
    if point.expected_frequency_hz is not None:
        added |= {
            "expected_frequency_hz": point.expected_frequency_hz,
            "expected_frequency_standard_uncertainty_hz": point.expected_frequency_uncertainty_hz,
        }
        fall = measured.model_copy(update=added).fall(lambda: None)
        if fall is not None:
            added |= {
                "frequency_fall_percent": fall.percent, "frequency_fall_interval_95_percent": fall.interval_95_percent,
            }  # fmt: skip
    if point.places_disagree is not None and "doubts" in measured.model_fields_set:
        of_session = Doubt(reason=str(DoubtReason.PLACES_DISAGREE), detail=point.places_disagree)
        added["doubts"] = (*measured.doubts, of_session)
    own, shares = measured.preload_feature_standard_uncertainty_s2, measured.variance_shares
    excess = excess_variance(point)
    if excess != 0.0 and own is not None and shares and own**2 + excess > 0.0:
        total = own**2 + excess
        added |= {
            "interval_95_n": interval_of(point),
            "if_stated": tuple(
                better.model_copy(update={"interval_95_n": with_what_was_learnt(better.interval_95_n, point)})
                for better in measured.if_stated
            ),
            "preload_feature_standard_uncertainty_s2": math.sqrt(total),
            "variance_shares": _shares_with(shares, excess / own**2),
        }
    return added


def _shares_with(shares: dict[str, float], excess: float) -> dict[str, float]:
    """Return shares of a variance that is larger or smaller by so much of itself, as sessions have shown."""
    shown = sum(shares.get(name, 0.0) for name in SHOWN_BY_SESSIONS)
    if excess > 0.0:
        changed = {"between_session": shares.get("between_session", 0.0) + excess}
    else:
        left = max(1.0 + excess / shown, 0.0) if shown else 0.0
        changed = {name: shares[name] * left for name in SHOWN_BY_SESSIONS if name in shares}
    new = shares | changed
    return {name: share / sum(new.values()) for name, share in new.items()}
