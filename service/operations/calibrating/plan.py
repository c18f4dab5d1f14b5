"""Plan the calibration of an axis by what was measured of it: where to move, which preload next, how many are left."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from pydantic import Field

from monitor_core.errors import MonitorCoreError, NotIdentifiableError
from monitor_core.preload import (
    CalibrationPlan,
    ExpectedReadings,
    ModalReading,
    PlannedSetting,
    PositioningBolts,
    Weighting,
    calibrate,
    plan_calibration,
)
from monitor_core.recording import Conditions, ExcitationSource
from monitor_core.recordings.calibration_file import calibration_from_document
from monitor_core.recordings.elements.units import metres, to_millimetres
from service.operations.fields import MILLIMETRES, NEWTONS, RequestModel
from service.operations.monitoring.axis_configuration import AxisConfiguration, load_configuration
from service.store import calibrations, measurements
from service.store.axes import get_axis
from service.store.database import Database
from service.store.measurements import SetMeasurement

if TYPE_CHECKING:
    from monitor_core.models.preload_share import PreloadLevel

#: Settings of a plan: so many positions over the travel, so many preloads up to the highest.
POSITIONS, PRELOADS = 5, 3
#: So many of the newest measurements are planned from: each setting four times. What was measured of an older nut or
#: mounting says nothing of the next setting.
MOST_PLANNED: Final = 4 * POSITIONS * PRELOADS
#: Part of the screw that a table can be near its ends, and preloads as shares of the highest.
_MARGIN: Final = 0.1
_SHARES: Final = (1.0 / 3.0, 2.0 / 3.0, 1.0)
#: The loss that a calibration is to see, of the highest preload, where none is wished for.
_WISHED: Final = 0.3
#: Settings nearer to each other than this were meant to be one [mm], [-].
_NEAR_MM, _NEAR_SHARE = 20.0, 0.1
#: Where nothing is known of an axis [mm], [N].
_USUAL_TRAVEL, _USUAL_PRELOAD = (100.0, 900.0), 300.0

Source = Literal["measured", "calibration", "model", "none"]


class PlanIn(RequestModel):
    """Over which positions and preloads; what is left out follows from the axis."""

    from_mm: Annotated[float, MILLIMETRES] | None = None
    to_mm: Annotated[float, MILLIMETRES] | None = None
    highest_n: Annotated[float, NEWTONS, Field(description="the healthy preload, highest to be set")] | None = None
    wished_loss_n: Annotated[float, NEWTONS, Field(description="that the calibration is to see")] | None = None
    bolt_mm: (
        Annotated[float, Field(ge=0.5, le=100, description="nominal diameter of those that set the preload")] | None
    ) = None
    bolts: Annotated[int, Field(ge=1, le=100, description="that share the preload")] = 2


@dataclass(frozen=True, slots=True)
class PreloadToSet:
    """A preload of a plan as makers and mechanics know it."""

    preload: float  # [N]
    share: float | None  # of the dynamic load rating [-]; None: not stated
    level: "PreloadLevel | None"  # what it is called
    bolt_torque: float | None  # at each bolt [N·m]; None: the bolts are not stated


@dataclass(frozen=True, slots=True)
class AxisPlan:
    """A plan, and what it rests on."""

    positions_mm: tuple[float, ...]
    preloads_n: tuple[float, ...]
    wished_loss_n: float
    measured: list[SetMeasurement]
    plan: CalibrationPlan
    source: Source  # of the expected scatter
    to_set: list[PreloadToSet]

    @property
    def usable(self) -> list[SetMeasurement]:
        """What can be fitted: measurements in which the mode was found."""
        return [item for item in self.measured if item.frequency_hz is not None]


def calibration_plan(database: Database, axis_id: str, asked: PlanIn) -> AxisPlan:
    """Return the plan of an axis.

    Raises UnknownResourceError if there is no such axis; NotIdentifiableError if the travel is none.
    """
    with database.read() as session:
        axis = get_axis(session, axis_id)
        configuration = load_configuration(axis.configuration)
        measured = measurements.set_measurements(session, axis, MOST_PLANNED)
        in_force = None
        if axis.active_calibration_id is not None:
            in_force = calibrations.get_calibration(session, axis_id, axis.active_calibration_id).document
    places, preloads = _grid(configuration, measured, asked)
    usable = [item for item in measured if item.frequency_hz is not None]
    source: Source = "measured"
    expected = _from_measured(usable)
    if expected is None and in_force is not None:
        calibration = calibration_from_document(in_force)
        source, expected = "calibration", ExpectedReadings(calibration.coefficients, calibration.residual_sd)
    if expected is None:
        source, expected = "model", _from_model(configuration, places, preloads)
    grid = [PlannedSetting(metres(place), preload) for preload in preloads for place in places]
    wished = asked.wished_loss_n or float(f"{_WISHED * max(preloads):.2g}")
    done = [PlannedSetting(metres(item.position_mm), item.set_preload_n) for item in usable]
    plan = plan_calibration(done, grid, expected, healthy_preload=max(preloads), wished_loss=wished)
    to_set = _to_set(configuration, preloads, asked)
    return AxisPlan(places, preloads, wished, measured, plan, "none" if expected is None else source, to_set)


def _to_set(configuration: AxisConfiguration, preloads: tuple[float, ...], asked: PlanIn) -> list[PreloadToSet]:
    from monitor_core.models.preload_share import preload_level  # noqa: PLC0415  # a start pays for no analysis

    rating = _load_rating(configuration)
    bolts = None if asked.bolt_mm is None else PositioningBolts(metres(asked.bolt_mm), asked.bolts)
    shares = [None if rating is None else preload / rating for preload in preloads]
    return [
        PreloadToSet(
            preload,
            share,
            None if share is None else preload_level(share),
            None if bolts is None else bolts.torque(preload),
        )
        for preload, share in zip(preloads, shares, strict=True)
    ]


def _grid(
    configuration: AxisConfiguration, measured: Sequence[SetMeasurement], asked: PlanIn
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return positions [mm] and preloads [N]: those asked for, of the drive, of what was measured, or usual ones."""
    low, high = _USUAL_TRAVEL
    if (length := _screw_length(configuration)) is not None:
        low, high = _MARGIN * to_millimetres(length), (1.0 - _MARGIN) * to_millimetres(length)
    own_places = _levels([item.position_mm for item in measured], lambda level: _NEAR_MM)
    own_preloads = _levels([item.set_preload_n for item in measured], lambda level: _NEAR_SHARE * level)
    grid_asked = (asked.from_mm, asked.to_mm, asked.highest_n) != (None, None, None)
    if not grid_asked and len(own_places) >= 3 and len(own_preloads) >= 2:
        return own_places, own_preloads  # whoever measures has a plan of his own
    if len(own_places) >= 3:
        low, high = own_places[0], own_places[-1]
    low, high = (given if given is not None else own for given, own in ((asked.from_mm, low), (asked.to_mm, high)))
    if not high - low >= 10.0:
        raise NotIdentifiableError(f"the travel of a calibration must be 10 mm or more; got {low:g} to {high:g} mm")
    highest = asked.highest_n or max([item.set_preload_n for item in measured], default=None)
    highest = highest or configuration.commissioned_preload_n or _rated(configuration) or _USUAL_PRELOAD
    places = tuple(float(round(place)) for place in np.linspace(low, high, POSITIONS))
    return places, tuple(float(f"{share * highest:.3g}") for share in _SHARES)


