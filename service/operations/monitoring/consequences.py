"""Predict what other settings of an axis would change, before they are saved."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from itertools import pairwise

from sqlalchemy.orm import Session

from monitor_core.preload import Calibration, axial_frequency, preload_feature, preload_from_feature
from monitor_core.trend import DetectorDesign, DetectorState, detection_delay
from service.clock import now
from service.documents.consequences import (
    Consequence,
    Gaps,
    InBand,
    Limit,
    of_band,
    of_commissioned,
    of_limit,
    of_limits_in_time,
    of_machine,
    of_silence,
    of_windows,
)
from service.json_types import Json
from service.operations.monitoring.axis_configuration import (
    AxisConfiguration,
    detector_design,
    detector_settings,
    load_configuration,
)
from service.operations.monitoring.intake.chart_state import load_design, load_state
from service.store import axes, calibrations
from service.store.database import Database
from service.store.tables import AxisRow
from service.store.trend.points import Span, newest_point
from service.store.trend.sessions import UNCALIBRATED, newest_sessions
from service.store.trend.shown import PageOf, page_of_points

#: The loss that is spoken of [N].
LOSS_N = 20.0
#: The newest sessions and frequencies that are looked at.
MOST_SESSIONS, MOST_FREQUENCIES = 400, 200


@dataclass(frozen=True, slots=True)
class Change:
    """A setting that is stored, and what it would become."""

    setting: str
    before: Json
    after: Json


@dataclass(frozen=True, slots=True)
class Outlook:
    """What would be changed, and what follows from it."""

    changes: tuple[Change, ...]
    consequences: tuple[Consequence, ...]


def changes_between(
    before: tuple[str, AxisConfiguration], after: tuple[str, AxisConfiguration]
) -> tuple[Change, ...]:  # fmt: skip
    """Return how two names and configurations differ."""
    old, new = ({"name": name} | configuration.model_dump(mode="json") for name, configuration in (before, after))
    return tuple(Change(setting, value, new[setting]) for setting, value in old.items() if value != new[setting])


def outlook_of(database: Database, axis_id: str, name: str, wanted: AxisConfiguration) -> Outlook:
    """Return what this name and configuration would change.

    Raises OutsideValidityError if no limits of the charts give the wanted rate of false alarms.
    """
    with database.read() as session:
        row = axes.get_axis(session, axis_id)
        stored = load_configuration(row.configuration)
        changes = changes_between((row.name, stored), (name, wanted))
        changed = {change.setting for change in changes}
        look = _Look(session, row, stored, wanted)
        return Outlook(changes, tuple(look.consequences(changed)))


@dataclass(frozen=True, slots=True)
class _Look:
    """An axis, and what it is to become."""

    session: Session
    row: AxisRow
    stored: AxisConfiguration
    wanted: AxisConfiguration

    def consequences(self, changed: set[str]) -> Iterator[Consequence]:
        if changed & {"false_alarms_per_year", "measurements_per_year"}:
            yield self._of_limit()
            yield of_limits_in_time()
        if "silent_after_hours" in changed:
            yield from self._of_silence()
        if "windows_per_measurement" in changed:
            yield of_windows(self.stored.windows_per_measurement, self.wanted.windows_per_measurement)
        if "search_band_hz" in changed and self.wanted.search_band_hz is not None:
            yield from self._of_band(*self.wanted.search_band_hz)
        if changed & {"machine", "machine_place"}:
            yield of_machine(self.wanted.machine, self._n_others())
        if "commissioned_preload_n" in changed:
            yield self._of_commissioned()

    def _of_limit(self) -> Consequence:
        stored, after = load_design(self.row.detector_design), detector_design(detector_settings(self.wanted))
        calibration = calibrations.active_calibration(self.session, self.row)
        detector = load_state(self.row.monitor_state).detector
        old, new = (
            Limit(design.settings.false_alarms_per_year, _delay_days(design, detector, calibration))
            for design in (stored, after)
        )
        return of_limit(old, new, LOSS_N)

    def _of_silence(self) -> Iterator[Consequence]:
        charted_under = self.row.active_calibration_id or UNCALIBRATED
        sessions = newest_sessions(self.session.connection(), self.row.number, charted_under, MOST_SESSIONS)
        gaps = [later.started_at - earlier.last_at for earlier, later in pairwise(sessions)]

        def longer(hours: float) -> Gaps:
            n_gaps = sum(gap > timedelta(hours=hours) for gap in gaps)
            return Gaps(hours, n_gaps, len(gaps) + 1 if gaps else 0)

        heard, hours = self.row.last_charted_at, self.wanted.silent_after_hours
        silent = None if heard is None else now() - heard
        silent_now = silent is not None and (
            timedelta(hours=hours) < silent <= timedelta(hours=self.stored.silent_after_hours)
        )
        yield from of_silence(longer(self.stored.silent_after_hours), longer(hours), silent_now=silent_now)

    def _of_band(self, low: float, high: float) -> Iterator[Consequence]:
        newest = PageOf(Span(), MOST_FREQUENCIES, newest_first=True)
        points = page_of_points(self.session.connection(), self.row.number, newest)
        frequencies = [point.frequency_hz for point in points if point.frequency_hz is not None]
        n_outside = sum(not low <= frequency <= high for frequency in frequencies)
        yield from of_band(InBand(low, high, n_outside, len(frequencies), self.row.active_calibration_id is not None))

    def _n_others(self) -> int:
        """Count the other axes of the machine."""
        machine = self.wanted.machine
        return sum(
            axis_id != self.row.id and isinstance(configuration, dict) and configuration.get("machine") == machine
            for axis_id, configuration in axes.configurations(self.session).items()
        )

    def _of_commissioned(self) -> Consequence:
        commissioned = self.wanted.commissioned_preload_n
        newest = newest_point(self.session.connection(), self.row.number)
        if commissioned is None or newest is None or newest.preload_n is None:
            return of_commissioned(commissioned, None)
        return of_commissioned(commissioned, newest.preload_n / commissioned)


def _delay_days(design: DetectorDesign, detector: DetectorState, calibration: Calibration | None) -> float | None:
    """Return after how many days a loss is alarmed on average; None as long as there is no baseline to lose from."""
    baseline = detector.baseline
    if baseline is None or calibration is None:
        return None
    coefficients, place = calibration.coefficients, calibration.position.lower
    preload = preload_from_feature(baseline.mean, coefficients) - LOSS_N
    if preload <= 0.0:
        return None
    lost = preload_feature(axial_frequency(place, preload, coefficients), place, coefficients)
    scatter = (baseline.scatter**2 + baseline.standard_uncertainty**2) ** 0.5
    return detection_delay(detector.of(design), (lost - baseline.mean) / scatter).days