def _levels(values: Sequence[float], near: Callable[[float], float]) -> tuple[float, ...]:
    """Return the levels of a quantity that was set: those nearer to each other than a setting repeats are one."""
    levels: list[list[float]] = []
    for value in sorted(values):
        if levels and value - levels[-1][0] <= near(levels[-1][0]):
            levels[-1].append(value)
        else:
            levels.append([value])
    return tuple(float(f"{np.mean(level):.4g}") for level in levels)


def _from_measured(usable: Sequence[SetMeasurement]) -> ExpectedReadings | None:
    """Return what the measurements themselves show, once they can be fitted with three to spare."""
    if len(usable) < 7:
        return None
    loaded = all(item.payload_kg is not None for item in usable)
    heated = all(item.temperature_c is not None for item in usable)
    readings = []
    for item in usable:
        payload, temperature = item.payload_kg if loaded else None, item.temperature_c if heated else None
        conditions = Conditions(metres(item.position_mm), payload, temperature, item.set_preload_n)
        if item.frequency_hz is not None:
            readings.append(ModalReading(item.frequency_hz, conditions))
    try:
        fitted = calibrate(readings, weighting=Weighting.NONE, excitation_source=None)
    except MonitorCoreError:
        return None
    return ExpectedReadings(fitted.coefficients, fitted.residual_sd)


def _from_model(
    configuration: AxisConfiguration, places: tuple[float, ...], preloads: tuple[float, ...]
) -> ExpectedReadings | None:
    if configuration.drive_model is None or configuration.search_band_hz is None:
        return None
    try:
        return _expected_of_model(
            configuration.drive_model, configuration.search_band_hz, places, preloads, configuration.excitation_source
        )
    except MonitorCoreError:  # the band holds several modes, or a place is beyond the screw
        return None


@lru_cache(maxsize=64)
def _expected_of_model(
    text: str, band: tuple[float, float], places: tuple[float, ...], preloads: tuple[float, ...], source: str
) -> ExpectedReadings:
    from monitor_core.identification import readings_expected_of  # noqa: PLC0415  # a start pays for no analysis
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415

    axis = parse_model(text, "drive_model")
    at = tuple(metres(place) for place in places)
    return readings_expected_of(axis.build(), band, (at, preloads), ExcitationSource(source))


def _screw_length(configuration: AxisConfiguration) -> float | None:
    return None if configuration.drive_model is None else _parameters(configuration.drive_model).get("screw_length_m")


def _rated(configuration: AxisConfiguration) -> float | None:
    """Return the preload that makers set in such a nut; None if its load rating is not stated [N]."""
    from monitor_core.models.catalogue import NutKind  # noqa: PLC0415  # a start pays for no analysis

    rating = _load_rating(configuration)
    return None if rating is None else float(f"{NutKind.DOUBLE.usual_share * rating:.2g}")


def _load_rating(configuration: AxisConfiguration) -> float | None:
    if configuration.drive_model is None:
        return None
    return _parameters(configuration.drive_model).get("dynamic_load_rating_n")


@lru_cache(maxsize=64)
def _parameters(text: str) -> dict[str, float]:
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415  # a start pays for no analysis

    return dict(parse_model(text, "drive_model").parameters)
